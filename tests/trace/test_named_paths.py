"""Paths by what a report calls them, in Python and from the shell."""

from __future__ import annotations

import warnings

import pytest
from command_line import fails

import mistray

pytestmark = pytest.mark.filterwarnings("ignore:.*few rays")


@pytest.fixture(scope="module")
def scene():
    return mistray.coat("singlet_window_detector", {}, scatter={"window_front": ["harvey_shack rms_nm=5"]})


@pytest.fixture(scope="module")
def traced(scene) -> mistray.Trace:
    """Two wavelengths, and light that is scattered at random and aimed."""
    return mistray.trace(scene, rays=400, field_deg=1.0, wavelength_nm=[500.0, 600.0])


def test_every_printed_name_means_its_row(traced) -> None:
    rows = traced.paths.by_way()
    chosen = [*range(12), *range(12, len(rows), len(rows) // 12)]
    assert any("scatter at" in rows.label[k] for k in chosen)
    assert any(":" in rows.label[k] for k in chosen)
    assert any(len(rows.path_ids[k]) == 2 for k in chosen), "light at random and aimed"
    for k in chosen:
        expected = {i for ids in rows.path_ids[rows.label == rows.label[k]] for i in ids}
        for text in (rows.label[k], rows.label[k].replace(" → ", "->")):
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                assert {row.path_id for row in traced.paths.select(text)} == expected, text
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = {row.events for row in traced.paths.select(rows.events[k])}
        assert found == {traced.paths[i].events for i in expected}


def test_a_name_within_a_filter(traced) -> None:
    label = next(row.label for row in traced.paths if row.label.startswith("detector →"))
    whole = traced.paths.select(label)
    assert len(whole) == 2, "one at each wavelength"
    assert traced.paths.select(f"'{label}' & wavelength_nm = 500") == [r for r in whole if r.wavelength_nm == 500.0]
    assert len(traced.rays(label, n=20)) == 20
    # A short name says how many
    names = {row.label for row in traced.paths if row.label.startswith("detector → w")}
    with pytest.warns(mistray.MistrayWarning, match=f"means {len(names)} paths together") as told:
        rows = traced.paths.select("detector -> w*")
    assert {row.label for row in rows} == names
    assert [one.message.code for one in told] == ["several-paths"]
    # A name that no light has
    label = next(row.label for row in traced.paths if row.label.startswith("detector →"))
    first, last = label.split(" → ")
    with pytest.warns(mistray.MistrayWarning, match=f"did you mean '{label}'") as told:
        assert traced.paths.select(f"{last} -> {first}") == []
    assert [one.message.code for one in told] == ["no-path"]


def test_wrong_names_are_refused_before_the_trace(scene) -> None:
    for call, near in (
        (lambda: mistray.optimize.path_power(scene, "detectr -> L1_front", rays=1e9), "'detector'"),
        (lambda: mistray.trace(scene, n_rays=1), "did you mean 'rays'"),
        (lambda: mistray.ghosts(scene, feild_deg=1), "did you mean 'field_deg'"),
        (lambda: mistray.sweep(scene, n_rays=1), "did you mean 'rays'"),
        (lambda: mistray.view(scene, pathids=[1]), "did you mean 'path_ids'"),
    ):
        with pytest.raises(mistray.MistrayError, match=near):
            call()


def test_commands_refuse_before_they_trace(capsys, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments, words in (
        (("goasts", "phone_camera"), ("'ghosts'?", "See 'mistray --help'")),
        (("ghosts", "phone_camera", "--feild-deg", "20"), ("--field-deg?", "See 'mistray ghosts --help'")),
    ):
        message = fails(capsys, *arguments)
        assert all(word in message for word in words)
    for command, option in (("ghosts", "--filter"), ("view", "--path-ids"), ("sensitivity", "--paths")):
        wrong = [command, "singlet_window_detector", option, "L1_fron -> L1_rear", "--rays", "1e9"]
        assert "'L1_front'" in fails(capsys, *wrong)

"""Names of paths tell them apart in every table."""

from __future__ import annotations

import warnings

import pytest

import mistray
from mistray.analysis.pst.causes import stray_paths
from mistray.errors import MistrayWarning
from mistray.recorders.path_events import path_names
from mistray.scene.load import shipped_scenes


def test_a_label_of_its_own_is_kept() -> None:
    assert path_names(["a:T b:R d:A", "a:r d:A"], ["b", "scatter at a"]) == ["b", "scatter at a"]


def test_paths_of_one_label_are_named_by_their_turns() -> None:
    assert path_names(["a:t b:T d:A", "a:r b:T d:A"], ["scatter at a"] * 2) == ["a:t", "a:r"]


def test_straight_shots_are_named_by_the_surfaces_that_not_all_pass() -> None:
    names = path_names(["a:T bevel:T d:A", "a:T edge:T c:T d:A", "d:A", "a:T d:A"], ["straight shot"] * 4)
    through = ["straight shot through a, bevel", "straight shot through a, edge, c", "straight shot through a"]
    assert [names[k] for k in (0, 1, 3)] == through
    assert names[2] == "straight shot past all surfaces"
    both = path_names(["a:T bevel:T d:A", "a:T edge:T c:T d:A"], ["straight shot"] * 2)
    assert both == ["straight shot through bevel", "straight shot through edge, c"]


def test_the_order_of_the_same_surfaces_makes_a_name() -> None:
    names = path_names(["a:T b:T d:A", "b:T a:T d:A", "a:T b:T a:T d:A"], ["straight shot"] * 3)
    assert len(set(names)) == 3


def test_equal_paths_share_a_name() -> None:
    first, second, other = path_names(["a:T d:A", "a:T d:A", "b:T d:A"], ["straight shot"] * 3)
    assert first == second != other


@pytest.mark.long
@pytest.mark.parametrize("scene", ["phone_camera", "double_gauss_barrel", "cassegrain", "lens_and_reflector"])
def test_no_name_is_blank_or_given_twice_in_a_pst(scene: str) -> None:
    pst = mistray.pst(mistray.load(scene), [18.0, 20.0, 22.0, 24.0], rays=4_000)
    for angle in pst.field_deg:
        rows = stray_paths(pst, angle)
        assert rows.events.is_unique
        assert rows.label.is_unique
        assert rows.label.str.strip().astype(bool).all()


@pytest.mark.parametrize(("scene", "field"), [("phone_camera", 20.0), ("double_gauss", 20.0), ("newtonian", 0.2)])
def test_no_name_is_blank_or_given_twice_in_a_table_of_ghosts(scene: str, field: float) -> None:
    table = mistray.ghosts(mistray.load(scene), field_deg=[0.0, field], rays=20_000).table(field)
    assert table.label.is_unique
    assert table.label.str.strip().astype(bool).all()


@pytest.mark.long
@pytest.mark.parametrize("scene", sorted(shipped_scenes()))
def test_every_path_of_a_trace_has_a_name_of_its_own(scene: str) -> None:
    """At two wavelengths, so that the same events occur twice; in the ledger, in its print and with ways added up."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MistrayWarning)  # of improbable scatter
        loaded = mistray.load(scene)
    paths = mistray.trace(loaded, field_deg=0.1, rays=512, wavelength_nm=[550.0, 600.0]).paths
    for table in (paths.to_pandas(), paths.by_way()):
        assert table.label.is_unique
        assert table.label.str.strip().astype(bool).all()
    for line, row in zip(str(paths).splitlines()[1:21], paths, strict=False):
        assert line.endswith(row.label)

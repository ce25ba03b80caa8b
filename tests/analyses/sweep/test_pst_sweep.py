"""The PST before and after edits: closed forms of each kind, paired errors, the command line, what is refused."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from command_line import fails, succeeds
from oracles.scatter_scenes import beam_xml, placed_xml, wall_xml
from oracles.small_scenes import interface_xml, plates_text, write

import mistray
from mistray.errors import MistrayError
from mistray.materials import refractive_index
from mistray.physics import thinfilm
from mistray.prescription import Structure
from mistray.sweeps import Configuration, PstSweep, rank_edits, read_configurations, sweep_pst

RAYS = 20_000
ANGLE = 10.0


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A plate before a detector, and beside them a white wall that light meets and the detector sees."""
    plate = placed_xml("asphere", "plate", interface_xml("air", "1.5"), semi_diameter=20.0)
    wall = placed_xml("asphere", "wall", wall_xml(0.4), at=(12.0, 0.0, 10.0), facing=(1.0, 0.0, 0.0), semi_diameter=5.0)
    detector = placed_xml("asphere", "detector", at=(0.0, 0.0, 20.0), pixels=4, semi_diameter=3.0)
    text = f'<scene version="3.0.0">{beam_xml(5.0)}{plate}{wall}{detector}</scene>'
    file = tmp_path / "scene.xml"
    file.write_text(text, encoding="utf-8")
    return file


def swept(scene: Path | mi.Scene, *configurations: Configuration, **more: Any) -> PstSweep:
    return sweep_pst(scene, configurations, [ANGLE], rays=RAYS, max_scatters=1, **more)


def test_nothing_changes_nothing(scene: Path) -> None:
    found = swept(scene, Configuration("nothing"))
    assert found.configurations == ("as it is", "nothing")
    change = found.changed("nothing", ANGLE, "total")
    assert change.ratio == 1
    assert change.ratio_se < 1e-12 * change.before_se / change.before  # sums of the same rays in another order
    assert change.before_se > 0
    assert not any("no stray light" in text for text in found.warnings)
    # Without scatter and reflections there is none: 0 ± 0 is no measurement
    dark = sweep_pst(scene, [Configuration("nothing")], [ANGLE], rays=1000, max_scatters=0, max_reflections=0)
    (text,) = [text for text in dark.warnings if "no stray light" in text]
    assert "10 deg" in text


@pytest.mark.long
def test_edits_say_that_their_light_is_unpolarised(tmp_path: Path) -> None:
    """The ghost of a plate at 45° is 1.548 times as bright by Stokes vectors; what is given is taken."""
    scene, edit = write(tmp_path, plates_text(1)), Configuration("bent", {"p0_front.curvature": [1e-5]})
    told = "Stokes vectors change the ghost p0_rear → p0_front by +54.8"
    found = sweep_pst(scene, [edit], [45.0], rays=2000)
    assert [text.partition(": ")[0] for text in found.warnings if told in text] == ["as it is", "bent"]
    assert not sweep_pst(scene, [edit], [45.0], rays=2000, polarization="unpolarized").warnings
    assert any(told in text for text in rank_edits(scene, 45.0, rays=2000, keys=["p0_front.z"]).left_out)


@pytest.mark.long
def test_painted_and_moved_light_is_in_proportion(scene: Path) -> None:
    """What the wall scatters once goes with its reflectance, ray by ray: the error of the ratio is that of float32."""
    found = swept(
        scene,
        Configuration("paint", paint={"w*": 0.1}),
        Configuration("preset", paint={"wall": "flat_black"}),
        Configuration("black", paint={"wall": 0.0}),
        Configuration("value", {"wall.bsdf.paint.reflectance": 0.3}),
    )
    for name, expected in (("paint", 0.25), ("preset", 0.045 / 0.4), ("black", 0.0), ("value", 0.75)):
        change = found.changed(name, ANGLE, "single_scatter")
        assert change.ratio == pytest.approx(expected, rel=1e-4), name
        assert change.ratio_se < 1e-4 * max(expected, 1e-9) + 1e-12 < change.before_se / change.before


def test_a_coating(scene: Path) -> None:
    """The direct image goes with T of the plate, at 10° and unpolarised."""
    found = swept(scene, Configuration("coat", coat={"plate": "MgF2 99.64"}), cell_deg=0.2)
    change = found.changed("coat", ANGLE, "direct")
    cosine = np.cos(np.radians(ANGLE))
    n = complex(refractive_index("MgF2", 550.0))
    coated, bare = (
        float(np.mean(thinfilm.reflectance_transmittance(1.0, layers, nm, 1.5, 550.0, cosine)[1]))
        for layers, nm in (([n], [99.64]), ([], []))
    )
    assert change.ratio == pytest.approx(coated / bare, rel=1e-4)


def test_a_block(scene: Path) -> None:
    """A disc before the detector takes all; one that stands aside nothing, and it widens the beam of forward rays."""
    covers = Configuration("covers", block=[Structure("covers", 0.0, 19.0, 15.0, 19.0)])
    aside = Configuration("aside", block=[Structure("aside", 50.0, 19.0, 51.0, 19.0)])
    assert swept(scene, covers).changed("covers", ANGLE, "direct").after == 0
    for method in ("joined", "forward"):
        change = swept(scene, aside, method=method).changed("aside", ANGLE, "total")
        assert (change.ratio, change.ratio_se) == (pytest.approx(1, abs=1e-6), pytest.approx(0, abs=1e-6))
        assert change.before_se > 0


@pytest.mark.long
def test_the_error_of_the_ratio(scene: Path) -> None:
    """
    Of 12 seeds the ratios spread as their errors say.

    χ² of 11 degrees of freedom between its quantiles 1e-4 and 1 - 1e-4; a rim that blocks a part of the light.
    """
    rim = Configuration("rim", block=[Structure("rim", 2.0, 15.0, 30.0, 15.0)])
    changes = [swept(scene, rim, seed=seed).changed("rim", ANGLE, "total") for seed in range(12)]
    ratios, errors = (np.array([getattr(change, key) for change in changes]) for key in ("ratio", "ratio_se"))
    chi2 = np.sum(((ratios - np.average(ratios, weights=errors**-2)) / errors) ** 2)
    assert 1.5 < chi2 < 37.4


@pytest.mark.long
def test_table_and_command(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edits = tmp_path / "edits.toml"
    edits.write_text(
        '[[configuration]]\nname = "grey"\npaint = { "wall" = 0.2 }\n'
        '[[configuration]]\nname = "ring"\nblock = [{ name = "ring", r0 = 4.0, r1 = 30.0, z0 = 15.0 }]\n'
        'values = { "detector.z" = 0.5 }\n'
        '[[configuration]]\nname = "coated"\ncoat = { "plate" = "MgF2 99.64" }\n',
        encoding="utf-8",
    )
    grey, ring, coated = read_configurations(edits)
    assert grey.paint == {"wall": 0.2}
    assert ring.block == [Structure("ring", 4.0, 15.0, 30.0, 15.0)]
    assert (coated.coat, coated.rebuilds) == ({"plate": "MgF2 99.64"}, True)
    out = tmp_path / "out"
    command = ["sweep", str(scene), str(edits), "--pst-field-deg", "0:20:10", "--rays", "5000", "--out", str(out)]
    record = json.loads(succeeds(capsys, *command, "--json"))
    assert record["configurations"] == ["as it is", "grey", "ring", "coated"]
    assert len(record["rows"]) == 9
    with (out / "pst_sweep.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    assert [float(row["after"]) for row in rows] == pytest.approx([row["after"] for row in record["rows"]])
    assert {file.name for file in out.iterdir()} == {
        "pst_sweep.csv", "pst_sweep.json", "pst_sweep.png", "report.html"
    }  # fmt: skip
    assert json.loads((out / "pst_sweep.json").read_text())["rows"] == record["rows"]
    assert "What each configuration does" in (out / "report.html").read_text(encoding="utf-8")
    assert "coated" in succeeds(capsys, *command, "--force")


def test_refuses(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for change, words in (
        ({"paint": {"wal": 0.1}}, "paint 'wal=0.1' fits no surface and no part; the nearest names are wall"),
        ({"paint": {"wall": "flat_blak"}}, "did you mean flat_black"),
        ({"coat": {"plate": "bbr3"}}, "coating 'bbr3'.*did you mean 'bbar3'"),
        ({"coat": {"wall": "bbar3"}}, "'wall' is opaque; give an opaque coating"),
        ({"block": [Structure("wall", 1.0, 0.0, 2.0, 0.0)]}, "it has an object 'wall' already"),
    ):
        with pytest.raises(MistrayError, match=f"configuration 'x'.*{words}") as caught:
            swept(scene, Configuration("x", **change))
        assert "\n" not in str(caught.value)
    with pytest.raises(MistrayError, match="relative_error would give the runs different rays"):
        swept(scene, Configuration("x"), relative_error=0.1)
    with pytest.raises(MistrayError, match="this name is that of the scene without changes"):
        swept(scene, Configuration("as it is"))
    with pytest.raises(MistrayError, match="no configuration 'y'"):
        swept(scene, Configuration("x")).changed("y", ANGLE)
    for more in (["--pst-field-deg", "10"], ["none.toml", "--pst-field-deg", "10", "--field-deg", "1"]):
        fails(capsys, "sweep", scene, *more)


def test_a_loaded_scene(scene: Path) -> None:
    """Edits of a loaded scene are those of its file, with its numbers as they are; it stays as it is."""
    key, paint = "wall.bsdf.paint.reflectance", Configuration("paint", paint={"w*": 0.1})
    loaded = mistray.load(scene)
    params = mi.traverse(loaded)
    assert swept(loaded, paint).changed("paint", ANGLE, "single_scatter").ratio == pytest.approx(0.25, rel=1e-4)
    assert np.ravel(params[key]) == pytest.approx([0.4])
    params[key] = type(params[key])(0.2)
    params.update()
    assert swept(loaded, Configuration("back", {key: 0.4})).changed("back", ANGLE).ratio == pytest.approx(2, rel=1e-4)
    assert np.ravel(params[key]) == pytest.approx([0.2])
    with pytest.raises(MistrayError, match=r"configuration 'paint': 'wall.bsdf.paint.reflectance' of the scene is"):
        swept(loaded, paint)
    # A scene of a dict is moved and not painted
    place = mi.ScalarTransform4f().translate([0, 0, -20])
    detector = {"type": "asphere", "semi_diameter": 3.0, "bsdf": {"type": "interface", "R": 0.0, "T": 0.0}}
    detector["sensor"] = {"type": "irradiancemeter"}
    light = {"type": "collimated", "radius": 3.0, "to_world": place}
    given = {"type": "scene", "light": light, "detector": detector}
    loaded = mistray.load(given)
    found = sweep_pst(loaded, {"moved": {"detector.z": 1.0}}, [ANGLE], rays=2000)
    assert found.changed("moved", ANGLE, "direct").ratio == pytest.approx(1, abs=0.05)
    with pytest.raises(MistrayError, match="a scene of a dict cannot be painted"):
        sweep_pst(loaded, [Configuration("dark", paint={"detector": 0.1})], [ANGLE], rays=2000)

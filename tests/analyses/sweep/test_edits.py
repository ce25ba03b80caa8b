"""Edits and their PSTs: closed forms of each kind, the ranking, paired errors, the command line, what is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
from command_line import fails, succeeds
from oracles.object_scenes import common_area
from oracles.scatter_scenes import beam_xml, placed_xml, scatter_scene, wall_xml
from oracles.small_scenes import interface_xml, plates_text, write
from refusals import refused

import mistray
from mistray.materials import refractive_index
from mistray.optimize import pst_bin
from mistray.physics import thinfilm
from mistray.prescription import Structure
from mistray.sweeps import Configuration, EditRanking, PstSweep, rank_edits, read_configurations, sweep_pst

RAYS = 20_000
FIELD = 10.0
ANGLE, CELL = 15.0, 28.0  # of the ranking
HOLE, DETECTOR, DISTANCE = 2.5, 3.0, 10.0
LAYER_NM, GLASS = 60.0, 1.5
SIGMAS = 4.5


def plate_and_wall(film: str = "", *more: str) -> str:
    """A plate before a detector, and beside them a grey wall that light meets and the detector sees."""
    glass = interface_xml("air", str(GLASS)).removesuffix("</bsdf>") + film + "</bsdf>"
    plate = placed_xml("asphere", "plate", glass, semi_diameter=20.0)
    wall = placed_xml("asphere", "wall", wall_xml(0.4), at=(12.0, 0.0, 10.0), facing=(1.0, 0.0, 0.0), semi_diameter=5.0)
    detector = placed_xml("asphere", "detector", at=(0.0, 0.0, 20.0), pixels=4, semi_diameter=DETECTOR)
    return scatter_scene(beam_xml(5.0), plate, *more, wall, detector)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return write(tmp_path, plate_and_wall())


def swept(scene: Path | mi.Scene, *configurations: Configuration, **more: Any) -> PstSweep:
    return sweep_pst(scene, configurations, [FIELD], rays=RAYS, max_scatters=1, **more)


def test_nothing_changes_nothing(scene: Path) -> None:
    found = swept(scene, Configuration("nothing"))
    assert found.configurations == ("as it is", "nothing")
    change = found.changed("nothing", FIELD, "total")
    assert change.ratio == 1
    assert change.ratio_se < 1e-12 * change.before_se / change.before  # sums of the same rays in another order
    assert change.before_se > 0
    assert not any("no stray light" in text for text in found.warnings)
    # Without scatter and reflections there is none: 0 ± 0 is no measurement
    dark = sweep_pst(scene, [Configuration("nothing")], [FIELD], rays=1000, max_scatters=0, max_reflections=0)
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
        change = found.changed(name, FIELD, "single_scatter")
        assert change.ratio == pytest.approx(expected, rel=1e-4), name
        assert change.ratio_se < 1e-4 * max(expected, 1e-9) + 1e-12 < change.before_se / change.before


def test_a_coating(scene: Path) -> None:
    """The direct image goes with T of the plate, at 10° and unpolarised."""
    found = swept(scene, Configuration("coat", coat={"plate": "MgF2 99.64"}), cell_deg=0.2)
    change = found.changed("coat", FIELD, "direct")
    cosine = np.cos(np.radians(FIELD))
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
    assert swept(scene, covers).changed("covers", FIELD, "direct").after == 0
    for method in ("joined", "forward"):
        change = swept(scene, aside, method=method).changed("aside", FIELD, "total")
        assert (change.ratio, change.ratio_se) == (pytest.approx(1, abs=1e-6), pytest.approx(0, abs=1e-6))
        assert change.before_se > 0


@pytest.mark.long
def test_the_error_of_the_ratio(scene: Path) -> None:
    """
    Of 12 seeds the ratios spread as their errors say.

    χ² of 11 degrees of freedom between its quantiles 1e-4 and 1 - 1e-4; a rim that blocks a part of the light.
    """
    rim = Configuration("rim", block=[Structure("rim", 2.0, 15.0, 30.0, 15.0)])
    changes = [swept(scene, rim, seed=seed).changed("rim", FIELD, "total") for seed in range(12)]
    ratios, errors = (np.array([getattr(change, key) for change in changes]) for key in ("ratio", "ratio_se"))
    chi2 = np.sum(((ratios - np.average(ratios, weights=errors**-2)) / errors) ** 2)
    assert 1.5 < chi2 < 37.4


@pytest.mark.long
def test_tables_and_command(ringed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edits = tmp_path / "edits.toml"
    edits.write_text(
        '[[configuration]]\nname = "grey"\npaint = { "wall" = 0.2 }\n'
        '[[configuration]]\nname = "rim"\nblock = [{ name = "rim", r0 = 4.0, r1 = 30.0, z0 = 15.0 }]\n'
        'values = { "detector.z" = 0.5 }\n'
        '[[configuration]]\nname = "coated"\ncoat = { "plate" = "MgF2 99.64" }\n',
        encoding="utf-8",
    )
    grey, rim, coated = read_configurations(edits)
    assert grey.paint == {"wall": 0.2}
    assert rim.block == [Structure("rim", 4.0, 15.0, 30.0, 15.0)]
    assert (coated.coat, coated.rebuilds) == ({"plate": "MgF2 99.64"}, True)
    out, few = tmp_path / "out", ["--pst-field-deg", "0:20:10", "--rays", "5000", "--max-scatters", "1"]
    ranking = ["--rank", "--step", "rim=0.3", "share=2%"]
    assert "rows" not in json.loads(succeeds(capsys, "sweep", ringed, *few, *ranking, "--json"))
    command = ["sweep", ringed, edits, *few, *ranking, "--out", out]
    record = json.loads(succeeds(capsys, *command, "--json"))
    assert record["configurations"] == ["as it is", "grey", "rim", "coated"]
    assert len(record["rows"]) == 9
    assert {row["step"] for row in record["ranking"] if row["method"] == "block"} == {0.3}
    rows, ranked_rows = (
        pd.read_csv(out / f"{name}.csv", comment="#", keep_default_na=False) for name in ("pst_sweep", "edit_ranking")
    )
    assert list(rows.after) == pytest.approx([row["after"] for row in record["rows"]])
    assert list(ranked_rows.label) == [row["label"] for row in record["ranking"]]
    assert {"pst_sweep.json", "pst_sweep.png", "report.html"} < {file.name for file in out.iterdir()}
    assert json.loads((out / "pst_sweep.json").read_text())["rows"] == record["rows"]
    assert "What each configuration does" in (out / "report.html").read_text(encoding="utf-8")
    printed = succeeds(capsys, *command, "--force")
    assert all(text in printed for text in ("coated", "grey", "wall.bsdf.paint.reflectance"))


def test_wrong_edits_are_refused(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for change, words in (
        ({"paint": {"wal": 0.1}}, "paint 'wal=0.1' fits no surface and no part; the nearest names are wall"),
        ({"paint": {"wall": "flat_blak"}}, "did you mean flat_black"),
        ({"coat": {"plate": "bbr3"}}, "coating 'bbr3'.*did you mean 'bbar3'"),
        ({"coat": {"wall": "bbar3"}}, "'wall' is opaque; give an opaque coating"),
        ({"block": [Structure("wall", 1.0, 0.0, 2.0, 0.0)]}, "it has an object 'wall' already"),
    ):
        with refused(f"configuration 'x'.*{words}"):
            swept(scene, Configuration("x", **change))
    with refused("relative_error would give the runs different rays"):
        swept(scene, Configuration("x"), relative_error=0.1)
    with refused("this name is that of the scene without changes"):
        swept(scene, Configuration("as it is"))
    with refused("no configuration 'y'"):
        swept(scene, Configuration("x")).changed("y", FIELD)
    for more in (["--pst-field-deg", "10"], ["none.toml", "--pst-field-deg", "10", "--field-deg", "1"]):
        fails(capsys, "sweep", scene, *more)


def test_a_loaded_scene(scene: Path) -> None:
    """Edits of a loaded scene are those of its file, with its numbers as they are; it stays as it is."""
    key, paint = "wall.bsdf.paint.reflectance", Configuration("paint", paint={"w*": 0.1})
    loaded = mistray.load(scene)
    params = mi.traverse(loaded)
    assert swept(loaded, paint).changed("paint", FIELD, "single_scatter").ratio == pytest.approx(0.25, rel=1e-4)
    assert np.ravel(params[key]) == pytest.approx([0.4])
    params[key] = type(params[key])(0.2)
    params.update()
    assert swept(loaded, Configuration("back", {key: 0.4})).changed("back", FIELD).ratio == pytest.approx(2, rel=1e-4)
    assert np.ravel(params[key]) == pytest.approx([0.2])
    with refused(r"configuration 'paint': 'wall.bsdf.paint.reflectance' of the scene is"):
        swept(loaded, paint)
    # A scene of a dict is moved and not painted
    place = mi.ScalarTransform4f().translate([0, 0, -20])
    detector = {"type": "asphere", "semi_diameter": 3.0, "bsdf": {"type": "interface", "R": 0.0, "T": 0.0}}
    detector["sensor"] = {"type": "irradiancemeter"}
    light = {"type": "collimated", "radius": 3.0, "to_world": place}
    given = {"type": "scene", "light": light, "detector": detector}
    loaded = mistray.load(given)
    found = sweep_pst(loaded, {"moved": {"detector.z": 1.0}}, [FIELD], rays=2000)
    assert found.changed("moved", FIELD, "direct").ratio == pytest.approx(1, abs=0.05)
    with refused("a scene of a dict cannot be painted"):
        sweep_pst(loaded, [Configuration("dark", paint={"detector": 0.1})], [FIELD], rays=2000)


@pytest.fixture(scope="module")
def ringed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a coating on the plate, and a ring through whose hole the detector sees the light."""
    film = f'<bsdf type="thinfilm"><string name="layers" value="MgF2 {LAYER_NM}"/></bsdf>'
    ring = placed_xml("frustum", "ring", r0=HOLE, z0=20.0 - DISTANCE, r1=8.0, z1=20.0 - DISTANCE)
    return write(tmp_path_factory.mktemp("edits"), plate_and_wall(film, ring))


def ranked(scene: Any, light: str = "total", **more: Any) -> EditRanking:
    return rank_edits(scene, [ANGLE], light, **{"rays": 30_000, "max_scatters": 1, "cell_deg": CELL, **more})


def through_the_hole(hole: float = HOLE, distance: float = DISTANCE, nm: float = LAYER_NM) -> float:
    """Direct PST, mean over the solid angle of the cell: T cos θ times the part of the detector that sees the sky."""
    edges = np.radians(np.linspace(ANGLE - CELL / 2, ANGLE + CELL / 2, 2001))
    theta = (edges[1:] + edges[:-1]) / 2
    index = complex(refractive_index("MgF2", 550.0))
    values = []
    for angle in theta:
        d = distance * math.tan(math.asin(math.sin(angle) / GLASS))  # between hole and detector, seen along the light
        passed = float(
            np.mean(thinfilm.reflectance_transmittance(1.0, [index], [nm], GLASS, 550.0, math.cos(angle))[1])
        )
        values.append(passed * math.cos(angle) * common_area(d, hole, DETECTOR) / (math.pi * DETECTOR**2))
    return float(np.average(values, weights=np.diff(-np.cos(edges))))


@pytest.mark.long
def test_closed_forms(ringed: Path) -> None:
    """All four methods: four comparisons within 4.5 standard errors, false alarm 3e-5; the widest error is 10 %."""
    found = ranked(ringed, "direct", rays=1_200_000)
    value, error = found.pst[0]
    assert value == pytest.approx(through_the_hole(), abs=SIGMAS * error)
    expected = {
        "ring.r0": ("block", 0.1, through_the_hole(hole=HOLE + 0.05) - through_the_hole(hole=HOLE - 0.05)),
        "ring.z": (
            "move", 0.1, through_the_hole(distance=DISTANCE - 0.05) - through_the_hole(distance=DISTANCE + 0.05)
        ),
        "plate.bsdf.coating.thickness_nm": (
            "coat", 1.0, through_the_hole(nm=LAYER_NM + 0.5) - through_the_hole(nm=LAYER_NM - 0.5)
        ),
    }  # fmt: skip
    for label, (method, step, change) in expected.items():
        edit = found[label]
        assert (edit.method, edit.step) == (method, step)
        derivative = edit.derivative[0]
        assert derivative.value * step == pytest.approx(change, abs=SIGMAS * derivative.se * step), label
        assert derivative.se * step < 0.1 * change
    painted = ranked(ringed, "single_scatter")["wall.bsdf.paint.reflectance"]
    assert painted.method == "paint"
    assert painted.step == pytest.approx(0.004)
    # The light goes with the reflectance, ray by ray: nothing is uncertain about the relative change
    assert painted.change[0] == (pytest.approx(0.01, rel=1e-5), pytest.approx(0, abs=1e-7))
    assert painted.derivative[0].se > 1e-3 * painted.derivative[0].value


@pytest.mark.long
def test_parts_move_as_a_whole() -> None:
    """The derivative by the place of a lens is the sum of those by its surfaces, which are no edits of their own."""
    scene, settings = mistray.load("baffle_tube"), {"rays": 20_000, "max_scatters": 1, "cell_deg": 8}
    found = rank_edits(scene, [6], keys=["lens_front.z", "detector.z", "*.tilt_x"], **settings)
    keys = ["lens_front.z", "lens_rear.z", "lens_edge.z"]
    gradient = mistray.gradient(pst_bin(scene, 6, **settings), mi.traverse(scene), keys)
    whole = sum(gradient.gradient[key][0] for key in keys)
    assert whole != 0
    assert found["lens.z"].derivative[0].value == pytest.approx(whole, rel=1e-9)
    labels = {edit.label for edit in found.edits}
    assert {"detector.z", "detector.tilt_x"} < labels
    assert not {*keys, "lens_front.tilt_x"} & labels


@pytest.mark.long
def test_several_angles_share_one_pst(ringed: Path) -> None:
    both = rank_edits(ringed, [ANGLE, 25.0], "total", rays=20_000, max_scatters=1)
    metric = pst_bin(mistray.load(ringed), 25.0, "total", pst_field_deg=[ANGLE, 25.0], rays=20_000, max_scatters=1)
    # One width of the zones at rims for all edits, where a gradient by one of them may choose another
    gradient = mistray.gradient(metric, mi.traverse(metric.scene), ["ring.r0"], edge_width=both.edge_width[1])
    # Sums over lanes are in any order
    assert both.pst[1].value == pytest.approx(gradient.value, rel=1e-12)
    assert both["ring.r0"].derivative[1].value == pytest.approx(gradient.gradient["ring.r0"][0], rel=1e-12)
    assert list(both.to_pandas().angle_deg[:2]) == [ANGLE, 25.0]


def test_ranking_and_steps(ringed: Path) -> None:
    found = ranked(ringed, steps={"rim": 0.2, "wall.bsdf.*": "5 %", "coating": 3.0, "ring.z": "1 %"} | {"ring.z": 0.3})
    assert found["ring.r0"].step == 0.2
    assert found["wall.bsdf.paint.reflectance"].step == pytest.approx(0.02)
    assert found["plate.bsdf.coating.thickness_nm"].step == 3
    assert (found["ring.z"].step, found["detector.z"].step) == (0.3, 0.1)
    assert {edit.method for edit in found.edits} == {"move", "block", "paint", "coat"}
    certain = [max(abs(c.value) - 2 * c.se for c in edit.change) for edit in found.edits]
    assert certain[0] == max(certain)
    table = found.to_pandas()
    np.testing.assert_allclose(table.change, table.derivative * table.step)
    np.testing.assert_allclose(table.change_percent, 100 * table.change / table.pst, rtol=1e-12)
    assert not {"plate.tilt_x", "detector.half_width"} & {edit.label for edit in found.edits if edit.method == "block"}


def test_wrong_steps_are_refused(ringed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for change, words in (
        ({"steps": {"rim": 0.0}}, "step of 'ring.*' is 0.0; give a number greater than 0 in mm"),
        ({"steps": {"rim": "nan"}}, "is nan"),
        ({"steps": {"ring.z": "1 %"}}, "'ring.z' is 1 % of 0; give it in mm"),
        ({"steps": {"rimm": 1.0}}, "no parameter 'rimm'"),
        ({"steps": {"plate.curvature": 1.0}}, "none of the edits is about it"),
        ({"light": "edge_diffraction"}, "the PST at 15° is 0"),
        ({"method": "forward"}, "method of a PST metric"),
    ):
        with refused(words):
            ranked(ringed, **change)
    with refused("field_deg is empty"):
        rank_edits(ringed, [])
    for more in ("--rank", "--pst-field-deg 10 --step rim=1", "--pst-field-deg 10 --rank --step rim"):
        fails(capsys, "sweep", ringed, *more.split())

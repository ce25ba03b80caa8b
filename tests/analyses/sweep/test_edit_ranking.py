"""The ranking of edits: closed forms of all four kinds, differences with equal rays, steps, the command line."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from command_line import fails, succeeds
from oracles.object_scenes import common_area
from oracles.scatter_scenes import beam_xml, placed_xml, wall_xml
from oracles.small_scenes import interface_xml

import mistray
from mistray.errors import MistrayError
from mistray.materials import refractive_index
from mistray.optimize import pst_bin
from mistray.physics import thinfilm
from mistray.sweeps import EditRanking, rank_edits

ANGLE, CELL = 15.0, 28.0
HOLE, DETECTOR, DISTANCE = 2.5, 3.0, 10.0
LAYER_NM, GLASS = 60.0, 1.5
SIGMAS = 4.5


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A coated plate, a ring through whose hole a detector sees the light, and a grey wall beside them."""
    film = f'<bsdf type="thinfilm"><string name="layers" value="MgF2 {LAYER_NM}"/></bsdf></bsdf>'
    plate = placed_xml(
        "asphere", "plate", interface_xml("air", str(GLASS)).removesuffix("</bsdf>") + film, semi_diameter=20.0
    )
    ring = placed_xml("frustum", "ring", r0=HOLE, z0=20.0 - DISTANCE, r1=8.0, z1=20.0 - DISTANCE)
    wall = placed_xml("asphere", "wall", wall_xml(0.4), at=(12.0, 0.0, 10.0), facing=(1.0, 0.0, 0.0), semi_diameter=5.0)
    detector = placed_xml("asphere", "detector", at=(0.0, 0.0, 20.0), pixels=4, semi_diameter=DETECTOR)
    file = tmp_path_factory.mktemp("edits") / "scene.xml"
    file.write_text(f'<scene version="3.0.0">{beam_xml(5.0)}{plate}{ring}{wall}{detector}</scene>', encoding="utf-8")
    return file


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
def test_closed_forms(scene: Path) -> None:
    """All four methods: four comparisons within 4.5 standard errors, false alarm 3e-5; the widest error is 10 %."""
    found = ranked(scene, "direct", rays=1_200_000)
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
    painted = ranked(scene, "single_scatter")["wall.bsdf.paint.reflectance"]
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
def test_several_angles_share_one_pst(scene: Path) -> None:
    both = rank_edits(scene, [ANGLE, 25.0], "total", rays=20_000, max_scatters=1)
    metric = pst_bin(mistray.load(scene), 25.0, "total", pst_field_deg=[ANGLE, 25.0], rays=20_000, max_scatters=1)
    # One width of the zones at rims for all edits, where a gradient by one of them may choose another
    gradient = mistray.gradient(metric, mi.traverse(metric.scene), ["ring.r0"], edge_width=both.edge_width[1])
    # Sums over lanes are in any order
    assert both.pst[1].value == pytest.approx(gradient.value, rel=1e-12)
    assert both["ring.r0"].derivative[1].value == pytest.approx(gradient.gradient["ring.r0"][0], rel=1e-12)
    assert list(both.to_pandas().angle_deg[:2]) == [ANGLE, 25.0]


def test_ranking_and_steps(scene: Path) -> None:
    found = ranked(scene, steps={"rim": 0.2, "wall.bsdf.*": "5 %", "coating": 3.0, "ring.z": "1 %"} | {"ring.z": 0.3})
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


def test_command(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edits = tmp_path / "edits.toml"
    edits.write_text('[[configuration]]\nname = "grey"\npaint = { "wall" = 0.2 }\n', encoding="utf-8")
    out = tmp_path / "out"
    words = ["--pst-field-deg", "15:35:20", "--rank", "--rays", "2e4", "--max-scatters", "1", "--step", "rim=0.3",
             "share=2%"]  # fmt: skip
    record = json.loads(succeeds(capsys, "sweep", scene, *words, "--json"))
    assert {row["step"] for row in record["ranking"] if row["method"] == "block"} == {0.3}
    assert "rows" not in record
    printed = succeeds(capsys, "sweep", scene, edits, *words, "--out", out)
    assert "grey" in printed
    assert "wall.bsdf.paint.reflectance" in printed
    with (out / "edit_ranking.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    assert [row["label"] for row in rows] == [row["label"] for row in record["ranking"]]
    assert (out / "pst_sweep.csv").exists()


def test_refuses(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for change, words in (
        ({"steps": {"rim": 0.0}}, "step of 'ring.*' is 0.0; give a number greater than 0 in mm"),
        ({"steps": {"rim": "nan"}}, "is nan"),
        ({"steps": {"ring.z": "1 %"}}, "'ring.z' is 1 % of 0; give it in mm"),
        ({"steps": {"rimm": 1.0}}, "no parameter 'rimm'"),
        ({"steps": {"plate.curvature": 1.0}}, "none of the edits is about it"),
        ({"light": "edge_diffraction"}, "the PST at 15° is 0"),
        ({"method": "forward"}, "method of a PST metric"),
    ):
        with pytest.raises(MistrayError, match=words) as caught:
            ranked(scene, **change)
        assert "\n" not in str(caught.value)
    with pytest.raises(MistrayError, match="field_deg is empty"):
        rank_edits(scene, [])
    for more in ("--rank", "--pst-field-deg 10 --step rim=1", "--pst-field-deg 10 --rank --step rim"):
        fails(capsys, "sweep", scene, *more.split())

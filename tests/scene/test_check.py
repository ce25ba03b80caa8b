"""Overlapping surfaces are found in any scene, and nothing else is; loading grows in proportion to the shapes."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from refusals import refused

import mistray
from mistray.scene.check import check_overlaps

SCENES = sorted(path.parent.name for path in Path(__file__).parents[2].glob("scenes/*/scene.xml"))
T = mi.ScalarTransform4f


def asphere(
    z: float = 0.0, front: str = "air", back: str = "air", turn: float = 0.0, opaque: bool = False, **values: Any
) -> dict[str, Any]:
    place = T().translate([values.pop("x", 0.0), 0.0, z]) @ T().rotate([1, 0, 0], turn)
    values = {"semi_diameter": 5.0} | values if "half_width" not in values else values
    bsdf = {"type": "interface", "front": front, "back": back, **({"R": 0.0} if opaque else {})}
    return {"type": "asphere", "to_world": place, "bsdf": bsdf, **values}


def frustum(r0: float, z0: float, r1: float, z1: float, **bsdf: Any) -> dict[str, Any]:
    return {"type": "frustum", "r0": r0, "z0": z0, "r1": r1, "z1": z1, "bsdf": {"type": "interface", **bsdf}}


def lens(thickness: float = 3.0, rear: dict[str, Any] | None = None, move: Any = None) -> dict[str, Any]:
    """Biconvex, of R = 20 mm; its rear may be given in another way, or all of it moved."""
    made = {
        "L1_front": asphere(0.0, back="1.5", radius=20.0),
        "L1_rear": rear or asphere(thickness, front="1.5", radius=-20.0),
    }
    for shape in made.values() if move is not None else ():
        shape["to_world"] = move @ shape["to_world"]
    return made


def in_the_glass(**more: Any) -> dict[str, Any]:
    return {"inside": asphere(10.0, front="1.5", back="1.5"), "before": asphere(5.0), **more}


@pytest.mark.parametrize("name", SCENES)
def test_shipped_scenes_pass_quickly(name: str) -> None:
    scene = mistray.load(name)
    started = time.process_time()
    for _ in range(5):
        check_overlaps(scene)
    assert (time.process_time() - started) / 5 < 0.02


def test_telescopes_pass() -> None:
    batoid = pytest.importorskip("batoid")
    for file in ("LSST_r.yaml", "ComCam_g.yaml", "HSC_no_obsc.yaml", "donsoptikz1.yaml"):
        mistray.prescription.from_batoid(batoid.Optic.fromYaml(file), wavelength_nm=620.0).to_scene()


SAG = 20 - np.sqrt(20**2 - 5**2)
ASKEW = T().translate([7, -3, 2]) @ T().rotate([0.6, 0.0, 0.8], 40)  # an axis that is no world axis
BOWL = asphere(0.0, radius=20.0, semi_diameter=6.0, opaque=True)
BOARD = float(20 - np.sqrt(20**2 - 3**2))  # height of the bowl at 3 mm


@pytest.mark.parametrize(
    "shapes",
    [
        lens(1.3),
        lens(3.0, move=ASKEW),
        lens(rear=asphere(3.0, turn=180.0, back="1.5", radius=20.0)),  # in a frame that looks the other way
        # Materials are compared by their index
        {"a": asphere(0.0, back="1.50"), "b": asphere(2.0, front="1.5", back="vacuum"), "c": asphere(4.0)},
        # Touching at the vertex, at the rim, and structure in contact with a lens or drawn into it
        {**lens(), "window": asphere(3.0, back="1.5"), "window_rear": asphere(4.0, front="1.5")},
        lens(2 * SAG),
        # Along a circle: h = 1e-3 (r² - 4)²
        {"bowl": BOWL | {"radius": -1 / 0.016, "conic": -1.0, "a4": 1e-3}, "board": asphere(-0.016, opaque=True)},
        {
            **lens(),
            "edge": frustum(5.0, SAG, 5.0, 3.0 - SAG, R=0.0),
            "flange": frustum(4.0, 3.0 - SAG, 5.0, 3.0 - SAG, R=0.0),
            "seat": frustum(4.0, 3.0 - SAG, 6.0, 3.0 - SAG, R=0.0),
            "tube": frustum(4.9, -5.0, 4.9, 8.0, R=0.0),
        },
        # Rings side by side may share heights
        {
            "M1": asphere(radius=100.0, semi_diameter=10.0, inner_semi_diameter=6.0, opaque=True),
            "M3": asphere(-0.1, radius=20.0, semi_diameter=6.0, inner_semi_diameter=1.0, opaque=True),
        },
        # Other axes do not count
        {
            "front": asphere(0.0, back="1.5"),
            "rear": asphere(2.0, front="1.5"),
            "fold": asphere(1.0, turn=45.0, opaque=True),
            "aside": asphere(1.0, x=20.0, opaque=True),
        },
        # What refracts on the axis besides aspheres is not followed
        in_the_glass(
            ball={"type": "sphere", "center": [0, 0, 10], "radius": 2.0, "bsdf": {"type": "interface", "front": "1.5"}}
        ),
        in_the_glass(disc=frustum(0.0, 7.0, 5.0, 7.0, back="1.5")),
        # Rectangles count to their inscribed circle
        {"bowl": BOWL, "board": asphere(BOARD + 0.01, half_width=3.0, half_height=4.0, opaque=True)},
    ],
)
def test_allowed(shapes: dict[str, Any]) -> None:
    scene_dicts.load(**shapes)


@pytest.mark.parametrize(
    ("shapes", "words"),
    [
        (lens(1.0), "'L1_front' and 'L1_rear' cross at r = 4.4"),
        (lens(1.0, move=ASKEW), "cross at r = 4.4"),
        (lens(rear=asphere(1.0, turn=180.0, back="1.5", radius=20.0)), "cross"),
        ({**lens(), "L2_front": asphere(2.9, back="1.6", radius=15.0), "L2_rear": asphere(6.0, front="1.6")},
         "'L2_front' and 'L1_rear' cross"),
        # No surface crosses another, but the second lens begins inside of the first
        ({"a": asphere(0.0, back="1.5"), "b": asphere(4.0, front="1.5"),
          "c": asphere(3.0, back="1.6"), "d": asphere(7.0, front="1.6")},
         "'a' at z = 0 mm and 'c' at z = 3 mm: the material between them is '1.5' for one and 'air'"),
        ({"a": asphere(radius=30.0), "b": asphere(radius=30.0)}, "'a' and 'b' coincide; remove one"),
        ({"front": asphere(1.0, radius=20.0), "beside": asphere(1.2)}, "'front' and 'beside' cross"),
        (in_the_glass(), "'1.5'"),
        ({"bowl": BOWL, "board": asphere(BOARD - 0.1, half_width=3.0, half_height=4.0, opaque=True)}, "cross"),
    ],
)  # fmt: skip
def test_refused(shapes: dict[str, Any], words: str) -> None:
    with refused(r"\A[^\n]*\Z", words):
        scene_dicts.load(**shapes)


@pytest.mark.parametrize("detector", ["asphere", "rectangle"])
@pytest.mark.parametrize(("front", "rear"), [(0.0, -3.0), (5.0, 3.0), (20.0, 3.0), (1e9, 3.0)])
def test_a_rear_ahead_of_its_front(detector: str, front: float, rear: float) -> None:
    """Light would start in the glass; not where the detector is in it as well, nor for a gap of air in glass."""
    size = {"semi_diameter": 5.0} if detector == "asphere" else {}

    def shapes(**around: str) -> dict[str, Any]:
        image = scene_dicts.detector(10, type=detector, bsdf={"type": "interface", "R": 0.0, **around}, **size)
        return {"front": asphere(front, back="1.5"), "rear": asphere(rear, front="1.5"), "image": image}

    test_refused(shapes(), "light starts in '1.5'")
    scene_dicts.load(**shapes(front="1.5"))
    if rear < min(front, 8.0):
        straight = {"front": asphere(rear, back="1.5"), "rear": asphere(min(front, 8.0), front="1.5")}
        scene_dicts.load(**shapes() | straight)


# Painted walls, each with a paint of its own, and tiles on axes of their own: overlaps had been looked for pair by pair
WALL = """<shape type="frustum" id="wall_{k}"><float name="r0" value="20"/><float name="z0" value="{k}"/>
<float name="r1" value="20"/><float name="z1" value="{k}.9"/>
<bsdf type="paint"><float name="reflectance" value="0.05"/></bsdf></shape>"""
TILE = """<shape type="asphere" id="tile_{k}"><float name="half_width" value="0.4"/>
<float name="half_height" value="0.4"/><transform name="to_world"><translate x="{k}"/></transform>
<bsdf type="interface"><float name="R" value="0"/></bsdf></shape>"""


def row(folder: Path, shape: str, count: int) -> Path:
    path = folder / f"{count}.xml"
    path.write_text(f'<scene version="3.0.0">{"".join(shape.format(k=k) for k in range(count))}</scene>')
    return path


def seconds(path: Path) -> float:
    """Processor time, which other programs on the machine do not lengthen."""
    begun = time.process_time()
    mistray.load(path)
    return time.process_time() - begun


@pytest.mark.parametrize(("shape", "count"), [(WALL, 60), (TILE, 150)])
def test_loading_grows_in_proportion_to_the_number_of_shapes(tmp_path: Path, shape: str, count: int) -> None:
    few, many = row(tmp_path, shape, count), row(tmp_path, shape, 4 * count)
    mistray.load(few)
    assert min(seconds(many) for _ in range(2)) < 1.6 * 4 * min(seconds(few) for _ in range(3))

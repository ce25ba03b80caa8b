"""Bodies whose faces meet in edges that the light crosses: the sum of their faces' derivatives is that of the body."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.estimate import Estimate
from mistray.optimize import Metric, bodies, parameters, path_power, pst_bin
from mistray.prescription import (
    Coating,
    Detector,
    Prescription,
    Source,
    Structure,
    Surface,
    array,
    beam_splitter_cube,
    box,
    moved_as_one,
    prism,
    rectangle,
)
from mistray.prescription.bodies.placing import face_place

MIRROR, BLACK = Coating(R=0.9), Coating(R=0.0)
ABOVE = Detector("above", y=30.0, z=5.0, tilt_deg=(90.0, 0.0, 0.0), half_width=20.0, half_height=20.0)
BEAM = Source(radius=5.0, distance=30.0)
ROOF = -0.9 * 10 / (25 * math.pi)  # R times the length of the ridge in the beam over its area

Make = Callable[[float], Any]


def system(surfaces: Sequence[Surface], detector: Detector, source: Source = BEAM, **more: Any) -> Any:
    """The scene of some surfaces in a beam."""
    return Prescription(name="one", surfaces=tuple(surfaces), detector=detector, source=source, **more).to_scene()


def roof(step: float = 0.0, tilt: float = 0.0) -> Any:
    """A mirror roof, its ridge in the beam; what one side reflects goes up to the detector."""
    faces = prism(
        "P", [(0, 0), (10, 10), (-10, 10)], 20.0, material="1.5", faces=["top", "base", "bottom"],
        coatings={"top": MIRROR, "bottom": MIRROR, "base": BLACK}, mirrors=("top", "bottom"),
    )  # fmt: skip
    faces = moved_as_one(faces, y=step, tilt_deg=(tilt, 0.0, 0.0))
    return system(faces, ABOVE)


def inclined(name: str, sign: float) -> Surface:
    """A square mirror from the axis upwards or downwards at 45°."""
    along = math.sqrt(0.5) * np.array([0.0, sign, 1.0])
    normal = math.sqrt(0.5) * np.array([0.0, sign, -1.0])
    place = face_place(np.array([0.0, 5.0 * sign, 5.0]), (np.cross(along, normal), along, normal))
    half = 5 * math.sqrt(2)
    return Surface(name, **place, half_width=10.0, half_height=half, coating=MIRROR, mirror=True, part="P")


def two_mirrors(step: float = 0.0) -> Any:
    faces = moved_as_one([inclined("top", 1.0), inclined("bottom", -1.0)], y=step)
    return system(faces, ABOVE)


def turned_box(step: float = 0.0) -> Any:
    side = 10 * math.sqrt(2)
    faces = moved_as_one(box("P", (20.0, side, side), coating=MIRROR), tilt_deg=(45.0, 0.0, 0.0))
    faces = moved_as_one(faces, y=step, z=10.0)
    return system((), ABOVE, structures=faces)


def biprism(step: float) -> Any:
    faces = moved_as_one(prism("P", [(-8, 0), (-8, -0.5), (0, -3), (8, -0.5), (8, 0)], 16.0, material="1.5"), y=step)
    detector = Detector(y=5.0, z=60.0, half_width=20.0, half_height=5.0)
    return system(faces, detector)


def tilted_prism(step: float) -> Any:
    """A rectangular block of glass in a beam that is wider."""
    faces = prism("P", [(-5, 0), (5, 0), (5, 8), (-5, 8)], 20.0, material="1.5")
    faces = moved_as_one(moved_as_one(faces, tilt_deg=(25.0, 0.0, 0.0)), y=step)
    detector, wide = Detector(z=30.0, half_width=15.0, half_height=3.0), Source(radius=9.0, distance=30.0)
    return system(faces, detector, wide)


def lens(step: float, freeform: bool = True) -> Any:
    """A lens in light that comes in at 25°, so that its black edge is lit where it meets the front."""
    sag: dict[str, Any] = {"sag": {"xy_2_2": 1e-9}} if freeform else {}
    common: dict[str, Any] = {"semi_diameter": 5.0, "y": step, "part": "P"}
    front = Surface("front", radius=30.0, back="1.5", **common, **sag)
    rear = Surface("rear", radius=-30.0, front="1.5", z=4.0, **common)
    rim = 30 - math.sqrt(30**2 - 25)
    edge = Structure("edge", 5.0, rim, 5.0, 4.0 - rim, y=step, part="P", front="1.5", coating=BLACK)
    detector = Detector(y=12.0, z=12.0, half_width=20.0, half_height=10.0)
    light = Source(radius=9.0, distance=30.0, field_deg=25.0)
    return system((front, rear), detector, light, structures=(edge,))


def mirrors_side_by_side(step: float = 0.0) -> Any:
    """Two square segments that abut: no light is lost in their seam, whatever the direction they move in."""
    tile = Surface(
        "tile", outline=rectangle(4.0, 4.0), coating=MIRROR, mirror=True, part="P", tilt_deg=(45.0, 0.0, 0.0)
    )
    faces = [Surface(**{**vars(face), "part": "P"}) for face in array([tile], [(-4.0, step, 10.0), (4.0, step, 10.0)])]
    below = Detector("below", y=-30.0, z=10.0, tilt_deg=(90.0, 0.0, 0.0), half_width=20.0, half_height=20.0)
    return system(faces, below, Source(radius=2.0))


def splitter(step: float) -> Any:
    """A cube whose splitting diagonal ends in two of its edges; half of it lies in the beam."""
    cube = beam_splitter_cube("P", 10.0, material="1.5", splitter=Coating(R=0.5, T=0.5))
    faces = moved_as_one(cube, y=step + 5.0, z=10.0)
    return system(faces, Detector(z=40.0, half_width=4.0, half_height=8.0))


def derivative(scene: Any, metric: Metric, name: str = "y", pivot: Sequence[float] | None = None) -> Estimate:
    """By the displacement or tilt of the body P."""
    params = mi.traverse(scene)
    body = bodies(parameters(scene, params))["P"]
    slopes = (body if pivot is None else body.about(pivot)).slopes(name)
    return mistray.gradient(metric, params, keys=slopes).along(slopes)


def difference(make: Make, metric: Callable[[Any], Metric], step: float) -> float:
    return (metric(make(step)).value() - metric(make(-step)).value()) / (2 * step)


def check(found: Estimate, expected: float, most: float = 0.1) -> None:
    """Within 4 standard errors, which are 10 % of it at most: false alarms 5e-3 in all (32 batches)."""
    assert abs(found.value - expected) < 4 * found.se, (found, expected)
    assert found.se < most * abs(expected), (found, expected)


@pytest.mark.parametrize("make", [roof, two_mirrors, pytest.param(turned_box, marks=pytest.mark.long)])
def test_mirror_roof(make: Make) -> None:
    scene = make(0.0)
    check(derivative(scene, path_power(scene, "all", rays=30_000)), ROOF)


def test_one_mirror_alone() -> None:
    """Behind its end there is nothing: the whole of it counts by its own keys."""
    face = inclined("P_top", 1.0)
    scene = system((face,), ABOVE)
    found = mistray.gradient(path_power(scene, "all", rays=60_000), mi.traverse(scene), keys=["P_top.y", "P_top.z"])
    way = face.to_world()[:3, :3].T @ (0.0, 1.0, 0.0)
    check(found.along({f"P_top.{axis}": float(part) for axis, part in zip("yz", way[1:], strict=True)}), ROOF)


def test_tilt_of_the_roof() -> None:
    """The middle of its vertices lies 7.5 mm behind its ridge: a tilt about it moves the ridge."""
    scene = roof()
    metric = path_power(scene, "all", rays=30_000)
    check(derivative(scene, metric, "tilt_x"), ROOF * 7.5 * math.pi / 180)
    about_ridge = derivative(scene, metric, "tilt_x", pivot=(0.0, 0.0, 0.0))
    assert abs(about_ridge.value) < max(4 * about_ridge.se, 1e-5)


@pytest.mark.parametrize(
    ("make", "rays", "step", "selection"),
    [
        (biprism, 100_000, 0.2, "direct"),
        (tilted_prism, 800_000, 0.1, "all"),
        (lens, 1_200_000, 0.1, "all"),
        (lambda step: lens(step, freeform=False), 1_200_000, 0.1, "all"),
        (splitter, 120_000, 0.2, "all"),
    ],
    ids=["biprism", "tilted prism", "freeform lens", "asphere lens", "beam splitter"],
)
def test_against_scenes_built_again(make: Make, rays: int, step: float, selection: str) -> None:
    scene = make(0.0)
    expected = difference(make, lambda s: path_power(s, selection, rays=3 * rays, seed=1), step)
    check(derivative(scene, path_power(scene, selection, rays=rays)), expected)


def test_segments_that_abut() -> None:
    """The beam lies within both: nothing changes but by what falls off."""
    scene = mirrors_side_by_side()
    found = derivative(scene, path_power(scene, "all", rays=50_000), "x")
    assert abs(found.value) < max(4 * found.se, 1e-6)
    assert found.se < 0.01


def test_pst_of_a_box() -> None:
    """A box between detector and sky."""

    def make(step: float) -> Any:
        faces = moved_as_one(box("P", (6.0, 4.0, 3.0), coating=Coating(R=0.8)), y=3.0 + step, z=-6.0)
        wall = Structure("wall", 12.0, -20.0, 12.0, 0.0, coating=BLACK)
        return system((), Detector(half_width=4.0, half_height=4.0), structures=(*faces, wall))

    def metric(scene: Any, rays: int = 400_000, seed: int = 1) -> Metric:
        return pst_bin(scene, 30.0, "total", rays=rays, method="adjoint", cell_deg=10.0, seed=seed)

    scene = make(0.0)
    check(derivative(scene, metric(scene, 1_200_000, 0)), difference(make, metric, 0.2))

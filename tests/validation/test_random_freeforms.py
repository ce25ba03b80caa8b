"""Random freeforms, each from its number alone: closed books, no NaN, and the paths of a tracer in float64."""

import math
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from oracles import nonsequential, scene_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml, write
from validation.books import faults

import mistray

pytestmark = pytest.mark.validation

SCENES, QUICK, BY_ORACLE, RAYS = 500, 24, 8, 3000
APART = 12.0  # mm, between vertices
NUDGE = 2e-5  # mm, by which start rays are moved, to see which of them pass a rim


def polygon(rng: np.random.Generator) -> dict[str, float]:
    """Corners of a star-shaped polygon about the origin, mm."""
    count = int(rng.integers(3, 9))
    angles = np.sort(rng.uniform(0, 2 * np.pi, count)) + np.arange(count) * 1e-3
    while np.max(np.diff(angles, append=angles[0] + 2 * np.pi)) > 0.9 * np.pi:
        angles = np.sort(rng.uniform(0, 2 * np.pi, count)) + np.arange(count) * 1e-3
    radii = rng.uniform(4, 9, count)
    corners = radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return {f"{axis}{k}": float(corner[i]) for k, corner in enumerate(corners, 1) for i, axis in enumerate("xy")}


def figure(rng: np.random.Generator, number: int, sign: str, size: float) -> tuple[str, dict[str, float]]:
    kind = str(rng.choice(["circle", "ellipse", "rectangle", "polygon"]))
    own: dict[str, float] = {"x": float(rng.uniform(-2, 2)), "y": float(rng.uniform(-2, 2))}
    if kind == "circle":
        own["radius"] = size * float(rng.uniform(0.7, 1))
    elif kind == "polygon":
        own |= {name: value * size / 9 for name, value in polygon(rng).items()}
    else:
        own |= {"half_width": size * float(rng.uniform(0.5, 1)), "half_height": size * float(rng.uniform(0.5, 1))}
        own["angle_deg"] = float(rng.uniform(-90, 90))
    return sign + kind, {f"clip_{number}_{name}": value for name, value in own.items()}


def surface(rng: np.random.Generator, name: str, z: float, bsdf: str) -> str:
    numbers: dict[str, float] = {"curvature": float(rng.uniform(-0.02, 0.02)), "conic": float(rng.uniform(-2, 1))}
    for j in rng.choice(np.arange(2, 46), int(rng.integers(1, 7)), replace=False):
        numbers[f"zernike_{j}"] = float(rng.normal() * 0.05 / math.sqrt(j))
    numbers["zernike_radius"] = 12.0
    words, clips = [], dict[str, float]()
    signs = ["+", *rng.choice(["-", "+", "&"], int(rng.integers(0, 3)))]
    for k, sign in enumerate(signs, start=1):
        word, own = figure(rng, k, sign, 9.0 if sign != "-" else 2.5)
        words.append(f'<string name="clip_{k}" value={quoteattr(word)}/>')
        clips |= own
    pose = {key: float(rng.uniform(-4, 4)) for key in ("tilt_x", "tilt_y", "tilt_z")}
    pose |= {key: float(rng.uniform(-1, 1)) for key in ("x", "y")}
    text = shape_xml("freeform", name, z, bsdf, **numbers, **clips)
    turn = "".join(f'<rotate {axis}="1" angle="{pose[f"tilt_{axis}"]!r}"/>' for axis in "xyz")
    turn += f'<translate x="{pose["x"]!r}" y="{pose["y"]!r}" z="{z!r}"/>'
    return text.replace(f'<translate z="{z!r}"/>', turn).replace("<transform", "".join(words) + "<transform", 1)


def scene(number: int) -> str:
    rng = np.random.default_rng([19, number])
    count = int(rng.integers(2, 6))
    shapes, glass = [], "air"
    for k in range(count):
        kind = rng.choice(["lens", "mirror", "plate"], p=[0.7, 0.2, 0.1]) if glass == "air" else "lens"
        if kind == "mirror":
            bsdf = interface_xml(R=0.8)
        elif kind == "plate":
            bsdf = interface_xml(R=0.0)
        else:
            other = "1.6" if glass == "air" else "air"
            bsdf, glass = interface_xml(glass, other, R=0.1, T=0.85), other
        shapes.append(surface(rng, f"s{k}", APART * (k + 1), bsdf))
    end = interface_xml(glass, glass, R=0.0)
    size = {"half_width": 25.0, "half_height": 25.0}
    detector = shape_xml("asphere", "detector", APART * (count + 2), end, sensor=True, **size)
    return scene_text(*shapes, detector, radius=7.0)


def traced(number: int, folder: Path, rays: int = RAYS) -> tuple[Path, Any]:
    path = write(folder, scene(number))
    settings = {"max_reflections": 3, "flux_threshold": 0.0, "polarization": "unpolarized"}
    return path, mistray.trace(mistray.load(path), rays=rays, seed=number, **settings)


def check(numbers: range, folder: Path) -> None:
    wrong, lit = [], 0
    for number in numbers:
        _, t = traced(number, folder)
        lit += len(list(t.paths)) > 0
        wrong += [f"scene {number}: {fault}" for fault in faults(t, closed=False)]
    assert not wrong, "\n".join(wrong)
    assert lit > 0.4 * len(numbers)


def test_some_scenes(tmp_path: Path) -> None:
    check(range(QUICK), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("tenth", range(10))
def test_all_scenes(tenth: int, tmp_path: Path) -> None:
    check(range(tenth * SCENES // 10, (tenth + 1) * SCENES // 10), tmp_path)


@pytest.mark.parametrize("number", range(BY_ORACLE))
def test_paths_of_a_tracer_in_float64(number: int, tmp_path: Path) -> None:
    """The same ledger from the same start rays, but for rays that a move by 20 nm sends another way."""
    path, t = traced(number, tmp_path, rays=RAYS // 4)
    model = scene_xml.read_scene(path)
    (run,) = t.runs
    origin, direction = run.start_rays(np.arange(RAYS // 4, dtype=np.uint32))
    unit = run.unit

    def ledger(start: np.ndarray) -> dict[str, float]:
        result = nonsequential.trace(model, start, direction, np.full(len(start), unit), 550.0, max_reflections=3)
        return {row.text: row.power_W for row in result.paths}

    exact = ledger(origin)
    moved = [ledger(origin + NUDGE * np.array(step)) for step in ([1, 0, 0], [0, 1, 0], [-1, -1, 0])]
    ours = {row.events: row.power_W for row in t.paths}
    for text in set(exact) | set(ours):
        theirs = [found.get(text, 0.0) for found in (exact, *moved)]
        # Bodies are open: light that comes to a surface out of turn is in the wrong medium, and is cut by mistray
        if text not in ours and max(theirs) <= t.energy.cut.get("medium", 0.0):
            continue
        slack = max(theirs) - min(theirs) + 2e-6 * t.energy.launched_W + 1e-5 * max(theirs)
        assert min(theirs) - slack <= ours.get(text, 0.0) <= max(theirs) + slack, text

"""A surface that a user defines in one file, as this one: part of a torus, the rounded lip of a baffle."""

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from oracles.statistics import assert_z

import mistray
from mistray.optimize import path_power
from mistray.plugins.shapes.implicit import Implicit, arctan2, sqrt
from mistray.ranges import RADIUS_MM, Range
from mistray.surfaces.host_rays import crossings, first_hit, inside
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

pytestmark = pytest.mark.quick

MAJOR, MINOR, BEAM = 6.0, 1.5, 8.0


class TorusSegment(Implicit):
    """Part of a torus about the z axis; angles are those around its tube, 0 towards the axis of revolution."""

    numbers = ("major", "minor")
    ranges = {"major": RADIUS_MM, "minor": RADIUS_MM, "low_deg": Range(-180, 180), "high_deg": Range(-180, 180)}
    defaults = {"low_deg": -179.0, "high_deg": 179.0}

    @staticmethod
    def residual(x: Any, y: Any, z: Any, n: Any) -> Any:
        across = sqrt(x * x + y * y) - n["major"]
        return sqrt(across * across + z * z) - n["minor"]

    @staticmethod
    def gradient(x: Any, y: Any, z: Any, n: Any) -> tuple[Any, Any, Any]:
        rho = sqrt(x * x + y * y)
        across = rho - n["major"]
        off = sqrt(across * across + z * z)
        return across * x / (rho * off), across * y / (rho * off), z / off

    @staticmethod
    def coordinate(x: Any, y: Any, z: Any, n: Any) -> Any:
        return n["minor"] * arctan2(z, n["major"] - sqrt(x * x + y * y))

    @staticmethod
    def generatrix(u: Any, n: Any) -> tuple[Any, Any]:
        angle = u / n["minor"]
        return n["major"] - n["minor"] * np.cos(angle), n["minor"] * np.sin(angle)

    @staticmethod
    def ends(values: Any) -> tuple[float, float]:
        return tuple(values["minor"] * np.radians(values[key]) for key in ("low_deg", "high_deg"))


mi.register_shape("torus_segment", TorusSegment)


def scene(major: float = MAJOR, minor: float = MINOR, scatter: dict[str, Any] | None = None, **more: Any) -> mi.Scene:
    """A beam of 8 mm radius on axis, the lip in its way, and a detector behind it."""
    lip = {"type": "interface", "R": 0.3, **({"scatter": scatter} if scatter else {})}
    return scene_dicts.load(
        lip={"type": "torus_segment", "major": major, "minor": minor, "bsdf": lip, **more},
        detector=scene_dicts.detector(20, semi_diameter=12.0),
        beam={"type": "collimated", "radius": BEAM},
    )


def reflected(R: float, minor: float, major: float, n: int = 400_000) -> float:
    """Share of the beam that the lip reflects once and sends to the detector: plane geometry of two circles."""
    h = BEAM * (np.arange(n) + 0.5) / n
    off = h - major
    met = np.abs(off) < minor
    h, off = h[met], off[met]
    z = -np.sqrt(minor**2 - off**2)
    dx, dz = -2 * z * off / minor**2, 1 - 2 * (z / minor) ** 2
    b, c = (h + major) * dx + z * dz, (h + major) ** 2 + z**2 - minor**2  # the other side of the lip
    free = (b * b < c) | (-b - np.sqrt(np.maximum(b * b - c, 0)) < 0)
    arrives = (dz > 0) & free & (np.abs(h + dx * (20 - z) / np.where(dz > 0, dz, 1)) < 12)
    return float(R * np.sum(h * arrives) * 2 / n / BEAM)


def test_trace_ghosts_and_pst_both_ways() -> None:
    t = mistray.trace(scene(), rays=400_000, max_reflections=1)
    power = {row.kind: row.power_W / t.energy.launched_W for row in t.paths}
    assert power["straight shot"] == pytest.approx(1 - 4 * MAJOR * MINOR / BEAM**2, abs=1e-3)
    assert power["structure"] == pytest.approx(reflected(0.3, MINOR, MAJOR), rel=0.03)
    assert abs(t.energy.closure) < 1e-8
    report = mistray.ghosts(scene(), [0.0], rays=20_000, max_reflections=1)
    assert "lip (structure)" in report.table(0.0).label.tolist()
    # Three methods, each by its own rays; false alarm 4e-3 in all
    here = scene(scatter={"type": "abg", "A": 0.02, "B": 0.05, "g": 2.0})
    found = {
        method: mistray.pst(here, [20.0, 60.0], method=method, cell_deg=4.0, rays=rays, seed=1)
        for method, rays in (("joined", 400_000), ("adjoint", 1_000_000), ("forward", 400_000))
    }
    for light in ("single_scatter", "total"):
        other, other_se = found["forward"].curve(light)
        for method in ("joined", "adjoint"):
            one, one_se = found[method].curve(light)
            assert_z(f"{light}, {method}", one, other, np.hypot(one_se, other_se), false_alarm=1e-3)


@pytest.mark.parametrize("kind", ["straight shot", "structure"])
def test_gradient(kind: str) -> None:
    """By both radii, silhouettes included, against closed forms; 3 standard errors of 4: false alarms 1 %."""
    here = scene()
    g = mistray.gradient(path_power(here, kind, rays=200_000, max_reflections=1), mi.traverse(here), keys=["lip.m*or"])
    exact = {
        "straight shot": {"lip.major": -4 * MINOR / BEAM**2, "lip.minor": -4 * MAJOR / BEAM**2},
        "structure": {
            "lip.major": (reflected(0.3, MINOR, MAJOR + 1e-3) - reflected(0.3, MINOR, MAJOR - 1e-3)) / 2e-3,
            "lip.minor": (reflected(0.3, MINOR + 1e-3, MAJOR) - reflected(0.3, MINOR - 1e-3, MAJOR)) / 2e-3,
        },
    }[kind]
    for key, value in exact.items():
        assert abs(g.gradient[key][0] - value) < 3 * g.standard_error[key][0]


def test_pictures_and_mesh(tmp_path: Path) -> None:
    here = scene(low_deg=-100.0, high_deg=100.0)
    mistray.view(here, mistray.trace(here, rays=2000)).write(tmp_path / "view.html")
    mistray.report.write_layout(mistray.report.layout_figure(here), tmp_path / "layout.png")
    lip = next(shape for shape in here.shapes() if shape.id() == "lip")
    vertices = np.array(mi.traverse(lip)["vertex_positions"]).reshape(-1, 3)
    off = np.hypot(np.hypot(vertices[:, 0], vertices[:, 1]) - MAJOR, vertices[:, 2])
    assert np.allclose(off, MINOR, atol=1e-5)


RAYS = 4000


def quartic(o: np.ndarray, d: np.ndarray, major: float, minor: float) -> np.ndarray:
    """Real roots of (|p|² + R² - r²)² = 4 R² (x² + y²) along p = o + t d, ascending."""
    b, c = 2 * o @ d, o @ o + major**2 - minor**2
    flat = 4 * major**2 * np.array([d[:2] @ d[:2], 2 * o[:2] @ d[:2], o[:2] @ o[:2]])
    roots = np.roots([1.0, 2 * b, b * b + 2 * c - flat[0], 2 * b * c - flat[1], c * c - flat[2]])
    return np.sort(roots[np.abs(roots.imag) < 1e-9].real)


# Radii, mm, and angles, degrees
SEGMENTS = [(6.0, 1.5, -179.0, 179.0), (6.0, 1.5, -120.0, 60.0), (5.0, 0.05, -90.0, 90.0), (2.5e3, 2.4e3, 10.0, 170.0)]


@pytest.mark.parametrize(("major", "minor", "low", "high"), SEGMENTS)
def test_first_hits(major: float, minor: float, low: float, high: float) -> None:
    table = SurfaceTable(scene(major, minor, low_deg=low, high_deg=high), 550.0)
    number = table.ids.index("lip")
    rng = np.random.default_rng(3)
    o = 3 * major * rng.normal(size=(RAYS, 3))
    aim = major * rng.normal(size=(RAYS, 3)) * [1, 1, 0.3]
    d = (aim - o) / np.linalg.norm(aim - o, axis=1, keepdims=True)
    ends = minor * np.radians([low, high])

    def at(q: np.ndarray) -> np.ndarray:
        return minor * np.arctan2(q[:, 2], major - np.hypot(q[:, 0], q[:, 1]))

    exact, sure = np.full(RAYS, np.inf), np.ones(RAYS, dtype=bool)
    for k in range(RAYS):
        roots = quartic(o[k], d[k], major, minor)
        u = at(o[k] + roots[:, None] * d[k])
        within = (u >= ends[0]) & (u <= ends[1]) & (roots > 0)
        exact[k] = roots[within].min(initial=np.inf)
        # float32 may decide otherwise for rays that nearly touch the surface or its ends
        near = [len(quartic(o[k], d[k], major, r)) for r in (minor - 1e-5 * major, minor + 1e-5 * major)]
        sure[k] = near[0] == near[1] and not np.any(np.abs(u[:, None] - ends) < 1e-4 * major)
    assert sure.mean() > 0.95
    assert np.isfinite(exact).mean() > 0.01
    intersector = Intersector(table)
    rays = [mi.Vector3f(*(upload(mi.Float, c) for c in v.T)) for v in (o - table.centre, d)]
    t, s = intersector.nearest(*rays, dr.full(mi.UInt32, NO_SURFACE, RAYS), mi.Bool(True))
    t, s = np.array(t), np.array(s)
    hit = np.where(s == number, t, np.inf)
    nearer = sure & ((s == number) | (s == NO_SURFACE) | (exact < t))  # not those that the detector keeps from it
    np.testing.assert_array_equal(np.isfinite(hit[nearer]), np.isfinite(exact[nearer]))
    both = nearer & np.isfinite(exact)
    q = o[both] + exact[both, None] * d[both]
    slope = np.abs(np.einsum("ij,ij->i", table.pieces[number].gradient(q), d[both])) * 2
    assert np.all(np.abs(hit[both] - exact[both]) * np.maximum(slope, 1e-3) < 3e-6 * 3 * major)
    found = crossings(table, number, o, d)
    some = sure & np.isfinite(exact)
    for k in np.flatnonzero(some)[:300]:
        ahead = found[k][np.isfinite(found[k]) & (found[k] > 0)]
        p = o[k] + ahead[:, None] * d[k]
        assert ahead[inside(table, number, p)].min() == pytest.approx(exact[k], rel=1e-9)
    assert set(first_hit(table, o[:50], d[:50], np.full(50, -1))[0]) <= {-1, *range(table.count)}

"""First hits of the kernel and the host with parts of tori against the roots of their quartics."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from surfaces.test_own_surface import scene

from mistray.surfaces.host_rays import crossings, first_hit, inside
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

pytestmark = pytest.mark.quick

RAYS = 4000


def quartic(o: np.ndarray, d: np.ndarray, major: float, minor: float) -> np.ndarray:
    """Real roots of (|p|² + R² - r²)² = 4 R² (x² + y²) along p = o + t d, ascending."""
    b, c = 2 * o @ d, o @ o + major**2 - minor**2
    flat = 4 * major**2 * np.array([d[:2] @ d[:2], 2 * o[:2] @ d[:2], o[:2] @ o[:2]])
    roots = np.roots([1.0, 2 * b, b * b + 2 * c - flat[0], 2 * b * c - flat[1], c * c - flat[2]])
    return np.sort(roots[np.abs(roots.imag) < 1e-9].real)


@pytest.mark.parametrize(
    ("major", "minor", "low", "high", "scale"),
    [
        (6.0, 1.5, -179.0, 179.0, 1.0),
        (6.0, 1.5, -120.0, 60.0, 1.0),
        (5.0, 0.05, -90.0, 90.0, 1.0),
        (2.5, 2.4, 10.0, 170.0, 1e3),
    ],
)
def test_first_hits(major: float, minor: float, low: float, high: float, scale: float) -> None:
    major, minor = scale * major, scale * minor
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
    surface, _, _ = first_hit(table, o[:50], d[:50], np.full(50, -1))
    assert set(surface) <= {-1, *range(table.count)}

"""The infrared camera of the examples: spot, cold stop and cold shield, by an independent trace of its lens file."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from mistray.analysis.thermal.emission import thermal
from mistray.materials import refractive_index
from mistray.prescription import from_zemax

DETECTOR_MM, STOP_MM, PIXEL_CORNER = 20.0, 5.0, (4.8, 3.84)
LENS = Path(__file__).parents[2] / "examples" / "lwir_camera.zmx"


@lru_cache
def build():
    return from_zemax(LENS)


def sag(surface, x, y):
    """Height and slope over r² of an even asphere, from its numbers."""
    c, r2 = 1 / surface.radius, x * x + y * y
    root = np.sqrt(1 - (1 + surface.conic) * c * c * r2)
    terms = enumerate(surface.coefficients)
    a = [(k, value) for k, value in terms if value]
    z = c * r2 / (1 + root) + sum(value * r2 ** (k + 2) for k, value in a)
    slope = c / root + sum(2 * (k + 2) * value * r2 ** (k + 1) for k, value in a)
    return z, slope


def through(lens, origin, direction, wavelength_nm, backward=False):
    """Rays (3, n) by Snell's law in vector form; also the heights over the clear radii, (surfaces, n)."""
    heights = []
    p, d = origin.astype(float), direction.astype(float)
    for surface in lens.surfaces[::-1] if backward else lens.surfaces:
        p = p + d * ((surface.z - p[2]) / d[2])
        for _ in range(8):
            z, slope = sag(surface, p[0], p[1])
            normal = np.stack([-slope * p[0], -slope * p[1], np.ones_like(z)])
            p = p - d * ((p[2] - surface.z - z) / (d * normal).sum(0))
        normal /= np.linalg.norm(normal, axis=0)
        heights.append(np.hypot(p[0], p[1]) / surface.semi_diameter)
        before, after = (surface.back, surface.front) if backward else (surface.front, surface.back)
        mu = refractive_index(before, wavelength_nm) / refractive_index(after, wavelength_nm)
        normal *= np.sign((d * normal).sum(0))
        cosine = (d * normal).sum(0)
        d = mu * d + (np.sqrt(1 - mu**2 * (1 - cosine**2)) - mu * cosine) * normal
    return p, d, np.array(heights)


def disc(radius, rings=12):
    """Points on circles of equal areas, (2, n)."""
    r = radius * np.sqrt((np.arange(rings) + 0.5) / rings)
    a = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    return np.stack([np.outer(r, np.cos(a)).ravel(), np.outer(r, np.sin(a)).ravel()])


def test_the_spot_on_axis_is_small_at_all_wavelengths_together():
    lens = build()
    spots = []
    for wavelength in (8000.0, 10000.0, 12000.0):
        x, y = disc(14.8)  # wider than the pupil, so that the stop limits the light
        origin = np.stack([x, y, np.full_like(x, -10.0)])
        along = np.stack([np.zeros_like(x), np.zeros_like(x), np.ones_like(x)])
        p, d, heights = through(lens, origin, along, wavelength)
        assert heights.max() < 1
        at_stop = p + d * ((lens.stop.z_front - p[2]) / d[2])
        passed = np.hypot(at_stop[0], at_stop[1]) <= STOP_MM
        assert 0.8 < passed.mean() < 1
        spots.append((p + d * ((lens.detector.z - p[2]) / d[2]))[:2, passed])
    found = np.concatenate(spots, axis=1)
    assert np.sqrt((found**2).sum(0).mean()) < 0.005  # asked for: 20 µm


def test_the_cold_stop_is_the_stop_for_every_point_of_the_detector():
    """From each point the whole stop is seen through clear apertures: backwards all rays reach the scene."""
    lens = build()
    assert lens.detector.z - lens.stop.z_front == pytest.approx(DETECTOR_MM)
    assert lens.stop.radius == STOP_MM
    assert (lens.detector.half_width, lens.detector.half_height) == PIXEL_CORNER
    rim = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    for x, y in ((0.0, 0.0), (4.8, 0.0), (0.0, 3.84), PIXEL_CORNER):
        start = np.stack([np.full(64, x), np.full(64, y), np.full(64, lens.detector.z)])
        ends = np.stack([STOP_MM * np.cos(rim), STOP_MM * np.sin(rim), np.full(64, lens.stop.z_front)])
        d = (ends - start) / np.linalg.norm(ends - start, axis=0)
        for wavelength in (8000.0, 12000.0):
            assert through(lens, start, d, wavelength, backward=True)[2].max() < 0.98


@pytest.mark.long
def test_the_detector_sees_the_cold_shield_and_the_scene_alone():
    """
    Cold shielding of 100 %: without reflections no ray of the detector ends at a warm wall, edge or flange.

    The light of the scene comes through the stop alone, with the shares of Lambertian rays that reach its points by
    geometry. 60 000 rays, 4 standard errors: false alarm 6e-5.
    """
    lens = build()
    warm = [structure.name for structure in lens.structures if not structure.name.startswith(("barrel_4", "board"))]
    report = thermal(
        lens.to_scene(), 293.0, wavelengths_um=8.0, band_um=(8.0, 8.01), rays=30_000,
        max_reflections=0, max_scatters=0,
    )  # fmt: skip
    assert "barrel_2_wall" in warm
    hits = {emitter.name: emitter.hits for emitter in report.emitters}
    assert not [name for name in warm if hits.get(name)]
    assert hits["stop_front"] > 1000
    rng, n = np.random.default_rng(4), 100_000
    x, y = rng.uniform(-1, 1, (2, n)) * np.array(PIXEL_CORNER)[:, None]
    r, a = STOP_MM * np.sqrt(rng.uniform(0, 1, n)), rng.uniform(0, 2 * np.pi, n)
    square = (r * np.cos(a) - x) ** 2 + (r * np.sin(a) - y) ** 2 + DETECTOR_MM**2
    open_share = float(np.mean(DETECTOR_MM**2 / square**2) * STOP_MM**2)
    seen = {e.name: e.share for e in report.emitters}
    assert abs(seen["window_rear"].value - open_share) < 4 * seen["window_rear"].se < 0.1 * open_share
    shield = seen["stop_front"].value + sum(seen[name].value for name in seen if name.startswith(("barrel_4", "board")))
    assert shield + open_share == pytest.approx(1, abs=5 * seen["window_rear"].se)

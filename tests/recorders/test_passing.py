"""Probes and far fields against closed forms: light that is recorded where it passes, and where it leaves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import plates_text, scene_text, shape_xml

import mistray
from mistray.recorders import FarField, Probe

pytestmark = pytest.mark.quick


def lambertian(f: float) -> str:
    return scattering_xml([bsdf_xml("abg", A=2 * f, B=1.0, g=0.0)], R=1.0, T=0.0)


def screen_text(f: float, radius: float) -> str:
    screen = shape_xml("asphere", "screen", 0.0, lambertian(f), semi_diameter=4.0)
    detector = shape_xml("asphere", "detector", 5.0, sensor=True, semi_diameter=0.1)
    return scene_text(screen, detector, radius=radius, distance=2.0)


class TestProbe:
    def test_a_beam(self, load_text) -> None:
        """1 W/mm² within the beam, and 0 beyond; what is beyond the rectangle is not there."""
        probe = Probe("ahead", (0.0, 0.0, -1.0), half_width=0.5, half_height=0.25, pixels=(4, 2))
        wide = Probe("wide", (0.3, 0.0, -0.5), half_width=2.0, half_height=2.0, pixels=(1, 1))
        back = Probe("back", (0.0, 0.0, -1.0), normal=(0.0, 0.0, -1.0), half_width=2.0, half_height=2.0)
        text = plates_text(1).replace('name="radius"', 'name="distance" value="3"/><float name="radius"', 1)
        t = mistray.trace(load_text(text)[0], rays=40_000, recorders=[probe, wide, back], max_reflections=1)
        irradiance, se = probe.irradiance
        assert irradiance.shape == (2, 4) == se.shape
        assert np.all(np.abs(irradiance - 1) < 5 * se)  # 8 pixels: 1 in 200,000
        assert probe.power[0] == pytest.approx(0.5, abs=5 * probe.power[1])
        assert wide.power == pytest.approx((np.pi, 0.0), rel=1e-6, abs=1e-9)
        r = 0.04
        assert back.power[0] == pytest.approx(np.pi * (r + r * (1 - r) ** 2), rel=1e-5)  # of both faces
        assert set(t.recorders) == {"ahead", "wide", "back"}
        assert abs(t.energy.closure) < 1e-6
        # A beam of 1 W/mm² brings cos 60° on a rectangle that is tilted so far
        probe = Probe("tilted", (0, 0, -2), normal=(0, math.sqrt(3), 1), half_width=0.3, half_height=0.4, pixels=(1, 1))
        text = plates_text(1).replace('name="radius"', 'name="distance" value="6"/><float name="radius"', 1)
        mistray.trace(load_text(text)[0], rays=50_000, recorders=[probe], max_reflections=0)
        (value,), (se,) = (column.ravel() for column in probe.irradiance)
        assert abs(value - 0.5) < 4 * se  # 1 in 16,000

    @pytest.mark.parametrize("depth", [0.0, 1.7, 5.0])
    def test_in_absorbing_glass(self, load_text, depth: float) -> None:
        """Beer and Lambert up to the rectangle: exp(-4πk d/λ)."""
        probe = Probe("within", (0.0, 0.0, min(max(depth, 1e-4), 5 - 1e-4)), half_width=2.0, half_height=2.0)
        mistray.trace(load_text(plates_text(1, index="1.5 k=1e-5", R=0.0, T=1.0))[0], rays=1000, recorders=[probe])
        assert probe.power[0] == pytest.approx(np.pi * math.exp(-4 * np.pi * 1e-5 * depth / 550e-6), rel=1e-4)

    def test_radiance_of_a_screen(self, load_text) -> None:
        """A Lambertian screen under 1 W/mm² has the radiance f in every direction: 11 cells of 5 SE, 1 in 150,000."""
        f = 0.1
        probe = Probe("near", (0, 0, -0.05), normal=(0, 0, -1), half_width=0.2, half_height=0.2, pixels=(1, 1),
                      directions=6)  # fmt: skip
        scene, _ = load_text(screen_text(f, 3.9))
        t = mistray.trace(scene, rays=1_000_000, max_scatters=1, scatter_rays=1, aimed_rays=0, recorders=[probe])
        value, se = probe.radiance
        assert value.shape == (1, 1, 6, 6)
        inside = np.zeros((6, 6), dtype=bool)
        inside[2:4, 1:5] = inside[1:5, 2:4] = True  # whole cells within the unit circle
        mirrored = np.unravel_index(np.argmax(value[0, 0]), inside.shape)
        assert 2 <= min(mirrored) <= max(mirrored) <= 3  # straight back, at the corner of the four cells in the middle
        inside[mirrored] = False
        assert np.all(np.abs(value[0, 0] - f)[inside] < 5 * se[0, 0][inside])
        assert np.all(se[0, 0][inside] < 0.15 * f)
        assert value.sum() * (2 / 6) ** 2 == pytest.approx(probe.irradiance[0].sum(), rel=1e-9)
        assert abs(t.energy.closure) < 1e-5

    def test_bad_numbers(self, load_text) -> None:
        for change, words in (
            ({"name": " "}, "not blank"),
            ({"half_width": 0.0}, "half_width"),
            ({"half_height": math.nan}, "half_height"),
            ({"normal": (0, 0, 0)}, "normal is 0, 0, 0"),
            ({"normal": (0, 1)}, "normal has 2 numbers"),
            ({"up": (0, 0, 2)}, "up is along"),
            ({"centre": (0, math.inf, 0)}, "centre"),
            ({"pixels": (0, 4)}, "width in pixels"),
            ({"pixels": (65536, 65536)}, "number of its cells"),
            ({"directions": 0}, "number of directions"),
        ):
            with pytest.raises(mistray.MistrayError, match=words):
                Probe(**{"name": "p", "centre": (0, 0, 0)} | change)
        for numbers, words in (
            ({"edges_deg": (0, 10, 10)}, "do not ascend"),
            ({"edges_deg": (0, 181)}, "edges_deg"),
            ({"azimuths": 0}, "azimuths"),
        ):
            with pytest.raises(mistray.MistrayError, match=words):
                FarField("f", **numbers)
        scene, _ = load_text(plates_text(1))
        twice = [Probe("focus", (0, 0, 1)), FarField("focus")]
        with pytest.raises(mistray.MistrayError, match="2 recorders have the name 'focus'"):
            mistray.trace(scene, rays=100, recorders=twice)
        with pytest.raises(mistray.MistrayError, match="'focus' has recorded nothing yet"):
            _ = twice[0].irradiance


def test_far_field_of_a_lambertian(load_text) -> None:
    """Intensity f Φ cos θ of a small screen: in a ring f Φ π (sin² θ2 - sin² θ1). 36 of 5 SE, 1 in 48,000."""
    f = 0.05
    far = FarField("sky", edges_deg=range(90, 181, 10), azimuths=4)
    scene, _ = load_text(screen_text(f, 0.5))
    t = mistray.trace(scene, rays=100_000, max_scatters=1, scatter_rays=1, aimed_rays=0, recorders=[far])
    value, se = far.intensity
    sine = np.sin(np.radians(far.edges_deg)) ** 2
    expected = f * np.pi * 0.5**2 * (sine[:-1] - sine[1:]) * np.pi / (4 * far.solid_angle_sr)
    assert value.shape == (9, 4)
    expected = np.repeat(expected[:, None], 4, axis=1)
    straight_back = np.unravel_index(np.argmax(value), value.shape)
    assert straight_back[0] == 8
    expected[straight_back] += np.pi * 0.5**2 * (1 - np.pi * f) / far.solid_angle_sr[-1]
    assert np.all(np.abs(value - expected) < 5 * se)
    assert np.all(se < 0.2 * expected)
    assert far.power[0] == pytest.approx(t.energy.escaped_W, rel=1e-9)
    # A beam at 10° and azimuth 90° (towards -x) that meets nothing behind a plate leaves in one cell
    text = plates_text(1, R=0.0, T=1.0).replace('half_width" value="50.0', 'half_width" value="0.01')
    scene, _ = load_text(text)
    far = FarField("beam", edges_deg=(0, 9, 11, 180), azimuths=8)
    mistray.trace(scene, rays=1000, field_deg=10.0, azimuth_deg=100.0, recorders=[far])
    flux = far.intensity[0] * far.solid_angle_sr[:, None]
    assert np.argmax(flux) == 8 + 2
    assert flux[1, 2] == pytest.approx(far.power[0], rel=1e-9)
    for axis, row in (((0, 0, -1), 2), ((0, 0, 1), 0)):
        edge = FarField("edge", edges_deg=(0, 5, 170, 180), axis=axis)
        mistray.trace(scene, rays=1000, recorders=[edge])
        assert np.argmax(edge.intensity[0] * edge.solid_angle_sr[:, None]) == row

"""Thermal self-emission: cones of optics, narcissus, closed cavities, absorbing media, names, messages.

A number from a trace must lie within 4 standard errors of the exact one: false-alarm probability 6e-5 each.
"""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml, wall_xml
from oracles.small_scenes import interface_xml
from oracles.statistics import assert_z
from refusals import each_refused, refused
from scipy.integrate import quad
from scipy.special import expn
from vectors import frame

from mistray import ThermalReport, thermal
from mistray.analyses.thermal.request import DetectorNoise
from mistray.analyses.thermal.result import Emitter
from mistray.analyses.thermal.spectrum import TracedBand, band_weights, traced_wavelengths
from mistray.materials import complex_index
from mistray.physics import planck
from mistray.physics.netd import netd_by_detectivity, netd_by_photons
from mistray.sampling.warm.emissivity import emissivities
from mistray.surfaces.surfaces import SurfaceTable

pytestmark = pytest.mark.quick
PER_M2 = 1e-6
BAND = (8.0, 12.0)
RADIANCE = planck.band_radiance(293.0, *BAND)  # its tests have oracles of their own


def detector_xml(half: float = 0.01, **values: float | str) -> str:
    """A small square detector at the origin, light comes from -z."""
    bsdf = interface_xml(**{"R": 0.0, **values})
    return placed_xml("asphere", "detector", bsdf, pixels=4, half_width=half, half_height=half)


Load = Callable[..., mi.Scene]
COLD: dict[str, Any] = {"max_reflections": 1, "max_scatters": 0, "temperatures": {"detector": 77.0}}
COLD["wavelengths_um"] = 10.0  # which stands for a narrow band


@pytest.fixture(scope="module")
def load(load_scene: Callable[[str], mi.Scene]) -> Load:
    return lambda *parts: load_scene(scatter_scene(beam_xml(1.0, distance=3.0), *parts))


def sheet_xml(emissivity: float) -> str:
    return interface_xml(R=0.0, T=1 - emissivity)


def emitter(report: ThermalReport, name: str) -> Emitter:
    (found,) = (e for e in report.emitters if name in (e.name, e.kind))
    return found


def check(what: str, found: tuple[float, float], expected: float, relative: float) -> None:
    """Within 4 standard errors, which are at most `relative` of the number."""
    assert found[1] < relative * expected, f"{what}: standard error {found[1] / expected:.1e} of {expected:.5g}"
    assert_z(what, found[0], expected, found[1], k=4.0, floor=3e-6 * expected)


class TestConeOfOptics:
    @pytest.mark.parametrize("row", list(frame("self_emission.csv").itertuples()), ids=["F2", "F4", "F2_cold"])
    def test_vectors(self, row: pd.Series, load: Load) -> None:
        """A window that fills the cone, and a housing of the same emissivity that passes the rest."""
        distance, radius = 10.0, 10.0 / (2 * row.F)
        scene = load(
            detector_xml(),
            placed_xml("asphere", "window", sheet_xml(row.emissivity), at=(0, 0, -distance), semi_diameter=radius),
            placed_xml("frustum", "housing", sheet_xml(row.emissivity), r0=radius, z0=-distance, r1=radius, z1=0.5),
        )
        report = thermal(scene, row.T, BAND, rays=200_000, seed=1)
        for name, exact, relative in (("window", row[6], 0.03), ("housing", row[7], 0.01)):
            check(name, emitter(report, name).irradiance_W_mm2, PER_M2 * exact, relative)
        check("total", report.total_W_mm2, PER_M2 * (row[6] + row[7]), 0.01)
        for name, found in (("scene", report.scene_W_mm2), ("image", report.image_W_mm2)):
            check(name, found, (1 - row.emissivity) * math.pi * planck.band_radiance(row.T, *BAND), 0.01)
        assert report.to_image.value == pytest.approx(row.emissivity / (1 - row.emissivity), rel=0.02)
        assert math.isnan(report.nitd_K.value), "nothing is cold"
        (note,) = report.notes
        assert "declare design_path" in note, "the beam misses a detector of 0.02 mm"

    def test_the_image_comes_by_the_design_path(self, load: Load) -> None:
        mirror, size = interface_xml(R=0.9, mirror=True), {"half_width": 0.05, "half_height": 0.05}
        scene = load(
            placed_xml("asphere", "detector", at=(0, 0, 50), facing=(0, 0, -1), pixels=4, **size),
            placed_xml("asphere", "mirror", mirror, at=(0, 0, 100), radius=-100.0, conic=-1.0, semi_diameter=10.3),
        )
        report = thermal(scene, 293.0, BAND, rays=200_000, aim="none", seed=4)
        sine2 = 10.3**2 / (10.3**2 + (50 - 10.3**2 / 200) ** 2)  # of the mirror's rim, seen from the detector
        check("image", report.image_W_mm2, 0.9 * sine2 * math.pi * RADIANCE, 0.02)
        check("scene", report.scene_W_mm2, (1 - 0.1 * sine2) * math.pi * RADIANCE, 0.01)
        assert report.notes == []

    def test_means_have_the_error_of_the_wavelengths(self, load: Load) -> None:
        """A slab absorbs 1 - 2 E₃(4πkd/λ); what three wavelengths leave open is in the error of its emission, too."""
        glass = "1.0001+0.00002i"
        scene = load(
            detector_xml(),
            placed_xml("asphere", "front", interface_xml("air", glass), at=(0, 0, -9), semi_diameter=400.0),
            placed_xml("asphere", "rear", interface_xml(glass, "air"), at=(0, 0, -6), semi_diameter=400.0),
        )
        report = thermal(scene, 293.0, BAND, rays=200_000, aim="none")
        um = np.linspace(*BAND, 2001)
        exact = np.average(1 - 2 * expn(3, 4 * np.pi * 2e-5 * 3e3 / um), weights=planck.spectral_radiance(um, 293.0))
        emission = emitter(report, "medium").emission
        check("emission", emission, exact, 0.01)
        assert emission.se > report.band_error / math.sqrt(3) * exact * 0.99 > 1e-3 * exact


class TestNarcissus:
    @pytest.mark.parametrize("row", list(frame("narcissus.csv").itertuples()), ids=["quarter", "whole"])
    def test_vectors(self, row: pd.Series, load: Load) -> None:
        """A concentric window sends a part of the F/2 cone back to the detector; it passes the rest."""
        sine = math.sqrt(1 / 17)
        part = math.sqrt(row.fraction_of_cone_returning_cold) * sine
        rings = [("window", row.R, part, 0.0)] + ([("rim", 0.0, sine, part)] if part < sine else [])
        shapes = [
            placed_xml("asphere", name, interface_xml(R=share, T=1 - share), at=(0, 0, -10), radius=10.0,
                       semi_diameter=10 * outer, **({"inner_semi_diameter": 10 * inner} if inner else {}))
            for name, share, outer, inner in rings
        ]  # fmt: skip
        wall = placed_xml("frustum", "wall", r0=10 * sine, z0=-10 * math.cos(math.asin(sine)), r1=10 * sine, z1=1.0)
        scene, cold = load(detector_xml(0.02), *shapes, wall), {"detector": row.T_cold}
        report = thermal(scene, row.T_housing, BAND, temperatures=cold, rays=400_000, seed=3)
        # The vector holds to first order: the window also reflects the scene away
        nitd = row.NITD_K / (1 - row.R * row.fraction_of_cone_returning_cold)
        view = row.R * row.fraction_of_cone_returning_cold * sine**2
        (back,) = report.returned
        assert (back.surface, back.part, report.detector_K) == ("window", "window", row.T_cold)
        for name, found, expected in (
            ("NITD", report.nitd_K, nitd),
            ("NITD by surface", back.nitd_K, nitd),
            ("self view", report.self_view, view),
            ("by surface", back.emission, view),
        ):
            check(name, found, expected, 0.05)
        # A change of the scene's temperature: dL/dT at 310 K, not at the 295 K of the housing
        at_scene, at_housing = (planck.narcissus_nitd(1.0, 295.0, 77.0, *BAND, scene_K) for scene_K in (310.0, None))
        slopes = planck.band_derivative(295.0, *BAND) / planck.band_derivative(310.0, *BAND)
        assert at_scene == pytest.approx(at_housing * slopes, rel=1e-12)

    def test_over_the_detector(self, load: Load) -> None:
        """A plane that reflects 20 %, 2 mm before a cold square of 4 mm: its image by Hottel's configuration factor."""
        half, near = 2.0, 2.0
        scene = load(
            placed_xml("asphere", "window", interface_xml(R=0.2, T=0.8), at=(0, 0, -near), semi_diameter=2000.0),
            detector_xml(half),
        )
        report = thermal(scene, 293.0, BAND, temperatures={"detector": 77.0}, rays=200_000, seed=6, aim="none")

        def corner(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            """Configuration factor of a rectangle with signed sides a, b in units of its distance, from its corner."""
            first = a / np.sqrt(1 + a**2) * np.arctan(b / np.sqrt(1 + a**2))
            return (first + b / np.sqrt(1 + b**2) * np.arctan(a / np.sqrt(1 + b**2))) / (2 * np.pi)

        x, y = np.random.default_rng(7).uniform(-half, half, (2, 200_000))
        a, b, distance = (half - x) / (2 * near), (half - y) / (2 * near), np.hypot(x, y)
        c, d = (half + x) / (2 * near), (half + y) / (2 * near)
        factor = corner(a, b) + corner(c, b) + corner(a, d) + corner(c, d)
        unit = planck.narcissus_nitd(0.2, 293.0, 77.0, *BAND) / 0.8
        (back,) = report.returned
        check("all", back.with_shield_K, unit * factor.mean(), 0.02)
        assert back.nitd_K.value == pytest.approx(back.with_shield_K.value, rel=0.02)
        assert report.zones_mm[-1] == pytest.approx(half * math.sqrt(2), rel=0.01)
        for (low, high), found in zip(pairwise(report.zones_mm), back.by_zone_K, strict=True):
            inside = (distance >= low) & (distance < high)
            assert inside.mean() == pytest.approx(0.2, abs=0.01)
            check(f"{low:.2f} mm", found, unit * factor[inside].mean(), 0.03)
        assert back.by_zone_K[0].value > 1.2 * back.by_zone_K[-1].value
        # What is cold and seen directly, as it should be, does not count
        shield = placed_xml("frustum", "shield", r0=2.5, z0=-10.0, r1=2.5, z1=0.5)
        scene = load(detector_xml(), shield)
        report = thermal(scene, 293.0, BAND, temperatures={"detector": 77.0, "shield": 77.0}, rays=50_000, aim="none")
        assert report.nitd_K == report.self_view == (0.0, 0.0), "both traces start the same rays"
        assert report.returned == []

    def test_which_surface(self, load: Load) -> None:
        """A lens with two coated faces, scatter and an absorbing glass: the single returns and the whole self view."""
        glass = "1.5+0.000002i"
        rough = scattering_xml([bsdf_xml("abg", A=1e-4, B=1e-3, g=2.0)], "air", glass, R=0.3, T=0.6)
        scene = load(
            placed_xml("asphere", "front", rough, at=(0, 0, -9), radius=12.0, semi_diameter=4.0),
            placed_xml("asphere", "rear", interface_xml(glass, "air", R=0.2, T=0.7), at=(0, 0, -6), semi_diameter=4.0),
            detector_xml(1.0, R=0.1),
            placed_xml("frustum", "tube", r0=4.0, z0=-8.0, r1=4.0, z1=0.5),
        )
        report = thermal(scene, 293.0, (9.99, 10.01), rays=400_000, **COLD)
        assert {back.surface for back in report.returned} == {"front", "rear"}
        single = sum(back.emission.value for back in report.returned)
        error = math.hypot(report.self_view.se, *(back.emission.se for back in report.returned))
        assert error < 0.03 * single
        assert_z("self view", report.self_view.value, single, error, k=4.0)
        assert all(0 < back.emission.value < 0.2 * 0.9 for back in report.returned if back.surface == "rear")

    def test_the_sky_beside_a_lens_is_no_image(self, load_scene: Callable[[str], mi.Scene]) -> None:
        """Without a tube most of what the detector sees is beside the lens; its image has the same temperature."""
        front, rear = interface_xml("air", "1.5", R=0.3, T=0.7), interface_xml("1.5", "air", R=0.2, T=0.8)
        lens = (
            placed_xml("asphere", "front", front, at=(0, 0, -9), radius=12.0, semi_diameter=4.0),
            placed_xml("asphere", "rear", rear, at=(0, 0, -6), semi_diameter=4.0),
            placed_xml("frustum", "edge", r0=4.0, z0=-8.31, r1=4.0, z1=-6.0),
        )
        scene = load_scene(scatter_scene(beam_xml(1.0, distance=30.0), *lens, detector_xml(1.0)))
        report = thermal(scene, 293.0, (9.99, 10.01), rays=50_000, **COLD)
        assert report.scene_W_mm2.value > 3 * report.image_W_mm2.value
        whole = sum(back.with_shield_K.value for back in report.returned)
        error = math.hypot(report.nitd_K.se, *(back.with_shield_K.se for back in report.returned))
        assert error < 0.05 * whole
        assert_z("nitd", whole, report.nitd_K.value, error, k=4.0)


PIXEL = {"pixel_um": 15.0, "bandwidth_hz": 500.0}
NOISE = DetectorNoise(**PIXEL, detectivity=5e10, quantum_efficiency=0.6)


def test_netd_of_a_cone_of_optics(load: Load) -> None:
    """F/2, all parts in closed form: each has a temperature of its own; the last name that fits holds."""
    scene = load(
        detector_xml(),
        placed_xml("asphere", "window", sheet_xml(0.05), at=(0, 0, -10), semi_diameter=2.5),
        placed_xml("frustum", "tube_a", r0=2.5, z0=-10.0, r1=2.5, z1=-1.0),
        placed_xml("frustum", "tube_b", r0=2.5, z0=-1.0, r1=2.5, z1=0.5),
    )
    kelvin = {"*": 250.0, "tube_?": 80.0, "tube_b": 0.0, "window": 350.0}
    settings = {"scene_K": 300.0, "rays": 100_000, "seed": 3, "noise": NOISE}
    report = thermal(scene, 293.0, BAND, temperatures=kelvin, **settings)
    emitters = {e.name: e for e in report.emitters}
    assert {name: e.temperature_K for name, e in emitters.items()} == {"window": 350, "tube_a": 80, "tube_b": 0}
    assert (report.detector_K, set(report.by_part())) == (250.0, set(emitters))
    cone = planck.cone_projected_solid_angle(2.0)
    inner = 2.5**2 / (2.5**2 + 1.0**2)  # sin² of the edge between the tubes
    for name, weight, temperature in (("window", 0.05 * cone, 350.0), ("tube_a", math.pi * inner - cone, 80.0)):
        check(name, emitters[name].irradiance_W_mm2, weight * planck.band_radiance(temperature, *BAND), 0.02)
    assert emitters["tube_b"].irradiance_W_mm2 == (0.0, 0.0)
    check("emission at 0 K", emitters["tube_b"].emission, 1 - inner, 0.01)
    check("scene", report.scene_W_mm2, 0.95 * cone * planck.band_radiance(300.0, *BAND), 0.01)
    table = report.to_pandas()
    assert table.irradiance_W_mm2.is_monotonic_decreasing
    assert table.percent.sum() == pytest.approx(100)
    assert table.irradiance_W_mm2.sum() == pytest.approx(report.total_W_mm2.value, rel=1e-6)

    def photons(temperature: float) -> float:
        """2c/λ⁴/(exp(x) - 1), photons/(s mm² sr)."""
        waves = np.linspace(*BAND, 20_001)
        x = planck.C2_UM_K / waves / temperature
        return 1e12 * float(np.trapezoid(2 * planck.LIGHT / waves**4 / np.expm1(x), waves))

    expected = {"scene, image": 0.95 * cone * photons(300.0), "window": 0.05 * cone * photons(350.0)}
    expected["tube_a"] = (math.pi * inner - cone) * photons(80.0)
    netd = report.netd
    found = {source.name: source for source in netd.sources}
    for name, value in expected.items():
        check(name, found[name].photons_mm2_s, value, 0.02)
    assert found["scene, ghosts and scatter"].photons_mm2_s == (0.0, 0.0)
    slope = 0.95 * cone * planck.band_derivative(300.0, *BAND)
    check("per kelvin", netd.per_kelvin_W_mm2, slope, 0.02)
    check("by D*", netd.by_detectivity_K, netd_by_detectivity(slope, 5e10, 0.015**2, 500.0), 0.02)
    rise = 0.95 * cone * (photons(300.5) - photons(299.5))
    check("by photons", netd.by_photons_K, netd_by_photons(sum(expected.values()), rise, 0.6, 0.015**2, 500.0), 0.02)
    assert math.fsum(s.netd_K.value**2 for s in netd.sources) == pytest.approx(netd.by_photons_K.value**2)
    assert math.fsum(s.percent for s in netd.sources) == pytest.approx(100)


class TestCavity:
    def test_black(self, load: Load) -> None:
        """A closed black box: every ray ends where it arrives, the sum has no error."""
        black, grey = (
            load(
                detector_xml(1.0),
                placed_xml("frustum", "wall", bsdf, r0=3.0, z0=-5.0, r1=3.0, z1=1.0),
                placed_xml("asphere", "end", bsdf, at=(0, 0, -5), semi_diameter=3.0),
            )
            for bsdf in (None, wall_xml(0.9))
        )
        report, whole = thermal(black, 293.0, BAND, rays=20_000, noise=NOISE), math.pi * RADIANCE
        assert report.total_W_mm2.value == pytest.approx(whole, rel=1e-6)
        assert report.total_W_mm2.se < 1e-6 * whole
        assert report.scene_W_mm2.value == 0
        assert math.isnan(report.to_image.value)
        assert "the detector sees no scene" in report.notes[0]
        assert (report.netd.sources, math.isnan(report.netd.by_detectivity_K.value)) == ([], True)
        report = thermal(grey, 293.0, BAND, rays=20_000, max_scatters=1)
        assert "was not followed to its source; raise max_reflections and max_scatters" in report.notes[0]
        assert 0.5 * whole < report.lost_W_mm2 < 0.81 * whole
        rest = report.total_W_mm2.value + report.scene_W_mm2.value + report.lost_W_mm2
        assert rest == pytest.approx(whole, rel=1e-5)

    def test_what_was_cut_is_a_share_of_all_that_is_seen(self, load: Load) -> None:
        """In a medium that absorbs 99 % of the view, too: 0.4 % is cut, which is no cause for a note."""
        glass = "1.0+0.0015i"
        scene = load(
            detector_xml(1.0, front=glass),
            placed_xml("frustum", "side", r0=3.0, z0=-2.0, r1=3.0, z1=1.0),
            placed_xml("asphere", "front", interface_xml("air", glass, R=0.0, T=1.0), at=(0, 0, -2), semi_diameter=3.0),
            placed_xml("frustum", "wall", wall_xml(0.9), r0=3.0, z0=-5.0, r1=3.0, z1=-2.0),
            placed_xml("asphere", "end", wall_xml(0.9), at=(0, 0, -5), semi_diameter=3.0),
        )
        report = thermal(scene, 293.0, BAND, rays=20_000, max_scatters=1)
        assert 0.001 < report.lost_W_mm2 / (math.pi * RADIANCE) < 0.01
        assert not any("was not followed" in note for note in report.notes)

    def test_everything(self, load: Load) -> None:
        """Lens, coatings, paint and a grey detector in glass: π n² L of a blackbody, less what was not followed."""
        glass = "1.5+0.00001i"
        coated = interface_xml("air", glass, R=0.1, T=0.8)
        scene = load(
            placed_xml("asphere", "lens_front", coated, at=(0, 0, -4), radius=10.0, semi_diameter=3.0),
            placed_xml("frustum", "lens_edge", interface_xml(R=0.6), r0=3.0, z0=-3.5390302, r1=3.0, z1=0.5),
            detector_xml(1.0, front=glass, R=0.3),
            placed_xml("frustum", "barrel", wall_xml(0.3), r0=3.0, z0=-8.0, r1=3.0, z1=-3.5390302),
            placed_xml("asphere", "cap", wall_xml(0.5), at=(0, 0, -8), semi_diameter=3.0),
            placed_xml("asphere", "floor", wall_xml(0.2), at=(0, 0, 0.5), semi_diameter=3.0),
        )
        many = {"max_reflections": 60, "max_scatters": 60, "splitting": "one", "below_threshold": "roulette"}
        many |= {"wavelengths_um": [8.0, 10.0, 12.0], "rays": 40_000, "seed": 4, "flux_threshold": 1e-3}
        report = thermal(scene, 293.0, BAND, **many)
        total = report.total_W_mm2.value + report.lost_W_mm2
        assert report.lost_W_mm2 < 0.01 * total
        check("total", (total, report.total_W_mm2.se), 1.5**2 * math.pi * RADIANCE, 0.01)
        assert any(e.kind == "medium" and e.name == glass and e.irradiance_W_mm2.value > 0 for e in report.emitters)
        assert any(e.name == "detector" and e.emission.value > 0 for e in report.emitters)


def test_media_absorb_and_walls_emit(load: Load) -> None:
    """
    Constant k and index 1: 1 - exp(-4πk t/(λ cos θ)) over angle and band; interpolation in λ costs 1e-3.

    Two names of one medium: the first is in the table, and the other holds for the temperature, too.
    """
    k, thickness, near = 2e-4, 5.0, 1.0
    medium, other = f"1+{k:g}i", f"1.0+{k:.5f}i"
    scene = load(
        detector_xml(),
        placed_xml("asphere", "rear", interface_xml(medium, "air"), at=(0, 0, -near), semi_diameter=50.0),
        placed_xml("asphere", "front", interface_xml("air", other), at=(0, 0, -near - thickness), semi_diameter=50.0),
        placed_xml("asphere", "stop", at=(0, 0, -0.5), semi_diameter=60.0, inner_semi_diameter=0.5 * math.tan(0.5)),
    )
    report = thermal(scene, 350.0, (3.0, 5.0), temperatures={medium: 300.0}, rays=100_000, seed=5)
    assert {3.0, 4.0, 5.0} <= set(report.wavelengths_um)

    def absorbed(wave: float) -> float:
        depth = 4e3 * math.pi * k * thickness / wave
        return quad(lambda t: 2 * math.sin(t) * math.cos(t) * -math.expm1(-depth / math.cos(t)), 0, 0.5)[0]

    expected = math.pi * quad(lambda w: absorbed(w) * float(planck.spectral_radiance(w, 300.0)), 3, 5)[0]
    slab = emitter(report, "medium")
    assert (slab.name, slab.temperature_K) == (other, 300.0)
    assert slab.irradiance_W_mm2.se < 0.01 * expected
    assert_z("slab", slab.irradiance_W_mm2.value, expected, slab.irradiance_W_mm2.se, k=4.0, floor=4e-3 * expected)
    assert f"({other})" in report.by_part()


def test_emissivity_is_what_is_neither_reflected_nor_transmitted(load: Load) -> None:
    sheets = {"dark": (0.1, 0.0), "half": (0.1, 0.5), "clear": (0.25, 0.75)}
    shapes = [
        placed_xml("asphere", name, interface_xml(R=R, T=T), at=(0, 0, -9 + k), semi_diameter=1.0)
        for k, (name, (R, T)) in enumerate(sheets.items())
    ]
    table = SurfaceTable(load(detector_xml(R=0.3), *shapes), 1e4)
    found = dict(zip(table.ids, emissivities(table, np.array([1.0, 0.2])), strict=True))
    for name, (R, T) in {"detector": (0.3, 0.0), **sheets}.items():
        np.testing.assert_allclose(found[name], 1 - R - T, rtol=0, atol=1e-6)


def test_band_weights() -> None:
    """Positive, sum to the band's radiance, exact for what is linear between the wavelengths."""
    nodes = (7.0, 9.0, 10.5, 14.0)
    weights = band_weights(293.0, BAND, nodes)
    assert np.all(weights > 0)
    assert weights.sum() == pytest.approx(RADIANCE, rel=1e-12)
    values = np.array([0.3, 0.8, 0.1, 0.5])

    def light(wave: float) -> float:
        return float(np.interp(wave, nodes, values) * planck.spectral_radiance(wave, 293.0))

    assert weights @ values == pytest.approx(quad(light, *BAND, points=nodes[1:3])[0], rel=1e-10)
    np.testing.assert_allclose(band_weights(293.0, BAND, [5.0]), [RADIANCE], rtol=1e-12)
    assert not band_weights(0.0, BAND, nodes).any()


class TestWavelengths:
    def test_depends(self, load: Load) -> None:
        """What a constant index scatters does not; an index, an absorption and a reference wavelength do."""
        abg = {"A": 1e-3, "B": 1e-3, "g": 2.0}
        for depends, lens in (
            (False, scattering_xml([bsdf_xml("abg", **abg)], "air", "1.5")),
            (True, interface_xml("air", "ZnSe k=0")),
            (True, interface_xml("air", "1.5+0.0001i")),
            (True, scattering_xml([bsdf_xml("abg", **abg, reference_nm=5e3)], R=0.5, T=0.5)),
        ):
            scene = load(placed_xml("asphere", "lens", lens, at=(0, 0, -5), semi_diameter=2.0), detector_xml())
            found = traced_wavelengths(scene, None, BAND)
            assert traced_wavelengths(scene, 9, BAND).wavelengths_um == (9.0,)
            assert (found == TracedBand((10.0,), 0.0)) != depends
            if depends:
                assert {8.0, 10.0, 12.0} <= set(found.wavelengths_um)
                assert 0 <= found.error <= 0.01
                # What is so cold has no light in the band
                assert traced_wavelengths(scene, None, BAND, [293.0, 0.1]) == found

    @pytest.mark.parametrize(
        ("material", "thick_mm", "band"),
        [("MgF2", 2.0, (3.0, 8.0)), ("SiO2", 0.02, (2.6, 4.3)), ("Al2O3", 0.2, (5.1, 8.9))],
    )
    def test_an_absorption_edge(self, material: str, thick_mm: float, band: tuple[float, float], load: Load) -> None:
        """Integrals of what a body absorbs, 1 - exp(-4πk t/λ), and passes are met to 1 %; three lines miss by half."""
        scene = load(
            placed_xml("asphere", "front", interface_xml("air", material), at=(0, 0, -200), semi_diameter=10.0),
            placed_xml("asphere", "rear", interface_xml(material, "air"), at=(0, 0, thick_mm - 200), semi_diameter=10),
            detector_xml(),
        )

        def passed(waves: np.ndarray) -> np.ndarray:
            k = np.array([complex_index(material, 1e3 * wave).imag for wave in waves])
            return np.asarray(np.exp(-4e3 * np.pi * k * thick_mm / waves))

        fine = np.linspace(*band, 601)
        exact = float(np.trapezoid(passed(fine) * planck.spectral_radiance(fine, 300.0), fine))
        whole = planck.band_radiance(300.0, *band)
        found = traced_wavelengths(scene, None, band, [300.0])
        assert found.error <= 0.01
        nodes = np.array(found.wavelengths_um)
        by_nodes = band_weights(300.0, band, nodes) @ passed(nodes)
        assert by_nodes == pytest.approx(exact, rel=0.01)
        assert whole - by_nodes == pytest.approx(whole - exact, rel=0.01)
        ends = [band[0], sum(band) / 2, band[1]]
        off = abs((whole - band_weights(300.0, band, ends) @ passed(np.array(ends))) / (whole - exact) - 1)
        assert 0.1 < off < traced_wavelengths(scene, ends, band, [300.0]).error

    def test_unknown_there_and_bad_input(self, load: Load) -> None:
        glass = placed_xml("asphere", "lens", interface_xml("air", "N-BK7"), at=(0, 0, -5), semi_diameter=2.0)
        scene = load(glass, detector_xml())
        with refused(r"surface 'lens' at 8 µm: .*2500 nm.*"):
            thermal(scene, 293.0, BAND)
        assert "outside the band" in thermal(scene, 293.0, BAND, wavelengths_um=2.0, rays=1000, aim="none").notes[-1]
        scene = load(detector_xml(), placed_xml("asphere", "window", at=(0, 0, -5), semi_diameter=1.0))
        each_refused(
            (lambda: thermal(scene, wavelengths_um=[9.0, 8.0], rays=1000), "give one or more in ascending order"),
            (lambda: DetectorNoise(**PIXEL), "give detectivity, quantum_efficiency or both"),
            (lambda: DetectorNoise(**PIXEL, quantum_efficiency=1.2), "quantum_efficiency is 1.2"),
        )

"""Metrics of PSTs beside the table of a PST and differences, and stray light of fields from classes of directions."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.derivatives import central_differences
from oracles.ideal_lens import cell_nodes, over_cells
from oracles.small_scenes import plates_text
from refusals import each_refused, refused
from scipy.integrate import quad
from vectors import analytic

import mistray
from mistray.analyses.pst.glare import ratios
from mistray.analyses.pst.glare.extended_source import Disc, SkyRadiance, cover, source_irradiance, sun
from mistray.analyses.pst.glare.glare import ghost_to_signal, glare_spread, veiling_glare_index
from mistray.analyses.pst.glare.ratios import normalised_irradiance, rejection_ratio, surface_magnitude
from mistray.analyses.pst.metrics.pst_metrics import pst_band, pst_bin, pst_mask, veiling_glare
from mistray.analyses.pst.metrics.pst_observation import PstObservation
from mistray.analyses.pst.result import CLASSES, Pst
from mistray.analyses.pst.sums import quotient, weighted_sum
from mistray.estimate import Estimate
from mistray.metrics.combined_metric import combine
from mistray.metrics.metric import Metric, log
from mistray.metrics.observation import smooth_maximum
from mistray.metrics.stray_metric import DEFINITIONS
from mistray.recorders.directions import DirectionGrid

Curve = Callable[[np.ndarray], np.ndarray]
WHOLE = np.arange(0.5, 90, 1.0)  # cells of 1° that leave no gap


def flat(level: float, to_deg: float = 180.0) -> Curve:
    return lambda theta: np.where(theta < np.radians(to_deg), level, 0.0)


def solid(from_deg: float, to_deg: float) -> float:
    return float(2 * np.pi * (np.cos(np.radians(from_deg)) - np.cos(np.radians(to_deg))))


def pst_of(
    angles: Sequence[float] | np.ndarray,
    stray: Curve | np.ndarray,
    direct: Curve | np.ndarray | float = 0.0,
    *,
    maps: np.ndarray | None = None,
    convention: str = "normal",
    **cells: object,
) -> Pst:
    """A PST without noise: ghost and direct light, functions of θ or values of the cells, the same in all batches."""
    grid = DirectionGrid.of(angles, **cells)
    by_class, nodes = np.zeros((len(CLASSES), *grid.shape)), np.radians(cell_nodes(grid.edges_deg, 20))
    for name, light in (("direct", direct), ("ghost", stray)):
        value = over_cells(light(nodes), grid.edges_deg)[:, None] if callable(light) else light
        by_class[CLASSES.index(name)] = value
    by_batch, facts = np.repeat(by_class[..., None], 4, axis=-1), {"detector_area_mm2": 4.0}
    extent = (-1.0, 1.0, -1.0, 1.0)
    return Pst(grid, by_batch, np.full(4, 0.25), convention=convention, facts=facts, maps=maps, extent_mm=extent)


def lorentz(theta: np.ndarray) -> np.ndarray:
    return np.asarray(1e-4 / (1 + np.degrees(theta) ** 2))


def test_uniform_skies() -> None:
    """A flat plate that transmits everything: E = π L, whatever the convention of the result; the vectors."""
    for convention in ("normal", "projected"):
        e = source_irradiance(pst_of(WHOLE, np.cos, convention=convention), SkyRadiance())
        assert (e.value, e.covered) == (pytest.approx(np.pi, rel=1e-12), pytest.approx(1, abs=1e-12))
        assert (e.se, e.interpolated) == (0, 0)
    for curve, case, what in (
        (lorentz, "uniform L=1 sky 20..90deg", "n"),
        (lambda t: lorentz(t) * np.cos(t), "same, if PST_projected", "p cos"),
    ):
        e = source_irradiance(pst_of(np.arange(20.5, 90, 1.0), curve), SkyRadiance(from_deg=20))
        assert e.value == pytest.approx(analytic(case, f"E_stray = int L PST_{what} dOmega"), rel=1e-9)
        assert e.covered == pytest.approx(1, abs=1e-9)
    pst = pst_of(range(0, 90, 10), np.cos)
    e = source_irradiance(pst, SkyRadiance())
    assert e.covered == pytest.approx(pst.grid.solid_angle.sum() / (2 * np.pi), rel=1e-12)
    assert e.value == pytest.approx(float(np.sum(pst.grid.solid_angle * pst.grid.mean_cosine)), rel=1e-12)
    linear = source_irradiance(pst, SkyRadiance(), interpolation="linear")
    assert linear.covered == e.covered
    assert linear.covered + linear.interpolated == pytest.approx(1 - np.cos(np.radians(81)), rel=1e-12)

    # L = cos θ (1 + cos φ / 2): 2 π/3 with a PST of 1, and by azimuth cells as well
    def radiance(theta_deg: np.ndarray, phi_deg: np.ndarray) -> np.ndarray:
        return np.cos(np.radians(theta_deg)) * (1 + 0.5 * np.cos(np.radians(phi_deg)))

    whole = source_irradiance(pst_of(WHOLE, np.ones_like), SkyRadiance(radiance))
    assert whole.value == pytest.approx(np.pi, rel=1e-9)
    azimuths = np.arange(0, 360, 20)
    front = np.where(np.abs((azimuths + 180) % 360 - 180) < 90, 1.0, 0.0)
    part = source_irradiance(pst_of(WHOLE, front[None, :], azimuths_deg=azimuths), SkyRadiance(radiance))
    half = np.radians(90)  # cells of 20° from -90 to 90°
    assert part.value == pytest.approx(0.5 * (2 * half + 0.5 * 2 * np.sin(half)), rel=1e-4)
    assert part.covered == pytest.approx(1, abs=1e-4)


class TestDisc:
    @pytest.mark.parametrize("azimuths", [None, np.arange(0, 360, 30)])
    @pytest.mark.parametrize(
        ("radius", "angle", "azimuth"), [(0.265, 7.3, 0), (0.265, 0.1, 0), (12, 40, 75), (30, 20, 180), (10, 80, -300)]
    )
    def test_solid_angle(self, radius: float, angle: float, azimuth: float, azimuths: np.ndarray | None) -> None:
        e = source_irradiance(pst_of(WHOLE, np.ones_like, azimuths_deg=azimuths), Disc(radius, 2.0, angle, azimuth))
        assert e.value == pytest.approx(2 * 2 * np.pi * (1 - np.cos(np.radians(radius))), rel=1e-8)
        assert e.covered == pytest.approx(1, abs=1e-8)

    def test_form_factor(self) -> None:
        """A sphere seen from a plate: π L sin²R cos θ; half-way below the horizon it is said what is missing."""
        pst = pst_of(np.arange(0.1, 90, 0.2), np.cos)
        e = source_irradiance(pst, Disc(15.0, 1.0, 60.0))
        assert e.value == pytest.approx(np.pi * np.sin(np.radians(15)) ** 2 * 0.5, rel=1e-5)
        below, behind = (source_irradiance(pst, Disc(20.0, 1.0, angle)) for angle in (90.0, 105.0))
        assert below.covered == pytest.approx(0.5, rel=1e-9)
        assert 0 < behind.value < below.value
        assert 0 < behind.covered < 0.2
        # Of a disc about azimuth 0 the cell from 0 to 10° sees what lies there: half, as the disc is narrower
        part = pst_of(WHOLE, np.ones_like, azimuths_deg=[5.0], azimuth_cell_deg=10.0)
        assert source_irradiance(part, Disc(1.0, 1.0, 45.0)).covered == pytest.approx(0.5, rel=1e-9)
        # The irradiance of the sun is what was asked for, at normal incidence on a plate that it hardly fills
        pst = pst_of(np.arange(0.05, 4, 0.1), np.cos)
        assert source_irradiance(pst, sun(0.0)).value == pytest.approx(1.361e-3, rel=1e-5)
        narrow = source_irradiance(pst_of(WHOLE, lorentz), sun(30.5, irradiance_W_mm2=1.0))
        assert narrow.value == pytest.approx(float(lorentz(np.radians(30.5))), rel=2e-3)

    @pytest.mark.parametrize("mode", ["linear", "log"])
    def test_interpolation(self, mode: str) -> None:
        """Exact where the PST is linear, or exponential, in field angle, against a double sum over the disc."""
        curve = (lambda t: 1 - 0.5 * t) if mode == "linear" else (lambda t: np.exp(-7 * t))
        angles = np.arange(20.0, 51.0, 5.0)
        pst = pst_of(angles, curve(np.radians(angles))[:, None], cell_deg=0.01)
        e = source_irradiance(pst, Disc(8.0, 1.0, 35.0), interpolation=mode)
        r, psi = np.radians((np.arange(800) + 0.5) / 100), (np.arange(400) + 0.5) * np.pi / 400
        cosine = np.cos(r[:, None]) * np.cos(np.radians(35)) + np.sin(r[:, None]) * np.sin(np.radians(35)) * np.cos(psi)
        value = np.sum(curve(np.arccos(cosine)) * np.sin(r[:, None])) * np.radians(0.01) * 2 * np.pi / 400
        assert e.value == pytest.approx(float(value), rel=1e-5)
        assert e.covered + e.interpolated == pytest.approx(1, rel=1e-9)
        dark = pst_of([10, 20, 30], np.array([[1e-3], [0.0], [1e-5]]), cell_deg=1.0)
        assert np.isfinite(source_irradiance(dark, Disc(5.0, 1.0, 20.0), interpolation=mode).value)


class TestErrors:
    """Standard errors against the scatter of many simulated results; 8 % of 2000 of them is 5 standard errors."""

    def simulated(self, forward: bool, rng: np.random.Generator) -> Pst:
        """Noise that the cells of a batch share, and noise of their own; forward: of their own alone."""
        grid, batches = DirectionGrid.of([0, 2, 4], azimuths_deg=[0, 180], azimuth_cell_deg=180), 12
        truth = np.array([[3.0, 2.0], [1.0, 0.5], [0.2, 0.1]])
        noise = 0.2 * rng.standard_normal((len(CLASSES), *grid.shape, batches))
        if not forward:
            noise += 0.3 * rng.standard_normal((len(CLASSES), 1, 1, batches)) + 0.3 * rng.standard_normal(batches)
        share = rng.dirichlet(np.full(batches, 400.0))
        noise = noise / np.sqrt(share * batches)  # larger batches are better
        weight = np.broadcast_to(share, (*grid.shape, batches)).copy() if forward else share
        return Pst(grid, truth[..., None] * (1 + noise), weight, method="forward" if forward else "adjoint")

    @pytest.mark.parametrize("forward", [False, True])
    def test_sum_and_quotient(self, forward: bool) -> None:
        rng, results = np.random.default_rng(7), []
        ones, first = np.ones((3, 2)), np.array([[0.5], [0.0], [0.0]]) * np.ones(2)
        for _ in range(2000):
            pst = self.simulated(forward, rng)
            ratio = rejection_ratio(pst)
            whole = weighted_sum(pst, pst.grid.solid_angle[:, None] * ones, "stray")
            results.append([whole, quotient(pst, (ones, "stray"), (first, "total")), (ratio.value[1], ratio.se[1])])
        values, errors = np.moveaxis(np.array(results), -1, 0)
        assert np.sqrt(np.mean(errors**2, axis=0)) == pytest.approx(values.std(axis=0, ddof=1), rel=0.08)

    def test_what_is_shared_cancels_in_a_quotient(self) -> None:
        """Noise common to all cells of a batch: the sum has it, the quotient has not."""
        grid = DirectionGrid.of([0, 2])
        common = 1 + 0.3 * np.random.default_rng(3).standard_normal(16)
        by_batch = np.array([[1.0, 0.5]] * len(CLASSES))[:, :, None, None] * common
        pst, ones = Pst(grid, by_batch, np.full(16, 1 / 16)), np.ones((2, 1))
        assert weighted_sum(pst, ones).se > 0.05
        assert quotient(pst, (ones, "stray"), (ones, "direct")).se < 1e-12
        ratio = rejection_ratio(pst)
        assert (ratio.value, ratio.se) == (pytest.approx([1, 0.5]), pytest.approx([0, 0], abs=1e-12))
        other = rejection_ratio(pst, reference=Estimate(pst.value[0], 0.1))
        assert other.se[1] > 0.05
        assert other.facts["reference_deg"] is None


class TestCurves:
    def test_rejection(self, tmp_path: Path) -> None:
        ratio = rejection_ratio(pst_of([0, 30, 60], np.cos, cell_deg=0.1, convention="projected"))
        assert ratio.value == pytest.approx([1, 1, 1], rel=1e-3)  # PST_p is 1 at all angles
        assert ratio.facts == {"light": "total", "reference_deg": 0.0, "convention": "projected"}
        ratio.to_csv(tmp_path / "psrr.csv")
        header, first, *_ = (tmp_path / "psrr.csv").read_text(encoding="utf-8").splitlines()
        assert header.startswith("angle_deg,quantity,value,se,unit,definition,light")
        assert DEFINITIONS["psrr"] in first
        # analytic_cases.csv: PST_projected / PST_normal = 1 / cos, and the definition says which it is
        pst = pst_of([30, 60, 80], np.cos, cell_deg=0.01)
        normal, projected = (normalised_irradiance(pst, "ndi", plane) for plane in ("normal", "projected"))
        expected = [analytic(f"PST convention th={t}", "PST_projected/PST_normal=1/cos") for t in (30, 60, 80)]
        assert projected.value / normal.value == pytest.approx(expected, rel=1e-6)
        # An F/2.2 field of ±10° and stray light of 1e-6: a lamp of 1° gives π sin²(½°) 1e-6 / 0.1543
        throughput = analytic("extended scene L=1 F/2.2 T=1", "pi/(4F^2+1)")
        pst = pst_of(WHOLE, flat(1e-6), flat(throughput / solid(0, 10), 10.0))
        assert ratios.image_throughput(pst).value == pytest.approx(throughput, rel=1e-12)
        assert ratios.ideal_throughput(2.2) == pytest.approx(throughput, rel=1e-12)
        assert ratios.ideal_throughput(np.sqrt(1.5**2 - 0.25)) == pytest.approx(np.pi / (4 * 1.5**2))  # sin u = 1/3
        light, flare = ratios.normalised_stray_light(pst, 1.0), ratios.flare_attenuation(pst, 1.0)
        assert light.value == pytest.approx(np.pi * np.sin(np.radians(0.5)) ** 2 * 1e-6 / throughput)
        assert light.value * flare.value == pytest.approx(1, rel=1e-12)
        assert ratios.flare_attenuation(pst, 1.0, decibels=True).value == pytest.approx(-10 * np.log10(light.value))
        none = pst_of([0, 2], np.zeros_like, np.ones_like)
        assert np.all(ratios.normalised_stray_light(none, 1.0).value == 0)
        assert np.all(ratios.flare_attenuation(none, 1.0).value == np.inf)

    def test_cells_that_were_not_traced(self) -> None:
        """A forward run whose time was up before 60°: what needs that cell says so, and all else is as without it."""
        whole = pst_of([0, 30, 60], np.cos, np.ones_like, cell_deg=4.0, maps=np.ones((2, 3, 1, 2, 2)))
        by_batch, maps = whole.by_batch.copy(), np.ones((2, 3, 1, 2, 2))
        by_batch[:, 2], maps[:, 2] = np.nan, np.nan
        cut = replace(whole, by_batch=by_batch, maps=maps)
        np.testing.assert_array_equal(rejection_ratio(cut).value, [*rejection_ratio(whole).value[:2], np.nan])
        later = rejection_ratio(replace(cut, by_batch=by_batch[:, ::-1]), reference_deg=30)
        assert later.value[1] == 1, "the first angle need not be traced"
        for metric in (
            lambda pst: source_irradiance(pst, Disc(1.0, 1.0, 30.0)),
            lambda pst: veiling_glare_index(pst, 1.0, source_deg=32.0, place="mean"),
            lambda pst: veiling_glare_index(pst, 1.0, source_deg=32.0, place="map"),
        ):
            assert metric(cut).value == metric(whole).value
        np.testing.assert_array_equal(glare_spread(cut).value, glare_spread(whole).value)
        told = r"1 of \d cells that count were not traced, .* the first at 60°, azimuth 0°; give the run more seconds"
        each_refused(
            (lambda: rejection_ratio(cut, reference_deg=60), told),
            (lambda: ratios.image_throughput(cut), told),
            (lambda: ratios.flare_attenuation(cut, 1.0), told),
            (lambda: ratios.equivalent_stray_radiance(cut, Disc(1.0, 1.0, 60.0), f_number=2), told),
            (lambda: source_irradiance(cut, SkyRadiance()), told),
            (lambda: veiling_glare_index(cut, 1.0, place="mean"), told),
            (lambda: veiling_glare_index(cut, 1.0, place="map"), told),
            (lambda: glare_spread(cut, 60.0), told),
        )

    def test_radiances_and_magnitudes(self) -> None:
        """Direct light within ±10°, 0.05 sr in all, and stray light of 1e-6 everywhere."""
        pst, stray = pst_of(WHOLE, flat(1e-6), flat(0.05 / solid(0, 10), 10.0)), 2 * np.pi * 1e-6 * 3.0
        own = ratios.equivalent_stray_radiance(pst, SkyRadiance(3.0))
        assert (own.value, own.unit) == (pytest.approx(stray / 0.05, rel=1e-12), "W/(mm2 sr)")
        ideal = ratios.equivalent_stray_radiance(pst, SkyRadiance(3.0), f_number=2.2, transmittance=0.9)
        assert ideal.value == pytest.approx(stray / (0.9 * 0.1543021932018562), rel=1e-12)
        ratio = ratios.stray_to_signal(pst, SkyRadiance(3.0), scene_radiance=1e-4)
        assert ratio.value == pytest.approx(stray / (1e-4 * 0.05), rel=1e-12)
        factor = ratios.contrast_factor(Estimate(0.25, 0.01))
        assert factor.estimate == (pytest.approx(0.8), pytest.approx(0.01 / 1.25**2))
        # f_λ of AB magnitude 0 at 550 nm is 3.6e-9 erg/(s cm² Å); 1 mag is a factor 10^0.4
        zero = ratios.ab_zero_point(550.0, 100.0)
        assert zero == pytest.approx(3.6e-15, rel=2e-3)
        arcsec2 = (np.pi / 648000) ** 2
        m = surface_magnitude(Estimate(zero / arcsec2 * 10 ** (-0.4 * 22), 0.01 * zero / arcsec2 * 10**-8.8), zero)
        assert m.estimate == (pytest.approx(22), pytest.approx(0.01 * 2.5 / np.log(10)))
        assert surface_magnitude(Estimate(0.0, 0.0), zero).value == np.inf


def test_veiling_glare_of_a_point_and_mean() -> None:
    """Stray light g from everywhere, a patch of 2°, and the direct light d of a point on the axis, from 0 … 0.5°.

    Over the whole detector the direct light of its field, from 0 … 5°, is no glare.
    """
    angles, d, g, patch = np.arange(0.25, 90, 0.5), 100.0, 1e-4, 2.0

    def expected(image_deg: float = 0.5) -> float:
        return 100 * g * solid(patch, 90) / (d * solid(0, image_deg) + g * solid(0, 90))

    pst = pst_of(angles, flat(g), flat(d, 0.5))
    glare = veiling_glare_index(pst, patch, place="point")
    assert glare.value == pytest.approx(expected(), rel=1e-9)
    assert (glare.unit, glare.covered) == ("%", pytest.approx(1))
    assert "taken for a point" in glare.definition
    mean = veiling_glare_index(pst_of(angles, flat(g), flat(d, 5.0)), patch)
    assert mean.value == pytest.approx(expected(5.0), rel=1e-9)
    pst = pst_of(angles, flat(g), flat(d, 18 / np.pi), azimuths_deg=np.arange(0, 360, 10))
    glare = veiling_glare_index(pst, patch, 3.0, 77.0, place="point", source_deg=40.0)
    black = cover(pst.grid, SkyRadiance(to_deg=40)).coefficients - cover(pst.grid, Disc(2, 1, 3, 77)).coefficients
    share = weighted_sum(pst, black).value / source_irradiance(pst, SkyRadiance(to_deg=40), "total").value
    assert glare.value == pytest.approx(100 * share, rel=1e-9)
    # Stray light is the same in all pixels; the image is in the pixel at x > 0, y > 0
    maps = np.zeros((2, len(angles), 1, 2, 2))
    maps[0], maps[1] = g, 0.1 * g
    maps[0, 0, 0, 1, 1] += d
    pst = pst_of(angles, np.zeros_like, maps=maps)
    glare = veiling_glare_index(pst, patch)
    assert glare.value == pytest.approx(expected(), rel=1e-9)
    assert (glare.facts["x_mm"], glare.facts["y_mm"]) == (0.5, 0.5)
    black = np.where(angles > patch, pst.grid.solid_angle, 0)
    error = np.linalg.norm(black - glare.value / 100 * pst.grid.solid_angle) * 0.1 * g
    assert glare.se == pytest.approx(100 * error / (d * solid(0, 0.5) + g * solid(0, 90)), rel=1e-6)
    assert veiling_glare_index(pst, patch, at_mm=(1.0, 1.0)).value == glare.value  # the corner of that pixel
    dark = veiling_glare_index(pst, patch, at_mm=(-0.5, 0.5))
    assert dark.value == pytest.approx(100 * solid(patch, 90) / solid(0, 90), rel=1e-9)
    # The spread of glare: direct flux on axis 0.5 · 4 mm² per W/mm²
    maps = np.array([[[[[0.25, 0.5]]], [[[0.1, 0.2]]]], [[[[0.01, 0.01]]], [[[0.01, 0.0]]]]])
    pst = pst_of([0, 40], np.zeros_like, np.array([[0.5], [0.0]]), maps=maps)
    spread = glare_spread(pst, 40.0, reference_deg=0.0)
    assert spread.value == pytest.approx(np.array([[0.05, 0.1]]))
    assert spread.se == pytest.approx(np.array([[0.005, 0.0]]))
    with refused("reference_deg within the field"):
        glare_spread(pst, 40.0)


def test_ghosts(load_scene: Callable[[str], object]) -> None:
    """One plate of n = 1.5: the first ghost has R² of the direct image, and the same shape."""
    scene = load_scene(plates_text(1))
    plate = mistray.trace(scene, rays=2000, max_reflections=2, flux_threshold=0)
    integrated, peak = ghost_to_signal(plate)
    assert integrated.value == pytest.approx(0.04**2, rel=1e-5)
    assert integrated.se < 1e-8  # the ghost of every ray has the same share of it
    assert peak.value == pytest.approx(0.04**2, rel=1e-5)
    other = ghost_to_signal(plate, plate)
    assert (other[0].value, other[1].value) == (pytest.approx(integrated.value), pytest.approx(peak.value))
    none = ghost_to_signal(mistray.trace(scene, rays=500, max_reflections=0))
    assert (none[0].value, none[1].value) == (0, 0)
    spread = glare_spread(plate)  # over the detector it adds up to the ghost's flux by that of the direct image
    x0, x1, y0, y1 = spread.extent_mm
    assert spread.value.mean() * (x1 - x0) * (y1 - y0) == pytest.approx(0.04**2, rel=1e-5)


def test_bad_input() -> None:
    pst = pst_of([0, 2, 4], np.ones_like, np.ones_like)
    dark, bright = pst_of([10, 12], np.zeros_like), pst_of([0, 2], np.ones_like, maps=np.zeros((2, 2, 1, 4, 4)))
    each_refused(
        (lambda: source_irradiance(pst, Disc(1.0, 1.0, 60.0)), "between 59 and 61°"),
        (lambda: source_irradiance(pst, Disc(1.0, 0.0)), "dark"),
        (lambda: source_irradiance(pst, SkyRadiance(), interpolation="cubic"), "'cubic'"),
        (lambda: source_irradiance(pst, SkyRadiance(), "ghosts"), "'ghosts'"),
        (lambda: source_irradiance(pst, SkyRadiance(lambda t, p: t[:, 0])), "radiance of the sky"),
        (lambda: SkyRadiance(-1.0), "not negative"),
        (lambda: SkyRadiance(from_deg=40, to_deg=30), "from 40 to 30°"),
        (lambda: Disc(100.0, 1.0), "radius_deg is 100"),
        (lambda: sun(10, diameter_deg=0), "diameter_deg is 0"),
        (lambda: rejection_ratio(dark, reference_deg=10), "10°"),
        (lambda: normalised_irradiance(pst, "nis"), "'nis'"),
        (lambda: normalised_irradiance(pst, plane="beam"), "'beam'"),
        (lambda: ratios.normalised_stray_light(dark, 1.0), "no direct light"),
        (lambda: ratios.equivalent_stray_radiance(dark, SkyRadiance(from_deg=9)), "f_number"),
        (lambda: ratios.ideal_throughput(0), "f_number is 0"),
        (lambda: ratios.stray_to_signal(pst, SkyRadiance(), 0.0), "scene_radiance is 0"),
        (lambda: surface_magnitude(Estimate(1, 0), 0), "zero_point_W_mm2 is 0"),
        (lambda: ratios.ab_zero_point(500, 600), "600 nm"),
        (lambda: veiling_glare_index(pst, 50, 45), "45°"),
        (lambda: veiling_glare_index(pst, 1, place="film"), "'film'"),
        (lambda: veiling_glare_index(pst, 1, place="map"), "map_pixels"),
        (lambda: veiling_glare_index(pst, 1, 3, place="point"), "azimuths_deg"),
        (lambda: veiling_glare_index(bright, 1, at_mm=(3.0, 0.0)), "-1 to 1"),
        (lambda: veiling_glare_index(bright, 1, at_mm=(0.0, 0.0), place="point"), "at_mm is a pixel of place 'map'"),
        (lambda: veiling_glare_index(pst, 1, at_mm=(0.0, 0.0)), "map_pixels"),
        (lambda: glare_spread(pst), "map_pixels"),
    )


BATCHES = 32


def made_up(angles: Any = range(5, 90, 10), cell_deg: float = 10.0, azimuths: Any = None) -> Pst:
    """A PST of random numbers whose batches differ in size, as after a run that was cut short."""
    rng, grid = np.random.default_rng(4), DirectionGrid.of(angles, azimuths, cell_deg)
    curve = 10.0 ** rng.uniform(-4, 0, (len(CLASSES), *grid.shape, 1))
    weight = rng.uniform(0.5, 1.5, BATCHES)
    by_batch = curve * rng.gamma(3.0, 1 / 3, (*curve.shape[:3], BATCHES))
    return Pst(grid, by_batch, weight / weight.sum(), facts={"seconds": 0.0})


DENSE, SPARSE = made_up(), made_up(range(10, 81, 20), 6.0)
AROUND = made_up(azimuths=(0, 120, 240))


def number(value: Any) -> float:
    assert dr.width(value) == 1
    return float(dr.detach(value)[0])


def total_of(pst: Pst, light: str) -> np.ndarray:
    """PST_normal of the cells, by a loop."""
    value = np.zeros(pst.grid.shape)
    for name in {"stray": CLASSES[1:], "total": CLASSES}.get(light, (light,)):
        for batch in range(BATCHES):
            value += pst.weight[batch] * pst.by_batch[CLASSES.index(name), :, :, batch]
    return value


class TestNumbers:
    @pytest.mark.parametrize("light", ["stray", "total", "ghost", "direct"])
    def test_cells(self, light: str) -> None:
        o, expected = PstObservation(AROUND.to("projected")), total_of(AROUND, light)
        n, m = AROUND.grid.shape
        np.testing.assert_allclose(np.array(o.cells(light)).reshape(n, m), expected, rtol=1e-13)
        np.testing.assert_allclose(np.array(o.curve(light)), expected.mean(axis=1), rtol=1e-13)
        assert number(o.value_at(27.0, light)) == pytest.approx(expected[2].mean(), rel=1e-13)
        assert number(o.value_at(27.0, light, 130.0)) == pytest.approx(expected[2, 1], rel=1e-13)
        low, high = np.cos(np.radians([20, 30]))
        projected = number(o.value_at(27.0, light, convention="projected"))
        assert projected == pytest.approx(expected[2].mean() / (0.5 * (low + high)), rel=1e-13)
        assert projected == pytest.approx(AROUND.to("projected").curve(light)[0][2], rel=1e-13)
        two = expected if light in ("stray", "total") else expected + total_of(AROUND, "single_scatter")
        assert number(o.value_at(5.0, [light, "single_scatter", light], 0.0)) == pytest.approx(two[0, 0], rel=1e-13)

    @pytest.mark.parametrize("interpolation", ["cells", "linear", "log"])
    def test_band(self, interpolation: str) -> None:
        """Against adaptive quadrature of the interpolated PST."""
        for pst, low, high in ((DENSE, 17.0, 64.0), (SPARSE, 8.0, 71.0)):
            if interpolation == "cells" and pst is SPARSE:
                continue
            curve, angles, edges = total_of(pst, "stray")[:, 0], pst.grid.field_deg, np.unique(pst.grid.edges_deg)

            def at(theta: float, curve=curve, angles=angles, pst=pst) -> float:
                if interpolation == "cells":
                    return float(curve[np.argmax(pst.grid.edges_deg[:, 1] >= theta)])
                if interpolation == "log":
                    return float(np.exp(np.interp(theta, angles, np.log(curve))))
                return float(np.interp(theta, angles, curve))

            def integral(function: Any, low=low, high=high, edges=edges, angles=angles) -> float:
                breaks = np.unique([low, high, *(a for a in (*edges, *angles) if low < a < high)])
                return sum(
                    quad(lambda t: function(np.degrees(t)) * np.sin(t), *np.radians(pair), epsabs=0, epsrel=1e-12)[0]
                    for pair in itertools.pairwise(breaks)
                )

            o, how = PstObservation(pst), {"interpolation": interpolation}
            whole = integral(at)
            assert number(o.band(low, high, **how)) == pytest.approx(2 * np.pi * whole, rel=1e-9)
            for convention, of in (("normal", lambda t: 1.0), ("projected", lambda t: np.cos(np.radians(t)))):
                mean = number(o.band(low, high, quantity="mean", convention=convention, **how))
                assert mean == pytest.approx(whole / integral(of), rel=1e-9)

    def test_mean_of_what_the_cells_hold(self) -> None:
        """Between cells it is dark in the integral and not in the mean."""
        o, solid = PstObservation(SPARSE), SPARSE.grid.solid_angle
        expected = np.sum(total_of(SPARSE, "stray")[:, 0] * solid)
        assert number(o.band(0, 90)) == pytest.approx(expected, rel=1e-10)
        assert number(o.band(0, 90, quantity="mean")) == pytest.approx(expected / solid.sum(), rel=1e-10)

    @pytest.mark.parametrize("place", ["mean", "point"])
    @pytest.mark.parametrize("interpolation", ["cells", "log"])
    def test_veiling_glare(self, place: str, interpolation: str) -> None:
        """Value and error of `mistray.analyses.pst.glare`."""
        how = {"place": place, "interpolation": interpolation}
        for pst, where in ((DENSE, (12.0,)), (AROUND, (7.0, 40.0, 100.0))):
            expected = veiling_glare_index(pst, *where, **how)
            o = PstObservation(pst)
            value = Metric(None, lambda seen, where=where: seen[0].veiling_glare_index(*where, **how)).evaluate([o])
            assert number(value) == pytest.approx(expected.value, rel=1e-12)
            dr.backward(value)
            assert o.noise().se == pytest.approx(expected.se, rel=1e-9)


FUNCTIONS = {
    "cell": lambda o: o.value_at(33, "ghost"),
    "projected": lambda o: o.value_at(33, "stray", 120, convention="projected"),
    "ratio": lambda o: o.value_at(33) / o.value_at(5, "direct"),
    "band": lambda o: dr.log(o.band(12, 56, ["ghost", "multiple_scatter"])),
    "mean": lambda o: o.band(12, 56, quantity="mean", convention="projected", interpolation="linear"),
    "logarithmic": lambda o: o.band(12, 56, quantity="mean", interpolation="log"),
    "mask": lambda o: smooth_maximum(o.curve("total"), 5.0),
    "glare": lambda o: o.veiling_glare_index(7.0, 40.0, 100.0),
    "glare at a point": lambda o: o.veiling_glare_index(7.0, 40.0, 100.0, place="point", interpolation="log"),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_by_every_cell(name: str) -> None:
    """Against central differences of the value with the cell changed, every class at some angles."""
    o, metric = PstObservation(AROUND), Metric(None, lambda seen: FUNCTIONS[name](seen[0]))
    value = metric.evaluate([o])
    dr.backward(value)
    found = o.derivative
    assert found.shape == AROUND.by_batch.shape[:3]
    for place in ((c, i, 1 + (i % 2)) for c in range(len(CLASSES)) for i in (0, 1, 3, 4, 8)):
        now = float(np.sum(AROUND.weight * AROUND.by_batch[place]))

        def changed(shift: float, place: tuple[int, ...] = place) -> float:
            by_batch = AROUND.by_batch.copy()
            by_batch[place] += shift
            return number(metric.evaluate([PstObservation(replace(AROUND, by_batch=by_batch))]))

        (expected,) = central_differences(changed, [0.0], [1e-3 * now])
        assert found[place] == pytest.approx(expected, rel=1e-7, abs=1e-11 * abs(number(value)) / now), place


@pytest.fixture(scope="module")
def scene() -> Any:
    return mistray.load("plate_and_wall")


TRACED = {"rays": 20_000, "max_scatters": 1}


def test_metrics_of_curve_and_band(scene) -> None:
    angles = (0.0, 20.0, 40.0)
    pst = mistray.pst(scene, angles, paths=False, **TRACED)
    stray = pst.curve("stray")[0]
    at_40 = pst_bin(scene, 40, pst_field_deg=angles, **TRACED)
    assert at_40.value() == pytest.approx(stray[2], rel=1e-12)
    projected = pst_bin(scene, 40, pst_field_deg=angles, convention="projected", **TRACED)
    assert projected.value() == pytest.approx(pst.to("projected").curve("stray")[0][2], rel=1e-12)
    direct = pst_bin(scene, 0, "direct", pst_field_deg=angles, **TRACED)
    assert direct.value() == pytest.approx(pst.curve("direct")[0][0], rel=1e-12)
    limits = (0.1, 0.01, 0.001)
    share = stray / limits
    mask = pst_mask(scene, angles, limits, **TRACED)
    assert mask.value() == pytest.approx(share.max() * np.sum((share / share.max()) ** 16) ** (1 / 16), rel=1e-10)
    assert log(at_40).value() == pytest.approx(np.log(stray[2]), rel=1e-12)
    assert at_40.value(seed=1) != at_40.value()
    # The mean over a band is the PST of one cell as wide as the band: the rays are the same
    band = pst_band(scene, 20, 50, method="adjoint", **TRACED)
    (view,) = band.views
    assert (len(view.arguments["field_deg"]), view.arguments["cell_deg"]) == (15, 2)
    wide = mistray.pst(scene, 35, cell_deg=30, paths=False, method="adjoint", **TRACED)
    assert band.value() == pytest.approx(wide.curve("stray")[0][0], rel=1e-6)  # angles are in single precision
    integral = pst_band(scene, 20, 50, quantity="integral", method="adjoint", **TRACED)
    assert integral.value() == pytest.approx(band.value() * wide.grid.solid_angle[0], rel=1e-9)
    assert (band.unit, integral.unit) == ("1", "sr")
    assert len(pst_band(scene, 10, 45.5, **TRACED).views[0].arguments["field_deg"]) == 18
    (o,) = veiling_glare(scene, 5.0, **TRACED).observe()
    assert o.pst.grid.edges_deg[[0, -1], [0, 1]].tolist() == [0, 90]


def test_closed_form_of_coatings(load_scene) -> None:
    """Every ghost carries T1 R2 R1 T2: relative derivatives 1/R and 1/T, for every ray, in single precision."""
    text = plates_text(1, R=0.1, T=0.8)
    for side in ("width", "height"):
        text = text.replace(f'"half_{side}" value="50.0"', f'"half_{side}" value="30.0"')
    scene = load_scene(text)
    params = mi.traverse(scene)
    keys = [f"p0_{face}.bsdf.{what}" for face in ("front", "rear") for what in "RT"]
    traced = {"rays": 20_000, "max_reflections": 2, "pst_field_deg": (0, 5)}
    ghost, direct = (pst_bin(scene, 0, light, **traced) for light in ("ghost", "direct"))
    merit = combine({"ghost": ghost, "direct": direct}, lambda m: dr.log(m["ghost"] / m["direct"]))
    other = pst_bin(scene, 0, **traced | {"rays": 3000, "pst_field_deg": np.array([0.0, 5.0])})
    # Equal runs are made once
    assert [len(combine({"a": merit, "b": b}, lambda m: m["a"]).views) for b in (ghost, other)] == [1, 2]
    for metric, values in (
        (log(ghost), (10.0, 1.25, 10.0, 1.25)),
        (log(direct), (0.0, 1.25, 0.0, 1.25)),
        (merit, (10.0, 0.0, 10.0, 0.0)),
    ):
        found = mistray.gradient(metric, params, keys)
        for key, value in zip(keys, values, strict=True):
            assert found.gradient[key] == pytest.approx([value], rel=1e-5, abs=1e-5), (metric.name, key)
    band = mistray.gradient(pst_band(scene, 0, 30, "ghost", rays=20_000, max_reflections=2), params, keys)
    assert band.gradient[keys[0]] == pytest.approx([10.0 * band.value], rel=1e-5)


def test_wrong_arguments(scene) -> None:
    each_refused(
        (lambda: pst_bin(scene, 20, "gost"), "light 'gost' does not exist; did you mean 'ghost'"),
        (lambda: pst_bin(scene, 20, ()), "no light is chosen; use total, stray"),
        (lambda: pst_bin(scene, 20, convention="both"), "convention is 'both'; choose from normal, projected"),
        (lambda: pst_bin(scene, 20, ray=3), "there is no setting 'ray'; did you mean 'rays'"),
        (lambda: pst_bin(scene, 20, method="forward"), "method of a PST metric is 'forward'; use 'joined'"),
        (lambda: pst_bin(scene, 20, relative_error=0.1), "relative_error is not a setting of a PST metric"),
        (lambda: pst_bin(scene, 20, next_order=True), "next_order is not a setting of a PST metric"),
        (lambda: pst_bin(scene, 20, pst_field_deg=(40,), **TRACED).value(), "angle 20° is in no cell"),
        (lambda: pst_bin(scene, (20, 40)), "field_deg is .20, 40.; it must lie between -90 and 90"),
        (lambda: pst_band(scene, 50, 20), "band from 50 to 20°; field angles must ascend"),
        (lambda: pst_band(scene, 20, 50, quantity="sum"), "quantity is 'sum'; choose from mean, integral"),
        (lambda: pst_band(scene, 20, 50, cell_deg=1.0), "cell_deg is given without pst_field_deg"),
        (lambda: pst_band(scene, 20, 50, pst_field_deg=80, **TRACED).value(), "no cell of the PST holds any of it"),
        (lambda: pst_mask(scene, 20, 1e-3, pst_field_deg=30), "leave out pst_field_deg"),
        (lambda: pst_mask(scene, (20, 40), (1e-3,)), "mask of 2 angles and 1 limits"),
        (lambda: pst_mask(scene, (20, 40), (1e-3, 0)), "limits is 0; it must lie between 1e-30"),
        (lambda: veiling_glare(scene, 5.0, place="map", **TRACED).value(), "place is 'map'; choose from mean"),
        (lambda: veiling_glare(scene, 95.0, **TRACED).value(), "patch of half-width 95°"),
        (lambda: veiling_glare(scene, 5.0, source_deg=0), "band from 0 to 0°; field angles must ascend"),
        (lambda: veiling_glare(scene, 5.0, source_deg=np.nan), "band from 0 to nan°; field angles must ascend"),
    )

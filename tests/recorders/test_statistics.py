"""Modes agree, standard errors say how far results and pixels scatter; hits on a film with a tent."""

import functools
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from lit_detector import lit, square
from oracles.frozen_paths import Hits, tent_image
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml
from oracles.statistics import assert_z, z_limit

import mistray
from mistray.errors import MistrayError
from mistray.execute.tracer import Run, prepare
from mistray.kernel.ray_tree import trace_tree
from mistray.recorders.adjoint import Adjoint
from mistray.recorders.film import Pixels, spreads
from mistray.recorders.ledger import DecodedPaths, Ledger
from mistray.settings import BATCHES, Settings
from mistray.surfaces.upload import upload

MODES = {
    "one in, one out": {"splitting": "one", "rays": 400_000},
    "roulette": {"splitting": "split", "below_threshold": "roulette", "flux_threshold": 3e-3, "rays": 60_000},
    "one, roulette": {"splitting": "one", "below_threshold": "roulette", "flux_threshold": 0.5, "rays": 400_000},
}


def lens_text(**coating: float) -> str:
    """A singlet that vignettes the beam, in front of a detector that cuts the image: every number is a random one."""
    return scene_text(
        shape_xml("asphere", "front", 0.0, interface_xml("air", "1.7", **coating), radius=30.0, semi_diameter=5.0),
        shape_xml("asphere", "rear", 3.0, interface_xml("1.7", "air", **coating), radius=-30.0, semi_diameter=5.0),
        shape_xml("asphere", "detector", 15.0, sensor=True, half_width=3.0, half_height=2.0),
        radius=6.0,
    )


@functools.cache
def split_trace(name: str, field_deg: float) -> mistray.Trace:
    """All children of every hit, which all modes are compared with."""
    scene = mistray.load(name)
    return mistray.trace(scene, rays=100_000, seed=11, flux_threshold=1e-8, max_reflections=2, field_deg=field_deg)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", ["plate", "cooke_triplet", pytest.param("phone_camera", marks=pytest.mark.slow)])
def test_modes_agree_with_splitting(name: str, mode: str) -> None:
    """Totals within 3 standard errors (four totals a case: 1 % false alarm each), strong paths at a joint 1e-3."""
    limits = {"max_reflections": 2, "field_deg": 5.0 if name != "plate" else 0.0}
    split = split_trace(name, limits["field_deg"])
    other = mistray.trace(mistray.load(name), seed=24, **MODES[mode], **limits)
    totals = []
    for t in (split, other):
        e = t.energy
        watts, errors = zip(*e.absorbed.values(), strict=True)
        absorbed = [sum(watts), np.hypot.reduce(errors)]
        totals.append([[e.detected_W, e.detected_se_W], [e.escaped_W, e.escaped_se_W], absorbed])
    (a, b) = np.array(totals).transpose(0, 2, 1)
    # what is cut by max_reflections and by the threshold moves between the books: 1e-6 of the launched flux
    floor = 2e-6 * split.energy.launched_W
    assert_z(f"{name}, totals", b[0], a[0], np.hypot(a[1], b[1]), k=3.0, floor=floor, names=["det", "esc", "abs"])
    mine = {row.events: row for row in other.paths}
    strong = [row for row in split.paths if row.events in mine and mine[row.events].rays >= 50][:12]
    assert len(strong) >= 2
    both = [(mine[row.events], row) for row in strong]
    names = [row.events for row in strong]
    for what, se in (("power_W", "power_se_W"), ("x_mm", "x_se_mm"), ("y_mm", "y_se_mm"),
                     ("rms_radius_mm", "rms_radius_se_mm")):  # fmt: skip
        measured, expected = np.array([[getattr(row, what) for row in pair] for pair in both]).T
        errors = np.array([[getattr(row, se) for row in pair] for pair in both])
        floor = 1e-6 * float(np.max(np.abs(expected)))
        assert_z(f"{name}, {what}", measured, expected, np.hypot(*errors.T), names=names, floor=floor)


class TestStandardErrors:
    """The spread over seeds against the standard errors of the single runs."""

    SEEDS = 250

    @pytest.fixture(scope="class")
    @staticmethod
    def runs(load_text) -> dict[str, np.ndarray]:
        """name → (seeds, 2): value and standard error."""
        scene, _ = load_text(lens_text(R=0.3, T=0.65))
        found: dict[str, list[tuple[float, float]]] = {}
        for seed in range(TestStandardErrors.SEEDS):
            t = mistray.trace(scene, rays=2500, seed=seed, max_reflections=2)
            e = t.energy
            values = {
                "detected": (e.detected_W, e.detected_se_W),
                "escaped": (e.escaped_W, e.escaped_se_W),
                "absorbed by front": e.absorbed["front"],
                "incident on rear": (t.surfaces[1].incident_W, t.surfaces[1].incident_se_W),
            }
            for row in t.paths[:2]:
                for key in ("power_W", "incident_W", "x_mm", "y_mm", "rms_radius_mm", "rms_irradiance_W_mm2"):
                    stem, unit = key.split("_", 1) if not key.startswith("rms") else (key[: key.index("_", 4)], "")
                    error = f"{stem}_se_{unit}" if unit else key.replace(stem, f"{stem}_se", 1)
                    values[f"{row.path} {key}"] = (getattr(row, key), getattr(row, error))
            for name, pair in values.items():
                found.setdefault(name, []).append(pair)
        return {name: np.array(pairs) for name, pairs in found.items()}

    def test_chi_square(self, runs: dict[str, np.ndarray]) -> None:
        """The square of t of 31 degrees of freedom has mean 1.069 and variance 2.54; joint false alarm 1e-3."""
        n = self.SEEDS
        limit = z_limit(len(runs), 1e-3)
        for name, pairs in runs.items():
            value, se = pairs.T
            assert len(value) == n
            chi2 = float(np.sum(np.square((value - value.mean()) / se))) / n
            assert abs(chi2 - 31 / 29) < limit * np.sqrt(2.54 / n), f"{name}: chi²/n = {chi2:.3f}"

    def test_binomial(self, load_text) -> None:
        """One in, one out: σ = sqrt(p (1 - p)/N) (A13); from 32 batches it is known to 12.6 %: 5 of these."""
        scene, _ = load_text(plates_text(1, R=0.2, T=0.6))
        t = mistray.trace(scene, rays=50_000, splitting="one", max_reflections=40)
        row, launched = t.paths[0], t.energy.launched_W
        unit = launched / 50_000 * row.power_W / (row.rays * launched / 50_000)  # weight of one ray: absorption stays
        share = row.rays / 50_000
        assert row.power_se_W == pytest.approx(unit * np.sqrt(share * (1 - share) * 50_000), rel=5 * 0.126)
        # Those of random positions, hence too large rather than too small, and not those of rows of the grid
        text = lens_text().replace("</emitter>", '<string name="pattern" value="grid"/></emitter>')
        even, grid = (mistray.trace(load_text(which)[0], rays=10_000).paths[0] for which in (lens_text(), text))
        assert grid.rays > 1000
        random = grid.rms_radius_mm / np.sqrt(2 * grid.rays)
        for error in (grid.x_se_mm, grid.y_se_mm):
            assert error == pytest.approx(random, rel=0.2 + 5 * 0.126)  # the image is cut to a rectangle
        share = grid.rays / 10_000
        assert grid.power_se_W == pytest.approx(grid.power_W * np.sqrt((1 - share) / (share * 10_000)), rel=5 * 0.126)
        for what in ("x_se_mm", "y_se_mm", "rms_radius_se_mm", "power_se_W"):
            assert getattr(grid, what) > getattr(even, what), what
        assert np.abs((grid.x_mm, grid.y_mm)).max() < 3 * grid.x_se_mm

    @pytest.mark.parametrize("rays", [1, 10, 31, 1000, 4097])
    def test_no_error_where_nothing_is_random(self, rays: int) -> None:
        """Every ray of the plate does the same, also if the batches are not of equal size; one ray cannot show that."""
        t = mistray.trace(mistray.load("plate"), rays=rays)
        if rays == 1:
            assert t.energy.detected_se_W == t.energy.detected_W
            return
        assert t.energy.detected_se_W <= 1e-7 * t.energy.detected_W
        assert all(t.paths.power([row.path_id])[1] <= 1e-6 * row.power_W for row in t.paths)
        assert all(row.incident_se_W <= 1e-7 * row.incident_W for row in t.surfaces if row.incident_W)

    def test_map(self, load_text) -> None:
        """Variance over 60 seeds against the squared error, in all pixels together; false alarm 1e-3."""
        scene, _ = load_text(lens_text().replace('value="64"', 'value="12"'))
        seeds = 60
        maps = [mistray.trace(scene, rays=4000, seed=seed, max_reflections=0, ledger=False) for seed in range(seeds)]
        values = np.array([t.irradiance for t in maps])
        errors = np.array([np.linalg.norm(t.light.apart, axis=-1) for t in maps])  # of pixels of few rays, too
        lit = (values > 0).all(axis=0)
        assert lit.sum() > 60
        ratio = values[:, lit].var(axis=0, ddof=1) / np.square(errors[:, lit]).mean(axis=0)
        # each variance has 59 degrees of freedom
        assert abs(ratio.mean() - 1) < z_limit(1, 1e-3) * np.sqrt(2 / 59 / lit.sum())


class TestStartRays:
    """A generator whose streams were correlated once passed all tests of means and failed these."""

    @pytest.mark.parametrize("rays", [1_000, 40_000])
    def test_uniform_and_even(self, load_text, rays: int) -> None:
        """Variance of means and chi² of 8 × 8 cells over 200 seeds fall as 1/n or faster; joint false alarm 1e-3."""
        text = scene_text(shape_xml("asphere", "detector", 1.0, sensor=True, half_width=2.0, half_height=2.0))
        size = 'name="half_width" value="1"/><float name="half_height" value="1"'
        scene, _ = load_text(text.replace('name="radius" value="1.0"', size))
        z, chi2, seeds = [], [], 200
        for seed in range(seeds):
            (run,) = prepare(scene, Settings(rays=rays, seed=seed))
            origin, _ = run.start_rays(np.arange(rays))
            z.append(origin[:, :2].mean(axis=0) * np.sqrt(3 * rays))
            cells, _, _ = np.histogram2d(origin[:, 0], origin[:, 1], bins=8, range=[[-1, 1]] * 2)
            chi2.append(np.sum(np.square(cells - rays / 64)) / (rays / 64))
        variance = np.square(z).mean(axis=0)
        even = 32 / rays  # of a batch
        assert np.all(variance < 10 * even), f"variance of the means {variance}"
        assert np.all(np.abs(np.mean(z, axis=0)) < z_limit(5, 1e-3) * np.sqrt(variance / seeds))
        assert np.mean(chi2) < 63 * np.minimum(1.0, 10 * np.sqrt(even)), f"chi² {np.mean(chi2):.1f} of 63 cells"

    def test_batches_are_independent(self, load_text) -> None:
        """Means of the 32 batches scatter as independent samples do, if less than random ones; false alarm 1e-3."""
        scene, _ = load_text(scene_text(shape_xml("asphere", "d", 1.0, sensor=True, half_width=2.0, half_height=2.0)))
        values = []
        for seed in range(60):
            (run,) = prepare(scene, Settings(rays=3200, seed=seed))
            start = run.start_pass(0)
            x, number = np.array(start.o.x, dtype=float), np.array(start.batch)
            values.append(np.bincount(number, x, 32) / np.bincount(number) * np.sqrt(4 * 100))  # radius 1: variance ¼
        values = np.array(values)
        assert np.var(values) < 0.2
        between = np.corrcoef(values.T)[np.triu_indices(32, 1)]
        assert abs(between.mean()) < z_limit(2, 1e-3) / np.sqrt(60 * between.size)


SIZE = 24


def image(draw: object, mean: float, seed: int = 0) -> Pixels:
    """An image of as many rays in a pixel in the mean, of weights that `draw` gives."""
    rng = np.random.default_rng(seed)
    film = np.zeros((BATCHES + 3, SIZE, SIZE))
    count = rng.poisson(mean, (SIZE, SIZE))
    y, x = (np.repeat(place.ravel(), count.ravel()) for place in np.indices(count.shape))
    weight = draw(rng, len(y))  # type: ignore[operator]
    np.add.at(film, (rng.integers(0, BATCHES, len(y)), y, x), weight)
    for number, power in enumerate((0, 2, 4), BATCHES):
        np.add.at(film[number], (y, x), weight**power)
    return Pixels.of_film(film, np.full(BATCHES, 1000.0), 0.37)


def even(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.ones(count)


def uneven(rng: np.random.Generator, count: int) -> np.ndarray:
    """One ray in a hundred brings ten times as much light as all others."""
    return np.where(rng.random(count) < 0.01, 1000.0, 1.0)


def test_rays_of_equal_weight_are_counted() -> None:
    found = image(even, 10.0)
    np.testing.assert_array_equal(found.few_rays, found.weights[0] < 10)
    np.testing.assert_array_equal(np.isnan(found.se), found.weights[0] < 10)
    # Most pixels of 40 rays lack the heavy ones, and would have a small error without their neighbours
    found = image(uneven, 40.0)
    assert np.mean(found.value < 0.37 * 1000) > 0.5
    assert found.few_rays.mean() > 0.97  # some squares of the corners lack them, too
    found = image(even, 4.0)
    assert found.few_rays.mean() > 0.95
    assert not found.few_in_squares(4).any()


@pytest.mark.parametrize(("draw", "mean"), [(even, 14.0), (even, 40.0), (uneven, 2500.0)])
def test_errors_hold(draw: object, mean: float) -> None:
    """Of pixels 1.5 % at most are off by 3 errors: of 20 images of 576, above it by chance below once in 10⁹ times."""
    expected = 0.37 * mean * (1.0 if draw is even else 0.99 + 0.01 * 1000.0)
    images = [image(draw, mean, seed) for seed in range(20)]
    z = np.concatenate([((one.value - expected) / one.se)[~one.few_rays] for one in images])
    assert z.size > 0.5 * 20 * SIZE**2
    assert np.mean(np.abs(z) > 3) < 0.015
    assert 0.6 < np.mean(np.abs(z) < 1) < 0.8


def test_a_trace_counts_its_hits() -> None:
    beam = {"type": "collimated", "radius": 1.0, "irradiance": 2.0 / np.pi}
    here = lit(beam, detector=square(2.0, 6, z=5.0, bsdf={"type": "interface", "R": 0.25}))
    t = mistray.trace(here, rays=512)
    rays, squares, fourths = t.light.weights
    one = 2.0 * 0.75 / 512 / (4.0 / 6) ** 2  # W/mm² of a ray
    assert rays.sum() == 512
    np.testing.assert_allclose(t.irradiance, rays * one, rtol=1e-6)
    np.testing.assert_allclose(squares, rays * one**2, rtol=1e-6)
    np.testing.assert_allclose(fourths, rays * one**4, rtol=1e-6)
    np.testing.assert_array_equal(np.isnan(t.irradiance_se), rays < 10)
    # A single ray has no spread, but an error
    energy = mistray.trace(here, rays=1).energy
    assert energy.detected_se_W == energy.detected_W > 0


RAYS = 4000


def moving_lens(
    film: str = '<rfilter type="box"/>', pixels: int = 8, z: float = 14.0, far: float = 0.0, radius: float = 3.5
) -> str:
    """A lens with ghosts; its beam is larger than the detector, whose middle may lie far from the axis."""
    glass = interface_xml("air", "1.7"), interface_xml("1.7", "air")
    text = scene_text(
        shape_xml("asphere", "front", 3.0, glass[0], curvature=0.08, semi_diameter=4.0),
        shape_xml("asphere", "rear", 6.0, glass[1], curvature=-0.02, semi_diameter=4.0),
        shape_xml("asphere", "detector", z, interface_xml(R=0.1), sensor=True, half_width=1.5, half_height=1.0),
        radius=radius,
    )
    text = text.replace('value="64"', f'value="{pixels}"').replace('<rfilter type="box"/>', film)
    return text.replace(f'<translate z="{z!r}"/>', f'<translate x="{-far!r}" z="{z!r}"/>')


def executed(scene: Any, **settings: Any) -> Run:
    (run,) = prepare(scene, Settings.of(scene, rays=RAYS, **settings))
    return run.execute(ledger=True)


def books(run: Run) -> tuple[Ledger, DecodedPaths]:
    assert run.ledger is not None
    assert run.sums.paths is not None
    return run.ledger, run.sums.paths


def recorded(run: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[bytes]]:
    """x, y (mm), weight and events of every hit of a plane detector that is not tilted, from the recorder."""
    recorder = run.record(None, 100_000)
    n = int(recorder.count[0])
    length = np.array(recorder.length)[:n]
    last = recorder.nodes_of(np.arange(n), recorder.max_events)[np.arange(n), length - 1]
    codes = np.array(recorder.codes).reshape(recorder.capacity, -1)[:n]
    x, y = (last[:, :2] - run.table.vertices[run.table.detector][:2]).T
    return x, y, last[:, 6], [codes[i, : length[i]].tobytes() for i in range(n)]


def metric(run: Run, **derivatives: Any) -> Adjoint:
    return Adjoint(0, run.make_film(), **derivatives, ledger=run.ledger)


def gains(run: Run, adjoint: Adjoint) -> float:
    trace_tree(run.scene, run.start_pass(0), run.settings, [adjoint])
    dr.eval(adjoint.gain)
    return float(np.array(adjoint.gain).sum())


class TestTent:
    def test_a_hit_is_spread_over_four_pixels_or_counts_in_one(self, load_scene) -> None:
        """The image is that of the oracle, float64, from the hits of the recorder; no flux is lost at the border."""
        run = executed(load_scene(moving_lens('<rfilter type="tent"/>')))
        x, y, w, _ = recorded(run)
        expected = tent_image([Hits(x, y, 0.9 * w, w, np.zeros((0, len(x), 3)), [])], (-1.5, 1.5, -1.0, 1.0), (8, 8))
        np.testing.assert_allclose(run.light.value, expected, rtol=2e-4, atol=1e-6 * expected.max())
        np.testing.assert_allclose(run.light.value.sum(), 0.9 * w.sum(), rtol=1e-6)
        assert np.any(np.abs(x) > 1.5 - 1.5 / 8)  # beyond the centres of the outer pixels
        run = executed(load_scene(moving_lens()))
        x, y, w, _ = recorded(run)
        expected, _, _ = np.histogram2d(y, x, bins=8, range=((-1.0, 1.0), (-1.5, 1.5)), weights=0.9 * w)
        np.testing.assert_allclose(run.light.value, expected, rtol=2e-3, atol=1e-3 * expected.max())
        np.testing.assert_allclose(run.light.value.sum(), 0.9 * w.sum(), rtol=1e-6)
        # Maps of paths are spread by a tent as well
        t = mistray.trace(load_scene(moving_lens('<rfilter type="tent"/>')), rays=RAYS)
        np.testing.assert_allclose(sum(t.irradiance_of([row.path_id])[0] for row in t.paths), t.irradiance, rtol=1e-9)

    def test_a_tent_of_another_width(self, load_scene) -> None:
        with pytest.raises(MistrayError, match=r"rfilter 'tent' has a radius of 2.5 pixels"):
            executed(load_scene(moving_lens('<rfilter type="tent"><float name="radius" value="2.5"/></rfilter>')))
        for kind, expected in (("tent", True), ("box", False), ("gaussian", False)):
            assert spreads(mi.load_dict({"type": "hdrfilm", "rfilter": {"type": kind}})) is expected


class TestDerivativeOfHits:
    @pytest.mark.parametrize("film", ["box", "tent"])
    def test_by_pixels(self, load_scene, film: str) -> None:
        run = executed(load_scene(moving_lens(f'<rfilter type="{film}"/>')))
        pixel = np.random.default_rng(2).normal(size=(8, 8))
        expected = np.sum(pixel * run.light.value)
        assert gains(run, metric(run, pixel=upload(mi.Float, pixel))) == pytest.approx(expected, rel=1e-5)

    def test_by_moments_of_paths(self, load_scene) -> None:
        """The ledger's sums know the flux, its first moments and x² + y²; the rest comes from the recorder."""
        run = executed(load_scene(moving_lens()))
        ledger, paths = books(run)
        coefficients = np.zeros((ledger.capacity, 6))
        coefficients[paths.slots] = np.random.default_rng(3).normal(size=(len(paths.slots), 6))
        x, y, w, texts = recorded(run)
        expected = 0.0
        for events, length, slot in zip(paths.events, paths.lengths, paths.slots, strict=True):
            mine = np.array([text == events[:length].tobytes() for text in texts])
            assert mine.any()
            terms = np.stack([np.ones(mine.sum()), x[mine], y[mine], x[mine] ** 2, y[mine] ** 2, x[mine] * y[mine]])
            expected += float(coefficients[slot] @ terms @ (0.9 * w[mine]))
        found = gains(run, metric(run, path=upload(mi.Float64, coefficients)))
        assert found == pytest.approx(expected, rel=1e-5)
        assert found != pytest.approx(1.01 * expected, rel=1e-5)
        # Variance of the place about its mean: its terms cancel to some 1e-6 of their size
        run = executed(load_scene(moving_lens(z=19.0, far=1.2, radius=0.2)))
        ledger, paths = books(run)
        sums = paths.sums.sum(axis=1)
        slot = int(paths.slots[np.argmax(sums[:, 2])])
        _, _, flux, moment, *_ = sums[np.argmax(sums[:, 2])]
        mean = moment / flux
        coefficients = np.zeros((ledger.capacity, 6))
        coefficients[slot] = np.array([mean**2, -2 * mean, 0.0, 1.0, 0.0, 0.0]) / flux
        x, _, w, texts = recorded(run)
        row = int(np.flatnonzero(paths.slots == slot)[0])
        events = paths.events[row][: paths.lengths[row]].tobytes()
        mine = np.array([text == events for text in texts])
        expected = np.average((x[mine] - mean) ** 2, weights=w[mine])
        assert expected < 1e-5 * mean**2
        assert gains(run, metric(run, path=upload(mi.Float64, coefficients))) == pytest.approx(expected, rel=1e-4)

    def test_paths_that_the_ledger_does_not_know(self, load_scene) -> None:
        scene = load_scene(moving_lens())
        run = executed(scene, max_reflections=0)
        other = executed(scene, max_reflections=2)
        assert run.ledger is not None
        assert other.sums.paths is not None
        known = np.array(run.ledger.keys)
        other, coefficients = replace(other, ledger=run.ledger), np.zeros((run.ledger.capacity, 6))
        coefficients[:, 0] = 1.0
        adjoint = metric(other, path=upload(mi.Float64, coefficients))
        direct = other.sums.paths.sums.sum(axis=1)[other.sums.paths.keys == known[known != 0][0]][0, 2]
        assert gains(other, adjoint) == pytest.approx(direct, rel=1e-6)
        assert float(adjoint.unknown[0]) == pytest.approx(other.sums.paths.sums.sum(axis=(0, 1))[2] - direct, rel=1e-5)
        np.testing.assert_array_equal(np.array(run.ledger.keys), known)

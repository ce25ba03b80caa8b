"""Fits with a covariance: a model in closed form, and the PST in bands against its own cells and differences."""

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from example_scripts import script
from refusals import each_refused, refused

import mistray
from mistray.gradients.table_gradient import GradientRequest
from mistray.optimize import Evaluations, Modelled, PstBands, fit, pst_bin

X = np.linspace(0, 2, 12)
TRUTH = {"height": 3.0, "decay": 0.7}


def exponential(values: np.ndarray, noise: float = 0.0) -> Modelled:
    a, b = values
    value = a * np.exp(-b * X)
    return Modelled(value, noise**2 * np.eye(len(X)), np.stack([value / a, -X * value], axis=1))


class TestFit:
    """A sum of squares whose minimum is known."""

    def test_exact_data_give_the_truth(self):
        exact = exponential(np.array([3.0, 0.7])).value
        found = fit(exponential, exact, np.full(12, 0.01), {"height": 30, "decay": 0.05})
        assert found.value == pytest.approx([3.0, 0.7], rel=1e-4)
        assert found.chi_square < 1e-3
        assert found.degrees == 10

    def test_regions_hold_the_truth_as_often_as_they_say(self):
        """400 draws at 95 %: 380 ± 4.4 expected, 362 or less with a probability of 1e-4."""
        rng, start = np.random.default_rng(3), {"height": 2.0, "decay": 1.0}
        data = exponential(np.array([3.0, 0.7])).value + np.hypot(0.05, 0.03) * rng.standard_normal((400, 12))
        fits = [fit(lambda values: exponential(values, 0.03), one, np.full(12, 0.05), start) for one in data]
        assert 362 <= sum(found.covers(TRUTH) for found in fits) <= 396
        # Mean of χ² with 2 degrees: 2 ± 0.1; a covariance that is wrong by a factor of 1.5 is seen
        assert np.mean([found.distance(TRUTH) for found in fits]) == pytest.approx(2.0, abs=0.4)


ANGLES = np.linspace(0, 3, 20)
SHAPES = np.exp(-3 * ANGLES), 1 / (1 + ANGLES), np.sin(3 * ANGLES)
WEAK = {"rough": 0.35, "grey": 1.0, "shift": -0.02}
SCALES: dict[str, Any] = {"low": (0, 0, -np.inf), "power": (2, 1, 1)}


def weak(values: np.ndarray) -> Modelled:
    """A PST as it is: the square of a roughness, a share, and a displacement of either sign, not quite linear."""
    rough, grey, shift = values
    one, two, three = SHAPES
    value = rough**2 * one + grey * (1 + 0.3 * shift) * two + shift * three
    by = np.stack([2 * rough * one, (1 + 0.3 * shift) * two, three + 0.3 * grey * two], axis=1)
    return Modelled(value, np.zeros((20, 20)), by)


class TestScales:
    """Parameters that data hardly know, of either sign, and limits."""

    def test_regions_of_a_weak_roughness(self):
        """
        Its square is 0.12 with an error of 0.06: in the logarithm regions were cut off on one side.

        400 draws at 95 %: 380 ± 4.4, outside of 362 … 394 with a probability of 1e-3. The mean χ² of three parameters
        is 3 ± 0.12, less what the bound takes, which one in forty estimates meets.
        """
        value = weak(np.array(list(WEAK.values()))).value
        model, start = Evaluations(weak), {"rough": 0.9, "grey": 0.6, "shift": 0.1}
        noise = (np.random.default_rng(seed).standard_normal(20) for seed in range(400))
        fits = [fit(model, value * (1 + 0.05 * one), 0.05 * value, start, **SCALES) for one in noise]
        assert 362 <= sum(found.covers(WEAK) for found in fits) <= 394
        assert np.mean([found.distance(WEAK) for found in fits]) == pytest.approx(3.0, abs=0.4)
        # 57 ± 1.7, 50 or less with a probability of 1e-3
        intervals = np.array([found.interval("rough") for found in fits[:60]])
        assert np.count_nonzero((intervals[:, 0] <= WEAK["rough"]) & (WEAK["rough"] <= intervals[:, 1])) >= 51
        assert len(model.points) < 200, "most draws found a point of an earlier one"

    def test_every_start_ends_at_the_same_and_the_interval_is_the_profile(self):
        value = weak(np.array([0.5, 1.0, -0.4])).value
        for start in (3.0, -2.0, 0.0):
            found = fit(weak, value, 0.01 * value, {"rough": 1.0, "grey": 2.0, "shift": start}, **SCALES)
            assert found.value == pytest.approx([0.5, 1.0, -0.4], rel=2e-3)
        # Its ends: where the least χ² over the other two parameters is 3.841 above that of all
        value = weak(np.array(list(WEAK.values()))).value
        data = value * (1 + 0.05 * np.random.default_rng(7).standard_normal(20))
        found = fit(weak, data, 0.05 * value, dict(WEAK), **SCALES)
        with refused("name is 'nope'"):
            found.interval("nope")
        for k, name in enumerate(WEAK):
            for end in found.interval(name):
                step = np.square([end, found.value[k]]) if k == 0 else np.array([end, found.value[k]])
                others = np.delete(found.slope, k, axis=1) / (0.05 * value)[:, None]
                left = (found.residual - found.slope[:, k] * (step[0] - step[1])) / (0.05 * value)
                left -= others @ np.linalg.lstsq(others, left, rcond=None)[0]
                assert left @ left - found.chi_square == pytest.approx(3.8415, rel=1e-4)

    def test_limits(self):
        """One number u with error 1, measured as -0.5: u ≥ 0 ends where (u + 0.5)² - 0.25 = 3.8415; and lower ones."""

        def one(value: float, slope: float) -> Modelled:
            return Modelled(np.array([value, 1.0]), np.zeros((2, 2)), np.array([[slope], [0.0]]))

        found = fit(lambda v: one(v[0] ** 2, 2 * v[0]), [-0.5, 1.0], [1.0, 1.0], {"rms": 3.0}, low=0.0, power=2)
        low, high = found.interval("rms")
        assert (found.value[0], low) == (0.0, 0.0)
        assert high**2 == pytest.approx(-0.5 + np.sqrt(0.25 + 3.8415), rel=1e-4)
        assert str(found).startswith(f"rms < {high:.4g} with 95%")
        assert found.distance({"rms": 0.0}) == pytest.approx(0.0)
        assert found.chi_square == pytest.approx(0.25)
        with refused(r"rms is -1; it lies between 0"):
            found.distance({"rms": -1.0})
        found = fit(lambda v: one(v[0], 1.0), [9.5, 1.0], [1.0, 1.0], {"x": 0.0}, low=-20, high=9)
        low, high = found.interval("x")
        assert (low, high) == pytest.approx((9.5 - np.sqrt(0.25 + 3.8415), 9.0), rel=1e-5)
        assert "x > " in str(found)
        flat = fit(lambda v: one(v[0], 1.0), [0.2, 1.0], [9.0, 1.0], {"x": 0.0}, low=-1, high=1)
        assert "all from -1 to 1 agree" in str(flat)


ONES, TWO, THREE = np.ones(12), {"height": 1.0, "decay": 1.0}, {"rough": 1.0, "grey": 2.0, "shift": 0.0}


def test_refusals():
    each_refused(
        ((exponential, ONES, np.zeros(12), TWO), {}, "standard error of 0"),
        ((exponential, ONES, ONES, TWO | {"height": -1.0}), {"power": 0}, "above 0"),
        ((exponential, ONES[:2], ONES[:2], TWO), {}, "observed has 2 numbers for 2 parameters"),
        ((exponential, ONES, ONES[:3], TWO), {}, "shape"),
        ((exponential, ONES[:11], ONES[:11], TWO), {}, "12 numbers for 11"),
        ((weak, np.ones(20), np.ones(20), THREE | {"rough": -1.0}), SCALES, "rough starts with -1"),
        ((weak, np.ones(20), np.ones(20), THREE | {"rough": 0.0}), SCALES, "starts with 0; start between above 0"),
        ((weak, np.ones(20), np.ones(20), THREE), {"power": -1}, r"power is \[-1"),
        ((weak, np.ones(20), np.ones((20, 20)), THREE), {}, "positive definite"),
        by=lambda arguments, more: fit(*arguments, **more),
    )


LINE = 3 * X + 1 + 0.1 * np.random.default_rng(0).standard_normal(12)
SLOPE = 10 * np.linalg.norm(X)  # of the line by its steepness, in standard errors
BEST = float(X @ (LINE - 1) / (X @ X))
HALF = np.sqrt(3.841459) / SLOPE


def line(values: np.ndarray, effect: float = 0.0) -> Modelled:
    """A steepness, and a position that hardly changes a thing."""
    by = np.stack([X, effect * np.sin(X)], axis=1)
    return Modelled(by @ values + 1, np.zeros((12, 12)), by)


def twins(values: np.ndarray) -> Modelled:
    """Two parameters that do the same thing, and one that does not."""
    by = np.stack([X, X, np.sin(X)], axis=1)[:, : len(values)]
    return Modelled(by @ values + 1, np.zeros((12, 12)), by)


def placed(effect: float, place: float) -> Any:
    """A fit of the steepness and of a position within ±100."""
    start, low, high = {"steep": 1.0, "y": place}, (-np.inf, -100), (np.inf, 100)
    return fit(lambda values: line(values, effect), LINE, np.full(12, 0.1), start, low=low, high=high)


class TestUntold:
    """Parameters that data do not tell stay where they are, and the others are as without them."""

    @pytest.mark.parametrize("effect", [0.0, 1e-18, -1e-9])
    @pytest.mark.parametrize("place", [0.0, 22.0])
    def test_a_position_without_effect_stays(self, effect, place):
        """Rounding leaves a derivative of 1e-18: the step that it asks for is 1e17 long."""
        found = placed(effect, place)
        assert found.value == pytest.approx([BEST, place], rel=1e-6)
        assert found.untold == {"y": ()}
        assert (found.told, found.degrees) == (1, 11)
        assert found.interval("steep") == pytest.approx((BEST - HALF, BEST + HALF), rel=1e-5)
        assert found.interval("y") == (-100, 100)
        assert f"y: no datum depends on it, it stays {place:.4g}" in str(found)
        assert found.standard_error == pytest.approx([1 / SLOPE, np.inf])
        assert np.isnan(found.correlation[0, 1])
        assert found.distance({"steep": BEST + HALF, "y": -99.0}) == pytest.approx(3.841459, rel=1e-5)
        assert not found.covers({"steep": BEST + 1.01 * HALF, "y": -99.0})

    @pytest.mark.parametrize("power", [0.0, 1.0])
    def test_a_factor_without_effect_within_its_bounds_stays(self, power):
        """From 1/100 to 100 it moves the data by 2e-4 standard errors."""

        def model(values):
            by = 1e-6 * np.sin(X)
            jacobian = np.stack([X, by / values[1]], axis=1)
            return Modelled(values[0] * X + 1 + by * np.log(values[1]), np.zeros((12, 12)), jacobian)

        bounds = {"low": (-np.inf, 0.01), "high": (np.inf, 100.0)}
        found = fit(model, LINE, np.full(12, 0.1), {"steep": 1.0, "factor": 1.0}, power=(1, power), **bounds)
        assert (found.estimate["factor"], found.untold) == (1.0, {"factor": ()})

    @pytest.mark.parametrize("power", [0.0, 1.0, 2.0])
    def test_a_start_of_almost_nothing_is_no_lack_of_effect(self, power):
        """It begins 1e-4 standard errors above its bound, where it hardly changes a thing."""
        exact, start = 3 * X + 1, 1e-4 / SLOPE
        found = fit(line, exact, np.full(12, 0.1), {"steep": start, "y": 0.0}, low=(0, -1), power=(power, 1))
        assert found.value[0] == pytest.approx(3.0, rel=0.02)
        assert found.untold == {"y": ()}

    def test_a_weak_effect_is_an_effect(self):
        """A position of which all values together move the data by two standard errors is fitted, and limited."""
        found = placed(1e-3, 0.0)
        both = np.linalg.lstsq(np.stack([X, 1e-3 * np.sin(X)], axis=1), LINE - 1, rcond=None)[0]
        assert abs(both[1]) > 100, "else the bound does not hold it"
        assert found.value[1] == np.sign(both[1]) * 100
        assert not found.untold

    def test_two_that_do_the_same_are_known_as_a_sum(self):
        """Of a sum s ± h, with a in 0 … 1, b is from s - h - 1 to s + h; a third is told beside them."""
        found = fit(twins, LINE, np.full(12, 0.1), {"a": 1.0, "b": 0.5})
        assert found.value == pytest.approx([BEST / 2 + 0.25, BEST / 2 - 0.25], rel=1e-6), "the least change of both"
        assert found.untold == {"a": ("b",), "b": ("a",)}
        assert (found.told, found.degrees) == (1, 11)
        assert found.interval("a") == (-np.inf, np.inf)
        assert "a: all from -inf to inf agree with the data with some b" in str(found)
        assert np.all(np.isinf(found.standard_error))
        assert found.covers({"a": 100.0, "b": BEST - 100})
        assert found.distance({"a": 100.0, "b": BEST - 100 + HALF}) == pytest.approx(3.841459, rel=1e-5)
        found = fit(twins, LINE, np.full(12, 0.1), {"a": 0.5, "b": 1.0}, low=(0, -np.inf), high=(1, np.inf))
        assert found.interval("a") == (0, 1)
        assert found.interval("b") == pytest.approx((BEST - HALF - 1, BEST + HALF), rel=1e-5)
        limited = fit(twins, LINE, np.full(12, 0.1), {"a": 0.5, "b": 1.0}, low=0)
        assert limited.interval("a") == pytest.approx((0, BEST + HALF), rel=1e-5)
        found = fit(twins, LINE, np.full(12, 0.1), {"a": 1.0, "b": 0.5, "c": 0.0})
        by = np.stack([X, np.sin(X)], axis=1)
        best, error = np.linalg.lstsq(by, LINE - 1, rcond=None)[0], np.sqrt(np.linalg.inv(by.T @ by)[1, 1]) / 10
        assert found.value[2] == pytest.approx(best[1], rel=1e-6)
        assert found.standard_error[2] == pytest.approx(error)
        assert found.interval("c") == pytest.approx(best[1] + error * np.sqrt(3.841459) * np.array([-1, 1]), rel=1e-5)
        assert set(found.untold) == {"a", "b"}

    def test_nothing_told(self):
        found = fit(lambda _: Modelled(np.ones(12), np.zeros((12, 12)), np.zeros((12, 1))), LINE, np.ones(12), {"a": 1})
        assert (found.told, found.degrees, found.evaluations, found.value[0]) == (0, 12, 1, 1)
        assert found.covers({"a": -1e9})


KEYS = ("polish.rms_nm", "dust.level", "black.reflectance")
SETTINGS: dict[str, Any] = {"azimuths_deg": (0, 180), "rays": 2000, "max_scatters": 1, "seed": 5}


@pytest.fixture(scope="module")
def scene() -> Any:
    return mistray.load("lens_and_screen")


class TestPstBands:
    """The derivatives of a curve from one replay."""

    def test_jacobian_is_that_of_single_numbers(self, scene):
        """Each row against `mistray.gradient` of that cell; a band of both cells is the mean over solid angles."""
        bands = PstBands(scene, KEYS, (20, 22, 24), cell_deg=2.0, **SETTINGS)
        found = bands(bands.start)
        assert bands.bands == [(0, 20.0, 22.0), (180, 20.0, 22.0), (0, 22.0, 24.0), (180, 22.0, 24.0)]
        cells = {"pst_field_deg": (21.0, 23.0), "cell_deg": 2.0, **SETTINGS}
        for row, (azimuth, low, high) in enumerate(bands.bands):
            metric = pst_bin(scene, (low + high) / 2, azimuth_deg=azimuth, **cells)
            expected = mistray.gradient(metric, mi.traverse(scene), KEYS)
            assert found.value[row] == pytest.approx(expected.value, rel=1e-6)
            derivatives = [expected.gradient[key][0] for key in KEYS]
            assert found.jacobian[row] == pytest.approx(derivatives, rel=1e-5, abs=1e-6 * expected.value)
            assert np.sqrt(found.covariance[row, row]) == pytest.approx(expected.value_se, rel=1e-6)
        wide = PstBands(scene, KEYS, (20, 24), cell_deg=2.0, **SETTINGS)
        solid = -np.diff(np.cos(np.radians([20, 22, 24])))
        parts = bands.measure(bands.start)[0].reshape(2, 2)
        assert wide.measure(wide.start)[0] == pytest.approx(solid @ parts / solid.sum(), rel=1e-6)

    def test_positions_are_within_the_size_of_the_scene(self, scene):
        """The box is that of the housing, 60 mm wide, from the vertex of the lens to the board at 62.6 mm."""
        bands = PstBands(scene, ("screen.y", "lens_front.conic", *KEYS), (20, 22), cell_deg=2.0)
        size = np.sqrt(2 * 60**2 + 62.6**2)
        assert (bands.low[0], bands.high[0]) == pytest.approx((-size, size), rel=1e-3)
        assert np.all(np.isfinite(bands.low))
        assert bands.high[1] <= (62 / 10) ** 2 - 1, "a sphere over the whole lens"
        assert bands.low[2:].tolist() == [0, 1, 0]

    def test_data_of_an_azimuth_that_shows_no_screen(self, scene):
        """Where the lens does not light the screen, neither its place nor its paint is told; the roughness is."""
        keys = ("polish.rms_nm", "black.reflectance", "screen.y")
        bands = PstBands(scene, keys, (20, 22, 24, 26, 28), cell_deg=2.0, **{**SETTINGS, "azimuths_deg": (180,)})
        value, _ = bands.measure(bands.start)
        start = dict(zip(keys, bands.start * [1.2, 1, 1], strict=True))
        found = fit(bands, value, 0.05 * value, start, low=bands.low, high=bands.high, power=bands.power)
        assert found.value == pytest.approx(bands.start, rel=0.05)
        assert found.untold == {"black.reflectance": (), "screen.y": ()}

    def test_bad_input_is_one_clear_line(self, scene):
        seen = PstBands(scene, KEYS, (20, 22), cell_deg=2.0, **SETTINGS).observe((1.5, 300, 0.04)).pst
        request = GradientRequest(scatter=True, edge_widths=(0.05, 0.025))
        gradients = seen.table_gradients(np.ones((5, 1, 2)), request, np.zeros((1, 2), dtype=int))
        each_refused(
            (lambda: PstBands(scene, KEYS, (4, 6.5, 9)), "multiples of cell_deg"),
            (lambda: PstBands(scene, KEYS, (-9, -6, -4)), "edges_deg is -9; it must lie between 0 and 90"),
            (lambda: PstBands(scene, KEYS, (4, 6), convention="projected"), "convention is not a setting"),
            (lambda: PstBands(scene, ("polish.rms",), (4, 6)), r"polish\.rms_nm"),
            (lambda: next(gradients), "edges=False"),
        )


@pytest.mark.validation
def test_truth_is_near_in_four_draws():
    """χ² of 12 degrees of freedom is beyond 32.9 with a probability of 1e-3; half the covariance doubles it."""
    fitting = script("fit_pst")
    assert sum(fitting.estimate(draw).distance(fitting.TRUTH) for draw in range(4)) < 32.9

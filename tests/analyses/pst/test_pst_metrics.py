"""Metrics of a point source transmittance: numbers, derivatives by its cells, noise, and what must raise."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.derivatives import central_differences
from oracles.small_scenes import plates_text
from scipy.integrate import quad

import mistray
from mistray import MistrayError
from mistray.analyses.pst.glare.glare import veiling_glare_index
from mistray.analyses.pst.metrics.pst_metrics import pst_band, pst_bin, pst_mask, veiling_glare
from mistray.analyses.pst.metrics.pst_observation import PstObservation
from mistray.analyses.pst.request import PstRequest
from mistray.analyses.pst.result import Pst
from mistray.analyses.pst.run import pst_of_each
from mistray.metrics.metric import Metric, combine, log
from mistray.metrics.observation import smooth_maximum
from mistray.recorders.direction_recorder import CLASSES
from mistray.recorders.directions import DirectionGrid

BATCHES = 32


def made_up(angles: Any = range(5, 90, 10), cell_deg: float = 10.0, azimuths: Any = None) -> Pst:
    """A PST of random numbers whose batches differ in size, as after a run that was cut short."""
    rng = np.random.default_rng(4)
    grid = DirectionGrid.of(angles, azimuths, cell_deg)
    curve = 10.0 ** rng.uniform(-4, 0, (len(CLASSES), *grid.shape, 1))
    weight = rng.uniform(0.5, 1.5, BATCHES)
    facts = {"seconds": 0.0}
    return Pst(grid, curve * rng.gamma(3.0, 1 / 3, (*curve.shape[:3], BATCHES)), weight / weight.sum(), facts=facts)


DENSE, SPARSE = made_up(), made_up(range(10, 81, 20), 6.0)
AROUND = made_up(azimuths=(0, 120, 240))


def number(value: Any) -> float:
    assert dr.width(value) == 1
    return float(dr.detach(value)[0])


def total_of(pst: Pst, light: str) -> np.ndarray:
    """PST_normal of the cells, by a loop."""
    names = {"stray": CLASSES[1:], "total": CLASSES}.get(light, (light,))
    value = np.zeros(pst.grid.shape)
    for name in names:
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
        both = number(o.value_at(5.0, [light, "single_scatter", light], 0.0))
        two = expected if light in ("stray", "total") else expected + total_of(AROUND, "single_scatter")
        assert both == pytest.approx(two[0, 0], rel=1e-13)

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
            mean = number(o.band(low, high, quantity="mean", **how))
            assert mean == pytest.approx(whole / integral(lambda t: 1.0), rel=1e-9)
            mean = number(o.band(low, high, quantity="mean", convention="projected", **how))
            assert mean == pytest.approx(whole / integral(lambda t: np.cos(np.radians(t))), rel=1e-9)

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


class TestDerivatives:
    @staticmethod
    def evaluated(name: str, pst: Pst = AROUND) -> tuple[PstObservation, Any]:
        o = PstObservation(pst)
        return o, Metric(None, lambda seen: FUNCTIONS[name](seen[0])).evaluate([o])

    @pytest.mark.parametrize("name", FUNCTIONS)
    def test_by_every_cell(self, name: str) -> None:
        """Against central differences of the value with the cell changed, every class at some angles."""
        o, value = self.evaluated(name)
        dr.backward(value)
        found = o.derivative
        assert found.shape == AROUND.by_batch.shape[:3]
        for place in ((c, i, 1 + (i % 2)) for c in range(len(CLASSES)) for i in (0, 1, 3, 4, 8)):
            now = float(np.sum(AROUND.weight * AROUND.by_batch[place]))

            def changed(shift: float, place: tuple[int, ...] = place) -> float:
                by_batch = AROUND.by_batch.copy()
                by_batch[place] += shift
                return number(self.evaluated(name, replace(AROUND, by_batch=by_batch))[1])

            (expected,) = central_differences(changed, [0.0], [1e-3 * now])
            assert found[place] == pytest.approx(expected, rel=1e-7, abs=1e-11 * abs(number(value)) / now), place


@pytest.fixture(scope="module")
def scene() -> Any:
    return mistray.load("plate_and_wall")


TRACED = {"rays": 20_000, "max_scatters": 1}


class TestMetrics:
    @pytest.mark.long
    def test_against_the_curve(self, scene) -> None:
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

    def test_cells_fill_a_band(self, scene) -> None:
        """The mean over a band is the PST of one cell as wide as the band: the rays are the same."""
        band = pst_band(scene, 20, 50, method="adjoint", **TRACED)
        (view,) = band.views
        angles, width = view.arguments["field_deg"], view.arguments["cell_deg"]
        assert len(angles) == 15
        assert width == 2
        wide = next(
            pst_of_each([scene], PstRequest.of(field_deg=35, cell_deg=30, paths=False, method="adjoint", **TRACED))
        )
        assert band.value() == pytest.approx(wide.curve("stray")[0][0], rel=1e-6)  # angles are in single precision
        integral = pst_band(scene, 20, 50, quantity="integral", method="adjoint", **TRACED)
        assert integral.value() == pytest.approx(band.value() * wide.grid.solid_angle[0], rel=1e-9)
        assert (band.unit, integral.unit) == ("1", "sr")
        angles = pst_band(scene, 10, 45.5, **TRACED).views[0].arguments["field_deg"]
        assert len(angles) == 18
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
    for call, message in (
        (lambda: pst_bin(scene, 20, "gost"), "light 'gost' does not exist; did you mean 'ghost'"),
        (lambda: pst_bin(scene, 20, ()), "no light is chosen; use total, stray"),
        (lambda: pst_bin(scene, 20, convention="both"), "convention is 'both'; choose from normal, projected"),
        (lambda: pst_bin(scene, 20, ray=3), "there is no setting 'ray'; did you mean 'rays'"),
        (lambda: pst_bin(scene, 20, method="forward"), "method of a PST metric is 'forward'; use 'joined'"),
        (lambda: pst_bin(scene, 20, relative_error=0.1), "relative_error is no setting of a PST metric"),
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
    ):
        with pytest.raises(MistrayError, match=message):
            call()

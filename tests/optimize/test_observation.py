"""What a metric sees of a trace, and its derivatives by every hit, from hits that are made up: no ray is traced."""

from __future__ import annotations

from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.derivatives import central_differences
from report.fake_ledger import GLASS, SENSOR, encode

from mistray.errors import MistrayError
from mistray.optimize.metrics.metric import Metric
from mistray.optimize.metrics.observation import Observation, smooth_maximum, smooth_minimum
from mistray.recorders.design_sequences import DesignSequences
from mistray.recorders.path_events import Events, describe_events
from mistray.recorders.sampled import Sampled
from mistray.trace.filter_rows import Rows
from mistray.trace.paths import PathRow

HALF_MM, PIXELS = 2.0, 8
SURFACES = {"lens_front": GLASS, "lens_rear": GLASS, "detector": SENSOR}
# Kind and events of each path; the third is the second at another wavelength, the last are scattered and aimed alike
PATHS = (
    ("direct", "lens_front:T lens_rear:T detector:A"),
    ("ghost", "lens_front:T lens_rear:R lens_front:R lens_rear:T detector:A"),
    ("ghost", "lens_front:T lens_rear:R lens_front:R lens_rear:T detector:A"),
    ("ghost", "lens_front:T lens_rear:T detector:R lens_rear:R detector:A"),
    ("single scatter", "lens_front:t lens_rear:T detector:A"),
    ("single scatter", "lens_front:i lens_rear:T detector:A"),
)
RAYS = 40
PATH, X, Y, FLUX = range(4)


def made_up() -> np.ndarray:
    """Hits: number of the path, x, y (mm), flux (W)."""
    rng = np.random.default_rng(5)
    hits = []
    for number in range(len(PATHS)):
        centre, spread = rng.uniform(-0.6, 0.6, 2), 0.1 + 0.3 * rng.random()
        xy = centre + spread * rng.uniform(-1, 1, (RAYS, 2))
        hits.append(np.column_stack([np.full(RAYS, number), xy, rng.uniform(0.5, 1.5, RAYS) / 10**number]))
    return np.concatenate(hits)


HITS = made_up()


class Paths(list):
    """Stands for a path table."""

    def __init__(self, hits: np.ndarray) -> None:
        super().__init__()
        self.hits = hits
        for number, (kind, events) in enumerate(PATHS):
            values: dict[str, Any] = {f.name: 0.0 for f in fields(PathRow)}
            mine = hits[hits[:, PATH] == number]
            values |= {"path_id": number, "source": "sun", "kind": kind, "events": events, "rays": len(mine)}
            self.append(PathRow(**values | {"power_W": float(mine[:, FLUX].sum())}))

    def chosen(self, wanted: Any) -> list[tuple[np.ndarray, np.ndarray]]:
        names = list(SURFACES)
        words = np.array(list(SURFACES.values()), dtype=np.uint32)
        events = Events(*encode([row.events for row in self], names), names, words, DesignSequences())
        facts = describe_events(events)
        facts |= {name: np.array([getattr(row, name) for row in self], object) for name in ("kind", "detector")}
        held = wanted.holds(Rows(events, names, facts, len(names)))
        return [(np.flatnonzero(held), np.flatnonzero(held))]

    def moments(self) -> np.ndarray:
        x, y = self.hits[:, X], self.hits[:, Y]
        terms = self.hits[:, FLUX, None] * np.column_stack([np.ones_like(x), x, y, x * x + y * y])
        return np.stack([terms[self.hits[:, PATH] == number].sum(axis=0) for number in range(len(PATHS))])

    def by_batch(self, coefficients: np.ndarray) -> np.ndarray:
        return np.full(32, np.sum(coefficients * self.moments()) / 32)


def observed(hits: np.ndarray = HITS) -> Observation:
    """The hits as a trace gives them, their images included."""

    def image(ids: Any) -> np.ndarray:
        chosen = hits[np.isin(hits[:, PATH], list(ids))]
        column, row = ((chosen[:, k] + HALF_MM) / (2 * HALF_MM) * PIXELS for k in (X, Y))
        flux = np.zeros((PIXELS, PIXELS))
        np.add.at(flux, (row.astype(int), column.astype(int)), chosen[:, FLUX])
        return flux / (2 * HALF_MM / PIXELS) ** 2

    def sampled(ids: Any) -> Sampled:
        """Noise of 10 % in each pixel, from groups of batches."""
        apart = np.random.default_rng(6).normal(size=(PIXELS, PIXELS, 8))
        apart -= apart.mean(axis=2, keepdims=True)
        apart *= 0.1 / np.linalg.norm(apart, axis=2, keepdims=True)
        return Sampled(image(ids), image(ids)[..., None] * apart)

    everything = image(range(len(PATHS)))
    result: Any = SimpleNamespace(
        paths=Paths(hits),
        irradiance=everything,
        light=sampled(range(len(PATHS))),
        extent=(-HALF_MM, HALF_MM, -HALF_MM, HALF_MM),
        energy=SimpleNamespace(launched_W=100.0),
        settings={"field_deg": 3.0},
        each_map=lambda groups, _: [sampled(ids) for ids in groups],
        seconds=0.0,
    )
    return Observation(result)


def moments(*numbers: int) -> tuple[float, float, float, float]:
    """Power, centroid and mean square radius of the hits of some paths."""
    chosen = HITS[np.isin(HITS[:, PATH], numbers)]
    w = chosen[:, FLUX] / chosen[:, FLUX].sum()
    x, y = w @ chosen[:, X], w @ chosen[:, Y]
    return chosen[:, FLUX].sum(), x, y, w @ ((chosen[:, X] - x) ** 2 + (chosen[:, Y] - y) ** 2)


def value_of(function: Any, hits: np.ndarray = HITS) -> float:
    o = observed(hits)
    return float(dr.detach(Metric(None, lambda seen: function(seen[0])).evaluate([o]))[0])


FUNCTIONS = {
    "power": lambda o: o.power("ghost") / o.launched_W,
    "ratio": lambda o: o.power("stray") / o.power("direct"),
    "one path": lambda o: o.power("lens_front:r lens_rear:T detector:A"),
    "two kinds": lambda o: o.power(["direct", "single scatter"]),
    "centroid": lambda o: o.moments("ghost").x * o.moments("all").y,
    "rms radius": lambda o: o.moments("direct").rms_radius,
    "rms irradiance": lambda o: o.moments(["ghost", "single scatter"]).rms_irradiance,
    "brightest ghost": lambda o: smooth_maximum(o.moments_of_each("ghost").rms_irradiance),
    "ghost in focus": lambda o: smooth_minimum(o.moments_of_each("stray").rms_radius, 4.0),
    "image": lambda o: dr.sum(dr.square(o.irradiance)),
    "peak": lambda o: o.peak("all"),
    "peak of the ghosts": lambda o: o.peak("ghost", 6.0),
    "overlapping images": lambda o: o.peak("ghost", 3.0) / o.peak("direct") + 0.1 * o.peak("stray", 2.0) + o.peak(),
    "all together": lambda o: dr.log(o.peak("ghost") / o.moments("direct").rms_irradiance + 3 * o.power("all")),
}


class TestNumbers:
    def test_moments(self) -> None:
        o = observed()
        for selection, numbers in {"direct": (0,), "ghost": (1, 2, 3), "all": range(6), "stray": range(1, 6)}.items():
            found = o.moments(selection)
            power, x, y, square = moments(*numbers)
            for value, expected in (
                (found.power, power),
                (o.power(selection), power),
                (found.x, x),
                (found.y, y),
                (found.variance, square),
                (found.rms_radius, np.sqrt(square)),
                (found.rms_irradiance, power / (np.pi * square)),
            ):
                assert float(value[0]) == pytest.approx(expected, rel=1e-12), selection

    def test_each_path_at_all_wavelengths(self) -> None:
        """Paths are pooled over wavelengths, and light that was scattered at random with light that was aimed."""
        found = observed().moments_of_each("stray")
        groups = [(1, 2), (3,), (4, 5)]
        expected = np.array([moments(*numbers) for numbers in groups]).T
        for value, numbers in zip((found.power, found.x, found.y, found.variance), expected, strict=True):
            np.testing.assert_allclose(np.array(value), numbers, rtol=1e-12)

    def test_paths_of_few_rays(self) -> None:
        few = HITS[(HITS[:, PATH] != 3) | (np.arange(len(HITS)) % RAYS < 29)]
        assert dr.width(observed(few).moments_of_each("ghost").power) == 1
        assert dr.width(observed().moments_of_each("ghost").power) == 2

    def test_smooth_maximum(self) -> None:
        rng = np.random.default_rng(2)
        values = rng.random(50) * np.array([1e-9, 1e9])[rng.integers(0, 2, 50)]
        values[:5] = 0
        for norm in (1.0, 2.5, 16.0, 60.0):
            expected = values.max() * np.sum((values / values.max()) ** norm) ** (1 / norm)
            assert float(smooth_maximum(mi.Float64(values), norm)[0]) == pytest.approx(expected, rel=1e-10)
        assert float(smooth_maximum(mi.Float64([0.0, 0.0]))[0]) == 0
        expected = np.sum(values[5:] ** -3.0) ** (-1 / 3)
        assert float(smooth_minimum(mi.Float64(values[5:]), 3.0)[0]) == pytest.approx(expected, rel=1e-10)
        assert float(smooth_maximum(mi.Float64([3.0, 3.0]))[0]) == pytest.approx(3 * 2 ** (1 / 16), rel=1e-12)

    def test_selections(self) -> None:
        o = observed()
        assert o.chosen("lens_front:i lens_rear:T detector:A").tolist() == [4, 5]
        assert o.chosen(("direct", PATHS[3][1])).tolist() == [0, 3]
        assert o.chosen(lambda row: row.power_W < 1e-2).tolist() == [4, 5]
        assert o.chosen("TIR").tolist() == []
        assert float(o.power("TIR")[0]) == 0
        assert not np.array(o.map("TIR")).any()


class TestDerivatives:
    """By the flux of one hit more, anywhere and of any path, against central differences of the value itself."""

    @staticmethod
    def at_hits(o: Observation, extra: np.ndarray) -> np.ndarray:
        """What `hit_derivative` says of hits."""
        found = o.hit_derivative()
        number, x, y = extra[:, PATH].astype(int), extra[:, X], extra[:, Y]
        total = np.zeros(len(extra))
        if found.path is not None:
            total += np.sum(found.path[number] * np.stack([x**0, x, y, x * x, y * y, x * y], axis=1), axis=1)
        if found.pixel is not None:
            row, column = (((k + HALF_MM) / (2 * HALF_MM) * PIXELS).astype(int) for k in (y, x))
            place = np.zeros(len(extra), dtype=int) if found.map_of_path is None else found.map_of_path[number]
            total += np.where(place >= 0, found.pixel[place, row, column], 0.0)
        return total

    @pytest.mark.parametrize("name", FUNCTIONS)
    def test_by_every_hit(self, name: str) -> None:
        function = FUNCTIONS[name]
        o = observed()
        value = Metric(None, lambda seen: function(seen[0])).evaluate([o])
        dr.backward(value)
        rng = np.random.default_rng(8)
        picked = HITS[np.arange(3, len(HITS), RAYS)]  # one hit of each path, and places where its light is not
        moved = picked + [0, 1, 1, 0] * rng.uniform(-0.3, 0.3, picked.shape)
        extra = np.concatenate([picked, moved])
        found = self.at_hits(o, extra)
        for hit, derivative in zip(extra, found, strict=True):
            step = 1e-3 * HITS[HITS[:, PATH] == hit[PATH], FLUX].min()

            def changed(flux: float, hit: np.ndarray = hit) -> float:
                return value_of(function, np.vstack([HITS, [*hit[:FLUX], flux]]))

            (expected,) = central_differences(changed, [0.0], [step])
            # Rounding of the value, 1e-15 relative, over the step
            noise = 1e-13 * abs(float(dr.detach(value)[0])) / step
            assert derivative == pytest.approx(expected, rel=1e-6, abs=noise), (name, hit)

    def test_evaluating_forgets_the_value_before(self) -> None:
        o = observed()
        for _ in range(2):
            dr.backward(Metric(None, lambda seen: seen[0].power("ghost")).evaluate([o]))
            np.testing.assert_array_equal(o.hit_derivative().path[:, 0], [0, 1, 1, 1, 0, 0])

    def test_noise(self) -> None:
        o = observed()
        dr.backward(Metric(None, lambda seen: dr.sum(seen[0].map("ghost"))).evaluate([o]))
        noise = o.noise()
        (ghosts,) = o.trace.each_map([[1, 2, 3]], [True])
        assert noise.value == pytest.approx(ghosts.value.sum(), rel=1e-12)
        # Of all pixels together, which share start rays
        error = np.linalg.norm(ghosts.apart.sum(axis=(0, 1)))
        assert noise.se == pytest.approx(error, rel=1e-9)
        both = Metric(None, lambda seen: dr.sum(seen[0].map("ghost")) + seen[0].power("direct"))
        o.clear()
        dr.backward(both.evaluate([o]))
        assert o.noise().value == pytest.approx(ghosts.value.sum() + moments(0)[0], rel=1e-12)
        o.clear()
        dr.backward(Metric(None, lambda seen: seen[0].power("ghost")).evaluate([o]))
        assert o.noise().value == pytest.approx(moments(1, 2, 3)[0], rel=1e-12)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda o: o.power("gost"), "'gost' is no kind of path; did you mean 'ghost'"),
        (lambda o: o.power("lens_fron:T detector:A"), "is called 'lens_fron'; did you mean 'lens_front'"),
        (lambda o: o.power("lens_front:X detector:A"), "'X' after 'lens_front:' is no event"),
        (lambda o: o.power(""), "the selection of paths is ''"),
        (lambda o: o.power([]), r"the selection of paths is \[\]"),
        (lambda o: o.power(["ghost", 3]), r"the selection of paths is \['ghost', 3\]"),
        (lambda o: o.moments("TIR").x, r"paths 'TIR': no light .* at field 3°"),
        (lambda o: o.moments_of_each("TIR").x, r"paths 'TIR': no light .* at field 3°"),
        (lambda o: observed(HITS[::4]).moments_of_each("ghost").x, "paths 'ghost': none has 30 rays at field 3°"),
        (lambda o: o.peak("all", 0.5), r"norm is 0\.5"),
        (lambda o: o.power("ghost") / o.power("TIR"), "the metric is inf; something it divides by is 0"),
        (lambda o: o.power("TIR") / o.power("TIR"), "the metric is nan; something it divides by is 0"),
        (lambda o: dr.mean(np.float64(2) * o.irradiance), "the metric does not depend on the traces"),
        (lambda o: o.irradiance, "returned 64 values"),
    ],
)
def test_refusals(function: Any, message: str) -> None:
    with pytest.raises(MistrayError, match=message):
        value_of(function)

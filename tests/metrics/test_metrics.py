"""Metrics of traces: their numbers against the tables of the traces themselves, and their coating gradients."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.derivatives import central_differences
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from refusals import each_refused

import mistray
from mistray.analyses.ghosts.combine import by_path
from mistray.metrics import views
from mistray.metrics.metric import ghost_focus, ghost_rms_irradiance, ghost_to_signal, path_power, peak_irradiance
from mistray.metrics.observation import smooth_maximum, smooth_minimum
from mistray.metrics.scene_values import changed
from mistray.optimize import Metric, combine, image_metric, log, relative_illumination, rms_spot, transmission

FIELDS = (0.0, 4.0)
TRACED = {"rays": 1500, "max_reflections": 2, "wavelength_nm": (500.0, 600.0)}
OF_GHOSTS = (path_power, ghost_to_signal, peak_irradiance, ghost_rms_irradiance, ghost_focus)
EVERY = {factory.__name__: factory for factory in (*OF_GHOSTS, rms_spot, transmission)}
GHOST = "front:T rear:R front:R rear:T detector:A"
# Of one observation of the coated singlet
FUNCTIONS = {
    "one path": lambda o: o.power(GHOST) + 0.01 * o.power(["direct", GHOST]),
    "centroid": lambda o: (1 + o.moments("ghost").x) * o.moments("all").y,
    "radius of all ghosts": lambda o: o.moments("ghost").rms_radius,
    "rms irradiance": lambda o: o.moments(["ghost", "direct"]).rms_irradiance,
    "ghost in focus": lambda o: smooth_minimum(o.moments_of_each("stray").rms_radius, 4.0),
    "image": lambda o: dr.sum(dr.square(o.irradiance)),
    "overlapping images": lambda o: o.peak("ghost", 3.0) / o.peak("direct") + 0.1 * o.peak("stray", 2.0) + o.peak(),
    "all together": lambda o: dr.log(o.peak("ghost") / o.moments("direct").rms_irradiance + 3 * o.power("all")),
}


@pytest.fixture(scope="module")
def scene() -> Any:
    return mistray.load("singlet_window_detector")


@pytest.fixture(scope="module")
def traces(scene) -> list[mistray.Trace]:
    return [mistray.trace(scene, field_deg=angle, **TRACED) for angle in FIELDS]


def ghosts(t: mistray.Trace) -> Any:
    table = by_path(t.paths.by_way(), t.paths)
    return table[(table.kind == "ghost") & (table.rays >= 30)]


def p_norm(values: Any, norm: float = 16.0) -> float:
    values = np.asarray(values, dtype=np.float64)
    return float(values.max() * np.sum((values / values.max()) ** norm) ** (1 / norm))


class TestNumbers:
    """Means over the fields of what the path tables and maps of the same traces say."""

    def test_powers(self, scene, traces) -> None:
        def share(t: mistray.Trace, kind: str) -> float:
            return sum(row.power_W for row in t.paths if row.kind == kind)

        launched = [t.energy.launched_W for t in traces]
        expected = {
            path_power: [share(t, "ghost") / light for t, light in zip(traces, launched, strict=True)],
            ghost_to_signal: [share(t, "ghost") / share(t, "direct") for t in traces],
            transmission: [share(t, "direct") / light for t, light in zip(traces, launched, strict=True)],
        }
        for factory, numbers in expected.items():
            assert factory(scene, field_deg=FIELDS, **TRACED).value() == pytest.approx(np.mean(numbers), rel=1e-12)

    def test_sums_of_the_path_table(self, traces) -> None:
        """Batches add up to the flux and moments of the paths."""
        for t in traces:
            power = t.paths.moments()[:, 0]
            assert power == pytest.approx([row.power_W for row in t.paths], rel=1e-12)
            coefficients = np.random.default_rng(1).random((len(power), 4))
            by_batch = t.paths.by_batch(coefficients)
            assert by_batch.sum() == pytest.approx(np.sum(coefficients * t.paths.moments()), rel=1e-12)
            assert np.count_nonzero(by_batch) == 32

    def test_moments_of_several_paths(self, scene, traces) -> None:
        """From those of each row, by Steiner's theorem; none are of paths that are not there."""
        (o,) = path_power(scene, field_deg=FIELDS[1], **TRACED).observe()
        rows = traces[1].paths
        for selection in ("direct", "ghost", "all", "stray", [row.events for row in rows][1]):
            found = o.moments(selection)
            mine = [row for row in rows if selection in ("all", row.kind, row.events)
                    or (selection == "stray" and row.kind != "direct")]  # fmt: skip
            assert [rows[k].path_id for k in o.chosen(selection)] == [row.path_id for row in mine]
            power = np.array([row.power_W for row in mine])
            places = np.array([(row.x_mm, row.y_mm) for row in mine])
            x, y = power @ places / power.sum()
            squares = np.array([row.rms_radius_mm**2 for row in mine]) + np.sum((places - (x, y)) ** 2, axis=1)
            square = power @ squares / power.sum()
            sizes = found.variance, found.rms_radius, found.rms_irradiance
            values = [float(v[0]) for v in (found.power, o.power(selection), found.x, found.y, *sizes)]
            expected = [power.sum(), power.sum(), x, y, square, np.sqrt(square), power.sum() / (np.pi * square)]
            assert values == pytest.approx(expected, rel=1e-9, abs=1e-9), selection
        assert (o.chosen("TIR").tolist(), float(o.power("TIR")[0])) == ([], 0.0)
        assert o.chosen(lambda row: row.order == 0).tolist() == o.chosen("direct").tolist()
        assert not np.array(o.map("TIR")).any()

    def test_smooth_maximum(self) -> None:
        rng = np.random.default_rng(2)
        values = rng.random(50) * np.array([1e-9, 1e9])[rng.integers(0, 2, 50)]
        values[:5] = 0
        for norm in (1.0, 2.5, 16.0, 60.0):
            assert float(smooth_maximum(mi.Float64(values), norm)[0]) == pytest.approx(p_norm(values, norm), rel=1e-10)
        assert float(smooth_maximum(mi.Float64([0.0, 0.0]))[0]) == 0
        expected = np.sum(values[5:] ** -3.0) ** (-1 / 3)
        assert float(smooth_minimum(mi.Float64(values[5:]), 3.0)[0]) == pytest.approx(expected, rel=1e-10)
        dark = mi.Float64(values)
        dr.enable_grad(dark)
        least = smooth_minimum(dark)
        dr.backward(least)
        assert (float(least[0]), np.array(dr.grad(dark)).tolist()) == (0.0, [0.0] * 50)

    def test_rms_irradiance_of_ghosts(self, scene, traces) -> None:
        """The figures of the ghost table: all wavelengths of a path together."""
        figures = [ghosts(t).rms_irradiance_W_mm2 for t in traces]
        radii = [ghosts(t).rms_radius_mm for t in traces]
        brightest = ghost_rms_irradiance(scene, field_deg=FIELDS, **TRACED)
        one = ghost_rms_irradiance(scene, ghosts(traces[0]).events.iloc[1], **TRACED)
        focus = ghost_focus(scene, field_deg=FIELDS, norm=4.0, **TRACED)
        assert len(figures[0]) > 3
        assert brightest.value() == pytest.approx(np.mean([p_norm(e) for e in figures]), rel=1e-9)
        assert one.value() == pytest.approx(figures[0].iloc[1], rel=1e-9)
        assert focus.value() == pytest.approx(np.mean([1 / p_norm(1 / r, 4.0) for r in radii]), rel=1e-9)
        assert one.value() != pytest.approx(figures[0].iloc[0], rel=1e-3)

    def test_spot(self, scene) -> None:
        """Against the rays one by one, whose places are found again in float64."""
        settings = TRACED | {"wavelength_nm": 550.0}
        t = mistray.trace(scene, field_deg=4.0, **settings)
        (row,) = (row for row in t.paths if row.kind == "direct")
        rays = t.rays(f"path_id = {row.path_id}", n=None)
        assert len(rays) == row.rays
        w = rays.flux_W / rays.flux_W.sum()  # the detector absorbs the same share of every ray
        # The plane of the detector is that of its own frame but for a shift
        x, y = (rays[name] - w @ rays[name] for name in ("x_mm", "y_mm"))
        # Places in the kernel are rounded to 6e-8 of up to 2 mm
        spot = rms_spot(scene, field_deg=4.0, **settings)
        assert spot.value() == pytest.approx(np.sqrt(w @ (x * x + y * y)), rel=1e-5)
        assert (log(spot).value(), log(spot).unit) == (pytest.approx(np.log(spot.value()), rel=1e-12), "1")

    def test_peak(self, scene, traces) -> None:
        maps = [t.irradiance_of([row.path_id for row in t.paths if row.kind == "ghost"])[0] for t in traces]
        found = peak_irradiance(scene, field_deg=FIELDS, **TRACED).value()
        assert found == pytest.approx(np.mean([p_norm(image) for image in maps]), rel=1e-9)
        largest = np.mean([image.max() for image in maps])
        assert largest <= found <= largest * maps[0].size ** (1 / 16)
        image = image_metric(scene, dr.sum, field_deg=FIELDS, **TRACED).value()
        assert image == pytest.approx(np.mean([t.irradiance.sum() for t in traces]), rel=1e-12)
        everything = peak_irradiance(scene, "all", norm=1.0, field_deg=FIELDS, **TRACED).value()
        assert everything == pytest.approx(image, rel=1e-12)

    @pytest.mark.parametrize("index", [1.0, 1.5])
    def test_relative_illumination(self, load_scene, index) -> None:
        """A pinhole before glass that fills the camera: cos⁴θ' with sin θ = n sin θ'; its image is distorted."""
        glass = shape_xml("asphere", "face", 0.0, interface_xml("air", str(index), R=0.0, T=1.0), semi_diameter=50.0)
        wide = {"half_width": 20.0, "half_height": 20.0}
        detector = shape_xml("asphere", "detector", 10.0, interface_xml(str(index), R=0.0), sensor=True, **wide)
        scene = load_scene(scene_text(glass, detector, radius=0.1, plane="axis"))
        fields = (10.0, -30.0, 0.0)
        inside = np.arcsin(np.sin(np.radians(fields)) / index)
        expected = np.mean(np.cos(inside) ** 4)
        # The centroids are those of the same random places in the beam; what is left is the difference for the slope
        for step in (None, 1.0, 0.05):
            found = relative_illumination(scene, step_deg=step, field_deg=fields, rays=500).value()
            bound = 2 * np.radians(0.5 if step is None else step) ** 2 + 2e-5
            assert found == pytest.approx(expected, rel=bound), step
        assert found != pytest.approx(np.mean(np.cos(inside) ** 3), rel=0.01)

    def test_more_rays(self, scene) -> None:
        metric = transmission(scene, rays=1001, max_reflections=0)
        (few,), (many,) = metric.observe(seed=3), metric.observe(2.0, seed=3)
        assert (few.trace.settings["rays"], many.trace.settings["rays"]) == (1001, 2002)
        (more,) = combine({"light": metric.with_rays_times(2.0)}, lambda m: m["light"]).observe(1.5)
        assert more.trace.settings["rays"] == 3003
        (usual,) = transmission(scene, max_reflections=0).observe(1e-4)
        assert usual.trace.settings["rays"] == 100


def test_equal_traces_are_made_once(scene, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []
    trace = views.trace

    def counted(*args: Any, **more: Any) -> Any:
        made.append(more["field_deg"])
        return trace(*args, **more)

    monkeypatch.setattr(views, "trace", counted)
    parts = {
        "ghosts": path_power(scene, field_deg=[0.0, 4.0], **TRACED),
        "spot": rms_spot(scene, field_deg=np.array([4.0]), **TRACED),
        "light": transmission(scene, field_deg=(0, 4), **TRACED | {"wavelength_nm": [500, 600]}),
        "other": transmission(scene, field_deg=4.0, **TRACED | {"rays": 200}),
    }
    merit = combine(parts, lambda m: m["ghosts"] / m["light"] ** 2 + m["spot"] - dr.log(m["other"]))
    values = {name: part.value() for name, part in parts.items()}
    made.clear()
    expected = values["ghosts"] / values["light"] ** 2 + values["spot"] - np.log(values["other"])
    assert (merit.value(), sorted(made)) == (pytest.approx(expected, rel=1e-12), [0.0, 4.0, 4.0])
    made.clear()
    nested = combine({"merit": merit, "log": log(merit)}, lambda m: (dr.exp(m["log"]) + m["merit"]) / 2)
    assert (nested.value(), sorted(made)) == (pytest.approx(expected, rel=1e-12), [0.0, 4.0, 4.0])
    assert merit.value(seed=1) != merit.value()


def test_errors_over_seeds(scene) -> None:
    """Over 40 seeds the spread is the error: χ² with 39 degrees of freedom, false-alarm probability 1e-6 each."""
    settings = {"rays": 400, "max_reflections": 2, "field_deg": FIELDS}
    radius = Metric(scene, lambda seen: sum(o.moments("ghost").rms_radius for o in seen), FIELDS, settings={**settings})
    of_maps = Metric(scene, lambda seen: sum(dr.sum(o.map("ghost")) for o in seen), FIELDS, settings={**settings})
    metrics = [rms_spot(scene, **settings), ghost_to_signal(scene, **settings), radius, of_maps]
    values, variances = np.zeros((2, 40, len(metrics)))
    for seed in range(40):
        observations = metrics[0].observe(seed=seed)
        for k, metric in enumerate(metrics):
            value = metric.evaluate(observations)
            dr.backward(value)
            values[seed, k] = float(dr.detach(value)[0])
            variances[seed, k] = np.sum(np.sum([o.noise().apart for o in observations], axis=0) ** 2)
    ratio = values.var(axis=0, ddof=1) / variances.mean(axis=0)
    assert np.all(ratio < 2.7), ratio
    assert np.all(ratio > 0.24), ratio


@pytest.fixture(scope="module")
def lens(load_scene) -> Any:
    """A coated singlet before a detector that reflects; the beam fills it."""
    coated = {"R": 0.1, "T": 0.8}
    front = shape_xml("asphere", "front", 0.0, interface_xml("air", "1.5", **coated), curvature=0.02, semi_diameter=6.0)
    rear = shape_xml("asphere", "rear", 4.0, interface_xml("1.5", "air", **coated), curvature=-0.02, semi_diameter=6.0)
    detector = shape_xml(
        "asphere", "detector", 50.0, interface_xml("air", R=0.2, T=0.0), sensor=True, half_width=30.0, half_height=30.0
    )
    return load_scene(scene_text(front, rear, detector, radius=4.0))


class TestCoatings:
    """Coating gradients of every metric against central differences with the same rays."""

    KEYS = ("front.bsdf.R", "rear.bsdf.T", "detector.bsdf.R")
    STEP = 0.002

    @pytest.mark.parametrize("name", [*EVERY, *FUNCTIONS])
    def test_central_differences(self, lens, name: str) -> None:
        params, fields = mi.traverse(lens), (0.0, 3.0)
        if name in EVERY:
            metric = EVERY[name](lens, field_deg=fields, rays=400)
        else:
            metric = Metric(lens, lambda seen: sum(map(FUNCTIONS[name], seen)), fields, settings={"rays": 400})
        found = mistray.gradient(metric, params, list(self.KEYS)).gradient
        size = metric.value()
        for key in self.KEYS:

            def at(value: float, key: str = key) -> float:
                with changed(params, {key: np.array([value])}):
                    return metric.value()

            (expected,) = central_differences(at, [float(params[key][0])], [self.STEP])
            # Rounding of the fluxes in single precision, 1e-7 relative, over the step
            assert found[key][0] == pytest.approx(expected, rel=1e-3, abs=1e-6 * size / self.STEP), key


def test_refusals(scene) -> None:
    def of_one(function: Any, rays: int = 64) -> float:
        return Metric(scene, lambda seen: function(seen[0]), field_deg=3.0, settings={"rays": rays}).value()

    def both(a: Metric, b: Metric) -> Metric:
        return combine({"a": a, "b": b}, lambda m: m["a"])

    spot = rms_spot(scene, rays=64)
    each_refused(
        (lambda: path_power(scene, ray=16), "there is no setting 'ray'"),
        (lambda: rms_spot(scene, field_deg=()), "field_deg is empty"),
        (lambda: relative_illumination(scene, field_deg=0.0), "needs field_deg off the axis"),
        (lambda: relative_illumination(scene, field_deg=3.0, step_deg=-1), "step_deg is -1"),
        (lambda: spot.value(times=0), "times is 0"),
        (lambda: path_power(scene, rays=0).value(times=2), "rays is 0; it must be a whole number"),
        (lambda: rms_spot(scene, field_deg=60.0, rays=64).value(), "no (direct )?light .*at field 60°"),
        (lambda: ghost_to_signal(scene, field_deg=60.0, rays=64).value(), "no (direct )?light .*at field 60°"),
        (lambda: log(path_power(scene, "TIR", rays=64)).value(), "the path power is 0"),
        (lambda: combine({}, lambda m: 0), r"combine\(\) got no metric"),
        (lambda: both(spot, rms_spot(mistray.load("plate"))), "the metrics a, b are of 2 scenes"),
        (lambda: both(spot, spot.with_rays_times(4)), "unequal multiples of .* rays: a 1, b 4; .* the same `times`"),
        (lambda: combine({"a": spot}, lambda m: float(m["a"][0])).value(), "the merit does not depend on the traces"),
        (lambda: of_one(lambda o: o.moments_of_each("ghost").x, 20), "paths 'ghost': none has 30 rays at field 3°"),
    )
    each_refused(
        (lambda o: o.power("gost"), "'gost' is not a kind of path; did you mean 'ghost'"),
        (lambda o: o.power("L1_fron:T detector:A"), "is called 'L1_fron'; did you mean 'L1_front'"),
        (lambda o: o.power("L1_front:X detector:A"), "'X' after 'L1_front:' is not an event"),
        (lambda o: o.power(""), "the selection of paths is ''"),
        (lambda o: o.power([]), r"the selection of paths is \[\]"),
        (lambda o: o.power(["ghost", 3]), r"the selection of paths is \['ghost', 3\]"),
        (lambda o: o.moments("TIR").x, r"paths 'TIR': no light .* at field 3°"),
        (lambda o: o.moments_of_each("TIR").x, r"paths 'TIR': no light .* at field 3°"),
        (lambda o: o.peak("all", 0.5), r"norm is 0\.5"),
        (lambda o: o.power("ghost") / o.power("TIR"), "the metric is inf; something it divides by is 0"),
        (lambda o: dr.mean(np.float64(2) * o.irradiance), "the metric does not depend on the traces"),
        (lambda o: o.irradiance, r"returned \d+ values"),
        by=of_one,
    )

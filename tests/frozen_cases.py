"""Scenes whose recorded rays the oracle of frozen paths follows, and metrics that both sides compute."""

import re
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from oracles import small_scenes
from oracles.frozen_paths import Bundle, FrozenPaths, Hits, power, rms_radius
from oracles.frozen_scene import FrozenScene, read_frozen
from oracles.geometry import Array, Frustum
from oracles.scatter_scenes import with_scatter

import mistray
from mistray import Metric, Trace
from mistray.events import EVENT_BITS, EVENT_MASK, INTERCEPTS


def recorded_bundles(trace: Trace) -> list[Bundle]:
    """Every branch of one source and wavelength that ends on the detector, by path, as the kernel wrote it down.

    Positions found again in float64, as `Trace.history` has them, would share code with the program under test.
    """
    of = trace.runs[0]
    count = int(trace.paths.column("rays")[trace.paths.located()[0].ids].sum())
    recorder = of.record(None, count)
    assert int(recorder.count[0]) == count, "the rays that were recorded are not those of the ledger"
    lanes, lengths = np.array(recorder.lane)[:count], np.array(recorder.length)[:count]
    codes = np.array(recorder.codes).reshape(recorder.capacity, -1)[:count]
    nodes = recorder.nodes_of(np.arange(count), recorder.max_events)
    nodes[:, :, :3] += of.table.centre
    origins, directions = of.start_rays(lanes)
    weights = np.array(of.start_pass(0).w, dtype=np.float64)[lanes]
    codes = np.where(np.arange(codes.shape[1]) < lengths[:, None], codes, 0)
    lists, group = np.unique(codes, axis=0, return_inverse=True)
    ids = of.table.event_ids
    bundles = []
    for number, events in enumerate(lists):
        here = np.flatnonzero(group.ravel() == number)
        here = here[np.argsort(lanes[here], kind="stable")]
        k = lengths[here[0]]
        names = tuple((ids[int(c) >> EVENT_BITS], INTERCEPTS[int(c) & EVENT_MASK]) for c in events[:k])
        own = np.moveaxis(nodes[here, :k], 0, 1)
        leaving = np.concatenate([own[1:, :, 3:6], np.zeros((1, len(here), 3))])
        leaving[:-1] /= np.linalg.norm(leaving[:-1], axis=2, keepdims=True)
        bundles.append(Bundle(names, origins[here], directions[here], own[:, :, :3], leaving, of.unit * weights[here],
                              of.unit * own[-1, :, 6], lanes[here]))  # fmt: skip
    return bundles


LAYERS = '<bsdf type="thinfilm"><string name="layers" value="1.38 95, 2.1 120, 1.63 80"/></bsdf>'
NORM = 16.0  # of the peak
SMALL = 0.1  # of the largest derivative of its kind, or of what cancels in it: what a smaller one is compared with
MOVE = 2e-5  # of a surface, in units of its size
# Names → the metric for mistray, of one observation, and for the oracle
Metrics = dict[str, tuple[Callable[[Any], Any], Callable[[Sequence[Hits]], float]]]
Kinds = Callable[[str], str]


def scene_text(name: str) -> str:
    return (Path(__file__).parents[1] / "scenes" / name / "scene.xml").read_text(encoding="utf-8")


def coated_text(text: str, *shape_ids: str) -> str:
    """A scene's XML with three layers on some bare surfaces."""
    return with_scatter(text, dict.fromkeys(shape_ids, (LAYERS,)))


def with_values(text: str, shape_id: str, **values: float) -> str:
    """A scene's XML with numbers of a shape or, as bsdf_R and bsdf_T, of its interface."""
    root = ElementTree.fromstring(text)
    (shape,) = [node for node in root.iter("shape") if node.attrib["id"] == shape_id]
    for name, value in values.items():
        place = shape.find("bsdf") if name.startswith("bsdf_") else shape
        name = name.removeprefix("bsdf_")
        for old in [node for node in place if node.attrib.get("name") == name]:
            place.remove(old)
        place.append(ElementTree.Element("float", {"name": name, "value": repr(value)}))
    return ElementTree.tostring(root, encoding="unicode")


def with_shape(text: str, shape: str) -> str:
    return text.replace("</scene>", f"{shape}</scene>")


@dataclass
class Case:
    """A scene, its trace, and the oracle's view of all rays that reach the detector.

    Keys of new parameters of position, tilt and index, which the XML does not have, are in `moved`, set on both sides.
    """

    text: str
    settings: dict[str, Any]
    moved: dict[str, float] = field(default_factory=dict)

    @cached_property
    def scene(self) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            scene = mistray.load(small_scenes.write(Path(folder), self.text))
        params = mi.traverse(scene)
        for key, value in self.moved.items():
            params[key] = mi.Float(value)
        if self.moved:
            params.update()
        return scene

    @cached_property
    def trace(self) -> mistray.trace.Trace:
        return mistray.trace(self.scene, **{"polarization": "unpolarized", **self.settings})

    @cached_property
    def paths(self) -> FrozenPaths:
        scene = read_frozen(self.text)
        for key, value in self.moved.items():
            scene = scene.moved(key, float(np.float32(value)))
        return FrozenPaths(scene, recorded_bundles(self.trace))

    frozen = property(lambda self: self.paths.scene)
    launched_W = property(lambda self: self.trace.energy.launched_W)

    @cached_property
    def met(self) -> list[str]:
        return list(dict.fromkeys(name for bundle in self.paths.bundles for name, _ in bundle.events))

    def metric(self, function: Callable[[Any], Any]) -> Metric:
        """Metric of one observation with the settings of the trace."""
        settings = dict(self.settings)
        field_deg = settings.pop("field_deg", None)
        fields = None if field_deg is None else (field_deg,)
        return Metric(self.scene, lambda observations: function(observations[0]), fields, settings=settings)

    def strongest(self, kind: str, rays: int = 50) -> str:
        return next(row.events for row in self.trace.paths if row.kind == kind and row.rays >= rays)

    def select(self, events: Sequence[str] | None) -> Callable[[Sequence[Hits]], list[Hits]]:
        """Takes the hits of some paths out of those of all."""
        texts = [bundle.text for bundle in self.paths.bundles]
        chosen = [k for k, text in enumerate(texts) if events is None or text in events]
        return lambda hits: [hits[k] for k in chosen]

    def image_functional(self, pixels: Array, events: Sequence[str] | None = None) -> Callable[[Sequence[Hits]], float]:
        """Σ flux · g: its value where a ray lands now as the pixel has it, its slope between the centres of pixels."""
        height, width = pixels.shape
        x0, x1, y0, y1 = self.trace.extent
        take = self.select(events)

        def places(hits: Hits) -> tuple[Array, Array]:
            return (hits.x - x0) / (x1 - x0) * width - 0.5, (hits.y - y0) / (y1 - y0) * height - 0.5

        def at(i: Array, j: Array) -> Array:
            return pixels[np.clip(j, 0, height - 1).astype(int), np.clip(i, 0, width - 1).astype(int)]

        # The cell between centres, and the pixel, are those of the ray as it was: a derivative does not see corners
        cells, offsets = [], []
        for hits in take(self.paths.nominal):
            u, v = places(hits)
            i, j = (np.floor(w).astype(int) for w in (u, v))
            corners = [at(i + a, j + b) for b in (0, 1) for a in (0, 1)]
            cells.append((i, j, corners))
            offsets.append(at(np.rint(u), np.rint(v)) - _bilinear(u - i, v - j, corners))

        def value(hits: Sequence[Hits]) -> float:
            total = 0.0
            for h, (i, j, corners), offset in zip(take(hits), cells, offsets, strict=True):
                u, v = places(h)
                total += float(h.flux @ (offset + _bilinear(u - i, v - j, corners)))
            return total

        return value

    def metrics(self, ghost: str) -> Metrics:
        one, everything = self.select([ghost]), self.select(None)
        x0, x1, y0, y1 = self.trace.extent
        area = (x1 - x0) * (y1 - y0) / self.trace.irradiance.size
        spot = self.trace.irradiance_of([row.path_id for row in self.trace.paths if row.events == ghost])[0]
        peak = spot.max() * np.sum((spot / spot.max()) ** NORM) ** (1 / NORM)

        image = self.image_functional(2 * self.trace.irradiance / area)
        brightest = self.image_functional((spot / peak) ** (NORM - 1) / area, [ghost])

        def y_of(hits: Sequence[Hits]) -> float:
            return float(sum(h.flux @ h.y for h in one(hits)) / power(one(hits)))

        return {
            "power": (lambda o: o.power("all") / o.launched_W, lambda hits: power(everything(hits)) / self.launched_W),
            "one ghost": (lambda o: o.power(ghost) / o.launched_W, lambda hits: power(one(hits)) / self.launched_W),
            "rms radius": (lambda o: o.moments(ghost).rms_radius, lambda hits: rms_radius(one(hits))),
            "mean y": (lambda o: o.moments(ghost).y, y_of),
            "image": (lambda o: dr.sum(dr.square(o.irradiance)), image),
            "peak": (lambda o: o.peak(ghost, NORM), brightest),
        }


def _bilinear(a: Array, b: Array, corners: Sequence[Array]) -> Array:
    """Between four values: at (0, 0), (1, 0), (0, 1), (1, 1)."""
    return (1 - b) * ((1 - a) * corners[0] + a * corners[1]) + b * ((1 - a) * corners[2] + a * corners[3])


def step(scene: FrozenScene, key: str) -> float:
    """A step that moves a surface by 2e-5 of its size, an index or a share by 1e-5, a layer by 0.01 nm."""
    owner, name = key.rsplit(".", 1)
    if name in ("n_front_shift", "n_back_shift", "R", "T", "n_shift", "k_shift"):
        return 1e-5
    if name == "thickness_nm":
        return 1e-2
    if owner not in scene.model.by_id:  # a scatter model
        return 1e-4 * abs(scene.number(key))
    surface = scene.model.by_id[owner].surface
    size = max(surface.r0, surface.r1) if isinstance(surface, Frustum) else surface.extent()
    if name in ("x", "y", "z", "r0", "z0", "r1", "z1") or name.startswith(("zernike", "fringe", "q", "chebyshev")):
        return MOVE * size
    if name in ("curvature", "curvature_x", "toroid_curvature"):
        return MOVE / size
    if name.startswith("tilt"):
        return float(np.degrees(MOVE))
    if name in ("conic", "conic_x"):
        return 10 * MOVE
    if name.startswith("slope"):
        return MOVE
    return float(MOVE * size ** (1 - sum(int(order) for order in re.findall(r"\d+", name))))


def deviations(
    gradient: dict[str, Array],
    batches: dict[str, Array],
    expected: dict[str, Array],
    zero: dict[str, float],
    kind_of: Kinds,
) -> dict[str, float]:
    """Largest deviation of each kind, relative to the derivative or to what is small beside it."""
    largest: dict[str, float] = {}
    for key, values in expected.items():
        largest[kind_of(key)] = max(largest.get(kind_of(key), 0.0), float(np.max(np.abs(values))))
    worst: dict[str, float] = {}
    for key, values in expected.items():
        kind, cancelling = kind_of(key), np.abs(batches[key]).sum(axis=0)
        scale = np.maximum(np.abs(values), SMALL * np.maximum(largest[kind], cancelling))
        error = np.abs(gradient[key] - values) / np.maximum(scale, max(zero[key], np.finfo(float).tiny))
        worst[kind] = max(worst.get(kind, 0.0), float(np.max(error)))
    return worst


def compare(
    case: Case, keys: Sequence[str], metrics: Metrics, kind_of: Kinds, *, tolerance: float, wrong: float,
    cancels: float, zero: float = 0.0,
) -> set[str]:  # fmt: skip
    """Asserts the derivatives of each metric by each key; gives kinds of which some derivative does not cancel.

    Those that are larger by the factor ``wrong`` must fail, but for what is below the share ``cancels`` of
    Σ |parts of the batches|; ``zero`` is the share of the metric that a move by the size of the surface may change.
    """
    params, steps = mi.traverse(case.scene), {key: step(case.frozen, key) for key in keys}
    expected: dict[str, dict[str, Array]] = {metric: {} for metric in metrics}
    for key in keys:
        oracles = [oracle for _, oracle in metrics.values()]
        entries = len(case.frozen.numbers[key])
        rows = [case.paths.derivatives(oracles, key, steps[key], entry) for entry in range(entries)]
        for metric, values in zip(metrics, np.transpose(rows), strict=True):
            expected[metric][key] = values
    noticed: set[str] = set()
    for metric, (function, _) in metrics.items():
        found = mistray.gradient(case.metric(function), params, keys=list(keys), edges=False)
        floor = {key: zero * abs(found.value) * MOVE / steps[key] for key in keys}
        worst = deviations(found.gradient, found.batches, expected[metric], floor, kind_of)
        assert max(worst.values()) <= tolerance, (metric, worst)
        larger = {key: wrong * values for key, values in found.gradient.items()}
        seen = deviations(larger, found.batches, expected[metric], floor, kind_of)
        there = {
            kind_of(key)
            for key, values in expected[metric].items()
            if np.any(np.abs(values) > cancels * np.abs(found.batches[key]).sum(axis=0) + floor[key])
        }
        assert {kind for kind, value in seen.items() if value > tolerance} >= there, (metric, seen)
        noticed |= there
    return noticed

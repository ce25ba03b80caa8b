"""Nonsequential split tracer, breadth first: an independent ledger and energy budget for few rays.

Every hit makes a transmitted and a reflected ray; what a limit removes is booked. A ray that hits a detector leaves the
power (1 - R - T) w there, and its reflected part goes on. Total internal reflection and ``mirror`` surfaces are not
counted by ``max_reflections``.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from .geometry import Array, Mask
from .glass import absorption_per_mm, refractive_index
from .interface import interact
from .replay import Event
from .scene_xml import SceneModel

EVENT_NAMES = ("SpecTran", "SpecRefl", "TIR", "Absorbed")
TRANSMITTED, REFLECTED, TOTAL, ABSORBED = range(4)


@dataclass(frozen=True)
class PathRecord:
    """One path to a detector; positions in the detector's frame.

    Attributes
    ----------
    events : tuple of (shape id, event name), the last one Absorbed
    order : reflections other than TIR and at mirrors
    rays : detector hits;  power_W absorbed, incident_W arriving
    x_mm, y_mm, rms_radius_mm : power-weighted centroid and root-mean-square distance from it
    start_rays : (rays,) numbers of the start rays;  hits : (rays, 2) in mm;  weights : (rays,) absorbed W
    """

    events: tuple[Event, ...]
    order: int
    rays: int
    power_W: float
    incident_W: float
    x_mm: float
    y_mm: float
    rms_radius_mm: float
    start_rays: np.ndarray
    hits: Array
    weights: Array

    @property
    def text(self) -> str:
        """``"lens_front:T … detector:A"``; TIR is written as TIR."""
        short = {"SpecTran": "T", "SpecRefl": "R", "TIR": "TIR", "Absorbed": "A"}
        return " ".join(f"{shape_id}:{short[name]}" for shape_id, name in self.events)

    @property
    def rms_irradiance_W_mm2(self) -> float:
        """power / (pi rms_radius^2)."""
        return self.power_W / (np.pi * self.rms_radius_mm**2)


@dataclass(frozen=True)
class Ledger:
    """Everything that became of the launched power, W; ``paths`` by falling power."""

    launched_W: float
    detected_W: float
    absorbed_W: dict[str, float]
    escaped_W: float
    cut_W: dict[str, float]
    paths: list[PathRecord]
    segments: int
    leaks_W: dict[tuple[str, str, str], float] = field(default_factory=dict)
    escaped_from_W: dict[str, float] = field(default_factory=dict)
    absorbed_in_W: dict[str, float] = field(default_factory=dict)

    @property
    def closure(self) -> float:
        """(launched - everything booked) / launched."""
        absorbed = sum(self.absorbed_W.values()) + sum(self.absorbed_in_W.values())
        booked = self.detected_W + absorbed + self.escaped_W + sum(self.cut_W.values())
        return (self.launched_W - booked) / self.launched_W

    def find(self, *events: str) -> PathRecord:
        """The path whose text is the given events joined by blanks."""
        wanted = " ".join(events)
        for path in self.paths:
            if path.text == wanted:
                return path
        raise KeyError(f"no path {wanted!r} among {len(self.paths)}")


@dataclass
class _Rays:
    """A generation of rays, arrays over the rays."""

    origin: Array
    direction: Array
    weight: Array
    start: np.ndarray
    last: np.ndarray
    medium: np.ndarray
    order: np.ndarray
    path: np.ndarray

    def take(self, index: np.ndarray | Mask) -> _Rays:
        return _Rays(*(getattr(self, name)[index] for name in _Rays.__dataclass_fields__))

    @staticmethod
    def join(parts: list[_Rays]) -> _Rays:
        return _Rays(*(np.concatenate([getattr(p, name) for p in parts]) for name in _Rays.__dataclass_fields__))


class _Trie:
    """Paths as a tree of (parent, surface, event), so that rays carry one integer."""

    def __init__(self) -> None:
        self.nodes: list[tuple[int, int, int]] = [(-1, -1, -1)]
        self.index: dict[tuple[int, int, int], int] = {}

    def step(self, parents: np.ndarray, surface: int, event: int) -> np.ndarray:
        unique, inverse = np.unique(parents, return_inverse=True)
        children = np.empty(len(unique), dtype=np.int64)
        for i, parent in enumerate(unique):
            key = (int(parent), surface, event)
            if key not in self.index:
                self.index[key] = len(self.nodes)
                self.nodes.append(key)
            children[i] = self.index[key]
        return children[inverse]

    def events(self, node: int, ids: list[str]) -> tuple[Event, ...]:
        found: list[Event] = []
        while node > 0:
            node, surface, event = self.nodes[node]
            found.append((ids[surface], EVENT_NAMES[event]))
        return tuple(reversed(found))


def nearest_hits(model: SceneModel, origin: Array, direction: Array, last: np.ndarray) -> tuple[Array, np.ndarray]:
    """Path length (n,) to the nearest surface and its number in XML order, inf and -1 where there is none."""
    best, surface = np.full(len(origin), np.inf), np.full(len(origin), -1)
    for number, shape in enumerate(model.shapes):
        t = shape.first_hit(origin, direction, last == number)
        nearer = t < best
        best[nearer], surface[nearer] = t[nearer], number
    return best, surface


def trace(
    model: SceneModel,
    origin: Array,
    direction: Array,
    power: Array,
    wavelength_nm: float,
    *,
    max_reflections: int = 2,
    max_events: int = 32,
    flux_threshold: float = 1e-8,
    start_material: str = "air",
) -> Ledger:
    """Ledger of all paths of the start rays: positions and directions (n, 3), powers (n,) in W.

    ``max_events`` counts the hits of a path, the last one on the detector included. ``flux_threshold`` is relative to
    the start ray's own power. ``leaks_W`` books the incident power of hits whose incidence-side index differs from that
    of the medium the ray travels in, by (surface left, surface hit, medium travelled in), and what leaves the scene in
    a medium other than the first as a hit on "escape". ``escaped_from_W`` books what left by the last surface touched.
    """
    ids = [shape.shape_id for shape in model.shapes]
    materials = [start_material]
    for shape in model.shapes:
        if not shape.interface.opaque:
            materials += [m for m in (shape.interface.front, shape.interface.back) if m not in materials]
    index = np.array([refractive_index(material, wavelength_nm) for material in materials])
    absorption = np.array([absorption_per_mm(material, wavelength_nm) for material in materials])
    n = len(origin)
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    none = np.full(n, -1)
    zero = np.zeros(n, dtype=np.int64)
    rays = _Rays(np.array(origin), unit, np.array(power, dtype=np.float64), np.arange(n), none, zero, zero, zero)
    floor = flux_threshold * np.asarray(power)
    trie = _Trie()
    absorbed: defaultdict[str, float] = defaultdict(float)
    absorbed_in: defaultdict[str, float] = defaultdict(float)
    cut: defaultdict[str, float] = defaultdict(float)
    leaks: defaultdict[tuple[str, str, str], float] = defaultdict(float)
    hits: defaultdict[int, list[tuple[np.ndarray, Array, Array, Array]]] = defaultdict(list)
    orders: dict[int, int] = {}
    escaped: defaultdict[str, float] = defaultdict(float)
    segments = 0
    for generation in range(max_events):
        segments += len(rays.weight)
        t, surface = nearest_hits(model, rays.origin, rays.direction, rays.last)
        for number in np.unique(rays.last[surface < 0]):
            gone = rays.take((surface < 0) & (rays.last == number))
            left = "source" if number < 0 else ids[number]
            escaped[left] += float(gone.weight.sum())
            for medium in np.unique(gone.medium[np.abs(index[gone.medium] - index[0]) > 1e-9]):
                leaks[left, "escape", materials[medium]] += float(gone.weight[gone.medium == medium].sum())
        children: list[_Rays] = []
        for number in np.unique(surface[surface >= 0]):
            shape = model.shapes[number]
            here = surface == number
            arrived = rays.take(here)
            point = arrived.origin + t[here, None] * arrived.direction
            left_over = arrived.weight * np.exp(-absorption[arrived.medium] * t[here])
            for medium in np.unique(arrived.medium[absorption[arrived.medium] > 0]):
                lost = (arrived.weight - left_over)[arrived.medium == medium]
                absorbed_in[materials[medium]] += float(lost.sum())
            arrived.weight = left_over
            n_front, n_back = model.indices(shape.shape_id, wavelength_nm)
            out = interact(shape.interface, n_front, n_back, wavelength_nm, arrived.direction, shape.normal(point))
            after = arrived.medium
            if not shape.interface.opaque:
                front, back = materials.index(shape.interface.front), materials.index(shape.interface.back)
                before, after = np.where(out.from_front, front, back), np.where(out.from_front, back, front)
                for i in np.flatnonzero(np.abs(index[before] - index[arrived.medium]) > 1e-9):
                    left = "source" if arrived.last[i] < 0 else ids[arrived.last[i]]
                    leaks[left, shape.shape_id, materials[arrived.medium[i]]] += float(arrived.weight[i])
            taken = arrived.weight * (1 - out.reflectance - out.transmittance)
            if shape.detector:
                nodes = trie.step(arrived.path, number, ABSORBED)
                local, _ = shape.to_local(point, arrived.direction)
                for node in np.unique(nodes):
                    mine = nodes == node
                    hits[node].append((arrived.start[mine], local[mine, :2], taken[mine], arrived.weight[mine]))
                    orders[node] = int(arrived.order[mine][0])
            else:
                absorbed[shape.shape_id] += float(taken.sum())
            for reflects in (False, True):
                weight = arrived.weight * (out.reflectance if reflects else out.transmittance)
                counts = reflects & ~out.tir & (not shape.interface.mirror)
                order = arrived.order + counts
                some = weight > 0
                over = some & (order > max_reflections)
                weak = some & ~over & (weight < floor[arrived.start])
                late = some & ~over & ~weak & (generation + 1 >= max_events)
                for reason, mask in (("max_reflections", over), ("flux_threshold", weak), ("max_events", late)):
                    if mask.any():
                        cut[reason] += float(weight[mask].sum())
                go = some & ~over & ~weak & ~late
                if not go.any():
                    continue
                path = np.empty(int(go.sum()), dtype=np.int64)
                for kind in (TRANSMITTED,) if not reflects else (REFLECTED, TOTAL):
                    chosen = np.ones(len(path), dtype=bool) if not reflects else out.tir[go] == (kind == TOTAL)
                    if chosen.any():
                        path[chosen] = trie.step(arrived.path[go][chosen], number, kind)
                heading = out.reflected if reflects else out.transmitted
                medium = arrived.medium if reflects else after
                child = _Rays(
                    point, heading, weight, arrived.start, np.full(len(weight), number), medium, order, arrived.path
                )
                kept = child.take(go)
                kept.path = path
                children.append(kept)
        if not children:
            break
        rays = _Rays.join(children)
    paths = [_record(trie.events(node, ids), orders[node], parts) for node, parts in hits.items()]
    paths.sort(key=lambda p: -p.power_W)
    detected = sum(p.power_W for p in paths)
    launched = float(np.sum(power))
    lost = sum(escaped.values())
    return Ledger(
        launched,
        detected,
        dict(absorbed),
        lost,
        dict(cut),
        paths,
        segments,
        dict(leaks),
        dict(escaped),
        dict(absorbed_in),
    )


def _record(events: tuple[Event, ...], order: int, parts: list[tuple[np.ndarray, Array, Array, Array]]) -> PathRecord:
    start, hit, taken, arriving = (np.concatenate(column) for column in zip(*parts, strict=True))
    total = float(taken.sum())
    share = taken / total if total > 0 else np.full(len(taken), 1 / len(taken))
    centre = share @ hit
    rms = float(np.sqrt(share @ np.sum((hit - centre) ** 2, axis=1)))
    return PathRecord(
        events,
        order,
        len(start),
        total,
        float(arriving.sum()),
        float(centre[0]),
        float(centre[1]),
        rms,
        start,
        hit,
        taken,
    )

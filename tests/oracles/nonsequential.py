"""Nonsequential split tracer, breadth first, with a ledger of its own; what a limit removes is booked."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from .geometry import Array, Mask
from .glass import absorption_per_mm, refractive_index
from .interface import interact
from .replay import Event, path_text
from .scatter_integrals import Lobe
from .scene_xml import SceneModel

EVENT_NAMES = ("SpecTran", "SpecRefl", "TIR", "Absorbed", "RandTran", "RandRefl")
TRANSMITTED, REFLECTED, TOTAL, ABSORBED, SCATTERED_ON, SCATTERED_BACK = range(6)


@dataclass(frozen=True)
class PathRecord:
    """One path to a detector: events, reflections (but TIR and mirrors), and by ray start, place and power."""

    events: tuple[Event, ...]
    order: int
    start_rays: np.ndarray
    hits: Array
    weights: Array
    arriving: Array

    text = property(lambda self: path_text(self.events))  # "lens_front:T … detector:A"
    rays = property(lambda self: len(self.start_rays))
    incident_W = property(lambda self: float(self.arriving.sum()))
    x_mm = property(lambda self: float(self._centre[0]))
    y_mm = property(lambda self: float(self._centre[1]))

    power_W = property(lambda self: float(self.weights.sum()))

    @cached_property
    def _centre(self) -> Array:
        return np.average(self.hits, axis=0, weights=self.weights if self.power_W > 0 else None)

    @property
    def rms_radius_mm(self) -> float:
        distance2 = np.sum((self.hits - self._centre) ** 2, axis=1)
        return float(np.sqrt(np.average(distance2, weights=self.weights if self.power_W > 0 else None)))


@dataclass(frozen=True)
class Ledger:
    """What became of the launched power, W; ``books``: (absorbed, …, cut or leak, where …) → by start ray."""

    launched_W: float
    paths: list[PathRecord]
    segments: int
    books: Mapping[tuple[str, ...], Array]

    def _sums(self, what: str) -> dict[Any, float]:
        found = {key[1:]: float(power.sum()) for key, power in self.books.items() if key[0] == what}
        return {key if len(key) > 1 else key[0]: power for key, power in found.items()}

    detected_W = property(lambda self: sum(path.power_W for path in self.paths))
    absorbed_W = property(lambda self: self._sums("absorbed"))
    absorbed_in_W = property(lambda self: self._sums("absorbed in"))
    escaped_from_W = property(lambda self: self._sums("escaped"))  # by the last surface touched
    escaped_W = property(lambda self: sum(self.escaped_from_W.values()))
    cut_W = property(lambda self: self._sums("cut"))
    leaks_W = property(lambda self: self._sums("leak"))  # by surface left, surface hit, and medium travelled in

    @property
    def closure(self) -> float:
        booked = sum(float(power.sum()) for key, power in self.books.items() if key[0] != "leak")
        return (self.launched_W - self.detected_W - booked) / self.launched_W

    def find(self, *events: str) -> PathRecord:
        (found,) = (path for path in self.paths if path.text == " ".join(events))
        return found


@dataclass
class _Rays:
    origin: Array
    direction: Array
    weight: Array
    start: np.ndarray
    last: np.ndarray
    medium: np.ndarray
    order: np.ndarray
    scatters: np.ndarray
    path: np.ndarray

    def take(self, index: np.ndarray | Mask) -> _Rays:
        return _Rays(*(getattr(self, name)[index] for name in _Rays.__dataclass_fields__))

    @staticmethod
    def join(parts: list[_Rays]) -> _Rays:
        return _Rays(*(np.concatenate([getattr(p, name) for p in parts]) for name in _Rays.__dataclass_fields__))


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
    lobes: Mapping[str, Sequence[Lobe]] | None = None,
    max_reflections: int = 2,
    max_scatters: int = 1,
    max_events: int = 32,
    flux_threshold: float = 1e-8,
    start_material: str = "air",
    seed: int = 0,
) -> Ledger:
    """Ledger of all paths of the start rays (n, 3), powers in W; the threshold is relative to the start ray's power,
    and a leak is a hit whose index on the incident side is not that of the medium the ray is in."""
    ids, rng = [shape.shape_id for shape in model.shapes], np.random.default_rng(seed)
    materials = [start_material]
    for shape in model.shapes:
        if not shape.interface.opaque:
            materials += [m for m in (shape.interface.front, shape.interface.back) if m not in materials]
    index = np.array([refractive_index(material, wavelength_nm) for material in materials])
    absorption = np.array([absorption_per_mm(material, wavelength_nm) for material in materials])
    n = len(origin)
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    zero = np.zeros(n, dtype=np.int64)
    power = np.array(power, dtype=np.float64)
    rays = _Rays(np.array(origin), unit, power, np.arange(n), zero - 1, zero, zero, zero, zero)
    floor = flux_threshold * power
    known: dict[tuple[Event, ...], int] = {(): 0}  # paths, so that rays carry one integer
    listed: list[tuple[Event, ...]] = [()]
    books: defaultdict[tuple[str, ...], Array] = defaultdict(lambda: np.zeros(n))
    hits: defaultdict[int, list[tuple[np.ndarray, Array, Array, Array]]] = defaultdict(list)
    orders: dict[int, int] = {}
    segments = 0

    def step(parents: np.ndarray, name: str, events: np.ndarray) -> np.ndarray:
        unique, inverse = np.unique(parents * len(EVENT_NAMES) + events, return_inverse=True)
        paths = [(*listed[code // len(EVENT_NAMES)], (name, EVENT_NAMES[code % len(EVENT_NAMES)])) for code in unique]
        for path in paths:
            if known.setdefault(path, len(listed)) == len(listed):
                listed.append(path)
        return np.array([known[path] for path in paths], dtype=np.int64)[inverse]

    def book(key: tuple[str, ...], booked: _Rays, mask: Mask) -> None:
        if mask.any():
            books[key] += np.bincount(booked.start[mask], booked.weight[mask], n)

    def book_leaks(gone: _Rays, to: str, wrong: Mask) -> None:
        for last, medium in set(zip(gone.last[wrong].tolist(), gone.medium[wrong].tolist(), strict=True)):
            key = ("leak", "source" if last < 0 else ids[last], to, materials[medium])
            book(key, gone, wrong & (gone.last == last) & (gone.medium == medium))

    for generation in range(max_events):
        segments += len(rays.weight)
        t, surface = nearest_hits(model, rays.origin, rays.direction, rays.last)
        gone = surface < 0
        for number in np.unique(rays.last[gone]):
            book(("escaped", "source" if number < 0 else ids[number]), rays, gone & (rays.last == number))
        book_leaks(rays, "escape", gone & (np.abs(index[rays.medium] - index[0]) > 1e-9))
        children: list[_Rays] = []
        for number in np.unique(surface[~gone]):
            shape, name = model.shapes[number], ids[number]
            here = surface == number
            arrived = rays.take(here)
            point = arrived.origin + t[here, None] * arrived.direction
            passed = np.exp(-absorption[arrived.medium] * t[here])
            lost = replace(arrived, weight=arrived.weight * (1 - passed))
            for medium in np.unique(arrived.medium[absorption[arrived.medium] > 0]):
                book(("absorbed in", materials[medium]), lost, arrived.medium == medium)
            arrived.weight = arrived.weight * passed
            n_front, n_back = model.indices(name, wavelength_nm)
            normal = shape.normal(point)
            out = interact(shape.interface, n_front, n_back, wavelength_nm, arrived.direction, normal)
            after = arrived.medium
            if not shape.interface.opaque:
                front, back = materials.index(shape.interface.front), materials.index(shape.interface.back)
                before, after = np.where(out.from_front, front, back), np.where(out.from_front, back, front)
                book_leaks(arrived, name, np.abs(index[before] - index[arrived.medium]) > 1e-9)
            taken = 1 - out.reflectance - out.transmittance
            daughters = []  # share, direction, event, medium, by how much order and number of scatters grow
            ways = (True, out.transmittance, out.transmitted), (False, out.reflectance, out.reflected)
            for transmits, x, heading in ways:
                medium, kept = after if transmits else arrived.medium, np.ones(len(x))
                for lobe in (lobes or {}).get(name, ()):
                    if transmits != (lobe.event == "transmission"):
                        continue
                    mine = np.where(out.from_front, "front" in lobe.sides, "back" in lobe.sides)
                    mine &= ~(out.tir & transmits)
                    share = mine * (1.0 if lobe.absolute else x)
                    total = np.where(mine, lobe.total(np.abs(np.einsum("ij,ij->i", heading, normal))), 0.0)
                    if lobe.absolute:
                        taken -= total
                    else:
                        kept -= total
                    scattered, factor = lobe.drawn(heading, normal, rng)
                    event = np.full(len(x), SCATTERED_ON if transmits else SCATTERED_BACK)
                    daughters.append((share * factor, scattered, event, medium, 0, 1))
                event = np.where(transmits, TRANSMITTED, np.where(out.tir, TOTAL, REFLECTED))
                counts = ~out.tir & (not transmits and not shape.interface.mirror)
                daughters.append((x * kept, heading, event, medium, counts, 0))
            if shape.detector:
                nodes = step(arrived.path, name, np.array(ABSORBED))
                local, _ = shape.to_local(point, arrived.direction)
                for node in np.unique(nodes):
                    mine = nodes == node
                    weight = arrived.weight[mine]
                    hits[node].append((arrived.start[mine], local[mine, :2], taken[mine] * weight, weight))
                    orders[node] = int(arrived.order[mine][0])
            else:
                book(("absorbed", name), replace(arrived, weight=arrived.weight * taken), np.ones(len(taken), bool))
            for share, heading, event, medium, counts, scatters in daughters:
                child = replace(
                    arrived, origin=point, direction=heading, weight=arrived.weight * share, medium=medium,
                    last=np.full(len(share), number), order=arrived.order + counts,
                    scatters=arrived.scatters + scatters,
                )  # fmt: skip
                left = child.weight > 0
                for reason, beyond in (
                    ("max_reflections", child.order > max_reflections),
                    ("max_scatters", child.scatters > max_scatters),
                    ("flux_threshold", child.weight < floor[child.start]),
                    ("max_events", left & (generation + 1 >= max_events)),
                ):
                    book(("cut", reason), child, left & beyond)
                    left &= ~beyond
                child = child.take(left)
                child.path = step(child.path, name, event[left])
                children.append(child)
        rays = _Rays.join(children) if children else rays.take(np.zeros(len(t), dtype=bool))
        if not len(rays.weight):
            break
    paths = [PathRecord(listed[k], orders[k], *map(np.concatenate, zip(*own, strict=True))) for k, own in hits.items()]
    paths.sort(key=lambda p: -p.power_W)
    return Ledger(float(np.sum(power)), paths, segments, dict(books))

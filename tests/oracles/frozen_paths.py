"""Recorded rays followed again through their events, whatever the apertures, in a scene with other numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .frozen_scene import FrozenScene, Lobe
from .geometry import Array, Mask
from .interface import Interaction
from .replay import SPECULAR, Event, path_text

SCATTERED = {"RandTran": "transmission", "ImpTran": "transmission", "RandRefl": "reflection", "ImpRefl": "reflection"}


@dataclass(frozen=True)
class Bundle:
    """Rays of one path as a trace recorded them: starts, hits and directions after each event, and flux."""

    events: tuple[Event, ...]
    origin: Array
    direction: Array
    points: Array
    leaving: Array
    power: Array
    arriving: Array
    start: np.ndarray

    text = property(lambda self: path_text(self.events))
    scatters = property(lambda self: any(name in SCATTERED for _, name in self.events))


@dataclass(frozen=True)
class Hits:
    """Where rays meet the detector, in its frame, and their flux; all hits, and what each ray was before each event."""

    x: Array
    y: Array
    flux: Array
    arriving: Array
    points: Array
    trail: list[State]


State = tuple[Array, Array, Array, float]
Metric = Callable[[Sequence[Hits]], float]
Direction = Mapping[str, Array]  # key → how its numbers move


def follow(scene: FrozenScene, bundle: Bundle, trail: Sequence[State] = ()) -> Hits:
    """Follow a bundle from the last state in `trail` on; after scatter the unit of flux is that of `FrozenPaths`."""
    unit = bundle.direction / np.linalg.norm(bundle.direction, axis=1, keepdims=True)
    states = list(trail) or [(bundle.origin, unit, bundle.power.copy(), 0.0)]
    position, heading, flux, absorption = states.pop()
    points = [state[0] for state in [*states, (position,)][1:]]
    for step, (shape_id, name) in enumerate(bundle.events):
        if step < len(states):
            continue
        states.append((position, heading, flux, absorption))
        near = np.einsum("ij,ij->i", bundle.points[step] - position, heading)
        length = scene.cross(shape_id, position, heading, near)
        position = position + length[:, None] * heading
        points.append(position)
        flux = flux * np.exp(-absorption * length)
        out = scene.meet(shape_id, position, heading)
        if step == len(bundle.events) - 1:
            rotation, vertex = scene.pose(shape_id)
            local = (position - vertex) @ rotation
            absolute = sum(_total(scene, shape_id, out, kind, True) for kind in ("transmission", "reflection"))
            taken = flux * np.asarray(1 - out.reflectance - out.transmittance - absolute)
            return Hits(local[:, 0], local[:, 1], taken, flux, np.array(points), states)
        passes = name == "SpecTran" or SCATTERED.get(name) == "transmission"
        if name in SCATTERED:
            heading = bundle.leaving[step]
            flux = flux * _scattered(scene, shape_id, out, SCATTERED[name], heading)
        else:
            kind = SPECULAR[name]
            if np.any(out.tir != (kind == "I")) and kind != "R":
                beyond = f"{np.sum(out.tir)} of {len(flux)} rays are beyond the critical angle"
                raise ValueError(f"event {step}, {name} at {shape_id}: {beyond}")
            event = "transmission" if passes else "reflection"
            power, heading = _specular(out, event)
            flux = flux * power * (1 - _total(scene, shape_id, out, event, False))
        interface = scene.model.by_id[shape_id].interface
        if passes and not interface.opaque:
            if not (out.from_front.all() or not out.from_front.any()):
                raise ValueError(f"event {step} at {shape_id}: rays come from both sides")
            absorption = scene.absorption(interface.back if out.from_front[0] else interface.front)
    raise ValueError(f"path does not end on the detector: {bundle.text}")


def _specular(out: Interaction, event: str) -> tuple[Array, Array]:
    return (out.transmittance, out.transmitted) if event == "transmission" else (out.reflectance, out.reflected)


def _lobes(scene: FrozenScene, shape_id: str, out: Interaction, event: str) -> Iterator[tuple[Lobe, Mask]]:
    """The lobes of one event at a surface, each with the rays that it is for."""
    for side, here in (("front", out.from_front), ("back", ~out.from_front)):
        if scene.scatter.get(shape_id) and here.any():
            yield from ((lobe, here) for lobe in scene.lobes(shape_id, side) if lobe.event == event)


def _total(scene: FrozenScene, shape_id: str, out: Interaction, event: str, absolute: bool) -> Array:
    """Total of the lobes of one event that are absolute, or of those that are not, (n,)."""
    cosine = np.abs(np.einsum("ij,ij->i", _specular(out, event)[1], out.normal))
    lobes = _lobes(scene, shape_id, out, event)
    return sum((here * lobe.total(cosine) for lobe, here in lobes if lobe.absolute == absolute), np.zeros(len(cosine)))


def _scattered(scene: FrozenScene, shape_id: str, out: Interaction, event: str, heading: Array) -> Array:
    """Scattered flux per solid angle along `heading` and unit of incident flux."""
    x, specular = _specular(out, event)

    def tangential(v: Array) -> Array:
        return v - np.einsum("ij,ij->i", v, out.normal)[:, None] * out.normal

    density = np.zeros(len(x))
    for lobe, here in _lobes(scene, shape_id, out, event):
        r = np.linalg.norm(tangential(heading if lobe.about_normal else heading - specular), axis=1)
        density = density + here * (1.0 if lobe.absolute else x) * lobe.profile(r)
    return density * np.abs(np.einsum("ij,ij->i", heading, out.normal))


class FrozenPaths:
    def __init__(self, scene: FrozenScene, bundles: Sequence[Bundle]) -> None:
        self.scene, self.bundles = scene, list(bundles)
        nominal = [follow(scene, bundle) for bundle in self.bundles]
        self._scale = [
            bundle.arriving / hits.arriving if bundle.scatters else np.ones(len(hits.x))
            for bundle, hits in zip(self.bundles, nominal, strict=True)
        ]
        self.nominal = [self._scaled(k, hits) for k, hits in enumerate(nominal)]

    def _scaled(self, k: int, hits: Hits) -> Hits:
        return replace(hits, flux=hits.flux * self._scale[k], arriving=hits.arriving * self._scale[k])

    def moved(self, direction: Direction, factor: float) -> list[Hits]:
        scene = self.scene
        for key, values in direction.items():
            for entry, value in enumerate(values):
                scene = scene.moved(key, factor * value, entry)
        names = {name for bundle in self.bundles for name, _ in bundle.events}
        moving = {name for name in names if any(scene.met_by(key, name) for key in direction)}
        found = list(self.nominal)
        for k, bundle in enumerate(self.bundles):
            first = next((step for step, (name, _) in enumerate(bundle.events) if name in moving), None)
            if first is not None:
                found[k] = self._scaled(k, follow(scene, bundle, self.nominal[k].trail[: first + 1]))
        return found

    def along(self, metrics: Sequence[Metric], direction: Direction) -> Array:
        """Derivatives by a common factor of the direction, (8 [f(h) - f(-h)] - [f(2h) - f(-2h)])/12h at h = 1."""
        total = np.zeros(len(metrics))
        for factor, weight in ((1, 8.0), (-1, -8.0), (2, -1.0), (-2, 1.0)):
            hits = self.moved(direction, factor)
            total += weight * np.array([metric(hits) for metric in metrics])
        return total / 12

    def derivatives(self, metrics: Sequence[Metric], key: str, step: float, entry: int = 0) -> Array:
        values = np.zeros(len(self.scene.numbers[key]))
        values[entry] = step
        return self.along(metrics, {key: values}) / step


def power(hits: Sequence[Hits]) -> float:
    return float(sum(h.flux.sum() for h in hits))


def mean_position(hits: Sequence[Hits]) -> tuple[float, float]:
    total = power(hits)
    return float(sum(h.flux @ h.x for h in hits) / total), float(sum(h.flux @ h.y for h in hits) / total)


def rms_radius(hits: Sequence[Hits]) -> float:
    x, y = mean_position(hits)
    return float(np.sqrt(sum(h.flux @ ((h.x - x) ** 2 + (h.y - y) ** 2) for h in hits) / power(hits)))


def tent_image(hits: Sequence[Hits], extent: tuple[float, float, float, float], shape: tuple[int, int]) -> Array:
    """Flux in pixels, each hit shared bilinearly by the four nearest; beyond the centres the outer ones take all."""
    height, width = shape
    image = np.zeros((height, width))
    for h in hits:
        u = np.clip((h.x - extent[0]) / (extent[1] - extent[0]) * width - 0.5, 0.0, width - 1.0)
        v = np.clip((h.y - extent[2]) / (extent[3] - extent[2]) * height - 0.5, 0.0, height - 1.0)
        i, j = np.minimum(u.astype(int), width - 2), np.minimum(v.astype(int), height - 2)
        a, b = u - i, v - j
        for di, wu in ((0, 1 - a), (1, a)):
            for dj, wv in ((0, 1 - b), (1, b)):
                np.add.at(image, (j + dj, i + di), h.flux * wu * wv)
    return image

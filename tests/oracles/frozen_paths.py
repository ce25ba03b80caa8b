"""Recorded rays followed again through their event lists: what a metric does when a number of the scene moves.

Visibility is frozen: a ray meets the surfaces of its list, whatever their apertures. After a scatter event the ray
keeps the direction that was recorded, and its flux moves with the BSDF. Derivatives are central differences of fourth
order in float64; nothing here knows of derivatives of surfaces, of Snell's law or of coatings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .frozen_scene import FrozenScene, Lobe, Outcome
from .geometry import Array, Mask
from .replay import Event

SPECULAR = {"SpecTran": "T", "SpecRefl": "R", "TIR": "TIR", "Absorbed": "A"}
SCATTERED = {"RandTran": "transmission", "ImpTran": "transmission", "RandRefl": "reflection", "ImpRefl": "reflection"}


@dataclass(frozen=True)
class Bundle:
    """
    Rays of one path as a trace recorded them.

    Attributes
    ----------
    events : tuple of (shape id, intercept type)
        The last one is Absorbed, at the detector.
    origin, direction : (n, 3) float64
        Start rays, mm.
    points : (k, n, 3) float64
        Recorded hits, mm; only near ones are needed.
    leaving : (k, n, 3) float64
        Recorded directions after each event; used after scatter events.
    power : (n,) float64
        Flux of the start rays, W.
    arriving : (n,) float64
        Recorded flux with which each ray meets the detector, W.
    start : (n,) int
        Numbers of the start rays.
    """

    events: tuple[Event, ...]
    origin: Array
    direction: Array
    points: Array
    leaving: Array
    power: Array
    arriving: Array
    start: np.ndarray

    @property
    def text(self) -> str:
        """Events as a row of a path table has them, with the letters of scatter as well."""
        letters = {"SpecTran": "T", "SpecRefl": "R", "TIR": "I", "Absorbed": "A"}
        letters |= {"RandTran": "t", "RandRefl": "r", "ImpTran": "i", "ImpRefl": "j"}
        return " ".join(f"{shape_id}:{letters[name]}" for shape_id, name in self.events)

    @property
    def scatters(self) -> bool:
        """Whether one of the events is a scatter event."""
        return any(name in SCATTERED for _, name in self.events)


@dataclass(frozen=True)
class Hits:
    """
    Where the rays of a bundle meet the detector.

    Attributes
    ----------
    x, y : (n,)
        In the detector's own frame, mm.
    flux, arriving : (n,)
        What the detector absorbs, and what meets it, W.
    points : (k, n, 3)
        All hits, mm.
    trail : list
        Position, direction, flux and absorption coefficient before each event.
    """

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
    """
    Follow the rays of a bundle through its events, from the last of the states in `trail` on.

    The flux of a path that scatters is in arbitrary units: the density with which its directions were drawn is not
    known here. `FrozenPaths` sets the scale by what was recorded.
    """
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
            taken = flux * _absorbed(scene, shape_id, out)
            return Hits(local[:, 0], local[:, 1], taken, flux, np.array(points), states)
        if name in SCATTERED:
            heading = bundle.leaving[step]
            flux = flux * _scattered(scene, shape_id, out, SCATTERED[name], heading)
            passes = SCATTERED[name] == "transmission"
        else:
            kind = SPECULAR[name]
            passes = kind == "T"
            if np.any(out.tir != (kind == "TIR")) and kind != "R":
                beyond = f"{np.sum(out.tir)} of {len(flux)} rays are beyond the critical angle"
                raise ValueError(f"event {step}, {name} at {shape_id}: {beyond}")
            event = "transmission" if passes else "reflection"
            flux = flux * (out.T if passes else out.R) * _kept(scene, shape_id, out, event)
            heading = out.transmitted if passes else out.reflected
        interface = scene.model.by_id[shape_id].interface
        if passes and not interface.opaque:
            if not (out.from_front.all() or not out.from_front.any()):
                raise ValueError(f"event {step} at {shape_id}: rays come from both sides")
            absorption = scene.absorption(interface.back if out.from_front[0] else interface.front)
    raise ValueError(f"path does not end on the detector: {bundle.text}")


def _specular(out: Outcome, event: str) -> Array:
    return out.transmitted if event == "transmission" else out.reflected


def _lobes_by_side(scene: FrozenScene, shape_id: str, out: Outcome) -> Iterator[tuple[Lobe, Mask]]:
    """The lobes of a surface, each with the rays that it is for."""
    if not scene.scatter.get(shape_id):
        return
    for side, here in (("front", out.from_front), ("back", ~out.from_front)):
        if here.any():
            for lobe in scene.lobes(shape_id, side):
                yield lobe, here


def _kept(scene: FrozenScene, shape_id: str, out: Outcome, event: str) -> Array:
    """What scatter leaves of the specular beam of one event."""
    x = out.T if event == "transmission" else out.R
    cosine = np.abs(np.einsum("ij,ij->i", _specular(out, event), out.normal))
    kept = np.ones(len(cosine))
    for lobe, here in _lobes_by_side(scene, shape_id, out):
        if lobe.event == event and not lobe.absolute:
            share = lobe.coefficient(x) / np.where(x > 0, x, 1.0) * lobe.total(cosine)
            kept = kept - np.where(here, share, 0.0)
    return kept


def _absorbed(scene: FrozenScene, shape_id: str, out: Outcome) -> Array:
    """Share that a surface takes: what is neither reflected, nor transmitted, nor scattered."""
    taken = np.ones(len(out.R))
    for event, x in (("transmission", out.T), ("reflection", out.R)):
        taken = taken - x * _kept(scene, shape_id, out, event)
        cosine = np.abs(np.einsum("ij,ij->i", _specular(out, event), out.normal))
        for lobe, here in _lobes_by_side(scene, shape_id, out):
            if lobe.event == event:
                taken = taken - np.where(here, lobe.coefficient(x) * lobe.total(cosine), 0.0)
    return taken


def _scattered(scene: FrozenScene, shape_id: str, out: Outcome, event: str, heading: Array) -> Array:
    """Scattered flux per solid angle along `heading` and unit of incident flux."""
    x = out.T if event == "transmission" else out.R

    def tangential(v: Array) -> Array:
        return v - np.einsum("ij,ij->i", v, out.normal)[:, None] * out.normal

    centre = tangential(_specular(out, event))
    beta = tangential(heading)
    density = np.zeros(len(x))
    for lobe, here in _lobes_by_side(scene, shape_id, out):
        if lobe.event == event:
            r = np.linalg.norm(beta - (0.0 if lobe.about_normal else centre), axis=1)
            density = density + np.where(here, lobe.coefficient(x) * lobe.profile(r), 0.0)
    return density * np.abs(np.einsum("ij,ij->i", heading, out.normal))


class FrozenPaths:
    """
    The recorded rays of a trace.

    Parameters
    ----------
    scene : FrozenScene
        As it was traced.
    bundles : sequence of Bundle
    """

    def __init__(self, scene: FrozenScene, bundles: Sequence[Bundle]) -> None:
        self.scene, self.bundles = scene, list(bundles)
        nominal = [follow(scene, bundle) for bundle in self.bundles]
        self._scale = [
            bundle.arriving / hits.arriving if bundle.scatters else np.ones(len(hits.x))
            for bundle, hits in zip(self.bundles, nominal, strict=True)
        ]
        self.nominal = self._scaled(nominal, range(len(self.bundles)))

    def _scaled(self, hits: Sequence[Hits], numbers: Sequence[int]) -> list[Hits]:
        return [
            replace(h, flux=h.flux * self._scale[k], arriving=h.arriving * self._scale[k])
            for h, k in zip(hits, numbers, strict=True)
        ]

    def moved(self, direction: Direction, factor: float) -> list[Hits]:
        """The hits with numbers changed by a factor times the direction."""
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
                hits = follow(scene, bundle, self.nominal[k].trail[: first + 1])
                (found[k],) = self._scaled([hits], [k])
        return found

    def along(self, metrics: Sequence[Metric], direction: Direction) -> Array:
        """Derivatives of metrics by a common factor of the direction, (metrics,), at steps of 1 and 2 times it.

        (8 [f(h) - f(-h)] - [f(2h) - f(-2h)])/12h with h = 1.
        """
        total = np.zeros(len(metrics))
        for factor, weight in ((1, 8.0), (-1, -8.0), (2, -1.0), (-2, 1.0)):
            hits = self.moved(direction, factor)
            total += weight * np.array([metric(hits) for metric in metrics])
        return total / 12

    def derivatives(self, metrics: Sequence[Metric], key: str, step: float, entry: int = 0) -> Array:
        """Derivatives of metrics by one number, (metrics,)."""
        values = np.zeros(len(self.scene.numbers[key]))
        values[entry] = step
        return self.along(metrics, {key: values}) / step

    def scan(
        self, metrics: Sequence[Metric], key: str, steps: Sequence[float], entry: int = 0
    ) -> tuple[Array, Array, float]:
        """
        Derivatives with several steps, and where they agree best.

        Returns
        -------
        derivatives, change : (metrics,)
            Those of the step that agrees best with its two neighbours, and the larger of the differences from them.
        step : float
        """
        rows = np.array([self.derivatives(metrics, key, step, entry) for step in steps])
        inner = np.maximum(np.abs(rows[1:-1] - rows[:-2]), np.abs(rows[1:-1] - rows[2:]))
        scale = np.maximum(np.abs(rows).max(axis=0), 1e-300)
        best = int(np.argmin(np.max(inner / scale, axis=1)))
        return rows[best + 1], inner[best], float(steps[best + 1])


def power(hits: Sequence[Hits]) -> float:
    """Flux that the detector absorbs, W."""
    return float(sum(h.flux.sum() for h in hits))


def mean_position(hits: Sequence[Hits]) -> tuple[float, float]:
    """Centroid, mm."""
    total = power(hits)
    return float(sum(h.flux @ h.x for h in hits) / total), float(sum(h.flux @ h.y for h in hits) / total)


def rms_radius(hits: Sequence[Hits]) -> float:
    """Root-mean-square distance from the centroid, mm."""
    x, y = mean_position(hits)
    return float(np.sqrt(sum(h.flux @ ((h.x - x) ** 2 + (h.y - y) ** 2) for h in hits) / power(hits)))


def tent_image(hits: Sequence[Hits], extent: tuple[float, float, float, float], shape: tuple[int, int]) -> Array:
    """Flux in pixels, (height, width), W, each hit shared bilinearly by the four pixels whose centres are nearest.

    extent : x0, x1, y0, y1 of the film, mm; beyond the centres of the outer pixels those take all.
    """
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

"""Distances of recorded hits, followed again in float64, from rims and from surfaces that meet a rim."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .frozen_paths import SCATTERED, Bundle, follow
from .frozen_scene import FrozenScene
from .geometry import Array, Asphere, Frustum

RIMS = ("outer", "inner", "half_width", "half_height", "low", "high")
APERTURES = {"semi_diameter": "outer", "inner_semi_diameter": "inner"}


@dataclass(frozen=True)
class RimHits:
    """Rays of a path that end close to a rim, or to the surface ``joined`` to it; ``c`` weighs distances."""

    bundle: Bundle
    rim: str
    joined: str | None
    c: Array
    batch: np.ndarray

    surface = property(lambda self: self.bundle.events[-1][0])


def rim_place(scene: FrozenScene, surface: str, rim: str) -> float:
    """Clear radius, half side or end of a surface, mm in its own frame."""
    own = scene.surface(surface)
    if isinstance(own, Frustum):
        r, z = sorted((own.r0, own.r1)), sorted((own.z0, own.z1))
        return {"outer": r[1], "inner": r[0], "low": z[0], "high": z[1]}[rim]
    assert isinstance(own, Asphere)
    return float(getattr(own, rim))


def distances(scene: FrozenScene, hits: RimHits, shift: float = 0.0) -> Array:
    """Distances of hits (n,) from their rim, which is moved by `shift`, or from the joined surface, mm."""
    bundle = hits.bundle
    end = follow(scene, bundle).points[-1]
    if hits.joined is not None:
        rotation, vertex = scene.pose(hits.joined)
        other = scene.surface(hits.joined)
        value, gradient = other.implicit((end - vertex) @ rotation)
        # For the program F falls along the axis of aspheres and planes
        sign = -1 if isinstance(other, Asphere) or (isinstance(other, Frustum) and other.z0 == other.z1) else 1
        return np.asarray(sign * value / np.linalg.norm(gradient, axis=1))
    rotation, vertex = scene.pose(hits.surface)
    local = (end - vertex) @ rotation
    rho, (x, y, z) = np.hypot(local[:, 0], local[:, 1]), local.T
    at = {"outer": rho, "inner": rho, "half_width": np.abs(x), "half_height": np.abs(y), "low": z, "high": z}[hits.rim]
    inwards = rim_place(scene, hits.surface, hits.rim) + shift - at
    return -inwards if hits.rim in ("inner", "low") else inwards


def edge_derivative(scene: FrozenScene, groups: list[RimHits], key: str, step: float) -> Array:
    """Derivative of Σ c Δ by a number of the scene, or by a clear radius or half side, by batch: (…, 32)."""
    owner, name = key.rsplit(".", 1)
    total = np.zeros((*groups[0].c.shape[:-1], 32))
    for hits in groups:
        if key in scene.numbers:
            if not any(scene.met_by(key, s) for s in {hits.joined or owner, *(e[0] for e in hits.bundle.events)}):
                continue
            up, down = (distances(scene.moved(key, sign * step), hits) for sign in (1, -1))
        else:
            own = owner == hits.surface and APERTURES.get(name, name) == hits.rim and hits.joined is None
            up, down = (distances(scene, hits, sign * step * own) for sign in (1, -1))
        slope = hits.c * (up - down) / (2 * step)
        for row in np.ndindex(slope.shape[:-1]):
            total[row] += np.bincount(hits.batch, slope[row], 32)
    return total


def bundles_of_hits(
    ids: list[str],
    intercepts: tuple[str, ...],
    codes: Array,
    lengths: np.ndarray,
    points: Array,
    origin: Array,
    direction: Array,
    rest: dict[str, Array],
    event_bits: int,
) -> list[RimHits]:
    """Hits by path, rim and joined surface; codes of events and hits (n, k, …), start rays (n, 3), the rest by name."""
    found: dict[tuple[bytes, int, int], list[int]] = {}
    for i, length in enumerate(lengths):
        label = codes[i, :length].tobytes(), int(rest["rim"][i]), int(rest["joined"][i])
        found.setdefault(label, []).append(i)
    groups = []
    for (_, rim, joined), chosen in found.items():
        length = lengths[chosen[0]]
        path = codes[chosen[0], :length]
        events = tuple((ids[c >> event_bits], intercepts[int(c) & ((1 << event_bits) - 1)]) for c in path)
        hits = np.moveaxis(points[chosen, :length], 1, 0)
        leaving = np.diff(hits, axis=0, append=hits[-1:])
        for k, (_, name) in enumerate(events):
            if name in SCATTERED:
                leaving[k] /= np.linalg.norm(leaving[k], axis=1, keepdims=True)
        one = np.ones(len(chosen))
        bundle = Bundle(events, origin[chosen], direction[chosen], hits, leaving, one, one, np.array(chosen))
        name = None if joined >= len(ids) else ids[joined]
        groups.append(RimHits(bundle, RIMS[rim], name, rest["c"][..., chosen], rest["batch"][chosen]))
    return groups


def scaled(groups: list[RimHits], factor: float) -> list[RimHits]:
    """The same with all coefficients multiplied: what a wrong program would give."""
    return [replace(hits, c=factor * hits.c) for hits in groups]

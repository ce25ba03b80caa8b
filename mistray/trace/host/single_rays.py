"""Tracer of rays that do not split, hit by hit: each is either transmitted or reflected, without scatter.

Rays go forward or backward; the geometry is the same. They are traced all at once, surface by surface. Each hit is
returned to the host with its point, its directions and the side of the surface.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.kernel.interaction import Interaction, interact
from mistray.kernel.kernel_scene import next_hit
from mistray.kernel.scattering import Scattering
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.optics import MIRROR, OPAQUE
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import download, upload

FAINTEST = 1e-12  # weight below which a ray ends


@dataclass(frozen=True, eq=False)
class StartPoints:
    """
    Start points, mm, unit directions and weights of rays that do not split.

    Attributes
    ----------
    o, d : (n, 3) float64
        Origins, mm, and unit directions.
    weight : (n,) float64
        Weights of the rays, see `mistray.trace.host.ray_sources` for their unit.
    left : int
        Index of the surface that all of them start on; -1 for none.
    normal : (n, 3) float64, optional
        Unit normals of that surface, needed if it is a Mitsuba shape.
    medium : int
        Index of the material in which they start; 0 for an unknown one without absorption.
    """

    o: np.ndarray
    d: np.ndarray
    weight: np.ndarray
    left: int = -1
    normal: np.ndarray | None = None
    medium: int = 0


@dataclass(frozen=True, eq=False, kw_only=True)
class Hits:
    """
    Hits of rays at one step of their paths: points, directions, weights and sides of surfaces.

    Attributes
    ----------
    number : int
        Index of the step, from 0.
    lane : (m,) int
        Indices of the rays.
    surface : (m,) int
        Indices of the surfaces hit.
    from_front : (m,) bool
        Whether the rays arrive from the front.
    point, direction : (m, 3) float64
        Points of the hits, mm, and unit directions in which the rays arrive.
    normal : (m, 3) float64
        Unit normals on the side towards which the rays travel.
    weight : (m,) float64
        Weights of the rays as they arrive.
    index : (m,) float64
        Refractive index of the medium in which they arrive, relative to that in which they started.
    transmits, reflects, total : (m,) bool
        Whether the rays are transmitted, whether they are reflected, and whether by total reflection; other rays end.
    """

    number: int
    lane: np.ndarray
    surface: np.ndarray
    from_front: np.ndarray
    point: np.ndarray
    direction: np.ndarray
    normal: np.ndarray
    weight: np.ndarray
    index: np.ndarray
    transmits: np.ndarray
    reflects: np.ndarray
    total: np.ndarray


@dataclass(frozen=True, eq=False)
class Escape:
    """Rays that leave the scene: indices of the rays, (m,), unit directions, (m, 3), and weights, (m,)."""

    lane: np.ndarray
    direction: np.ndarray
    weight: np.ndarray


class ChainTracer:
    """
    Tracer of rays that do not split: at each surface a ray is either transmitted or reflected.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    intersector : Intersector
        Search for the hits.
    scattering : Scattering
        Scatter of the surfaces, which reduces the specular light.
    allowed : str
        Allowed events, as in `mistray.trace.Settings`. With R and T one of them is drawn, in proportion to R and T.
    mirrors : (s,) bool
        Surfaces that count as declared mirrors.
    max_events : int
        Greatest number of surfaces on a path.
    total_reflection : bool
        Whether rays continue in total reflection, if it is an allowed event; else they end there.

    Attributes
    ----------
    lost : float
        Total weight of rays that met a surface from a wrong material: there is a gap in the geometry.
    """

    def __init__(
        self,
        table: SurfaceTable,
        intersector: Intersector,
        scattering: Scattering,
        allowed: str,
        mirrors: np.ndarray,
        max_events: int,
        total_reflection: bool = True,
    ) -> None:
        self.table, self.intersector, self.scattering = table, intersector, scattering
        self.allowed, self.max_events, self.total_reflection = allowed, max_events, total_reflection
        self.mirrors = mi.Bool(mirrors)
        self.lost = 0.0

    def follow(self, start: StartPoints, rng: np.random.Generator) -> Iterator[Hits | Escape]:
        """
        Trace rays to their ends, at most over `max_events` surfaces; `rng` draws between R and T.

        Yields
        ------
        Hits or Escape
            At each step, the rays that leave the scene, if any, and the hits of the others, if any.
        """
        table, n = self.table, len(start.o)
        o, d = table.upload_points(start.o), mi.Vector3f(*(upload(mi.Float, column) for column in start.d.T))
        w = upload(mi.Float, start.weight)
        # In memory: as constants they would make kernels of their own for the first step of each start
        index = dr.opaque(mi.Float, 1, n)
        last = dr.opaque(mi.UInt32, NO_SURFACE if start.left < 0 else start.left, n)
        medium = dr.opaque(mi.UInt32, start.medium, n)
        lane = np.arange(n)
        behind = None
        if start.normal is not None and table.mitsuba_scene is not None:
            behind = mi.Vector3f(*(upload(mi.Float, column) for column in start.normal.T))
        for number in range(self.max_events):
            t, s, normal = next_hit(table, self.intersector, o, d, last, mi.Bool(True), normal=behind)
            hit = s != NO_SURFACE
            if table.optics.absorbs:
                extinction = dr.gather(mi.Float, table.optics.extinction, medium, hit)
                w = dr.select(hit, w * dr.exp(-extinction * dr.select(hit, t, 0)), w)
            it = interact(table, dr.fma(t, d, o), d, s, normal if table.mitsuba_scene is not None else None, None, hit)
            R, T = it.R, it.T
            if self.scattering.any:
                given = self.scattering.budget(s, it, hit)
                R, T = R * given.reflection.kept, T * given.transmission.kept
            strayed = (medium != 0) & (it.medium_in != 0) & (it.medium_in != medium)
            hit_here = hit & ~strayed
            through, back, factor = self._child(it, s, R, T, rng, len(lane), hit_here)
            after = w * factor
            goes = hit_here & (through | back) & (after > FAINTEST)
            if not self.total_reflection:
                goes &= ~it.tir
            heading = dr.select(back, it.reflected, it.transmitted)
            n_after = dr.select(back, index, index / it.eta)
            inside = dr.select(it.medium_in == 0, medium, it.medium_in)
            medium = dr.select(back, inside, it.medium_out)
            dr.eval(
                it.p,
                d,
                it.axis,
                s,
                w,
                index,
                hit,
                strayed,
                hit_here,
                goes,
                through,
                back,
                heading,
                n_after,
                medium,
                after,
            )
            dr.eval(it.from_front, it.tir, normal)
            missed, met = ~np.array(hit), np.array(hit_here)
            astray = np.array(hit & strayed)
            self.lost += float(np.array(w, dtype=np.float64)[astray].sum())
            if missed.any():
                yield Escape(lane[missed], download(d)[missed], np.array(w, dtype=np.float64)[missed])
            if met.any():
                yield Hits(
                    number=number,
                    lane=lane[met],
                    surface=np.array(s, dtype=np.int64)[met],
                    from_front=np.array(it.from_front)[met],
                    point=table.download_points(it.p)[met],
                    direction=download(d)[met],
                    normal=download(it.axis)[met],
                    weight=np.array(w, dtype=np.float64)[met],
                    index=np.array(index, dtype=np.float64)[met],
                    transmits=np.array(goes & through)[met],
                    reflects=np.array(goes & back)[met],
                    total=np.array(goes & back & it.tir)[met],
                )
            kept = dr.compress(goes)
            if not dr.width(kept):
                return
            o, d = (dr.gather(mi.Vector3f, v, kept) for v in (it.p, heading))
            w, index = dr.gather(mi.Float, after, kept), dr.gather(mi.Float, n_after, kept)
            last, medium = dr.gather(mi.UInt32, s, kept), dr.gather(mi.UInt32, medium, kept)
            behind = dr.gather(mi.Vector3f, normal, kept) if table.mitsuba_scene is not None else None
            lane = lane[np.array(kept)]
            dr.eval(o, d, w, index, last, medium, behind)

    def _child(
        self, it: Interaction, s: mi.UInt32, R: mi.Float, T: mi.Float, rng: np.random.Generator, n: int, active: mi.Bool
    ) -> tuple[mi.Bool, mi.Bool, mi.Float]:
        """
        Return masks of the n rays that go on transmitted and reflected, and the fraction of its weight that each keeps.

        `R` and `T` are the specular fractions at their hits of the surfaces `s`, without scattered light. If both
        events are allowed, one is drawn in proportion to them and keeps the flux of both.
        """
        opaque = (it.word & OPAQUE) != 0
        mirror = ((it.word & MIRROR) != 0) | dr.gather(mi.Bool, self.mirrors, s, active)
        total, by_mirror, other, onwards = (mi.Bool(letter in self.allowed) for letter in "IMRT")
        back = dr.select(it.tir, total, dr.select(mirror, by_mirror, other))
        through = onwards & ~opaque & ~it.tir
        if "R" in self.allowed and "T" in self.allowed:
            reflects = upload(mi.Float, rng.random(n)) * (R + T) < R
            factor = dr.select(back, R, 0) + dr.select(through, T, 0)
            return through & ~(back & reflects), back & (reflects | ~through), factor
        through &= ~mirror
        return through, back, dr.select(through, T, R)

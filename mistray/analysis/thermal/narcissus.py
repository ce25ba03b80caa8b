"""Which surfaces show a cold detector its own image: one reflection on the way there and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.analysis.estimate import Estimate
from mistray.kernel.interaction import counts_as_reflection, interact
from mistray.kernel.next_hit import next_hit
from mistray.kernel.scatter_tables import ScatterTables
from mistray.kernel.scattering import Scattering
from mistray.sampling.design_path import find_design_path
from mistray.sampling.detector_start import DetectorStart
from mistray.settings import BATCHES, Settings
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.optics import OPAQUE
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surfaces import SurfaceTable

TOTAL = "(total reflection)"
FAINTEST = 1e-9  # weight below which a ray ends


@dataclass(frozen=True)
class Return:
    """
    Light of the detector that comes back to it by one reflection.

    Attributes
    ----------
    surface, part : str
        Where it is reflected; `TOTAL` stands for total reflection and mirrors alone.
    emission : Estimate
        n² times the share of Lambertian rays from the detector that it absorbs after this reflection alone; light that
        is transmitted everywhere else, and reflected by mirrors and in total reflection.
    nitd_K : Estimate
        Its part of the narcissus-induced temperature difference.
    """

    surface: str
    part: str
    emission: Estimate
    nitd_K: Estimate


def returns(
    scene: mi.Scene, detector: str, wavelength_um: float, rays: int, seed: int, settings: Settings
) -> dict[str, Estimate]:
    """
    Emission of the detector in its own view, by the one surface that reflects.

    Parameters
    ----------
    scene : mi.Scene
    detector : str
    wavelength_um : float
    rays, seed : int
        Of the start rays.
    settings : Settings
        `max_events` is used.

    Returns
    -------
    dict
        Surface id or `TOTAL` → emission, as in `Return`; only what sends light back.
    """
    table = SurfaceTable(scene, 1e3 * wavelength_um, detector)
    path = find_design_path(table, scene)
    light = path.steps[-1].before if path is not None else np.array([0.0, 0.0, 1.0])
    lanes = max(2 * BATCHES, rays // BATCHES * BATCHES)
    sums = dr.zeros(mi.Float64, (table.count + 1) * BATCHES)
    _follow(table, light, lanes, seed, settings.max_events, sums)
    by_batch = np.array(sums).reshape(table.count + 1, BATCHES) / (lanes / BATCHES)
    names = [*table.ids, TOTAL]
    return {
        names[j]: Estimate(float(row.mean()), float(row.std(ddof=1) / np.sqrt(BATCHES)))
        for j, row in enumerate(by_batch)
        if row.any()
    }


def _follow(table: SurfaceTable, light: np.ndarray, lanes: int, seed: int, max_events: int, sums: mi.Float64) -> None:
    """
    Add what the detector absorbs to sums by (reflecting surface, batch), row `table.count` for no reflection.

    A ray that has not been reflected has two children at each surface, one that has been only the transmitted one.
    """
    intersector = Intersector(table)
    scattering = Scattering(ScatterTables(table, {}, backward=True))
    has_stock = table.stock_scene is not None
    start = DetectorStart(table, light, None, False).pass_rays(seed, lanes, 1.0)
    full = dr.zeros(mi.Float, lanes)
    o, d, w, batch, last = start.o, start.d, start.w + full, start.batch, start.left
    by = dr.full(mi.UInt32, NO_SURFACE, lanes)  # surface of the reflection
    medium = dr.zeros(mi.UInt32, lanes) + (start.medium if start.medium is not None else 0)
    behind = start.normal if has_stock else None
    for _ in range(max_events):
        t, s, normal = next_hit(table, intersector, o, d, last, mi.Bool(True), normal=behind)
        hit = s != NO_SURFACE
        if table.optics.absorbs:
            w *= dr.exp(-dr.gather(mi.Float, table.optics.extinction, medium, hit) * dr.select(hit, t, 0))
        it = interact(table, dr.fma(t, d, o), d, s, normal if has_stock else None, None, hit)
        R, T = it.R, it.T
        loss = 1 - R - T
        if scattering.any:
            given = scattering.give(s, it, hit)
            R, T, loss = R * given.reflection.kept, T * given.transmission.kept, given.absorbed
        hit &= (medium == 0) | (it.medium_in == 0) | (it.medium_in == medium)
        row = dr.minimum(by, table.count)
        absorbed = mi.Float64(dr.maximum(w * loss, 0))
        dr.scatter_reduce(dr.ReduceOp.Add, sums, absorbed, row * BATCHES + batch, hit & (s == table.detector))
        free = ~counts_as_reflection(it)  # mirrors and total reflection
        through = hit & ~free & ((it.word & OPAQUE) == 0) & (w * T > FAINTEST)
        back = hit & (free | (by == NO_SURFACE)) & (w * R > FAINTEST)
        inside = dr.select(it.medium_in == 0, medium, it.medium_in)
        dr.eval(it.p, it.transmitted, it.reflected, it.medium_out, it.tir, R, T, s, w, by, batch, inside, normal, sums)
        lanes_of = [chosen for chosen in map(dr.compress, (through, back)) if dr.width(chosen)]
        if not lanes_of:
            return
        lane = dr.concat(lanes_of)
        first = dr.arange(mi.UInt32, dr.width(lane)) < dr.count(through)[0]

        def child(transmitted: Any, reflected: Any, lane: mi.UInt32 = lane, first: mi.Bool = first) -> Any:
            return dr.select(first, *(dr.gather(type(v), v, lane) for v in (transmitted, reflected)))

        o, last, batch = (dr.gather(type(v), v, lane) for v in (it.p, s, batch))
        d, medium = child(it.transmitted, it.reflected), child(it.medium_out, inside)
        w, by = child(w * T, w * R), child(by, dr.select(free, by, s))
        behind = dr.gather(mi.Vector3f, normal, lane) if has_stock else None
        dr.eval(o, d, w, by, medium, batch, last)


def mean_returns(runs: Sequence[dict[str, Estimate]], weights: np.ndarray) -> dict[str, Estimate]:
    """Sum over the wavelengths of weight times emission, by surface."""
    names = dict.fromkeys(name for run in runs for name in run)
    zero = Estimate(0.0, 0.0)
    return {
        name: Estimate(
            float(sum(w * run.get(name, zero).value for w, run in zip(weights, runs, strict=True))),
            float(np.hypot.reduce([w * run.get(name, zero).se for w, run in zip(weights, runs, strict=True)])),
        )
        for name in names
    }

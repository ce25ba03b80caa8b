"""Narcissus: light that a cold detector receives from itself by one reflection, surface by surface."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.estimate import UNKNOWN, Estimate
from mistray.events import REFLECTED, TOTAL, TRANSMITTED, event_of
from mistray.kernel.interaction import counts_as_reflection, interact
from mistray.kernel.kernel_scene import next_hit
from mistray.kernel.scatter_tables import ScatterTables
from mistray.kernel.scattering import Scattering
from mistray.recorders.design_sequences import DesignKeys
from mistray.recorders.path_key import FIRST_KEY, extend_key
from mistray.recorders.start_rays import StartRays
from mistray.sampling.design.search import design_sequences, traced_tables
from mistray.sampling.design.sequences import has_optics
from mistray.sampling.design_path import find_design_path
from mistray.sampling.detector_start import DetectorStart
from mistray.sampling.outer_medium import closed_media, outer_medium
from mistray.settings import BATCHES, Settings
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.optics import OPAQUE
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import download
from mistray.toolkit.rows import column, derived

ALONE = "(total reflection)"
ZONES = 5  # of the detector by the distance from its middle, with equal areas
FAINTEST = 1e-9  # weight below which a ray ends


@dataclass(frozen=True)
class NarcissusReturn:
    """
    Light from the detector that one surface reflects back to it, with its narcissus temperature difference, K.

    The difference is positive where the detector sees something cold. `emission` is dimensionless. `by_zone_K` is
    `with_shield_K` of each zone of the detector, from the middle to the edge, see `ThermalReport.zones_mm`.
    """

    surface: str = column(
        f'Surface that reflects; "{ALONE}" stands for total reflection and mirrors alone',
        head="the detector sees itself by",
    )
    part: str = column("Part that the surface belongs to")
    emission: Estimate = column(
        "n² times the share of Lambertian rays from the detector that it absorbs after this reflection alone. Else the "
        "light is transmitted, and reflected by mirrors and in total reflection",
        head="emission [n²]",
    )
    nitd_K: Estimate = column("Its part of the narcissus-induced temperature difference, K", head="NITD [K]")
    with_shield_K: Estimate = column(
        "Part of all that is colder than the housing and seen by this reflection, such as a cold shield, K",
        UNKNOWN,
        head="with the shield [K]",
    )
    by_zone_K: tuple[Estimate, ...] = ()

    @derived.column("Difference over the field: middle zone less outermost, K", head="middle - edge [K]")
    def over_field_K(self) -> Estimate:
        """Difference of `with_shield_K` between middle and outermost zone, K, seen in the image; NaN without zones."""
        if not self.by_zone_K:
            return UNKNOWN
        middle, edge = self.by_zone_K[0], self.by_zone_K[-1]
        return Estimate(middle.value - edge.value, math.hypot(middle.se, edge.se))


@dataclass(frozen=True)
class ZoneReturn:
    """Narcissus-induced temperature difference, K, that one surface causes in one ring-shaped zone of the detector."""

    surface: str = column("Surface that reflects")
    low_mm: float = column("Distance from the middle of the detector at which the zone begins, mm")
    high_mm: float = column("Distance at which it ends, mm")
    nitd_K: Estimate = column("Temperature difference by all that is cold, K", head="NITD [K]")


@dataclass(frozen=True)
class Returned:
    """
    Light that returns to the detector by one reflection at one wavelength.

    Attributes
    ----------
    emission : dict of str to Estimate
        Surface id or `ALONE` → emission, as in `NarcissusReturn`; only surfaces that send light back.
    cold : dict of str to (ZONES, BATCHES) float64
        Surface id or `ALONE` → irradiance missing because it shows cold objects to the detector, W/mm², by zone and
        batch of rays.
    scene : (ZONES, BATCHES) float64
        Derivative of the irradiance of the imaged scene with respect to its temperature, W/(mm² K).
    zones_mm : (ZONES + 1,) float64
        Distances from the middle of the detector that bound the zones, mm.
    """

    emission: dict[str, Estimate]
    cold: dict[str, np.ndarray]
    scene: np.ndarray
    zones_mm: np.ndarray


def returns(
    scene: mi.Scene,
    detector: str,
    wavelength_um: float,
    rays: int,
    seed: int,
    settings: Settings,
    missing: Mapping[str, float],
    per_kelvin: float,
) -> Returned:
    """
    Return the light that the detector receives from itself and cold objects by one reflection, zone by zone.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    detector : str
        Shape id of the detector.
    wavelength_um : float
        Wavelength, µm.
    rays, seed : int
        Number of start rays, of which whole batches are traced, and their seed.
    settings : Settings
        Settings of the trace; only `max_events` is used.
    missing : mapping of str to float
        Surface id → irradiance that the detector lacks because this surface is colder than the housing, W/mm², for an
        emission of 1; 0 for other surfaces.
    per_kelvin : float
        Derivative of the scene's irradiance with respect to its temperature, W/(mm² K), if all rays from the detector
        reach the scene.
    """
    (table,) = traced_tables(scene, [1e3 * wavelength_um], detector)
    path = find_design_path(table, scene)
    light = path.steps[-1].before if path is not None else np.array([0.0, 0.0, 1.0])
    lanes = max(2 * BATCHES, rays // BATCHES * BATCHES)
    start = DetectorStart(table, light, None, False).pass_rays(seed, lanes, 1.0)
    zone, edges = _zones(download(start.o))
    cell = zone * BATCHES + np.array(start.batch)
    design = design_sequences(scene, table)
    image = DesignKeys(design, table.detector) if has_optics(table) and design.lists.get(table.detector) else None
    closed = closed_media(table, outer_medium(table, scene))
    # Of the detector itself, of all that is cold, and in the last row of the scene
    sums = [dr.zeros(mi.Float64, rows * ZONES * BATCHES) for rows in (table.count + 1, table.count + 2)]
    weights = np.array([missing.get(name, 0.0) for name in table.ids])
    _follow(table, start, mi.UInt32(cell), settings.max_events, mi.Float64(weights), sums, image, closed)
    started = np.bincount(cell, minlength=ZONES * BATCHES).reshape(ZONES, BATCHES)
    own, cold = (np.array(one).reshape(-1, ZONES, BATCHES) for one in sums)
    by_batch = own.sum(axis=1) / (lanes / BATCHES)
    by_zone = cold / np.maximum(started, 1)
    names = [*table.ids, ALONE]
    emission = {
        names[j]: Estimate(float(row.mean()), float(row.std(ddof=1) / np.sqrt(BATCHES)))
        for j, row in enumerate(by_batch)
        if row.any()
    }
    returned = {names[j]: by_zone[j] for j in range(len(names)) if by_zone[j].any()}
    return Returned(emission, returned, per_kelvin * by_zone[-1], edges)


def _zones(o: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the zone index of each start point `o`, (n, 3), mm, and the zone borders, mm from the middle."""
    distance = np.linalg.norm(o - o.mean(axis=0), axis=1)
    edges = np.quantile(distance, np.linspace(0, 1, ZONES + 1))
    edges[0] = 0.0
    return np.clip(np.searchsorted(edges, distance, side="right") - 1, 0, ZONES - 1).astype(np.uint32), edges


def _follow(
    table: SurfaceTable,
    start: StartRays,
    cell: mi.UInt32,
    max_events: int,
    missing: mi.Float64,
    sums: list[mi.Float64],
    image: DesignKeys | None,
    closed: mi.Bool | None,
) -> None:
    """
    Add the light that the detector and cold surfaces absorb to sums by reflecting surface, zone and batch.

    Row `table.count` is for no reflection; there the second sums have the detector alone. Their last row is for light
    that leaves the scene by a design sequence, or, without any, without a reflection. A ray that has not been reflected
    may go on both ways at a surface; one that has been reflected is only transmitted. Mirrors and total reflection
    reflect every ray, and do not count.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    start : StartRays
        Rays that leave the detector.
    cell : mi.UInt32
        Zone times BATCHES plus batch, of each start ray.
    max_events : int
        Largest number of events of a ray.
    missing : mi.Float64
        Missing irradiance by surface, see `returns`.
    sums : list of two mi.Float64
        Sums for the detector itself and for all cold objects, updated in place.
    image : DesignKeys, optional
        Design sequences of the detector; None: it has none.
    closed : mi.Bool, optional
        Mask of the media in which no ray can leave the scene; None: there are none.
    """
    own, cold = sums
    width = ZONES * BATCHES
    intersector = Intersector(table)
    scattering = Scattering(ScatterTables(table, {}, backward=True))
    has_mitsuba_shapes = table.mitsuba_scene is not None
    lanes = dr.width(cell)
    full = dr.zeros(mi.Float, lanes)
    o, d, w, last = start.o, start.d, start.w + full, start.left
    by = dr.full(mi.UInt32, NO_SURFACE, lanes)  # surface of the reflection
    key = dr.full(mi.UInt64, FIRST_KEY, lanes)
    medium = dr.zeros(mi.UInt32, lanes) + (start.medium if start.medium is not None else 0)
    behind = start.normal if has_mitsuba_shapes else None
    for _ in range(max_events):
        t, s, normal = next_hit(table, intersector, o, d, last, mi.Bool(True), normal=behind)
        hit = s != NO_SURFACE
        if table.optics.absorbs:
            w *= dr.exp(-dr.gather(mi.Float, table.optics.extinction, medium, hit) * dr.select(hit, t, 0))
        it = interact(table, dr.fma(t, d, o), d, s, normal if has_mitsuba_shapes else None, None, hit)
        R, T = it.R, it.T
        loss = 1 - R - T
        if scattering.any:
            given = scattering.budget(s, it, hit)
            R, T, loss = R * given.reflection.kept, T * given.transmission.kept, given.absorbed
        hit &= (medium == 0) | (it.medium_in == 0) | (it.medium_in == medium)
        row = dr.minimum(by, table.count)
        absorbed = mi.Float64(dr.maximum(w * loss, 0))
        there = hit & (s == table.detector)
        dr.scatter_reduce(dr.ReduceOp.Add, own, absorbed, row * width + cell, there)
        # What is cold and seen without a reflection, as it should be, does not count
        lacking = absorbed * dr.gather(mi.Float64, missing, s, hit)
        dr.scatter_reduce(dr.ReduceOp.Add, cold, lacking, row * width + cell, hit & (there | (by != NO_SURFACE)))
        leaves = (s == NO_SURFACE) & (by == NO_SURFACE if image is None else image.hold(key, True))
        if closed is not None:
            leaves &= ~dr.gather(mi.Bool, closed, medium, leaves)
        dr.scatter_reduce(dr.ReduceOp.Add, cold, mi.Float64(w), (table.count + 1) * width + cell, leaves)
        free = ~counts_as_reflection(it)  # mirrors and total reflection
        through = hit & ~free & ((it.word & OPAQUE) == 0) & (w * T > FAINTEST)
        back = hit & (free | (by == NO_SURFACE)) & (w * R > FAINTEST)
        inside = dr.select(it.medium_in == 0, medium, it.medium_in)
        at_hit = it.p, it.transmitted, it.reflected, it.medium_out, it.tir
        dr.eval(*at_hit, R, T, s, w, by, key, cell, inside, normal, *sums)
        lanes_of = [chosen for chosen in map(dr.compress, (through, back)) if dr.width(chosen)]
        if not lanes_of:
            return
        lane = dr.concat(lanes_of)
        first = dr.arange(mi.UInt32, dr.width(lane)) < dr.count(through)[0]

        def child(transmitted: Any, reflected: Any, lane: mi.UInt32 = lane, first: mi.Bool = first) -> Any:
            return dr.select(first, *(dr.gather(type(v), v, lane) for v in (transmitted, reflected)))

        o, last, cell = (dr.gather(type(v), v, lane) for v in (it.p, s, cell))
        d, medium = child(it.transmitted, it.reflected), child(it.medium_out, inside)
        w, by = child(w * T, w * R), child(by, dr.select(free, by, s))
        bounced = dr.select(it.tir, mi.UInt32(TOTAL), REFLECTED)
        key = child(*(extend_key(key, event_of(s, what)) for what in (mi.UInt32(TRANSMITTED), bounced)))
        behind = dr.gather(mi.Vector3f, normal, lane) if has_mitsuba_shapes else None
        dr.eval(o, d, w, by, key, medium, cell, last)


def mean_returns(runs: Sequence[dict[str, Estimate]], weights: np.ndarray) -> dict[str, Estimate]:
    """Return emission by surface id, with its error: the sum over wavelengths, a run each, with `weights`, (runs,)."""
    names = dict.fromkeys(name for run in runs for name in run)
    zero = Estimate(0.0, 0.0)
    return {
        name: Estimate(
            float(sum(w * run.get(name, zero).value for w, run in zip(weights, runs, strict=True))),
            float(np.hypot.reduce([w * run.get(name, zero).se for w, run in zip(weights, runs, strict=True)])),
        )
        for name in names
    }

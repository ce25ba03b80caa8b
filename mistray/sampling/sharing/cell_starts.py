"""Forward start rays from all cells of directions, uniform or with the densities of a start map."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.start_rays import StartRays, generators
from mistray.sampling.sharing.cell_waves import CellWaves
from mistray.sampling.sharing.start_map import DeviceMap
from mistray.sampling.space_filling import curve_points
from mistray.settings import BATCHES
from mistray.surfaces.upload import upload


def cell_starts(
    waves: CellWaves, starts: DeviceMap | None, seed: tuple[int, ...], lanes: np.ndarray, weight: np.ndarray
) -> StartRays:
    """
    Return the forward start rays of a pass, cell by cell; the rays of each cell are stratified in each batch.

    Parameters
    ----------
    waves : CellWaves
    starts : DeviceMap or None
        Start map of all cells. None: rays start uniformly, and the random numbers of a cell do not depend on the rays
        of other cells.
    seed : tuple of int
    lanes : (c,) int
        Number of rays of each cell, multiples of `BATCHES`.
    weight : (c,) float64
        Throughput of a ray that starts at density 1, the mean.
    """
    # Cell of each ray, and its index there
    cell = upload(mi.UInt32, np.repeat(np.arange(len(lanes)), lanes))
    index = upload(mi.UInt32, np.arange(lanes.sum()) - np.repeat(np.cumsum(lanes) - lanes, lanes))
    strata = dr.gather(mi.UInt32, upload(mi.UInt32, lanes // BATCHES), cell)
    lane = dr.arange(mi.UInt32, int(lanes.sum()))
    stream = int(np.random.SeedSequence(seed).generate_state(1)[0])
    rng, _ = generators(stream, lane) if starts is not None else generators(stream, index, cell)
    # One stratum of 0 … 1 for each ray of a batch
    batch = index // strata
    within = mi.Float64(index - batch * strata) + mi.Float64(rng.next_float32())
    position = dr.minimum(within / mi.Float64(strata), 1 - 1e-12)
    if starts is not None:
        place, density = starts.sample(cell, position, rng)
    else:
        place = [*curve_points(position, 2, rng), rng.next_float32(), rng.next_float32()]
        density = dr.full(mi.Float, 1, dr.width(lane))
    o, d = waves.rays(cell, place)
    # A ray carries the inverse of the density with which it was drawn
    scale = dr.rcp(density)
    w = scale * dr.gather(mi.Float, upload(mi.Float, weight), cell)
    dr.eval(lane, batch, rng, o, d, w, cell, scale, place)
    return StartRays(lane, batch, rng, o, d, w, cell=cell, scale=scale, place=place)


def whole_batches(rays: np.ndarray) -> np.ndarray:
    """Return numbers of rays, rounded up to multiples of the number of batches."""
    return np.asarray(-(-np.asarray(rays, dtype=np.int64) // BATCHES) * BATCHES)

"""Rays that leave a detector and go backwards as the design sends them, in float64 on the host; they take no kernel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mistray.sampling.design.probes import MOST_STEPS
from mistray.surfaces.host_rays import first_hit, onward
from mistray.surfaces.surfaces import SurfaceTable


class BackwardStep(NamedTuple):
    """
    The way of some rays from one surface to the next.

    Attributes
    ----------
    ray : (n,) int
        Their numbers.
    left, met : (n,) int
        The surfaces; `met` is -1 where a ray leaves the scene.
    d : (n, 3) float64
        Directions on the way.
    p : (n, 3) float64
        Where they meet the next surface, mm.
    reflects, stops : (n,) bool
        What happens there; `stops` where a surface swallows the ray, and at the detector.
    """

    ray: np.ndarray
    left: np.ndarray
    met: np.ndarray
    d: np.ndarray
    p: np.ndarray
    reflects: np.ndarray
    stops: np.ndarray


def steps_back(table: SurfaceTable, o: np.ndarray, d: np.ndarray) -> Iterator[BackwardStep]:
    """
    Follow rays from the detector: reflected at mirrors, else transmitted, see `mistray.surfaces.host_rays.onward`.

    Parameters
    ----------
    table : SurfaceTable
    o, d : (n, 3) float64
        Where they start on the detector, mm, and their directions.
    """
    ray, last = np.arange(len(o)), np.full(len(o), table.detector)
    for _ in range(MOST_STEPS):
        if not len(ray):
            return
        met, p, normal = first_hit(table, o, d, last)
        after, reflects, stops = np.full_like(d, np.nan), np.zeros(len(ray), dtype=bool), np.zeros(len(ray), dtype=bool)
        inside = met >= 0
        after[inside], reflects[inside] = onward(table, met[inside], d[inside], normal[inside])
        stops[inside] = ~np.isfinite(after[inside]).all(axis=1) | (met[inside] == table.detector)
        yield BackwardStep(ray, last, met, d, p, reflects & ~stops, stops)
        going = inside & ~stops
        o, d, last, ray = p[going], after[going], met[going], ray[going]

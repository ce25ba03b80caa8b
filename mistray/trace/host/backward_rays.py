"""Rays from a detector backward along the design path, in float64 on the host, without a kernel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mistray.sampling.design.probes import MOST_STEPS
from mistray.surfaces.host_rays import first_hit, onward
from mistray.surfaces.surfaces import SurfaceTable


class BackwardStep(NamedTuple):
    """
    Ray segments from one surface to the next, followed backward from a detector.

    Attributes
    ----------
    ray : (n,) int
        Indices of the rays.
    left, met : (n,) int
        Indices of the surfaces that the rays leave and meet; `met` is -1 if a ray leaves the scene.
    d : (n, 3) float64
        Unit directions of the segments.
    p : (n, 3) float64
        Points at which the rays meet the next surface, mm; of no use for rays that leave the scene.
    reflects, stops : (n,) bool
        Whether the rays are reflected there, and whether they end, at an absorbing surface or the detector.
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
    Yield the segments of rays followed backward from a detector: reflected at mirrors, else transmitted, see `onward`.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    o, d : (n, 3) float64
        Start points on the detector, mm, and unit directions.
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

"""Float64 rays along the design path: points, directions, optical path lengths and throughput."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.sampling.design_path import DesignPath
from mistray.surfaces.host_rays import indices_along
from mistray.surfaces.optics import OPAQUE, absorption_per_mm

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class DesignLight:
    """
    Rays at the end of a design path; NaN for rays that fail. Clear apertures of surfaces are ignored.

    Attributes
    ----------
    last, hit : (n, 3) float64
        Points on the last surface before the detector (or at the start) and on the detector, mm.
    direction : (n, 3) float64
        Unit direction from the former to the latter.
    normal : (n, 3) float64
        Unit normal of the detector, from its front to its back, whichever side the light comes from.
    opl_mm : (n,) float64
        Optical path length from the origins to `last`, mm.
    index : float
        Refractive index before the detector.
    throughput : (n,) float64
        Share of the flux at the first surface that reaches the detector, without losses by scatter: the product of R or
        T of the surfaces, each in unpolarised light, and of what media between them pass; 1 if it was not requested.
    """

    last: Array
    hit: Array
    direction: Array
    normal: Array
    opl_mm: Array
    index: float
    throughput: Array


def check_sheets(path: DesignPath) -> None:
    """Raise `MistrayError` if a surface of the path is a mesh, whose facets give no smooth wavefront."""
    for step in path.steps[:-1]:
        if step.surface >= len(path.table.pieces):
            raise MistrayError(
                f"surface '{path.table.ids[step.surface]}' is a mesh: its facets give no wavefront; describe it as "
                "'asphere' or 'freeform'"
            )


def media(path: DesignPath) -> list[complex]:
    """
    Return the complex index n + ik of the medium before each step of a design path.

    Opaque surfaces, such as mirrors, take it from their neighbours; it is 1 if all are opaque.
    """
    optics = path.table.optics
    before, behind = (np.full(len(path.steps), np.nan, dtype=complex) for _ in range(2))
    for k, step in enumerate(path.steps):
        if optics.host_words[step.surface] & OPAQUE:
            continue
        front, back = optics.complex_indices[step.surface]
        before[k], after = (front, back) if step.from_front else (back, front)
        behind[k] = before[k] if step.reflects else after
    return [complex(index) for index in np.nan_to_num(indices_along(before, behind), nan=1.0)]


def design_light(path: DesignPath, o: Array, d: Array, throughput: bool = False) -> DesignLight:
    """
    Return the light at the end of a design path: points, directions, optical path lengths, throughput.

    Parameters
    ----------
    path : DesignPath
        Design path to follow.
    o, d : (n, 3) float64
        Origins (mm) and unit directions before the first step.
    throughput : bool
        Whether to compute the throughput as well; else it is 1.
    """
    optics, wavelength = path.table.optics, path.table.wavelength_nm
    opl, left = np.zeros(len(o)), np.ones(len(o))
    for number, (step, medium) in enumerate(zip(path.steps, media(path), strict=True)):
        p, normal = path.meet(step, o, d)
        length = np.einsum("ij,ij->i", p - o, d)
        if throughput and number:
            left = left * np.exp(-absorption_per_mm(medium, wavelength) * length)
        if step is path.steps[-1]:
            return DesignLight(o, p, d, normal, opl, float(medium.real), left)
        opl = opl + medium.real * length
        if throughput:
            with np.errstate(invalid="ignore"):
                cosines = np.abs(np.einsum("ij,ij->i", d, normal))
            good = np.isfinite(cosines)
            share = np.full(len(o), np.nan)
            share[good] = optics.shares(step.surface, step.from_front, cosines[good])[0 if step.reflects else 1]
            left = left * share
        d, o = path.leave(step, d, normal), p
    raise AssertionError("a design path ends at the detector")


def stop_crossing(path: DesignPath, o: Array, d: Array, place: int, at_surface: bool, centre: Array,
                  normal: Array) -> Array:  # fmt: skip
    """
    Return the points, (n, 3), mm, where rays cross the stop's plane before the step of index `place` of the path.

    Origins `o`, mm, and unit directions `d`, (n, 3), are before the first step. The plane goes through `centre`, mm,
    across the unit vector `normal`. With `at_surface` the points are those on the surface of that step instead.
    """
    for step in path.steps[:place]:
        p, along = path.meet(step, o, d)
        o, d = p, path.leave(step, d, along)
    if at_surface:
        return path.meet(path.steps[place], o, d)[0]
    with np.errstate(all="ignore"):
        t = ((centre - o) @ normal) / (d @ normal)
    return np.asarray(o + t[:, None] * d)

"""Ghosts of batoid's example telescopes, from mistray and from batoid's split trace of the same start rays.

Each refracting face and the detector reflect 2 % of the light. batoid passes light to neighbours in its list only. Its
paths with two reflections are compared, each with the same surfaces in the same order.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mistray.analyses.validate.declared import DeclaredRow, ReferenceFile
from mistray.analyses.validate.pack import Finder
from mistray.estimate import Estimate
from mistray.prescription import from_batoid
from mistray.trace import trace

REFLECTANCE = 0.02
FAINTEST = 1e-6  # of the star: fainter ghosts are not counted
Names = tuple[str, ...]


@dataclass(frozen=True)
class Bundle:
    """Light that reaches the detector by one path: flux in start rays, RMS radius in mm, and ghost reflections."""

    flux: float
    rms_mm: float
    order: int


@dataclass(frozen=True)
class BothPrograms:
    """Light on the detector by path, from mistray and from batoid; a path is the surfaces that it meets."""

    ours: Mapping[Names, Bundle]
    theirs: Mapping[Names, Bundle]

    @functools.cached_property
    def shared(self) -> list[Names]:
        """Paths with two reflections that batoid finds stronger than `FAINTEST`, the strongest first."""
        star = next((one.flux for one in self.theirs.values() if one.order == 0), 0.0)
        found = [names for names, one in self.theirs.items() if one.order == 2 and one.flux > FAINTEST * star]
        return sorted(found, key=lambda names: -self.theirs[names].flux)

    def number(self, quantity: str, bundles: Mapping[Names, Bundle]) -> float:
        """Return a quantity of a path from one program; NaN if that program has no light there."""
        ghosts = {names: bundles[names] for names in self.shared if names in bundles}
        image = next((one for one in bundles.values() if one.order == 0), None)
        if image is None or not ghosts:
            return math.nan
        if quantity == "ghosts":
            return len(ghosts)
        if quantity == "spot_um":
            return 1e3 * image.rms_mm
        if quantity == "ghost_permille":
            return 1e3 * sum(one.flux for one in ghosts.values()) / image.flux
        return ghosts[min(ghosts, key=lambda names: self.theirs[names].rms_mm)].rms_mm


@functools.cache
def _compared(file: str, wavelength_nm: float, field_deg: float, rays: int, seed: int) -> BothPrograms:
    """Trace a telescope with mistray and with batoid from the same start rays."""
    import batoid

    optic = batoid.Optic.fromYaml(file)
    read = from_batoid(optic, wavelength_nm=wavelength_nm, reflectance=REFLECTANCE, beam="exact")
    mirrors = {surface.name for surface in read.surfaces if surface.mirror}
    assert read.detector is not None
    sequence = [*(surface.name for surface in read.surfaces), read.detector.name]
    coating = batoid.SimpleCoating(REFLECTANCE, 1 - REFLECTANCE)
    for name in set(sequence) - mirrors:
        optic[name].forwardCoating = optic[name].reverseCoating = coating
    scene = read.to_scene()
    t = trace(scene, rays=rays, seed=seed, field_deg=field_deg, max_reflections=2, flux_threshold=1e-6)
    (run,) = t.runs
    origin, direction = run.start_rays(np.arange(run.rays))
    columns = [np.ascontiguousarray(column) for column in (*(1e-3 * origin).T, *direction.T)]
    start = batoid.RayVector(*columns, t=0.0, wavelength=1e-9 * wavelength_nm, flux=1.0)
    forward, _ = optic.traceSplit(start, minFlux=1e-4)
    unit = t.energy.launched_W / run.rays
    ours = {
        tuple(name for name, _ in row.event_list): Bundle(row.power_W / unit, row.rms_radius_mm, row.order)
        for row in t.paths
    }
    theirs = {}
    for bundle in forward:
        names = tuple(name for name in bundle.path if name in sequence)  # without baffles
        steps = np.diff([sequence.index(name) for name in names])
        theirs[names] = _bundle(bundle, int(np.count_nonzero(np.diff(steps))))
    return BothPrograms(ours, theirs)


def _bundle(rays: Any, order: int) -> Bundle:
    good = ~(rays.vignetted | rays.failed)
    flux = rays.flux[good]
    share = flux / flux.sum() if len(flux) else flux
    x, y = share @ rays.x[good], share @ rays.y[good]
    rms = np.sqrt(share @ ((rays.x[good] - x) ** 2 + (rays.y[good] - y) ** 2))
    return Bundle(float(flux.sum()), 1e3 * float(rms), order)


def _of(file: ReferenceFile, rays: int | None, seed: int, row: DeclaredRow) -> BothPrograms:
    assert row.field_deg is not None
    assert row.wavelength_nm is not None
    return _compared(row.argument("file"), row.wavelength_nm, row.field_deg, rays or file.rays, seed)


def ours(file: ReferenceFile, rays: int | None, seed: int) -> Finder:
    """Return the function that gives mistray's number for a row; it has no error, as both trace the same rays."""

    def number(row: DeclaredRow) -> Estimate:
        both = _of(file, rays, seed, row)
        return Estimate(both.number(row.argument("quantity"), both.ours), 0.0)

    return number


def asked(file: ReferenceFile, rays: int | None, seed: int) -> Finder:
    """Return the function that gives batoid's number for a row."""

    def number(row: DeclaredRow) -> Estimate:
        both = _of(file, rays, seed, row)
        return Estimate(both.number(row.argument("quantity"), both.theirs), 0.0)

    return number

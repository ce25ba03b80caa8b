"""Ghosts of batoid's example telescopes, from mistray and from batoid's split trace of the same start rays.

Each refracting face and the detector reflect 2 % of the light. batoid passes light to neighbours in its list only. Its
paths with two reflections are compared, each with the same surfaces in the same order.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mistray.analyses.validate.declared import DeclaredRow, ReferenceFile
from mistray.analyses.validate.pack import Finder, others
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
        """Paths with two reflections in which batoid finds more than `FAINTEST` of the star, the strongest first."""
        star = next((one.flux for one in self.theirs.values() if one.order == 0), 0.0)
        found = [names for names, one in self.theirs.items() if one.order == 2 and one.flux > FAINTEST * star]
        return sorted(found, key=lambda names: -self.theirs[names].flux)

    def number(self, quantity: str, bundles: Mapping[Names, Bundle]) -> Estimate | None:
        """
        Return a quantity of one program, without error, as both trace the same rays; None if it has no such light.

        Quantities are "spot_um", the RMS radius of the image, µm; "ghosts", the number of shared ghosts;
        "ghost_permille", their flux, ‰ of the image; any other: the RMS radius of batoid's sharpest ghost, mm.
        """
        ghosts = {names: bundles[names] for names in self.shared if names in bundles}
        image = next((one for one in bundles.values() if one.order == 0), None)
        if image is None or (not ghosts and quantity != "spot_um"):
            return None
        if quantity == "spot_um":
            value = 1e3 * image.rms_mm
        elif quantity == "ghosts":
            value = float(len(ghosts))
        elif quantity == "ghost_permille":
            value = 1e3 * sum(one.flux for one in ghosts.values()) / image.flux
        else:
            value = ghosts[min(ghosts, key=lambda names: self.theirs[names].rms_mm)].rms_mm
        return Estimate(value, 0.0)


class TelescopeNumbers:
    """
    Numbers of the rows of one file; rows with the same light share one trace in mistray and in batoid.

    Parameters are those of `SceneNumbers`.
    """

    def __init__(self, file: ReferenceFile, rays: int | None, seed: int) -> None:
        self._rays = rays or file.rays
        self._seed = seed
        self._traced: dict[tuple[str, float, float], BothPrograms] = {}

    def __call__(self, row: DeclaredRow) -> Estimate | None:
        """Return mistray's number for a row; None if it finds no such light."""
        both = self._both(row)
        return both.number(row.argument("quantity"), both.ours)

    def theirs(self, row: DeclaredRow) -> Estimate | None:
        """Return batoid's number for a row; None if it finds no such light."""
        both = self._both(row)
        return both.number(row.argument("quantity"), both.theirs)

    def _both(self, row: DeclaredRow) -> BothPrograms:
        assert row.field_deg is not None
        assert row.wavelength_nm is not None
        light = (row.argument("file"), row.wavelength_nm, row.field_deg)
        if light not in self._traced:
            self._traced[light] = _traced(*light, self._rays, self._seed)
        return self._traced[light]


def asked(row: DeclaredRow, ours: Finder) -> Estimate | None:
    """Return batoid's number for a row, from the same start rays as mistray's."""
    assert isinstance(ours, TelescopeNumbers)
    return ours.theirs(row)


def _traced(file: str, wavelength_nm: float, field_deg: float, rays: int, seed: int) -> BothPrograms:
    """
    Return the light on the detector by path, from mistray and from batoid, which trace the same start rays.

    `file` is a telescope file of batoid, `rays` the number of start rays, and `seed` that of their random numbers.
    """
    with others():
        import batoid

        optic = batoid.Optic.fromYaml(file)
    read = from_batoid(optic, wavelength_nm=wavelength_nm, reflectance=REFLECTANCE, beam="exact")
    mirrors = {surface.name for surface in read.surfaces if surface.mirror}
    assert read.detector is not None
    sequence = [*(surface.name for surface in read.surfaces), read.detector.name]
    scene = read.to_scene()
    t = trace(scene, rays=rays, seed=seed, field_deg=field_deg, max_reflections=2, flux_threshold=1e-6)
    (run,) = t.runs
    origin, direction = run.start_rays(np.arange(run.rays))
    columns = [np.ascontiguousarray(column) for column in (*(1e-3 * origin).T, *direction.T)]
    with others():
        coating = batoid.SimpleCoating(REFLECTANCE, 1 - REFLECTANCE)
        for name in set(sequence) - mirrors:
            optic[name].forwardCoating = optic[name].reverseCoating = coating
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
        found = _bundle(bundle, int(np.count_nonzero(np.diff(steps))))
        if found.flux > 0:  # not all of it vignetted
            theirs[names] = found
    return BothPrograms(ours, theirs)


def _bundle(rays: Any, order: int) -> Bundle:
    good = ~(rays.vignetted | rays.failed)
    flux = rays.flux[good]
    share = flux / flux.sum() if len(flux) else flux
    x, y = share @ rays.x[good], share @ rays.y[good]
    rms = np.sqrt(share @ ((rays.x[good] - x) ** 2 + (rays.y[good] - y) ** 2))
    return Bundle(float(flux.sum()), 1e3 * float(rms), order)

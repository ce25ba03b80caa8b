"""Telescopes that batoid ships, ray by ray beside its split trace, which lets light go to a neighbour only."""

import importlib
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import batoid
import numpy as np

import mistray
from mistray.prescription import Prescription, from_batoid

REFLECTANCE = 0.02
Names = tuple[str, ...]


@dataclass(frozen=True)
class Sums:
    """A path in one of the programs: rays, part of the launched flux, centroid and RMS radius in mm."""

    rays: int
    flux: float
    x_mm: float
    y_mm: float
    rms_mm: float


@dataclass(frozen=True)
class Comparison:
    """Both programs at one field, by the surfaces of a path; figures of mistray come first."""

    trace: mistray.Trace
    paths: dict[Names, tuple[Sums, Sums]]  # that both find
    more: dict[Names, tuple[Sums, Sums]]  # that only mistray finds, with batoid's figures from following the surfaces
    missing: dict[Names, Sums]  # that only batoid finds
    order: dict[Names, int]  # ghost reflections

    def ghosts(self) -> dict[Names, tuple[Sums, Sums]]:
        return {names: sums for names, sums in self.paths.items() if self.order[names] == 2}

    image = property(lambda self: next(pair for names, pair in self.paths.items() if self.order[names] == 0))


@dataclass(frozen=True)
class Telescope:
    """A telescope of batoid's with R = 2 % on every refracting surface and on the detector."""

    file: str
    wavelength_nm: float
    shipped: str = ""  # name of a scene that comes with mistray and stands for what is read from the file

    @cached_property
    def prescription(self) -> Prescription:
        if self.shipped:
            own = importlib.import_module(f"mistray.scenes.{self.shipped}.prescription").build()
            return replace(own, detector=replace(own.detector, name="Detector"))  # as batoid calls it
        optic = batoid.Optic.fromYaml(self.file)
        return from_batoid(optic, wavelength_nm=self.wavelength_nm, reflectance=REFLECTANCE, beam="exact")

    @cached_property
    def coated(self) -> batoid.Optic:
        optic = batoid.Optic.fromYaml(self.file)
        for name in [name for name in self.sequence if name not in self.mirrors]:
            for side in ("forwardCoating", "reverseCoating"):
                setattr(optic[name], side, batoid.SimpleCoating(REFLECTANCE, 1 - REFLECTANCE))
        return optic

    scene = cached_property(lambda self: self.prescription.to_scene())

    @cached_property
    def sequence(self) -> list[str]:
        return [*(surface.name for surface in self.prescription.surfaces), self.prescription.detector.name]

    @cached_property
    def mirrors(self) -> set[str]:
        return {surface.name for surface in self.prescription.surfaces if surface.mirror}

    def compare(self, field_deg: float, rays: int) -> Comparison:
        t = mistray.trace(self.scene, rays=rays, field_deg=field_deg, max_reflections=2, flux_threshold=1e-6)
        run = t.runs[0]
        origin, direction = run.start_rays(np.arange(run.rays))
        ours = {tuple(name for name, _ in row.event_list): row for row in t.paths}
        order = {names: row.order for names, row in ours.items()}
        forward, _ = self.coated.traceSplit(self._rays(origin, direction), minFlux=1e-4)
        theirs: dict[Names, Sums] = {}
        known = set(self.sequence)
        for bundle in forward:
            names = tuple(name for name in bundle.path if name in known)  # without baffles
            order.setdefault(names, len(self._turns(names)))
            if order[names] <= 2:
                theirs[names] = _sums(bundle, bundle.flux, run.rays)

        def sums(row: Any) -> Sums:
            return Sums(row.rays, row.power_W / t.energy.launched_W, row.x_mm, row.y_mm, row.rms_radius_mm)

        both = {names: (sums(row), theirs[names]) for names, row in ours.items() if names in theirs}
        alone = {names: row for names, row in ours.items() if names not in theirs}
        more = {names: (sums(row), self._follow(names, row, origin, direction)) for names, row in alone.items()}
        missing = {names: value for names, value in theirs.items() if names not in ours}
        return Comparison(t, both, more, missing, order)

    def unconverged(self, names: Names, comparison: Comparison) -> int:
        """Rays of a path that batoid gives up although the point of mistray lies on the surface, in its aperture."""
        t = comparison.trace
        row = next(row for row in t.paths if tuple(name for name, _ in row.event_list) == names)
        rays = t.history(row.path_id, n=row.rays)._rays
        start = [np.array([getattr(ray, what)[0] for ray in rays]) for what in ("points", "directions")]
        found = 0
        for k in np.flatnonzero(self.coated.trace(self._rays(*start), path=list(names)).failed):
            steps = self.coated.traceFull(self._rays(*(v[[k]] for v in start)), path=list(names))
            step = next(i for i, one in enumerate(steps.values()) if one["out"].failed[0])
            element = self.coated[names[step]]
            x, y, z = rays[k].points[step + 1] / 1e3 - element.coordSys.origin
            off = abs(z - element.surface.sag(x, y))
            found += bool(off < 1e-9 and not element.obscuration.contains(x, y))
        return found

    def label(self, names: Names) -> str:
        return " → ".join(self._turns(names)) or "image"

    def _turns(self, names: Names) -> list[str]:
        steps = np.diff([self.sequence.index(name) for name in names])
        return [names[i + 1] for i in np.flatnonzero(np.diff(steps))]

    def _rays(self, origin: np.ndarray, direction: np.ndarray) -> batoid.RayVector:
        n = len(origin)
        columns = [np.ascontiguousarray(column) for column in (*(origin.T / 1e3), *direction.T)]
        return batoid.RayVector(*columns, np.zeros(n), np.full(n, self.wavelength_nm * 1e-9), np.ones(n))

    def _follow(self, names: Names, row: Any, origin: np.ndarray, direction: np.ndarray) -> Sums:
        """batoid's sequential trace along a path that its split trace does not try; the flux by counting events."""
        rays = self.coated.trace(self._rays(origin, direction), path=list(names))
        good = ~(rays.vignetted | rays.failed)
        split = [kind for name, kind in row.event_list if name not in self.mirrors]
        reflected = sum(kind == "SpecRefl" for kind in split)
        flux = REFLECTANCE**reflected * (1 - REFLECTANCE) ** (len(split) - reflected)
        return _sums(rays[good], np.full(int(good.sum()), flux), len(rays))


def _sums(rays: batoid.RayVector, flux: np.ndarray, launched: int) -> Sums:
    share = flux / flux.sum()
    x, y = share @ rays.x, share @ rays.y
    rms = np.sqrt(share @ ((rays.x - x) ** 2 + (rays.y - y) ** 2))
    return Sums(len(rays), float(flux.sum()) / launched, 1e3 * float(x), 1e3 * float(y), 1e3 * float(rms))


LSST = Telescope("LSST_r.yaml", 620.0)

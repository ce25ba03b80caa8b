"""Rubin/LSST in the r band, ray by ray beside batoid's split trace.

Both programs get the same start rays, so that nothing differs by chance. batoid knows the order of the elements and
lets light go to a neighbour only, so that none comes back to the camera from M3 a second time; `Comparison.more` holds
such paths.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import batoid
import numpy as np

import mistray
from mistray.prescription import Prescription, from_batoid

FILE = "LSST_r.yaml"
WAVELENGTH_NM = 620.0
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
    """
    Both programs at one field.

    Attributes
    ----------
    trace : mistray.Trace
    paths : dict
        Surfaces of a path → (mistray, batoid), for the paths that both find.
    more, missing : dict
        Those that only mistray finds, with batoid's figures from following the named surfaces, and those that only
        batoid finds.
    order : dict
        Ghost reflections of every path.
    """

    trace: mistray.Trace
    paths: dict[Names, tuple[Sums, Sums]]
    more: dict[Names, tuple[Sums, Sums]]
    missing: dict[Names, Sums]
    order: dict[Names, int]

    def ghosts(self) -> dict[Names, tuple[Sums, Sums]]:
        """The two-reflection paths that both find."""
        return {names: sums for names, sums in self.paths.items() if self.order[names] == 2}


@cache
def prescription() -> Prescription:
    """The telescope with R = 2 % on every refracting surface and on the detector."""
    return from_batoid(batoid.Optic.fromYaml(FILE), wavelength_nm=WAVELENGTH_NM, reflectance=REFLECTANCE)


@cache
def coated() -> batoid.Optic:
    """The same for batoid."""
    optic = batoid.Optic.fromYaml(FILE)
    for name in [surface.name for surface in prescription().surfaces if not surface.mirror] + ["Detector"]:
        for side in ("forwardCoating", "reverseCoating"):
            setattr(optic[name], side, batoid.SimpleCoating(REFLECTANCE, 1 - REFLECTANCE))
    return optic


@cache
def _scene() -> Any:
    return prescription().to_scene()


def compare(field_deg: float, rays: int) -> Comparison:
    """Trace the field with both programs, up to two ghost reflections."""
    t = mistray.trace(_scene(), rays=rays, field_deg=field_deg, max_reflections=2, flux_threshold=1e-6)
    run = t._runs[0]
    origin, direction = run.start_rays(np.arange(run.rays))
    ours = {tuple(name for name, _ in row.event_list): row for row in t.paths}
    order = {names: row.order for names, row in ours.items()}
    forward, _ = coated().traceSplit(_rays(origin, direction), minFlux=1e-4)
    theirs: dict[Names, Sums] = {}
    for bundle in forward:
        names = tuple(bundle.path)
        order.setdefault(names, _order(names))
        if order[names] <= 2:
            theirs[names] = _sums(bundle, bundle.flux, run.rays)

    def sums(row: Any) -> Sums:
        return Sums(row.rays, row.power_W / t.energy.launched_W, row.x_mm, row.y_mm, row.rms_radius_mm)

    return Comparison(
        t,
        {names: (sums(row), theirs[names]) for names, row in ours.items() if names in theirs},
        {
            names: (sums(row), _follow(names, row, origin, direction))
            for names, row in ours.items()
            if names not in theirs
        },
        {names: value for names, value in theirs.items() if names not in ours},
        order,
    )


def _rays(origin: np.ndarray, direction: np.ndarray) -> batoid.RayVector:
    """Start rays in mm as batoid's, of unit flux."""
    n = len(origin)
    columns = [np.ascontiguousarray(column) for column in (*(origin.T / 1e3), *direction.T)]
    return batoid.RayVector(*columns, np.zeros(n), np.full(n, WAVELENGTH_NM * 1e-9), np.ones(n))


def _follow(names: Names, row: Any, origin: np.ndarray, direction: np.ndarray) -> Sums:
    """batoid's sequential trace along a path that its split trace does not try; the flux by counting events."""
    rays = coated().trace(_rays(origin, direction), path=list(names))
    good = ~(rays.vignetted | rays.failed)
    split = [name for name, _ in row.event_list if name not in ("M1", "M2", "M3")]
    reflected = sum(kind == "SpecRefl" for name, kind in row.event_list if name not in ("M1", "M2", "M3"))
    flux = REFLECTANCE**reflected * (1 - REFLECTANCE) ** (len(split) - reflected)
    return _sums(rays[good], np.full(int(good.sum()), flux), len(rays))


def _sums(rays: batoid.RayVector, flux: np.ndarray, launched: int) -> Sums:
    share = flux / flux.sum()
    x, y = share @ rays.x, share @ rays.y
    rms = np.sqrt(share @ ((rays.x - x) ** 2 + (rays.y - y) ** 2))
    return Sums(len(rays), float(flux.sum()) / launched, 1e3 * float(x), 1e3 * float(y), 1e3 * float(rms))


def _order(names: Names) -> int:
    """Ghost reflections of a path of neighbours: how often it turns."""
    sequence = [*(surface.name for surface in prescription().surfaces), "Detector"]
    steps = np.diff([sequence.index(name) for name in names])
    return int(np.count_nonzero(np.diff(steps)))


def label(names: Names) -> str:
    """The surfaces at which a path of neighbours turns."""
    sequence = [*(surface.name for surface in prescription().surfaces), "Detector"]
    steps = np.diff([sequence.index(name) for name in names])
    return " → ".join(names[i + 1] for i in np.flatnonzero(np.diff(steps))) or "image"


def differences(pairs: dict[Names, tuple[Sums, Sums]]) -> dict[str, float]:
    """Largest differences between the programs: rays, flux (relative), centroid in mm, RMS radius (relative)."""
    both = list(pairs.values())
    return {
        "rays": max(abs(a.rays - b.rays) for a, b in both),
        "flux": max(abs(a.flux / b.flux - 1) for a, b in both),
        "centroid_mm": max(float(np.hypot(a.x_mm - b.x_mm, a.y_mm - b.y_mm)) for a, b in both),
        "rms": max(abs(a.rms_mm / b.rms_mm - 1) for a, b in both),
    }

"""All two-reflection ghosts of four telescopes: `mistray.trace` against batoid's `traceSplit`, from the same rays.

Both get the telescope as batoid ships it, without baffles: batoid meets them in the order of its list, so that a disc
that shades the beam ahead of the camera is no obstacle for the light in the camera, which it would be for rays that go
where they will. Every refracting surface and the detector reflect 2 % and transmit the rest, mirrors reflect all. The
threshold of batoid lies below the flux of the faintest two-reflection ghost and above every path of more reflections.

batoid computes in float64 and gives rays; here it is float32 with float64 sums, and every ray meets the walls between
the lenses too, finds its next surface by itself, and is booked: ghost table, irradiance of the detector, energy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np
from rows import Row, agree, alternate, duration, measured, missing

import mistray
from mistray.prescription import from_batoid

REFLECTANCE = 0.02
REPEATS = 3  # a turn takes up to 20 s
TOLERANCE = 5e-3  # of the ghost flux: walls between the lenses, which batoid has not, and rims in float32


@dataclass(frozen=True)
class Telescope:
    """A file of batoid, its wavelength and field, passages of glass of its longest ghost, and jobs: rays and bar."""

    key: str
    name: str
    file: str
    wavelength_nm: float
    field_deg: float
    passages: int
    jobs: tuple[tuple[int, float | None], ...] = ((50_000, None),)

    @property
    def threshold(self) -> float:
        """Flux of the faintest ghost of two reflections, less a tenth."""
        return 0.9 * REFLECTANCE**2 * (1 - REFLECTANCE) ** self.passages


TELESCOPES = (
    Telescope("lsst", "Rubin/LSST r band", "LSST_r.yaml", 620.0, 1.0, 26, ((50_000, 10.0), (200_000, 13.0))),
    Telescope("hsc", "Subaru HSC", "HSC.yaml", 750.0, 0.5, 56),
    Telescope("decam", "Blanco DECam", "DECam.yaml", 640.0, 0.8, 36),
    Telescope("rubin", "Rubin v3.14 with Zernike terms", "Rubin_v3.14_r.yaml", 620.0, 1.0, 26, ((50_000, 5.0),)),
)


def optic(telescope: Telescope) -> Any:
    """Batoid's telescope without baffles, coated."""
    import batoid

    found = batoid.Optic.fromYaml(telescope.file)
    for baffle in [item.name for item in found.items if isinstance(item, batoid.optic.Baffle)]:
        found = found.withRemovedOptic(baffle)
    coating = batoid.SimpleCoating(REFLECTANCE, 1 - REFLECTANCE)
    for surface in found.itemDict.values():
        if isinstance(surface, batoid.RefractiveInterface | batoid.Detector):
            surface.forwardCoating = surface.reverseCoating = coating
    return found


def scene_of(telescope: Telescope) -> mi.Scene:
    """The same for mistray."""
    reflectance = {"wavelength_nm": telescope.wavelength_nm, "reflectance": REFLECTANCE}
    return from_batoid(optic(telescope), **reflectance).to_scene()


def ours(telescope: Telescope, scene: mi.Scene, rays: int) -> mistray.Trace:
    """The job here."""
    limits = {"max_reflections": 2, "max_events": 64, "flux_threshold": telescope.threshold}
    return mistray.trace(scene, rays=rays, field_deg=telescope.field_deg, **limits)


def theirs(telescope: Telescope, started: mistray.Trace) -> Callable[[], dict[tuple[str, ...], float]]:
    """The job of batoid with the start rays of a trace: flux that ends in the detector, by path, in start rays."""
    import batoid

    found = optic(telescope)
    (run,) = started.runs
    origin, direction = run.start_rays(np.arange(run.rays))
    wavelength = 1e-9 * telescope.wavelength_nm
    columns = [np.ascontiguousarray(column) for column in (*(1e-3 * origin).T, *direction.T)]
    columns[3:] = [column / found.inMedium.getN(wavelength) for column in columns[3:]]
    detector = list(found.itemDict.values())[-1].name

    def action() -> dict[tuple[str, ...], float]:
        rays = batoid.RayVector(*columns, t=0.0, wavelength=wavelength, flux=1.0)
        forward, _ = found.traceSplit(rays, minFlux=telescope.threshold)
        return {tuple(bundle.path): float(bundle.flux.sum()) for bundle in forward if bundle.path[-1] == detector}

    return action


def same_ghosts(trace: mistray.Trace, split: dict[tuple[str, ...], float]) -> str:
    """Compare the flux of all ghosts that batoid finds; it tries only neighbours, we may find more."""
    unit = trace.energy.launched_W / sum(run.rays for run in trace.runs)
    found = {tuple(name for name, _ in row.event_list): row.power_W / unit for row in trace.paths if row.order == 2}
    direct = {tuple(name for name, _ in row.event_list) for row in trace.paths if row.order == 0}
    ghosts = {tuple(name.replace(".", "_") for name in path): flux for path, flux in split.items()}
    ghosts = {path: flux for path, flux in ghosts.items() if path not in direct and flux > 0}
    more = len(found.keys() - ghosts.keys())
    flux = agree("flux", sum(found.get(path, 0.0) for path in ghosts), sum(ghosts.values()), TOLERANCE)
    return f"{len(ghosts)} ghosts, {flux}" + f"; {more} more here" * (more > 0)


def against_batoid(telescope: Telescope, key: str, rays: int, bar: float | None, repeats: int) -> Row:
    """Whole jobs, from the scene and the rays to the ghosts."""
    import batoid

    scene = scene_of(telescope)
    trace = ours(telescope, scene, rays)
    split = theirs(telescope, trace)
    equal = same_ghosts(trace, split())
    here, there = alternate(lambda: ours(telescope, scene, rays), split, repeats=repeats)
    return Row(
        key,
        f"{telescope.name}, R = 2 %, two-reflection ghosts of {rays} rays, batoid {batoid.__version__} `traceSplit`",
        duration(here),
        duration(there),
        there.seconds / here.seconds,
        bar,
        equal=equal,
    )


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `batoid`."""
    repeats = 1 if quick else REPEATS
    for telescope in TELESCOPES:
        what = f"{telescope.name}, two-reflection ghosts, batoid `traceSplit`"
        for number, (rays, bar) in enumerate(((2_000, None),) if quick else telescope.jobs):
            key = telescope.key if number == 0 else f"{telescope.key}-{rays}"
            absent = missing(key, what, "batoid")
            yield absent or measured(key, what, partial(against_batoid, telescope, key, rays, bar, repeats))

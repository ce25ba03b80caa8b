"""Stray-light study: the eight steps from the optical model to ghosts and PST, one after the other."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi

from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.run import ghosts
from mistray.analyses.objects.run import objects
from mistray.analyses.pst.result import Pst
from mistray.analyses.pst.run import pst
from mistray.analyses.study.analysis import stray_light_analysis
from mistray.analyses.study.first_order import FirstOrder
from mistray.analyses.study.image import images_with_stray_light
from mistray.analyses.study.models import mechanical_model, optical_model
from mistray.analyses.study.objects import object_steps, source_angles
from mistray.analyses.study.request import StudyRequest
from mistray.analyses.study.result import Study
from mistray.analyses.study.step import StudyStep
from mistray.analyses.study.surfaces import coatings_and_scatter, importance_sampling, transmittance
from mistray.analyses.transfer.result import Transfer
from mistray.errors import MistrayError
from mistray.recorders.directions import DirectionGrid
from mistray.sampling.design_path import find_design_path
from mistray.sampling.importance_targets import importance_targets
from mistray.sampling.sources import scene_sources, spectrum_of
from mistray.settings import NO_LIMIT, polarized_sources
from mistray.surfaces.surfaces import SurfaceTable
from mistray.time_budget import share, within
from mistray.toolkit.analysis import analysis
from mistray.trace import Settings, trace

RAYS = 1_000_000  # of the PST
QUICK_RAYS = 100_000
# Start rays in units of those of the PST: of the objects at each source angle, of the ghosts at each field, of the
# check of the sampling, and of the images with stray light at each field
OBJECT_SHARE, GHOST_SHARE, CHECK_SHARE, IMAGE_SHARE = 0.2, 0.1, 0.02, 0.02
# Of a time budget, each of what is left of it; the PST has the rest
OBJECT_TIME, PROBE_TIME, GHOST_TIME, IMAGE_TIME = 0.25, 0.1, 0.33, 0.2
FIELDS = (0.0, 0.5, 1.0, 1.25)  # of the half field over the detector's height, where the fields are not given
FEW_FIELDS_DEG = (0.0, 10.0, 20.0)  # where that is not known

Progress = Callable[[int, str, float], None]
"""Called with the number of the step, what it does, and the share of it that is done."""


def run(
    scene: mi.Scene,
    request: StudyRequest,
    *,
    state: str | Path | None = None,
    resume: bool = False,
    name: str = "scene",
    progress: Progress | None = None,
    seconds: float | None = None,
) -> Study:
    """
    Run the eight steps of a stray-light study.

    The steps are those that "Stray Light Analysis of a Mobile Phone Camera" quotes from R. Pfisterer:
    optical model, mechanical model, critical objects, illuminated objects, common objects, coatings and scatter models,
    importance sampling, stray-light analysis. Steps 1, 2, 6 and 7 use the first wavelength only. The azimuth is
    that of the ghosts; the PST is the mean over all azimuths.

    Parameters
    ----------
    scene : mi.Scene
        Scene from `mistray.load`, with a ``collimated`` source and a detector.
    request : StudyRequest
    state, resume
        File of the saved PST run, and whether to continue it; see `mistray.pst`.
    name : str
        Name of the system, for the report.
    progress : callable, optional
        See `Progress`.
    seconds : float, optional
        Time for all steps, s. A quarter is for the objects, a tenth of the rest for the check of the sampling, and a
        third of the rest for the ghosts. Then a fifth of the rest is for images of points with stray light (wavefronts
        take extra time), and all that remains for the PST. Each ends with the rays that it has, and a warning reports
        their number.

    Raises
    ------
    MistrayError
        If an argument is out of range, the scene has no source or no detector, or a source is polarised.

    Examples
    --------
    >>> found = mistray.study(mistray.load("newtonian_scatter"), [10, 30], [0], rays=2000)
    >>> [step for step in found if "objects" in step]
    ['critical_objects', 'illuminated_objects', 'common_objects']
    >>> print(found.findings[0].partition(",")[0])
    2 optical surfaces: focal length 1270 mm
    """
    began = started = time.perf_counter()
    # Refused before the first step, not by the last one
    angles = DirectionGrid.of(request.pst_field_deg).field_deg.tolist()
    given, count = request.settings, request.rays or (QUICK_RAYS if request.quick else RAYS)
    tell = progress or (lambda number, what, share: None)
    chosen = _checked(scene, Settings.of(scene, **{**given, "rays": count}))
    light = {key: value for key, value in request.light.items() if key != "azimuth_deg"}
    source = scene_sources(scene, **light)[0]
    first, azimuth_deg = source.wavelength_nm, request.light.get("azimuth_deg")
    table = SurfaceTable(scene, first, stokes=chosen.stokes)
    path = find_design_path(table, scene)
    asked: dict[str, Any] = {"convention": request.convention, "relative_error": request.relative_error}
    steps: list[StudyStep] = []

    def fewer(part: float) -> dict[str, Any]:
        """Return the settings with the number of rays multiplied by `part`, at least one ray."""
        return {**given, "rays": max(1, round(part * count))}

    def done(*found: StudyStep) -> None:
        nonlocal started
        now = time.perf_counter()
        steps.extend(replace(step, seconds=(now - started) / len(found)) for step in found)
        started = now

    tell(1, "optical model", 0.0)
    done(optical_model(scene, table, path))
    tell(2, "mechanical model", 0.0)
    done(mechanical_model(table, path))
    numbers: FirstOrder | None = steps[0].result
    wanted = list(request.field_deg or _fields(numbers))
    with within(seconds, began):
        tell(3, "critical, illuminated and common objects", 0.0)
        with share(OBJECT_TIME):
            seen = objects(
                scene,
                rays=fewer(OBJECT_SHARE)["rays"],
                field_deg=source_angles(wanted, max(angles)),
                azimuth_deg=source.emitter.azimuth_deg if azimuth_deg is None else azimuth_deg,
                wavelength_nm=first,
                seed=chosen.seed,
                progress=lambda at, of: tell(3, "critical, illuminated and common objects", at / of),
            )
        done(*object_steps(seen))
        tell(6, "coatings and scatter models", 0.0)
        done(coatings_and_scatter(table, path))
        tell(7, "importance sampling", 0.0)
        with share(PROBE_TIME):
            scatters = chosen.max_scatters > 0 and any(interface.scatter for interface in table.interfaces)
            probe = trace(scene, field_deg=0.0, wavelength_nm=first, **fewer(CHECK_SHARE)) if scatters else None
        done(importance_sampling(table, path, importance_targets(table, scene, chosen), probe))
        with share(GHOST_TIME):
            report = ghosts(
                scene,
                wanted,
                progress=lambda at, of: tell(8, "ghosts", at / of),
                **request.light,
                **fewer(GHOST_SHARE) | {"max_scatters": 0},
            )
        with share(IMAGE_TIME):
            images = images_with_stray_light(
                scene,
                report,
                request.light,
                fewer(IMAGE_SHARE),
                request.quick,
                lambda at, of: tell(8, "images with stray light", at / of),
            )
        curve = pst(
            scene,
            angles,
            rays=count,
            state=state,
            resume=resume,
            progress=lambda at: tell(8, "PST", at.share_done),
            next_order=request.next_order,
            **asked,
            **light,
            **given,
        )
    passed, design = math.nan, list[str]()
    if path is not None:  # of all the light, as the PST is
        lines = zip(*spectrum_of(scene, light.get("wavelength_nm"), light.get("weights")), strict=True)
        passed = sum(float(part) * transmittance(path.at(float(nm)).table, path) for nm, part in lines)
        design = [table.ids[step.surface] for step in path.steps]
    done(stray_light_analysis(report, curve, numbers, passed, design, images))
    settings = {"rays": count, **_angles_and_light(report, curve), **asked, **given}
    seen_images = images if isinstance(images, Transfer) else None
    return Study(scene, name, tuple(steps), settings, numbers, seen, report, curve, seen_images)


study = analysis("study", StudyRequest, run)


def _angles_and_light(report: GhostReport, curve: Pst) -> dict[str, Any]:
    """Return the angles, azimuth (degrees), wavelengths (nm) and weights at which ghosts and PST were traced."""
    return {
        "pst_field_deg": [float(angle) for angle in curve.field_deg],
        "field_deg": [float(field) for field in report],
        "wavelength_nm": list(report.wavelengths_nm),
        "weights": [report.weight(line) for line in report.wavelengths_nm],
        "azimuth_deg": next(iter(report.values())).settings["azimuth_deg"],
    }


def _checked(scene: mi.Scene, chosen: Settings) -> Settings:
    """Return the settings. Raise `MistrayError` for a polarised source, or for a limit that a PST does not support."""
    if polarized := polarized_sources(scene):
        raise MistrayError(
            f"source '{polarized[0]}' is polarised, and a study compares its light with a PST, which is of unpolarised "
            "light; leave the polarisation of the source out"
        )
    if chosen.max_random_scatters < NO_LIMIT:
        raise MistrayError(
            f"max_random_scatters is {chosen.max_random_scatters}; a PST that is traced backwards has no such "
            "limit; leave it out"
        )
    return chosen


def _fields(numbers: FirstOrder | None) -> list[float]:
    """
    Return the default field angles of the ghost analysis, degrees: 0, 1/2, 1 and 5/4 of the half field in y, rounded.

    Those of 89° or more are left out. Where the half field is not known they are 0°, 10° and 20°.
    """
    half = numbers.field_deg["y"] if numbers is not None else math.nan
    if not math.isfinite(half):
        return list(FEW_FIELDS_DEG)
    digits = 0 if half >= 8 else 1 if half >= 0.8 else 3
    return list(dict.fromkeys(round(share * half, digits) for share in FIELDS if share * half < 89))

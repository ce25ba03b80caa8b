"""A whole stray-light study: the eight steps from the optical model to ghosts and PST, one after the other."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.run import ghosts
from mistray.analyses.objects.result import Objects
from mistray.analyses.objects.run import objects
from mistray.analyses.pst.request import CONVENTIONS
from mistray.analyses.pst.result import Pst
from mistray.analyses.pst.run import pst
from mistray.analyses.study.analysis import stray_light_analysis
from mistray.analyses.study.first_order import FirstOrder
from mistray.analyses.study.image import images_with_stray_light
from mistray.analyses.study.models import mechanical_model, optical_model
from mistray.analyses.study.objects import object_steps, source_angles
from mistray.analyses.study.step import STEPS, StudyStep
from mistray.analyses.study.surfaces import coatings_and_scatter, importance_sampling
from mistray.analyses.transfer.result import Transfer
from mistray.errors import MistrayError, UnknownKeyError
from mistray.notes import warns
from mistray.ranges import FIELD_DEG, RELATIVE_ERROR
from mistray.recorders.directions import DirectionGrid
from mistray.sampling.design_path import find_design_path
from mistray.sampling.importance_targets import importance_targets
from mistray.sampling.sources import scene_sources
from mistray.scene.check import require_scene
from mistray.settings import NO_LIMIT, polarized_sources, refuse_unknown
from mistray.surfaces.surfaces import SurfaceTable
from mistray.time_budget import share, within
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


@dataclass(frozen=True, eq=False)
class Study(Mapping[str, StudyStep]):
    """
    Result of `study`: a mapping from the key of a step (see `mistray.analyses.study.step.STEPS`) to its result.

    Attributes
    ----------
    scene : mi.Scene
    name : str
        Of the system.
    steps : tuple of StudyStep
        The eight steps in order.
    settings : dict
        Arguments of the study, plain values.
    """

    scene: Any
    name: str
    steps: tuple[StudyStep, ...]
    settings: dict[str, Any]

    def __getitem__(self, key: str) -> StudyStep:
        for step in self.steps:
            if step.key == key:
                return step
        raise UnknownKeyError(f"a study has no step '{key}'; its steps are {', '.join(name for name, _ in STEPS)}")

    def __iter__(self) -> Iterator[str]:
        return iter(step.key for step in self.steps)

    def __len__(self) -> int:
        return len(self.steps)

    @property
    def first_order(self) -> FirstOrder | None:
        """First-order numbers of step 1; None where there is no design path."""
        found: FirstOrder | None = self["optical_model"].result
        return found

    @property
    def objects(self) -> Objects:
        """Critical, illuminated and common objects of the steps 3 to 5."""
        found: Objects = self["common_objects"].result
        return found

    @property
    def ghosts(self) -> GhostReport:
        """The ghost analysis of step 8."""
        found: GhostReport = self["analysis"].result["ghosts"]
        return found

    @property
    def pst(self) -> Pst:
        """The point source transmittance of step 8."""
        found: Pst = self["analysis"].result["pst"]
        return found

    @property
    def images(self) -> Transfer | None:
        """Images of points with their stray light of step 8; None where the scene makes none."""
        found: Transfer | None = self["analysis"].result["images"]
        return found

    @property
    def findings(self) -> list[str]:
        """Findings of the study, one sentence each, in the order of the steps."""
        return [text for step in self.steps for text in step.findings]

    @property
    def warnings(self) -> list[str]:
        """Warnings to heed before trusting the study, one line each; empty if all is well."""
        return [f"step {step.number}: {text}" for step in self.steps for text in step.warnings]

    def write(self, directory: str | Path, command: str = "") -> list[Path]:
        """
        Write report.html, which holds all of the study, and every table as CSV.

        Parameters
        ----------
        directory : str or Path
            Made if it is missing. Files of the same names are replaced.
        command : str
            Command line, quoted in the report.

        Returns
        -------
        list of Path
            The files written.
        """
        from mistray.analyses.study.page import write_study

        return write_study(self, directory, command)

    def __repr__(self) -> str:
        lines = [f"Study of '{self.name}'"]
        lines += [f"{step.number} {step.title}: {text}" for step in self.steps for text in step.findings]
        return "\n".join(lines + [f"warning: {text}" for text in self.warnings])


# More than 8 parameters: the keywords of a call, each with a default and used one by one
@warns
def study(
    scene: mi.Scene,
    pst_field_deg: float | Sequence[float] | np.ndarray = range(0, 81, 2),
    field_deg: float | Sequence[float] | None = None,
    *,
    rays: int | None = None,
    quick: bool = False,
    wavelength_nm: float | Sequence[float] | None = None,
    weights: Sequence[float] | None = None,
    azimuth_deg: float | None = None,
    relative_error: float | None = None,
    convention: str = "normal",
    state: str | Path | None = None,
    resume: bool = False,
    name: str = "scene",
    progress: Progress | None = None,
    seconds: float | None = None,
    next_order: bool = True,
    **settings: Any,
) -> Study:
    """
    Run the eight steps of a stray-light study.

    The steps are those of the list that "Stray Light Analysis of a Mobile Phone Camera" quotes from R. Pfisterer:
    optical model, mechanical model, critical objects, illuminated objects, common objects, coatings and scatter models,
    importance sampling, stray-light analysis.

    Parameters
    ----------
    scene : mi.Scene
        From `mistray.load`, with a ``collimated`` source and a detector.
    pst_field_deg : float or sequence of float
        Field angles of the PST, degrees.
    field_deg : float or sequence of float, optional
        Field angles of the ghost analysis, degrees; by default the axis, half, the whole and 5/4 of the half field.
    rays : int, optional
        Start rays of the PST (1e6; quick: 1e5). The objects get a fifth of them at each source angle, the ghosts a
        tenth at each field, the images of points with stray light a fiftieth at each field.
    quick : bool
        A first look: fewer rays.
    wavelength_nm, weights
        As in `mistray.trace`; the steps 1, 2, 6 and 7 are about the first wavelength.
    azimuth_deg : float, optional
        Azimuth of the fields of the ghost analysis; the PST is the mean over all azimuths.
    relative_error : float, optional
        Trace the PST until its relative standard error is below this at all angles, with `rays` as a limit.
    convention : {"normal", "projected"}
        Of the PST.
    state, resume
        File of the saved PST run, and whether to go on from it; see `mistray.pst`.
    name : str
        Of the system, for the report.
    progress : callable, optional
        See `Progress`.
    seconds : float, optional
        Time for all steps: a quarter for the objects, a third of what is left for the ghosts, a fifth of the rest for
        the images of points with stray light, whose wavefronts take their time beside it, and what is left for the PST.
        Each ends with the rays that it has, and its warnings count them.
    next_order : bool
        Measure the PST again with one more event on each path, see `mistray.pst`.
    **settings
        Other fields of `mistray.trace.Settings`, such as ``max_scatters`` or ``seed``.

    Raises
    ------
    MistrayError
        For arguments out of range, or a scene without a source or a detector.
    """
    began = started = time.perf_counter()
    require_scene(scene, "study")
    angles, given_fields = _check(settings, pst_field_deg, field_deg, convention, relative_error)
    given = {key: value for key, value in settings.items() if value is not None}
    count = rays if rays is not None else QUICK_RAYS if quick else RAYS
    tell = progress or (lambda number, what, share: None)
    chosen = _checked(scene, Settings.of(scene, **given | {"rays": count}))
    first = scene_sources(scene, wavelength_nm=wavelength_nm, weights=weights)[0].wavelength_nm
    table = SurfaceTable(scene, first, stokes=chosen.stokes)
    path = find_design_path(table, scene)
    light: dict[str, Any] = {"wavelength_nm": wavelength_nm, "weights": weights}
    steps: list[StudyStep] = []

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
    wanted = _fields(numbers) if given_fields is None else given_fields
    with within(seconds, began):
        tell(3, "critical, illuminated and common objects", 0.0)
        with share(OBJECT_TIME):
            seen = objects(
                scene,
                rays=max(1, round(OBJECT_SHARE * count)),
                field_deg=source_angles(wanted, max(angles)),
                azimuth_deg=azimuth_deg or 0.0,
                wavelength_nm=first,
                seed=chosen.seed,
                progress=lambda at, of: tell(3, "critical, illuminated and common objects", at / of),
            )
        done(*object_steps(seen))
        tell(6, "coatings and scatter models", 0.0)
        done(coatings_and_scatter(table, path))
        tell(7, "importance sampling", 0.0)
        with share(PROBE_TIME):
            few = given | {"rays": max(1, round(CHECK_SHARE * count))}
            probe = trace(scene, field_deg=0.0, wavelength_nm=first, **few) if _scatters(table, chosen) else None
        done(importance_sampling(table, path, importance_targets(table, scene, chosen), probe))
        with share(GHOST_TIME):
            report = ghosts(
                scene,
                wanted,
                azimuth_deg=azimuth_deg,
                progress=lambda at, of: tell(8, "ghosts", at / of),
                **light,
                **given | {"rays": max(1, round(GHOST_SHARE * count)), "max_scatters": 0},
            )
        with share(IMAGE_TIME):
            images = images_with_stray_light(
                scene,
                report,
                light | {"azimuth_deg": azimuth_deg},
                given | {"rays": max(1, round(IMAGE_SHARE * count))},
                quick,
                lambda at, of: tell(8, "images with stray light", at / of),
            )
        curve = pst(
            scene,
            angles,
            convention=convention,
            rays=count,
            relative_error=relative_error,
            state=state,
            resume=resume,
            progress=lambda at: tell(8, "PST", at.share_done),
            next_order=next_order,
            **light,
            **{key: value for key, value in given.items() if key != "rays"},
        )
    transmittance = steps[5].fact("transmittance of the design path") if path is not None else math.nan
    assert isinstance(transmittance, float)
    design = [table.ids[step.surface] for step in path.steps] if path is not None else []
    done(stray_light_analysis(report, curve, numbers, transmittance, design, images))
    asked = _angles_and_light(report, curve) | {"convention": convention, "relative_error": relative_error}
    return Study(scene, name, tuple(steps), {"rays": count, **asked, **given})


def _scatters(table: SurfaceTable, chosen: Settings) -> bool:
    return chosen.max_scatters > 0 and any(interface.scatter for interface in table.interfaces)


def _angles_and_light(report: GhostReport, curve: Pst) -> dict[str, Any]:
    """Angles and wavelengths that the ghosts and the PST have been traced for."""
    return {
        "pst_field_deg": [float(angle) for angle in curve.field_deg],
        "field_deg": [float(field) for field in report],
        "wavelength_nm": list(report.wavelengths_nm),
        "weights": [report.weight(line) for line in report.wavelengths_nm],
        "azimuth_deg": next(iter(report.values())).settings["azimuth_deg"],
    }


def _check(
    settings: Mapping[str, Any],
    pst_field_deg: float | Sequence[float] | np.ndarray,
    field_deg: float | Sequence[float] | None,
    convention: str,
    relative_error: float | None,
) -> tuple[list[float], list[float] | None]:
    """Angles of the PST and fields of the ghosts; refuses before the first step what the last one would refuse."""
    refuse_unknown(settings, study)
    angles = DirectionGrid.of(pst_field_deg).field_deg.tolist()
    if convention not in CONVENTIONS:
        raise MistrayError(f"convention is '{convention}'; use {' or '.join(map(repr, CONVENTIONS))}")
    if relative_error is not None:
        RELATIVE_ERROR.check("relative_error", relative_error)
    return angles, None if field_deg is None else FIELD_DEG.check_each("field_deg", field_deg)


def _checked(scene: mi.Scene, chosen: Settings) -> Settings:
    """Refuse light and limits that a PST has none of."""
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
    """Field angles of the ghost analysis where none are given: whole degrees, or tenths in a narrow field."""
    half = numbers.field_deg["y"] if numbers is not None else math.nan
    if not math.isfinite(half):
        return list(FEW_FIELDS_DEG)
    digits = 0 if half >= 8 else 1 if half >= 0.8 else 3
    return list(dict.fromkeys(round(share * half, digits) for share in FIELDS if share * half < 89))

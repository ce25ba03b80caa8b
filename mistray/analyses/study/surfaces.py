"""Steps 6 and 7 of a stray-light study: coatings and scatter of surfaces, and targets of aimed rays."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd

from mistray.analyses.study.step import Fact, StudyStep, count_of
from mistray.kernel.targets import AimSet, AnyTarget, Inside, Place, TargetCone
from mistray.sampling.design_path import DesignPath
from mistray.sampling.detector_images import DetectorImages
from mistray.surfaces.surfaces import SurfaceTable
from mistray.toolkit.tables.surface_optics import TIS, role, share_along, surface_optics
from mistray.trace import Trace
from mistray.trace.reliability import SamplingCheck, sampling_check

SEEN = ["distance_mm", "half_width_mm", "half_height_mm", "half_angle_deg"]
FAR_SIZES = 1e3  # distance of a target, in units of the system's size, from which on it is said to be at infinity


def coatings_and_scatter(table: SurfaceTable, path: DesignPath | None) -> StudyStep:
    """
    Return step 6: R, T, absorptance, scatter models and total integrated scatter of surfaces at normal incidence.

    The tables are those of `surface_optics`.
    """
    frame, treatments, models = surface_optics(table, path)
    scatterers = sorted(set(models.surface))
    facts = [
        Fact("reference wavelength", table.wavelength_nm, "nm"),
        Fact("angle of incidence", 0.0, "°"),
        Fact("surfaces that scatter", float(len(scatterers))),
    ]
    findings = []
    if path is not None:
        through = transmittance(table, path)
        facts.append(Fact("transmittance of the design path", through))
        findings.append(
            f"At normal incidence {100 * through:.4g} % of the light passes the optics of the design path; the "
            f"detector takes in {frame.A_percent[frame.role == 'detector'].iloc[0]:.4g} % of what meets it."
        )
    if models.empty:
        findings.append("No surface scatters: the study finds ghosts and specular reflections only.")
    else:
        optics = frame[frame.role == "optic"].assign(total=lambda f: f[TIS[0]] + f[TIS[1]])
        worst = optics.sort_values("total", ascending=False).head(1)
        findings += [
            f"{len(scatterers)} of {table.count} surfaces scatter; of the optics '{row.surface}' scatters most, "
            f"{row.total:.3g} % of the light at normal incidence."
            for row in worst.itertuples()
            if row.total > 0
        ]
    return StudyStep.of(
        "coatings_and_scatter",
        "R, T and A of every surface and what it scatters, for light at normal incidence, unpolarised: R + T + TIS + A "
        "= 100 %. R and T are those of the specular beams, after scatter has taken its share.",
        facts=tuple(facts),
        tables={"treatments": treatments, "surface_budget": frame, "scatter_models": models},
        findings=tuple(findings),
    )


def transmittance(table: SurfaceTable, path: DesignPath) -> float:
    """Return the fraction, 0 … 1, of the light along the base ray that reaches the detector by the design path."""
    return float(np.prod([share_along(table, step) for step in path.steps[:-1]]))


def importance_sampling(
    table: SurfaceTable, path: DesignPath | None, targets: Mapping[Place, AimSet], probe: Trace | None
) -> StudyStep:
    """
    Return step 7: targets of the aimed rays of each surface, and the number of rays that arrive.

    Columns of the table: surface, role, leaves ("front", "back"; "in front", "behind" for scatter in the medium there
    on the way to the surface), number (of the target), shape, distance_mm (from the vertex of the surface to the middle
    of the target; negative: virtual, inf: far away), half_width_mm, half_height_mm, half_angle_deg (the larger of both
    as seen from the vertex), share_percent (of the aimed rays), rays (aimed at every hit).

    "paraxial_targets" compares with first-order optics: for each surface of the path the image of the detector in the
    space that the light enters, in columns surface, leaves, distance_mm, half_width_mm, half_height_mm and
    half_angle_deg as above. A row for each traced target from there adds its number (0: none), traced_distance_mm,
    traced_half_width_mm, traced_half_height_mm and traced_half_angle_deg. Traced targets are as large as real rays
    need, see `mistray.sampling.detector_images`.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    path : DesignPath, optional
        Design path of the scene, if it has one.
    targets : mapping
        Place of scatter → targets, as from `mistray.sampling.importance_targets.importance_targets`.
    probe : Trace, optional
        Trace with scatter, whose sampling is judged; None if nothing scatters.
    """
    rows = []
    far_away = FAR_SIZES * float(np.linalg.norm(np.ptp(table.vertices, axis=0)))
    for place, aim in targets.items():
        if isinstance(place, Inside):
            surface, leaves = place.surface, "behind" if place.at_back else "in front"
        else:
            surface, leaves = place[0], "back" if place[1] else "front"
        vertex = table.vertices[surface]
        for number, target in enumerate(aim.targets, start=1):
            which = (table.ids[surface], role(table, path, surface), leaves, number, target.shape)
            rows.append((*which, *_seen(target, vertex, far_away), 100 * target.share, aim.rays))
    columns = ["surface", "role", "leaves", "number", "shape", *SEEN, "share_percent", "rays"]
    frame = pd.DataFrame(rows, columns=columns)
    text = (
        "A part of the light that a surface scatters is aimed at targets. These are images of the detector in the "
        "space that the light enters, the detector itself, or lenses that the surface sees. The rest is sampled at "
        "random. So targets change the error of a result, and not the result."
    )
    tables = {"targets": frame, "paraxial_targets": _paraxial(table, path, frame, far_away)}
    if probe is None:
        return StudyStep.of(
            "importance_sampling",
            text,
            tables=tables,
            findings=("Nothing scatters, so there is nothing to aim.",),
        )
    check = sampling_check(probe)
    untargeted = sorted(
        table.ids[i]
        for i in range(table.count)
        if table.interfaces[i].scatter and not {(i, False), (i, True)} & set(targets)
    )
    findings = [
        f"{count_of(frame.surface.nunique(), 'surface')} with {count_of(len(frame), 'target')}; in a trace on axis "
        f"scattered light made {check.hits_per_start:.3g} hits of the detector for each start ray, worth "
        f"{check.effective_hits:.3g} hits of equal flux together."
    ]
    if untargeted:
        findings.append(
            "Without a target, because they see neither the detector nor a lens: "
            f"{count_of(len(untargeted), 'surface')}, "
            f"{', '.join(untargeted[:6])}{' …' if len(untargeted) > 6 else ''}."
        )
    return StudyStep.of(
        "importance_sampling",
        text,
        facts=_sampling_facts(check, probe),
        tables={**tables, "aimed_rays": _aimed(check)},
        findings=tuple(findings),
        warnings=check.notes,
        result=check,
    )


def _seen(target: AnyTarget, vertex: np.ndarray, far_away: float) -> tuple[float, ...]:
    """
    Return distance, half width, half height (mm) and half angle (degrees) of a ray target seen from a vertex.

    The distance is negative for a virtual target, and ``inf`` beyond `far_away`, mm, where the half sizes are NaN. Of a
    cone only the half angle is known; NaN stands for the rest.
    """
    if isinstance(target, TargetCone):
        return math.nan, math.nan, math.nan, math.degrees(target.half_angle)
    distance = float(np.linalg.norm(target.centre - vertex))
    width, height = target.size
    angle = math.degrees(math.atan2(max(width, height), distance))
    if distance > far_away:
        return math.inf, math.nan, math.nan, angle
    return -distance if target.reverse else distance, width, height, angle


def _paraxial(table: SurfaceTable, path: DesignPath | None, traced: pd.DataFrame, far_away: float) -> pd.DataFrame:
    """
    Return the table "paraxial_targets" of `importance_sampling`, see there for its columns, as DataFrame.

    `traced` is its table "targets". What is farther than `far_away`, mm, counts as at infinity. Without a design path
    there are no rows.
    """
    rows = []
    images = DetectorImages(path).paraxial if path is not None else []
    for image, step in zip(images[1:], path.steps if path is not None else (), strict=False):
        place = table.ids[step.surface], "back" if step.to_back else "front"
        own = traced[(traced.surface == place[0]) & (traced.leaves == place[1])][["number", *SEEN]]
        found = list(own.itertuples(index=False)) or [(0, *(math.nan for _ in SEEN))]
        rows += [(*place, *_seen(image, step.point, far_away), *target) for target in found]
    return pd.DataFrame(rows, columns=["surface", "leaves", *SEEN, "number", *(f"traced_{key}" for key in SEEN)])


def _sampling_facts(check: SamplingCheck, probe: Trace) -> tuple[Fact, ...]:
    return (
        Fact("start rays of the check", float(probe.settings["rays"])),
        Fact("hits of scattered rays per start ray", float(check.hits_per_start)),
        Fact("hits of equal flux", float(check.effective_hits)),
        Fact("largest share of one hit", float(100 * check.largest_share), "%"),
    )


def _aimed(check: SamplingCheck) -> pd.DataFrame:
    """Return a DataFrame of aimed rays by surface, most rays first: number, percentage that arrives, and `low`."""
    rows = [(row.surface, row.aimed, 100 * row.share_landed, row.low) for row in check.rows]
    frame = pd.DataFrame(rows, columns=["surface", "aimed", "landed_percent", "low"])
    return frame.sort_values("aimed", ascending=False, kind="stable", ignore_index=True)

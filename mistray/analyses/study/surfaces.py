"""Steps 6 and 7 of a stray-light study: what surfaces do to light, and where scattered light is sent."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd

from mistray.analyses.study.models import role
from mistray.analyses.study.step import Fact, StudyStep, count_of
from mistray.coatings import Bare, Ideal
from mistray.kernel.scatter_tables import light_indices
from mistray.kernel.targets import AimSet, AnyTarget, Inside, Place, TargetCone
from mistray.sampling.design_path import DesignPath
from mistray.sampling.detector_images import DetectorImages
from mistray.scatter import LobeModel
from mistray.scatter.particulate import particle_indices
from mistray.scatter.total import Totals, model_lobes, totals
from mistray.surfaces.host_rays import normals
from mistray.surfaces.optics import OPAQUE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.trace import Trace
from mistray.trace.reliability import SamplingCheck, sampling_check

BUDGET_ROUNDING = 1e-9
SAME_DIGITS = 9
SEEN = ["distance_mm", "half_width_mm", "half_height_mm", "half_angle_deg"]
FAR_SIZES = 1e3  # distance of a target, in units of the system's size, from which on it is said to be at infinity


def coatings_and_scatter(table: SurfaceTable, path: DesignPath | None) -> StudyStep:
    """
    Step 6: R, T, A, scatter models and total integrated scatter (TIS) of every surface, at normal incidence.

    Optics of the design path are seen from the side that the light comes from, all others from both sides, in one row
    where both are alike. Columns of the table "surfaces": surface, part, role, side, coating, R_percent, T_percent
    (specular, what is left after scatter), TIS_reflected_percent, TIS_transmitted_percent, A_percent (what is missing
    to 100), scatter (the models in words). "treatments" gathers the surfaces that have all of that in common;
    "scatter_models" has the TIS of each model alone.
    """
    from_front = {step.surface: step.from_front for step in path.steps} if path else {}
    rows, models = [], []
    for i in table.listed:
        if i in from_front:
            sides = {"front" if from_front[i] else "back": from_front[i]}
        else:
            sides = {"front": True, "back": False}
        numbers = {}
        for name, front in sides.items():
            numbers[name] = _budget(table, i, front)
            models += _models(table, i, name, front)
        common: dict[str, Any] = {"surface": table.ids[i], "part": table.parts[i], "role": role(table, path, i)}
        rest = {"coating": coating_words(table.interfaces[i].coating), "scatter": scatter_words(table.interfaces[i])}
        if len(numbers) == 2 and _rounded(numbers["front"]) == _rounded(numbers["back"]):
            numbers = {"both": numbers["front"]}
        rows += [common | {"side": side} | values | rest for side, values in numbers.items()]
    frame = pd.DataFrame(rows)
    scatterers = sorted({row["surface"] for row in models})
    facts = [
        Fact("reference wavelength", table.wavelength_nm, "nm"),
        Fact("angle of incidence", 0.0, "°"),
        Fact("surfaces that scatter", float(len(scatterers))),
    ]
    findings = []
    if path is not None:
        through = float(np.prod([_along(table, step) for step in path.steps[:-1]]))
        facts.append(Fact("transmittance of the design path", through))
        findings.append(
            f"At normal incidence {100 * through:.4g} % of the light passes the optics of the design path; the "
            f"detector takes in {frame.A_percent[frame.role == 'detector'].iloc[0]:.4g} % of what meets it."
        )
    model_frame = pd.DataFrame(models, columns=["surface", "side", "model", *TIS])
    if not models:
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
        tables={"treatments": _treatments(frame), "surface_budget": frame, "scatter_models": model_frame},
        findings=tuple(findings),
    )


TIS = ("TIS_reflected_percent", "TIS_transmitted_percent")


def _rounded(values: Mapping[str, float]) -> tuple[float, ...]:
    return tuple(round(value, SAME_DIGITS) for value in values.values())


def _totals(
    table: SurfaceTable, surface: int, models: Sequence[LobeModel], from_front: bool, cosine: float = 1.0
) -> Totals:
    """Compute how some models of a surface divide light at one angle of incidence; opaque surfaces transmit nothing."""
    opaque = bool(table.optics.host_words[surface] & OPAQUE)
    sides = light_indices(table.optics, surface, from_front)
    particles = particle_indices(models, table.wavelength_nm)
    return _known_totals(tuple(models), particles, table.wavelength_nm, *sides, from_front, opaque, cosine)


@lru_cache(maxsize=1024)
def _known_totals(
    models: tuple[LobeModel, ...],
    _particles: tuple[complex, ...],
    wavelength_nm: float,
    n_in: float,
    n_out: float,
    from_front: bool,
    opaque: bool,
    cosine: float,
) -> Totals:
    lobes = model_lobes(models, wavelength_nm, n_in, n_out, from_front)
    lobes = tuple(lobe for lobe in lobes if not (opaque and lobe.event == "transmission"))
    return totals(lobes, np.array([cosine]), n_in, n_out)


def _budget(table: SurfaceTable, surface: int, from_front: bool) -> dict[str, float]:
    """Specular R and T, TIS in both events and what is absorbed, in percent, at normal incidence."""
    r, t = (float(share[0]) for share in table.optics.shares(surface, from_front, np.ones(1)))
    sums = _totals(table, surface, table.interfaces[surface].scatter, from_front)
    x = {"reflection": r, "transmission": t}
    specular = {event: share * (1 - float(sums.loss[event][0])) for event, share in x.items()}
    tis = {event: float(sums.scattered(event, np.array([share]))[0]) for event, share in x.items()}
    absorbed = 1 - sum(specular.values()) - sum(tis.values())
    return {
        "R_percent": 100 * specular["reflection"],
        "T_percent": 100 * specular["transmission"],
        TIS[0]: 100 * tis["reflection"],
        TIS[1]: 100 * tis["transmission"],
        "A_percent": 100 * absorbed if absorbed > BUDGET_ROUNDING else 0.0,
    }


def _models(table: SurfaceTable, surface: int, side: str, from_front: bool) -> list[dict[str, Any]]:
    """TIS of each scatter model of a surface alone."""
    r, t = table.optics.shares(surface, from_front, np.ones(1))
    rows = []
    for item in table.interfaces[surface].scatterers:
        sums = _totals(table, surface, (item.model,), from_front)
        shares = (float(sums.scattered(event, x)[0]) for event, x in (("reflection", r), ("transmission", t)))
        values = dict(zip(TIS, (100 * share for share in shares), strict=True))
        if any(values.values()):
            rows.append({"surface": table.ids[surface], "side": side, "model": model_words(item)} | values)
    return rows


def _along(table: SurfaceTable, step: Any) -> float:
    """Share of the base ray's light that goes on along the design path."""
    along = normals(table, step.surface, step.point[None])[0] if step.surface < len(table.pieces) else step.normal
    cosine = min(abs(float(step.before @ along)), 1.0)
    r, t = table.optics.shares(step.surface, step.from_front, np.array([cosine]))
    loss = _totals(table, step.surface, table.interfaces[step.surface].scatter, step.from_front, cosine).loss
    share, event = (r, "reflection") if step.reflects else (t, "transmission")
    return float(share[0] * (1 - loss[event][0]))


def coating_words(coating: Any) -> str:
    """A coating in a few words."""
    name = str(getattr(coating, "name", "") or "")
    if isinstance(coating, Bare):
        return "bare"
    if isinstance(coating, Ideal):
        constants = f"R {coating.R:g}" + (f", T {coating.T:g}" if coating.T else "")
        return f"{name}: {constants}" if name else constants
    layers = getattr(coating, "layers", None)
    kind = f"{len(layers)} layers" if layers is not None else "table"
    return f"{name}: {kind}" if name else kind


def scatter_words(interface: Any) -> str:
    """The scatter models of an interface in words, "-" if it has none."""
    return " + ".join(model_words(item) for item in interface.scatterers) or "-"


def model_words(item: Any) -> str:
    """A scatter plugin's model with the numbers that differ from their defaults, such as "harvey_shack rms_nm 4"."""
    model = item.model
    shown = []
    for f in dataclasses.fields(model) if dataclasses.is_dataclass(model) else ():
        value = getattr(model, f.name)
        if isinstance(value, int | float) and not isinstance(value, bool) and value != f.default:
            shown.append(f"{f.name} {value:.4g}")
    return " ".join([item.kind, *shown])


def _treatments(frame: pd.DataFrame) -> pd.DataFrame:
    """Surfaces with one and the same coating, scatter and budget, the most frequent first."""
    numbers = ["R_percent", "T_percent", *TIS, "A_percent"]
    keys = ["role", "side", "coating", "scatter", *numbers]
    rounded = frame.assign(**{name: frame[name].round(SAME_DIGITS) for name in numbers})
    groups = rounded.groupby(keys, sort=False).surface.agg(["size", lambda names: ", ".join(names)])
    groups.columns = pd.Index(["count", "surfaces"])
    order = {kind: k for k, kind in enumerate(("optic", "bevel or edge", "other optic", "structure", "detector"))}
    table = groups.reset_index()
    table = table.sort_values(["role", "count"], key=lambda c: c.map(order) if c.name == "role" else -c, kind="stable")
    return table[["role", "side", "count", "coating", *numbers, "scatter", "surfaces"]].reset_index(drop=True)


def importance_sampling(
    table: SurfaceTable, path: DesignPath | None, targets: Mapping[Place, AimSet], probe: Trace | None
) -> StudyStep:
    """
    Step 7: where each surface sends aimed rays, and how many of them arrive.

    Columns of the table: surface, role, leaves ("front", "back"; "in front", "behind": what the medium there scatters
    on the way to the surface), number (of the target), shape, distance_mm (from the vertex of the surface to the middle
    of the target; negative: virtual, inf: far away), half_width_mm, half_height_mm, half_angle_deg (the larger of both
    as seen from the vertex), share_percent (of the aimed rays), rays (aimed at every hit). "paraxial_targets" has what
    first-order optics says beside it: for each surface of the path the image of the detector in the space that the
    light enters, in columns surface, leaves, distance_mm, half_width_mm, half_height_mm and half_angle_deg as above,
    and in a row for each target that is traced from there its number (0: none is), traced_distance_mm,
    traced_half_width_mm, traced_half_height_mm and traced_half_angle_deg. Traced targets are as large as real rays
    need, see `mistray.sampling.detector_images`.

    Parameters
    ----------
    table : SurfaceTable
    path : DesignPath, optional
    targets : mapping
        Where light is scattered → targets, as from `mistray.sampling.importance_targets.importance_targets`.
    probe : Trace, optional
        A trace with scatter, whose sampling is judged; None where nothing scatters.
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
    """A target as seen from a surface's vertex, by the columns `SEEN`."""
    if isinstance(target, TargetCone):
        return math.nan, math.nan, math.nan, math.degrees(target.half_angle)
    distance = float(np.linalg.norm(target.centre - vertex))
    width, height = target.size
    angle = math.degrees(math.atan2(max(width, height), distance))
    if distance > far_away:
        return math.inf, math.nan, math.nan, angle
    return -distance if target.reverse else distance, width, height, angle


def _paraxial(table: SurfaceTable, path: DesignPath | None, traced: pd.DataFrame, far_away: float) -> pd.DataFrame:
    """The paraxial images of the detector behind the surfaces of the path, beside every target that is traced."""
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
    """Aimed rays of each surface and the share of them that lands, the most often aimed first."""
    rows = [(row.surface, row.aimed, 100 * row.share_landed, row.low) for row in check.rows]
    frame = pd.DataFrame(rows, columns=["surface", "aimed", "landed_percent", "low"])
    return frame.sort_values("aimed", ascending=False, kind="stable", ignore_index=True)

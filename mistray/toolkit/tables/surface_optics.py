"""Effect of surfaces on light at normal incidence: specular shares, scatter and absorption, by surface and by group."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd

from mistray.coatings import Bare, Ideal
from mistray.kernel.scatter_tables import light_indices
from mistray.sampling.design_path import DesignPath
from mistray.scatter import LobeModel
from mistray.scatter.particulate import particle_indices
from mistray.scatter.total import Totals, model_lobes, totals
from mistray.surfaces.host_rays import normals
from mistray.surfaces.optics import OPAQUE, WALL
from mistray.surfaces.surfaces import SurfaceTable

BUDGET_ROUNDING = 1e-9
SAME_DIGITS = 9
TIS = ("TIS_reflected_percent", "TIS_transmitted_percent")
OPTIC, BEVEL, OTHER_OPTIC, STRUCTURE, DETECTOR = "optic", "bevel or edge", "other optic", "structure", "detector"


def role(table: SurfaceTable, path: DesignPath | None, surface: int) -> str:
    """
    Return the role of a surface, given by its index: optic, bevel or edge, other optic, structure, detector.

    An optic belongs to the design path `path`; None: there is none.
    """
    word = int(table.optics.host_words[surface])
    if surface == table.detector:
        return DETECTOR
    if path is not None and any(step.surface == surface for step in path.steps):
        return OPTIC
    if word & OPAQUE:
        return STRUCTURE
    return BEVEL if word & WALL else OTHER_OPTIC


def surface_optics(table: SurfaceTable, path: DesignPath | None) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """
    Return R, T, A, scatter models and total integrated scatter (TIS) of every surface at normal incidence, percent.

    Optics of the design path are given for the side or sides from which its light meets them, all others for both. Two
    sides are in one row if they are alike. Percentages are of the incident light.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    path : DesignPath, optional
        Design path of the scene; None: it has none.

    Returns
    -------
    surfaces : DataFrame
        Columns surface, part, role, side, coating, R_percent, T_percent (specular, without the scattered share),
        TIS_reflected_percent, TIS_transmitted_percent, A_percent (the rest to 100), scatter (the models in
        words).
    treatments : DataFrame
        Groups of surfaces that have role, side, coating, scatter and percentages in common, see `_treatments`.
    models : DataFrame
        Columns surface, side, model, TIS_reflected_percent, TIS_transmitted_percent: each scatter model alone.
    """
    passed = {(step.surface, step.from_front) for step in path.steps} if path else set()
    rows, models = [], []
    for i in table.listed:
        numbers = {}
        for name, front in (("front", True), ("back", False)):
            if (i, not front) in passed and (i, front) not in passed:
                continue  # the light of the design path comes from the other side alone
            numbers[name] = _budget(table, i, front)
            models += _models(table, i, name, front)
        common: dict[str, Any] = {"surface": table.ids[i], "part": table.parts[i], "role": role(table, path, i)}
        rest = {"coating": coating_words(table.interfaces[i].coating), "scatter": scatter_words(table.interfaces[i])}
        if len(numbers) == 2 and _rounded(numbers["front"]) == _rounded(numbers["back"]):
            numbers = {"both": numbers["front"]}
        rows += [common | {"side": side} | values | rest for side, values in numbers.items()]
    frame = pd.DataFrame(rows)
    return frame, _treatments(frame), pd.DataFrame(models, columns=["surface", "side", "model", *TIS])


def _rounded(values: Mapping[str, float]) -> tuple[float, ...]:
    return tuple(round(value, SAME_DIGITS) for value in values.values())


def _totals(
    table: SurfaceTable, surface: int, models: Sequence[LobeModel], from_front: bool, cosine: float = 1.0
) -> Totals:
    """
    Return the `Totals` of scatter models at a surface, for one cosine of the angle of incidence.

    `surface` is its index. Light arrives from the front if `from_front`, else from the back. Through an opaque surface
    nothing is scattered.
    """
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
    """
    Return specular R and T, TIS of reflection and transmission, and absorption at normal incidence, by column.

    They are percentages of the incident light, which arrives from the front if `from_front`, else from the back.
    """
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
    """
    Return table rows with the TIS of each scatter model of a surface alone, percent of light at normal incidence.

    Light arrives from the front if `from_front`, the side called `side`; models without TIS are left out.
    """
    r, t = table.optics.shares(surface, from_front, np.ones(1))
    rows = []
    for item in table.interfaces[surface].scatterers:
        sums = _totals(table, surface, (item.model,), from_front)
        shares = (float(sums.scattered(event, x)[0]) for event, x in (("reflection", r), ("transmission", t)))
        values = dict(zip(TIS, (100 * share for share in shares), strict=True))
        if any(values.values()):
            rows.append({"surface": table.ids[surface], "side": side, "model": model_words(item)} | values)
    return rows


def share_along(table: SurfaceTable, step: Any) -> float:
    """Return the share of the base ray's incident flux, 0 … 1, that goes on along the design path at a `DesignStep`."""
    along = normals(table, step.surface, step.point[None])[0] if step.surface < len(table.pieces) else step.normal
    cosine = min(abs(float(step.before @ along)), 1.0)
    r, t = table.optics.shares(step.surface, step.from_front, np.array([cosine]))
    loss = _totals(table, step.surface, table.interfaces[step.surface].scatter, step.from_front, cosine).loss
    share, event = (r, "reflection") if step.reflects else (t, "transmission")
    return float(share[0] * (1 - loss[event][0]))


def coating_words(coating: Any) -> str:
    """Return a short description of a coating: "bare", or its name, if it has one, with its R and T or its kind."""
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
    """Return the scatter models of an interface in words; "-" if it has none."""
    return " + ".join(model_words(item) for item in interface.scatterers) or "-"


def model_words(item: Any) -> str:
    """Return a scatter model with its numbers other than defaults in words, such as "harvey_shack rms_nm 4"."""
    model = item.model
    shown = []
    for f in dataclasses.fields(model) if dataclasses.is_dataclass(model) else ():
        value = getattr(model, f.name)
        if isinstance(value, int | float) and not isinstance(value, bool) and value != f.default:
            shown.append(f"{f.name} {value:.4g}")
    return " ".join([item.kind, *shown])


def _treatments(frame: pd.DataFrame) -> pd.DataFrame:
    """
    Return a DataFrame of groups of surfaces with equal role, side, coating, scatter, R, T, TIS and A, percent.

    Each has its "count" of rows of `frame` and the names of their surfaces. Groups are sorted by role, then by count,
    the largest first.
    """
    numbers = ["R_percent", "T_percent", *TIS, "A_percent"]
    keys = ["role", "side", "coating", "scatter", *numbers]
    rounded = frame.assign(**{name: frame[name].round(SAME_DIGITS) for name in numbers})
    groups = rounded.groupby(keys, sort=False).surface.agg(["size", lambda names: ", ".join(names)])
    groups.columns = pd.Index(["count", "surfaces"])
    order = {kind: k for k, kind in enumerate(("optic", "bevel or edge", "other optic", "structure", "detector"))}
    table = groups.reset_index()
    table = table.sort_values(["role", "count"], key=lambda c: c.map(order) if c.name == "role" else -c, kind="stable")
    return table[["role", "side", "count", "coating", *numbers, "scatter", "surfaces"]].reset_index(drop=True)

"""Kinds of terms of a merit: metrics of traces and point source transmittances, and properties of coating layers."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import fields
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.analyses.optimize.study.model import CoatingGroup, Term
from mistray.analyses.pst.metrics.by_name import FACTORIES, OF_PST
from mistray.analyses.pst.metrics.by_name import own_arguments as arguments_of_metric
from mistray.analyses.pst.run import pst
from mistray.errors import MistrayError
from mistray.metrics.combined_metric import combine
from mistray.metrics.metric import Metric
from mistray.metrics.observation import smooth_maximum, smooth_minimum
from mistray.trace import Settings, trace

SOFT_NM = 0.2  # of the smooth minimum of thicknesses
PRESENT_NM = 5.0  # total thickness at which a material counts as 63 % of one
LIGHT = ("wavelength_nm", "weights")
# Arguments of a trace or of a PST that a metric sets itself, or cannot have
FIXED = ("scene", "seed", "field_deg", "method", "convention", "relative_error", "error_up_to_deg", "paths",
         "map_pixels", "state", "resume", "progress", "settings", "ledger", "seconds", "recorders",
         "next_order")  # fmt: skip
RAYS, FLUX_THRESHOLD = 10_000, 0.0  # of traces, unless the study says otherwise

Thicknesses = Mapping[str, np.ndarray]  # by name of the coating, (layers,) nm


def layer_minimum(
    thicknesses: Thicknesses, materials: Mapping[str, Sequence[str]]
) -> tuple[float, dict[str, np.ndarray]]:
    """
    Return the smooth minimum of the layer thicknesses, nm, and its derivatives.

    It is -s ln Σ exp(-d/s) over the thicknesses d, with s = `SOFT_NM`: at most s ln(layers) below the least of them.

    Parameters
    ----------
    thicknesses : mapping
        Name of the coating → (layers,) float64, nm.
    materials : mapping
        Name of the coating → materials of its layers; not used.

    Returns
    -------
    (float, dict)
        The minimum, nm, and its derivatives in the form of `thicknesses`.
    """
    least = min(float(np.min(d)) for d in thicknesses.values())
    shares = {name: np.exp((least - d) / SOFT_NM) for name, d in thicknesses.items()}
    total = sum(float(np.sum(share)) for share in shares.values())
    return least - SOFT_NM * float(np.log(total)), {name: share / total for name, share in shares.items()}


def total_thickness(
    thicknesses: Thicknesses, materials: Mapping[str, Sequence[str]]
) -> tuple[float, dict[str, np.ndarray]]:
    """Return the total thickness of all layers, nm, each coating once, and its derivatives, as `layer_minimum` does."""
    return sum(float(np.sum(d)) for d in thicknesses.values()), {n: np.ones_like(d) for n, d in thicknesses.items()}


def material_count(
    thicknesses: Thicknesses, materials: Mapping[str, Sequence[str]]
) -> tuple[float, dict[str, np.ndarray]]:
    """
    Return the smooth number of materials and its derivatives, 1/nm.

    It is Σ (1 - exp(-t/5 nm)) over the total thickness t of each material, so that one whose layers have shrunk to
    nothing does not count. For the arguments see `layer_minimum`.
    """
    totals: dict[str, float] = {}
    for name, d in thicknesses.items():
        for material, thickness in zip(materials[name], d, strict=True):
            totals[material] = totals.get(material, 0.0) + float(thickness)
    left = {material: float(np.exp(-total / PRESENT_NM)) for material, total in totals.items()}
    by_thickness = {n: np.array([left[m] / PRESENT_NM for m in materials[n]]) for n in thicknesses}
    return len(left) - sum(left.values()), by_thickness


OF_LAYERS: dict[str, Callable[..., tuple[float, dict[str, np.ndarray]]]] = {
    "layer_minimum": layer_minimum,
    "total_thickness": total_thickness,
    "materials": material_count,
}
UNITS_OF_LAYERS = {"layer_minimum": "nm", "total_thickness": "nm", "materials": "1"}
KINDS = (*FACTORIES, *OF_LAYERS)


def of_layers(term: Term) -> bool:
    """True if a term is a property of coating layers, which needs no trace."""
    return term.kind in OF_LAYERS


def of_pst(term: Term) -> bool:
    """True if a term is a metric of a point source transmittance (PST)."""
    return term.kind in OF_PST


def own_arguments(kind: Any) -> dict[str, bool]:
    """Return the arguments of a kind of term other than trace settings, by name; True: the argument is required."""
    if kind in OF_LAYERS:
        return {"coatings": False}
    return arguments_of_metric(kind if callable(kind) else FACTORIES[kind])


def traced_arguments(kind: Any) -> tuple[str, ...]:
    """
    Return the names of the trace settings that a kind of term accepts.

    Those in `FIXED` are left out, such as the seed, which the optimizer sets. A kind on coating layers accepts none.
    """
    if kind in OF_LAYERS:
        return ()
    settings = [f.name for f in fields(Settings) if f.name != "seed"]
    named = [name for name in inspect.signature(pst if kind in OF_PST else trace).parameters if name not in FIXED]
    return tuple(dict.fromkeys(["pst_field_deg" if kind in OF_PST else "field_deg", *named, *settings]))


def cell_settings(traced: Mapping[str, Any], field_deg: float | None, line: int | None) -> dict[str, Any]:
    """
    Return the trace settings that restrict a term to one field, degrees, and to the wavelength of index `line`.

    None stands for all fields or all wavelengths. A single wavelength gets a share of the rays by its weight.
    """
    changes: dict[str, Any] = {} if field_deg is None else {"field_deg": (field_deg,)}
    if line is not None:
        lines = traced["wavelength_nm"]
        weights = np.array(traced.get("weights") or [1.0] * len(lines))
        rays = max(1, round(float(weights[line] / weights.sum()) * traced.get("rays", RAYS)))
        # As many entries as a term of one wavelength has, so that a function of one's own need not tell them apart
        changes |= {"wavelength_nm": (lines[line],), "weights": (1.0,), "rays": rays}
    return changes


def traced_metric(term: Term, scene: Any, seed: int, **changes: Any) -> Metric:
    """
    Return the metric of a term, or a smooth extreme over fields and wavelengths if `Term.worst` asks for the worst.

    `seed` is that of the traces; `changes` replace their settings.
    """
    traced = {**term.traced, **changes}
    fields, lines = (
        range(len(values)) if term.worst in (over, "both") and isinstance(values, Sequence) else (None,)
        for over, values in (("field", traced.get("field_deg")), ("wavelength", traced.get("wavelength_nm")))
    )
    cells = [(None if i is None else traced["field_deg"][i], k) for i in fields for k in lines]
    parts = {
        f"{angle} {k}": _plain_metric(term, scene, seed, **{**changes, **cell_settings(traced, angle, k)})
        for angle, k in cells
    }
    if len(parts) == 1:
        return next(iter(parts.values()))
    extreme = smooth_minimum if term.goal == "at_least" else smooth_maximum
    first = next(iter(parts.values()))
    return combine(parts, lambda values: extreme(_joined(values.values())), first.unit, f"worst {first.name}")


def _joined(numbers: Collection[Any]) -> mi.Float64:
    """Return several numbers as one differentiable Dr.Jit array, (numbers,)."""
    places = dr.arange(mi.UInt32, len(numbers))
    return sum((dr.select(places == k, value, 0.0) for k, value in enumerate(numbers)), start=mi.Float64(0.0))


def _plain_metric(term: Term, scene: Any, seed: int, **changes: Any) -> Metric:
    make = term.kind if callable(term.kind) else FACTORIES[term.kind]
    usual = {} if of_pst(term) else {"rays": RAYS, "flux_threshold": FLUX_THRESHOLD}
    return make(scene, **term.own, **{**usual, **term.traced, "seed": seed, **changes})


def layer_value(
    term: Term, coatings: Sequence[CoatingGroup], keys: Mapping[str, str], parameters: Mapping[str, np.ndarray]
) -> tuple[float, dict[str, np.ndarray]]:
    """
    Return the value of a coating-layer term, in its unit, and its derivatives with respect to the thicknesses.

    Parameters
    ----------
    term : Term
        Term of the study.
    coatings : sequence of CoatingGroup
        Coatings of the study.
    keys : mapping of str to str
        Name of a coating → key of its thicknesses.
    parameters : mapping of str to (layers,) float64
        Thicknesses by that key, nm; other keys are ignored.

    Returns
    -------
    (float, dict)
        The value, in the unit of the term, and its derivatives by key, (layers,).
    """
    named = term.own.get("coatings")
    chosen = [group for group in coatings if named is None or group.name in named]
    thicknesses = {group.name: parameters[keys[group.name]] for group in chosen}
    materials = {group.name: [layer.material for layer in group.start.layers] for group in chosen}
    value, slopes = OF_LAYERS[term.kind](thicknesses, materials)
    return value, {keys[name]: slope for name, slope in slopes.items()}


def check_worst(term: Term) -> None:
    """Raise `MistrayError` if `worst` of a term does not suit its kind, or its number of fields or wavelengths."""
    for over, key in (("field", "field_deg"), ("wavelength", "wavelength_nm")):
        if term.worst not in (over, "both"):
            continue
        if of_layers(term) or of_pst(term):
            raise MistrayError(f'worst = "{term.worst}" is for metrics of traces; remove it')
        if len(term.traced.get(key) or ()) < 2:
            raise MistrayError(f'worst = "{term.worst}" needs two {key} or more; give them, or remove it')


def check_term(term: Term) -> None:
    """
    Check a term as far as is possible without a scene; a term on layers needs no check.

    Raises
    ------
    MistrayError
        If the term is wrong; the message is one line without the name of the term.
    """
    if of_layers(term):
        return
    try:
        Settings(**{key: value for key, value in term.traced.items() if key in Settings.__dataclass_fields__})
        traced_metric(term, None, 0)
    except MistrayError:
        raise
    except (TypeError, ValueError) as error:  # text where a number is meant, and the like
        raise MistrayError(f"its arguments do not fit: {error}; see docs/optimization.md") from None

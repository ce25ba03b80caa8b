"""Scatter models on the command line: their parameters as options, and the model that given options make."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from mistray._variant import ensure_variant, plugins_of_others
from mistray.analyses.bsdf.request import BsdfRequest
from mistray.errors import MistrayError
from mistray.materials import refractive_index
from mistray.named_values import as_number, named_values
from mistray.param import Param
from mistray.physics.abg import AbgFromRms, abg_from_rms
from mistray.ranges import FINITE, FLAG, TEXT, Range, Words, number_text
from mistray.scatter import Placement
from mistray.scatter.kinds import KINDS
from mistray.scatter.lobe import PLACEMENT
from mistray.toolkit.command import Group, Option
from mistray.toolkit.field_options import flag

METAVARS = {"nm": "NM", "um": "UM", "mm": "MM", "%": "PERCENT", "file": "FILE", "string": "TEXT"}
# What the command takes beside the parameters of a model, and makes them of
FROM_ROUGHNESS = {
    "rms_nm": Param("nm", doc="roughness, with --correlation-um instead of A, B and g"),
    "correlation_um": Param("um", doc="from --rms-nm: length of the exponential autocovariance"),
    "delta_n": Param(doc="from --rms-nm: index step (2, a mirror in air; in transmission that of the materials)"),
    "raw_integral": Param(doc="from --rms-nm: integral to normalise by, instead of the exact one"),
}
MADE_OF = {
    "abg": FROM_ROUGHNESS,
    "polynomial": {"coefficients": Param("string", TEXT, "c000=-0.5,c100=-0.4,l10=-0.7")},
}
TABLES = (".bsdf", ".anisotropicbsdf", ".csv")


def _kinds() -> Mapping[str, Any]:
    """
    Return the classes of scatter models by name.

    If other packages have plugins, Mitsuba and these plugins are imported first.
    """
    if plugins_of_others():
        ensure_variant()
    return KINDS


def known_models() -> str:
    """Return the names that are accepted as a scatter model, as text."""
    return f"{', '.join(_kinds())}, a file .bsdf, .anisotropicbsdf or .csv, or ABG_DATA.DAT:NAME"


def parameters(kind: str) -> dict[str, Param]:
    """
    Return the parameters that the command line takes for a kind of model, by name.

    Those of the placement, such as `event`, are not among them; those from which the command computes others are.
    """
    own = KINDS[kind].params().items()
    return {name: param for name, param in own if name not in PLACEMENT} | MADE_OF.get(kind, {})


def parameter_options() -> Group:
    """Return the parameters of all models as command-line options; models share one that has the same name."""
    shared: dict[str, dict[str, Param]] = {}
    for kind in _kinds():
        for key, param in parameters(kind).items():
            shared.setdefault(key, {})[kind] = param
    options = []
    for key, by_kind in shared.items():
        told: dict[str, list[str]] = {}
        for kind, param in by_kind.items():
            unit = "" if param.unit == "1" or not isinstance(param.values, Range) else f", {param.unit}"
            told.setdefault(f"{param.doc.replace('``', '')}{unit}", []).append(f"{kind}{_default(kind, key)}")
        text = "; ".join(f"{', '.join(kinds)}: {what}" for what, kinds in told.items())
        options.append(Option(flag(key), text, *_form(list(by_kind.values()))))
    return Group("parameters of the models", tuple(options))


def _default(kind: str, key: str) -> str:
    """Return the default of a scatter model's parameter as text in parentheses; "" if there is none, or it is 0."""
    default = {field.name: field.default for field in fields(KINDS[kind])}.get(key)
    if not default or default is MISSING:
        return ""
    return f" ({number_text(default) if isinstance(default, float) else default})"


def _form(params: list[Param]) -> tuple[Any, str | None]:
    """Return the type, and the placeholder or None, of the option that the parameters of one name share."""
    values = params[0].values
    if values is FLAG:
        return bool, None
    if isinstance(values, Words):
        choices = [word for param in params if isinstance(param.values, Words) for word in param.values.choices]
        return tuple(dict.fromkeys(choices)), None
    return FINITE if isinstance(values, Range) else None, METAVARS.get(params[0].unit, "X")


def kind_of(name: str) -> str:
    """
    Return the kind of scatter model that a model name, a table file or ABG_DATA.DAT:NAME stands for.

    Raises
    ------
    MistrayError
        If no model has this name.
    """
    kind = "tabulated" if name.lower().endswith(TABLES) else "abg" if ".dat:" in name.lower() else name
    if kind not in KINDS:
        raise MistrayError(f"scatter model '{name}' is unknown; use {known_models()}")
    return kind


def given(name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return the parameters of a scatter model that the command line sets, by name.

    `name` and `options` are those of `model_of`.

    Raises
    ------
    MistrayError
        If no model has this name, an option belongs to another one, or a file states what an option repeats.
    """
    kind = kind_of(name)
    allowed = parameters(kind)
    if kind != name:  # a file: what it says is not said again
        allowed = {key: param for key, param in allowed.items() if key != "file" and key not in MADE_OF.get(kind, {})}
    every = dict.fromkeys(key for known in (allowed, *map(parameters, KINDS)) for key in known)
    found = {key: value for key in every if (value := options[key]) is not None and value is not False}
    for key in found:
        if key not in allowed:
            raise MistrayError(f"{name} has no {flag(key)}; its options are {', '.join(map(flag, allowed))}")
    return found


def model_of(name: str, options: Mapping[str, Any], request: BsdfRequest) -> tuple[Placement, str, AbgFromRms | None]:
    """
    Return a scatter model, its title, and the calculation of A, B and g from a roughness.

    The calculation is None unless the model is `abg` and ``rms_nm`` is given.

    Parameters
    ----------
    name : str
        Name of a model, a file .bsdf, .anisotropicbsdf or .csv, or ABG_DATA.DAT:NAME.
    options : mapping
        Value by parameter, in the unit of the parameter; None, or False for a flag, where it is not given.
    request : BsdfRequest
        Wavelength, reflectance and materials.

    Raises
    ------
    MistrayError
        If there is none of this name, a file cannot be read, or a parameter is out of range. Also if an option is
        missing, belongs to another model or excludes another one.
    """
    kind, found = kind_of(name), given(name, options)
    parts = [f"{key} = {value:g}" if isinstance(value, float) else f"{key} {value}" for key, value in found.items()]
    title = " ".join([name if name in KINDS else Path(name).name, ", ".join(parts)]).rstrip()
    sheet = _roughness_sheet(found, request) if kind == name == "abg" and "rms_nm" in found else None
    if sheet is not None:  # R or T is in A
        found = {"A": sheet.a, "B": sheet.b, "g": sheet.g, "relative_to": "incident", "event": "reflection"}
    for key in FROM_ROUGHNESS.keys() - {"rms_nm"} & found.keys():
        raise MistrayError(f"abg: {flag(key)} is for parameters from a roughness; give --rms-nm as well")
    if "preset" in found and len(found) > 1:
        key = next(key for key in found if key != "preset")
        raise MistrayError(f"paint: {flag(key)} with a preset, which has its own numbers; leave one out")
    if "coefficients" in found:
        found |= _coefficients(found.pop("coefficients"))
    if kind != name:
        found["file"] = name
    if request.event is not None:
        found["event"] = request.event
    return KINDS[kind].of(**found), title, sheet


def _roughness_sheet(found: Mapping[str, Any], request: BsdfRequest) -> AbgFromRms:
    """
    Return A, B and g of an ABg model that follow from the rms roughness, nm, and correlation length, µm, in `found`.

    Raises
    ------
    MistrayError
        If a parameter that it replaces is given, or the correlation length is missing.
    """
    for key in ("A", "B", "g", "reference_nm", "file"):
        if key in found:
            raise MistrayError(f"abg: --rms-nm gives A, B and g; leave {flag(key)} out")
    if "correlation_um" not in found:
        raise MistrayError("abg from --rms-nm needs --correlation-um; --correlation-um is missing")
    sides = [refractive_index(material, request.wavelength_nm) for material in (request.front, request.back)]
    own, share = (abs(sides[0] - sides[1]), request.T) if request.event == "transmission" else (2.0, request.R)
    lengths_um = found["rms_nm"] * 1e-3, found["correlation_um"], request.wavelength_nm * 1e-3
    return abg_from_rms(*lengths_um, found.get("delta_n", own), share, found.get("raw_integral"))


def _coefficients(text: str) -> dict[str, float]:
    """Return the coefficients of a polynomial scatter model by name, from text such as NAME=X,…."""
    owner = f"--coefficients '{text}'"
    return {name: as_number(value, name, owner) for name, value in named_values(text.split(","), owner).items()}

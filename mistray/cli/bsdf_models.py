"""Scatter models of the command line: their parameters as options, and how these become a model."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any

from mistray.errors import MistrayError
from mistray.named_values import as_number, named_values
from mistray.param import Param
from mistray.ranges import FINITE, FLAG, TEXT, Range, Words, number_text
from mistray.toolkit.command import Group, Option
from mistray.toolkit.field_options import flag

if TYPE_CHECKING:
    from mistray.physics.abg import AbgFromRms
    from mistray.scatter import Placement

DELTA_N = 2.0  # of a mirror in air
PLACEMENT = ("event", "side", "relative_to")
METAVARS = {"nm": "NM", "um": "UM", "mm": "MM", "%": "PERCENT", "file": "FILE", "string": "TEXT"}
# What the command takes beside the parameters of a model, and makes them of
FROM_ROUGHNESS = {
    "rms_nm": Param("nm", doc="roughness, with --correlation-um instead of A, B and g"),
    "correlation_um": Param("um", doc="from --rms-nm: length of the exponential autocovariance"),
    "delta_n": Param(doc="from --rms-nm: difference of the indices (2, a mirror in air)"),
    "raw_integral": Param(doc="from --rms-nm: integral to normalise by, instead of the exact one"),
}
MADE_OF = {
    "abg": FROM_ROUGHNESS,
    "polynomial": {"coefficients": Param("string", TEXT, "c000=-0.5,c100=-0.4,l10=-0.7")},
}


def models() -> Mapping[str, type[Placement]]:
    """The models by name."""
    from mistray.scatter.kinds import KINDS  # NumPy; the help of another command does without it

    return KINDS


def parameters(kind: str) -> dict[str, Param]:
    """The options of a model by the names of its parameters; `--event` is one of the command."""
    own = models()[kind].params().items()
    return {name: param for name, param in own if name not in PLACEMENT} | MADE_OF.get(kind, {})


def model_argument() -> Option:
    """The model."""
    files = "a file .bsdf, .anisotropicbsdf or .csv, or ABG_DATA.DAT:NAME"
    return Option("model", f"{', '.join(models())}, {files}", metavar="MODEL")


def parameter_options() -> Group:
    """The parameters of all models; one that several have means the same in all."""
    shared: dict[str, dict[str, Param]] = {}
    for kind in models():
        for key, param in parameters(kind).items():
            shared.setdefault(key, {})[kind] = param
    options = []
    for key, by_kind in shared.items():
        told: dict[str, list[str]] = {}
        for kind, param in by_kind.items():
            unit = "" if param.unit == "1" or not isinstance(param.values, Range) else f", {param.unit}"
            told.setdefault(f"{param.doc}{unit}", []).append(f"{kind}{_default(kind, key)}")
        text = "; ".join(f"{', '.join(kinds)}: {what}" for what, kinds in told.items())
        options.append(Option(flag(key), text, *_form(list(by_kind.values()))))
    return Group("parameters of the models", tuple(options))


def _default(kind: str, key: str) -> str:
    """The default of a parameter of a model, in brackets."""
    default = {field.name: field.default for field in fields(models()[kind])}.get(key)
    if not default or default is MISSING:
        return ""
    return f" ({number_text(default) if isinstance(default, float) else default})"


def _form(params: Sequence[Param]) -> tuple[Any, str | None]:
    """Type and placeholder of an option; models check the ranges of numbers, which are not the same in all."""
    values = params[0].values
    if values is FLAG:
        return bool, None
    if isinstance(values, Words):
        choices = [word for param in params if isinstance(param.values, Words) for word in param.values.choices]
        return tuple(dict.fromkeys(choices)), None
    return FINITE if isinstance(values, Range) else None, METAVARS.get(params[0].unit, "X")


def kind_of(name: str) -> str:
    """
    The model that a name or a file stands for.

    Raises
    ------
    MistrayError
        If there is none.
    """
    tables = (".bsdf", ".anisotropicbsdf", ".csv")
    kind = "tabulated" if name.lower().endswith(tables) else "abg" if ".dat:" in name.lower() else name
    if kind not in models():
        raise MistrayError(
            f"scatter model '{name}' is unknown; use {', '.join(models())}, a file .bsdf, .anisotropicbsdf or .csv, or "
            "ABG_DATA.DAT:NAME"
        )
    return kind


def given(options: argparse.Namespace) -> dict[str, Any]:
    """
    The parameters that a command line gives.

    Raises
    ------
    MistrayError
        If one belongs to another model.
    """
    kind = kind_of(options.model)
    allowed = parameters(kind)
    if kind != options.model:  # a file: what it says is not said again
        allowed = {key: param for key, param in allowed.items() if key != "file" and key not in MADE_OF.get(kind, {})}
    every = dict.fromkeys(key for known in (allowed, *map(parameters, models())) for key in known)
    found = {key: value for key in every if (value := getattr(options, key)) is not None and value is not False}
    for key in found:
        if key not in allowed:
            raise MistrayError(f"{options.model} has no {flag(key)}; its options are {', '.join(map(flag, allowed))}")
    return found


def model_of(options: argparse.Namespace) -> Placement:
    """
    The model that a command line asks for.

    Parameters
    ----------
    options : argparse.Namespace
        `model` is a name, a file .bsdf, .anisotropicbsdf or .csv, or ABG_DATA.DAT:NAME.

    Raises
    ------
    MistrayError
        If there is none of this name, an option is missing or belongs to another model, or a parameter is out of range.
    """
    kind, found = kind_of(options.model), given(options)
    sheet = roughness_sheet(options)
    if sheet is not None:  # R is in A
        found = {"A": sheet.a, "B": sheet.b, "g": sheet.g, "relative_to": "incident", "event": "reflection"}
    for key in FROM_ROUGHNESS.keys() - {"rms_nm"} & found.keys():
        raise MistrayError(f"abg: {flag(key)} is for parameters from a roughness; give --rms-nm as well")
    if "preset" in found and len(found) > 1:
        key = next(key for key in found if key != "preset")
        raise MistrayError(f"paint: {flag(key)} with a preset, which has its own numbers; leave one out")
    if "coefficients" in found:
        found |= _coefficients(found.pop("coefficients"))
    if kind != options.model:
        found["file"] = options.model
    if options.event is not None:
        found["event"] = options.event
    return models()[kind].of(**found)


def roughness_sheet(options: argparse.Namespace) -> AbgFromRms | None:
    """
    The parameters of an abg from `--rms-nm`, or None if its parameters are given.

    Raises
    ------
    MistrayError
        If both are given, the length is missing, or the surface is not smooth.
    """
    from mistray.physics.abg import abg_from_rms

    if options.model != "abg" or options.rms_nm is None:
        return None
    for key in ("A", "B", "g", "reference_nm", "file"):
        if getattr(options, key) is not None:
            raise MistrayError(f"abg: --rms-nm gives A, B and g; leave {flag(key)} out")
    if not options.correlation_um:
        raise MistrayError("abg from --rms-nm needs --correlation-um; --correlation-um is missing")
    delta_n = DELTA_N if options.delta_n is None else options.delta_n
    return abg_from_rms(
        options.rms_nm * 1e-3, options.correlation_um, options.wavelength_nm * 1e-3, delta_n, options.R,
        options.raw_integral,
    )  # fmt: skip


def _coefficients(text: str) -> dict[str, float]:
    """Coefficients of a polynomial from the form NAME=X,…."""
    owner = f"--coefficients '{text}'"
    return {name: as_number(value, name, owner) for name, value in named_values(text.split(","), owner).items()}

"""Scatter models of the command line: which options each takes, and how they become a model."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from mistray.cli.command import Group, Option
from mistray.cli.shared import flag
from mistray.errors import MistrayError
from mistray.ranges import FINITE

if TYPE_CHECKING:
    from mistray.physics.abg import AbgFromRms
    from mistray.scatter import Scatter

DELTA_N = 2.0  # of a mirror in air


# fmt: off
# By the names of the models' own parameters; one that several models have means the same in all
GROUP = Group("parameters of the models", (
    Option("--A", "abg: A, 1/sr", FINITE, "X"),
    Option("--B", "abg: B", FINITE, "X"),
    Option("--g", "abg: slope g", FINITE, "X"),
    Option("--b0", "harvey_shack, paint, phong: BSDF in the specular direction, 1/sr", FINITE, "X"),
    Option("--l", "harvey_shack, paint: place of the knee, a direction cosine", FINITE, "X"),
    Option("--s", "harvey_shack, paint: slope, negative", FINITE, "X"),
    Option("--rms-nm", "harvey_shack, k_correlation, or abg with --correlation-um: roughness, nm", FINITE, "NM"),
    Option("--correlation-um", "abg from --rms-nm: length of the exponential autocovariance, µm", FINITE, "UM"),
    Option("--delta-n", "abg from --rms-nm: difference of the indices, 2 for a mirror in air (2)", FINITE, "X"),
    Option("--raw-integral", "abg from --rms-nm: integral to normalise by, instead of the exact one", FINITE, "X"),
    Option("--reference-nm", "abg, harvey_shack, k_correlation: where the numbers hold", FINITE, "NM"),
    Option("--B-um", "k_correlation: B, µm", FINITE, "UM"),
    Option("--slope", "k_correlation, particulate: slope of the spectrum or of the particle distribution", FINITE, "X"),
    Option("--band-limited", "k_correlation: the roughness is that of the band up to 1/wavelength", bool),
    Option("--theory", "k_correlation, psd_table: theory (ghs)",
           ("ghs", "ghs_full", "rayleigh_rice", "rayleigh_rice_vector")),
    Option("--width-mm", "edge_diffraction: width of the ring inside the edge, mm", FINITE, "MM"),
    Option("--law", "edge_diffraction: tail of a half plane, or after Heisenberg (half_plane)",
           ("half_plane", "heisenberg")),
    Option("--total", "gaussian_lobe: scattered share at normal incidence", FINITE, "X"),
    Option("--width", "gaussian_lobe: |β - β0| where the BSDF has fallen to 1/e", FINITE, "X"),
    Option("--exponent", "phong: power of the cosine", FINITE, "X"),
    Option("--level", "particulate: cleanliness level of IEST-STD-CC1246", FINITE, "X"),
    Option("--coverage-percent", "particulate: percent area coverage, instead of the level", FINITE, "PERCENT"),
    Option("--particle", "particulate: n + ik of the particles: 'dust', 1.53+0.002i, or file.csv", metavar="X"),
    Option("--min-um", "particulate: least diameter, µm", FINITE, "UM"),
    Option("--max-um", "particulate: greatest diameter, µm", FINITE, "UM"),
    Option("--reflectance", "paint: reflectance of its Lambertian part", FINITE, "X"),
    Option("--n", "paint: index of the binder, with which the lobe grows towards grazing angles", FINITE, "X"),
    Option("--preset", "paint: a named paint", metavar="X"),
    Option("--cosine-corrected", "table: its values are BSDF times the cosine of the scattered direction", bool),
    Option("--coefficients", "polynomial: c000=-0.5,c100=-0.4,l10=-0.7", metavar="NAME=X,…"),
    Option("--d", "polynomial: the Lorentzian part bends at |β - β0| = d^(-j/2) (1e4)", FINITE, "X"),
    Option("--file", "psd_table: CSV file of the spectrum", metavar="FILE"),
    Option("--scale", "psd_table: factor of the spectrum (1)", FINITE, "X"),
    Option("--anisotropy", "table: rotations of the sample that differ (error)", ("error", "mean", "keep")),
    Option("--beyond", "table: what holds past its last polar angle (error); psd_table: above its last frequency",
           ("error", "hold", "slope", "zero")),
))
# fmt: on
NAMES = tuple(option.dest for option in GROUP.options)


@dataclass(frozen=True)
class Kind:
    """
    A model of the command line.

    Attributes
    ----------
    options : tuple of str
        Names of the parameters that it takes.
    make : callable
        Given parameters of the model, all options → model.
    needs : tuple of str
        Parameters that must be given.
    """

    options: tuple[str, ...]
    make: Callable[[dict[str, Any], argparse.Namespace], Scatter]
    needs: tuple[str, ...] = ()


def given(options: argparse.Namespace) -> dict[str, Any]:
    """The parameters that a command line gives."""
    return {name: value for name in NAMES if (value := getattr(options, name)) is not None and value is not False}


def model_of(name: str, options: argparse.Namespace) -> Scatter:
    """
    The model that a command line asks for.

    Parameters
    ----------
    name : str
        A key of `KINDS`, a file .bsdf or .csv, or ABG_DATA.DAT:NAME.
    options : argparse.Namespace

    Raises
    ------
    MistrayError
        If there is none of this name, an option is missing or belongs to another model, or a parameter is out of range.
    """
    found = given(options)
    is_table, is_catalogue = name.lower().endswith((".bsdf", ".csv")), ".dat:" in name.lower()
    kind = TABLE if is_table else CATALOGUE if is_catalogue else KINDS.get(name)
    if kind is None:
        files = "a file .bsdf or .csv, or ABG_DATA.DAT:NAME"
        raise MistrayError(f"scatter model '{name}' is unknown; use {', '.join(KINDS)}, {files}")
    for key in found:
        if key not in kind.options:
            allowed = ", ".join(map(flag, kind.options))
            raise MistrayError(f"{name} has no {flag(key)}; its options are {allowed}")
    if options.event is not None:
        found["event"] = options.event
    if is_table or is_catalogue:
        found["file"] = name
    _require(name, found, kind.needs)
    return kind.make(found, options)


def _require(name: str, given: dict[str, Any], keys: Sequence[str]) -> None:
    missing = [flag(key) for key in keys if key not in given]
    if missing:
        raise MistrayError(f"{name} needs {', '.join(map(flag, keys))}; {', '.join(missing)} is missing")


def _abg(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
    from mistray.scatter.abg import ABg

    sheet = roughness_sheet(options)
    if sheet is not None:
        return ABg(sheet.a, sheet.b, sheet.g, relative_to="incident", event=options.event or "reflection")  # R is in A
    for key in ("correlation_um", "delta_n", "raw_integral"):
        if key in given:
            raise MistrayError(f"abg: {flag(key)} is for parameters from a roughness; give --rms-nm as well")
    _require("abg", given, ("A", "B", "g"))
    return ABg(**given)


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
    for key in ("A", "B", "g", "reference_nm"):
        if getattr(options, key) is not None:
            raise MistrayError(f"abg: --rms-nm gives A, B and g; leave {flag(key)} out")
    length = {"correlation_um": options.correlation_um} if options.correlation_um else {}
    _require("abg from --rms-nm", length, ("correlation_um",))
    delta_n = DELTA_N if options.delta_n is None else options.delta_n
    return abg_from_rms(
        options.rms_nm * 1e-3, options.correlation_um, options.wavelength_nm * 1e-3, delta_n, options.R,
        options.raw_integral,
    )  # fmt: skip


def _polynomial(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
    from mistray.scatter.polynomial import Polynomial

    named = {}
    for item in given.pop("coefficients").split(","):
        name, _, value = item.partition("=")
        try:
            named[name.strip()] = float(value)
        except ValueError:
            raise MistrayError(
                f"--coefficients '{item}' is no coefficient; write NAME=NUMBER, several between commas"
            ) from None
    return Polynomial(tuple(named.items()), **given)


def _psd_table(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
    from mistray.scatter.measured.psd_table import PsdTable

    return PsdTable.read(given.pop("file"), **given)


def _paint(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
    from mistray.scatter.paint import Paint

    name = given.pop("preset", None)
    if name is None:
        return Paint(**given)
    event = {"event": given.pop("event")} if "event" in given else {}
    if given:
        raise MistrayError(f"paint: {flag(next(iter(given)))} with a preset, which has its own numbers; leave one out")
    return Paint.preset(name, **event)


def _catalogue(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
    from mistray.scatter.measured.zemax_abg import abg_from_catalogue

    return abg_from_catalogue(given.pop("file"), **given)


def _table(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
    from mistray.scatter.measured.tabulated import Tabulated

    return Tabulated.read(given.pop("file"), **given)


def _class(module: str, name: str) -> Callable[[dict[str, Any], argparse.Namespace], Scatter]:
    """What makes a model of a class in `mistray.scatter` whose arguments are the parameters."""

    def make(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
        model: Scatter = getattr(import_module(f"mistray.scatter.{module}"), name)(**given)
        return model

    return make


# fmt: off
KINDS: Mapping[str, Kind] = MappingProxyType({
    "abg": Kind(("A", "B", "g", "reference_nm", "rms_nm", "correlation_um", "delta_n", "raw_integral"), _abg),
    "harvey_shack": Kind(("b0", "l", "s", "rms_nm", "reference_nm"), _class("harvey_shack", "HarveyShack")),
    "k_correlation": Kind(("rms_nm", "B_um", "slope", "band_limited", "theory", "reference_nm"),
                          _class("k_correlation", "KCorrelation"), ("rms_nm", "B_um", "slope")),
    "gaussian_lobe": Kind(("total", "width"), _class("gaussian", "Gaussian"), ("total", "width")),
    "psd_table": Kind(("file", "scale", "beyond", "theory"), _psd_table, ("file",)),
    "polynomial": Kind(("coefficients", "d"), _polynomial, ("coefficients",)),
    "phong": Kind(("b0", "exponent"), _class("phong", "Phong"), ("b0", "exponent")),
    "particulate": Kind(("level", "coverage_percent", "slope", "particle", "min_um", "max_um"),
                        _class("particulate", "Particulate")),
    "edge_diffraction": Kind(("width_mm", "law"), _class("edge_diffraction", "EdgeDiffraction"), ("width_mm",)),
    "paint": Kind(("reflectance", "b0", "l", "s", "n", "preset"), _paint),
})
# fmt: on
CATALOGUE = Kind((), _catalogue)
TABLE = Kind(("cosine_corrected", "beyond", "anisotropy"), _table)

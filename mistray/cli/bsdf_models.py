"""Scatter models of the command line: which options each takes, and how they become a model."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from mistray.errors import MistrayError
from mistray.ranges import FINITE

if TYPE_CHECKING:
    from mistray.physics.abg import AbgFromRms
    from mistray.scatter import Scatter

DELTA_N = 2.0  # of a mirror in air


@dataclass(frozen=True)
class Option:
    """
    One option of a model.

    Attributes
    ----------
    help : str
    type : callable or tuple of str
        Of its value, or its choices; bool for a flag.
    metavar : str, optional
    """

    help: str
    type: Any = FINITE
    metavar: str | None = None


# By the names of the models' own parameters; one that several models have means the same in all
OPTIONS: Mapping[str, Option] = MappingProxyType(
    {
        "A": Option("abg: A, 1/sr"),
        "B": Option("abg: B"),
        "g": Option("abg: slope g"),
        "b0": Option("harvey_shack, paint, phong: BSDF in the specular direction, 1/sr"),
        "l": Option("harvey_shack, paint: place of the knee, a direction cosine"),
        "s": Option("harvey_shack, paint: slope, negative"),
        "rms_nm": Option(
            "harvey_shack, k_correlation, or abg with --correlation-um: roughness, nm", metavar="NM"
        ),
        "correlation_um": Option("abg from --rms-nm: length of the exponential autocovariance, µm", metavar="UM"),
        "delta_n": Option("abg from --rms-nm: difference of the indices, 2 for a mirror in air (2)"),
        "raw_integral": Option("abg from --rms-nm: integral to normalise by, instead of the exact one"),
        "reference_nm": Option("abg, harvey_shack, k_correlation: where the numbers hold", metavar="NM"),
        "B_um": Option("k_correlation: B, µm", metavar="UM"),
        "slope": Option("k_correlation, particulate: slope of the spectrum or of the particle distribution"),
        "band_limited": Option("k_correlation: the roughness is that of the band up to 1/wavelength", bool),
        "theory": Option("k_correlation, psd_table: theory (ghs)",
                         ("ghs", "ghs_full", "rayleigh_rice", "rayleigh_rice_vector")),
        "width_mm": Option("edge_diffraction: width of the ring inside the edge, mm", metavar="MM"),
        "law": Option("edge_diffraction: tail of a half plane, or after Heisenberg (half_plane)",
                      ("half_plane", "heisenberg")),
        "total": Option("gaussian_lobe: scattered share at normal incidence"),
        "width": Option("gaussian_lobe: |β - β0| where the BSDF has fallen to 1/e"),
        "exponent": Option("phong: power of the cosine"),
        "level": Option("particulate: cleanliness level of IEST-STD-CC1246"),
        "coverage_percent": Option("particulate: percent area coverage, instead of the level", metavar="PERCENT"),
        "particle": Option("particulate: n + ik of the particles: 'dust', 1.53+0.002i, or file.csv", str),
        "min_um": Option("particulate: least diameter, µm", metavar="UM"),
        "max_um": Option("particulate: greatest diameter, µm", metavar="UM"),
        "reflectance": Option("paint: reflectance of its Lambertian part"),
        "n": Option("paint: index of the binder, with which the lobe grows towards grazing angles"),
        "preset": Option("paint: a named paint", str),
        "cosine_corrected": Option("table: its values are BSDF times the cosine of the scattered direction", bool),
        "coefficients": Option("polynomial: c000=-0.5,c100=-0.4,l10=-0.7", str, metavar="NAME=X,…"),
        "d": Option("polynomial: the Lorentzian part bends at |β - β0| = d^(-j/2) (1e4)"),
        "file": Option("psd_table: CSV file of the spectrum", str, metavar="FILE"),
        "scale": Option("psd_table: factor of the spectrum (1)"),
        "anisotropy": Option("table: rotations of the sample that differ (error)", ("error", "mean", "keep")),
        "beyond": Option("table: what holds past its last polar angle (error); psd_table: above its last frequency",
                         ("error", "hold", "slope", "zero")),
    }
)  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """
    A model of the command line.

    Attributes
    ----------
    options : tuple of str
        Keys of `OPTIONS` that it takes.
    make : callable
        Given options of the model, all options → model.
    """

    options: tuple[str, ...]
    make: Callable[[dict[str, Any], argparse.Namespace], Scatter]


def declare(parser: argparse.ArgumentParser) -> None:
    """Add the options of all models to a parser."""
    group = parser.add_argument_group("parameters of the models")
    for key, option in OPTIONS.items():
        name = flag(key)
        if option.type is bool:
            group.add_argument(name, dest=key, action="store_true", default=None, help=option.help)
        elif isinstance(option.type, tuple):
            group.add_argument(name, dest=key, choices=option.type, help=option.help)
        else:
            group.add_argument(name, dest=key, type=option.type, metavar=option.metavar or "X", help=option.help)


def flag(key: str) -> str:
    """The option of a parameter."""
    return f"--{key.replace('_', '-')}"


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
    given = {key: getattr(options, key) for key in OPTIONS if getattr(options, key) is not None}
    is_table, is_catalogue = name.lower().endswith((".bsdf", ".csv")), ".dat:" in name.lower()
    kind = TABLE if is_table else CATALOGUE if is_catalogue else KINDS.get(name)
    if kind is None:
        files = "a file .bsdf or .csv, or ABG_DATA.DAT:NAME"
        raise MistrayError(f"scatter model '{name}' is unknown; use {', '.join(KINDS)}, {files}")
    for key in given:
        if key not in kind.options:
            allowed = ", ".join(map(flag, kind.options))
            raise MistrayError(f"{name} has no {flag(key)}; its options are {allowed}")
    if options.event is not None:
        given["event"] = options.event
    if is_table or is_catalogue:
        given["file"] = name
    return kind.make(given, options)


def _required(name: str, given: dict[str, Any], *keys: str) -> None:
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
    _required("abg", given, "A", "B", "g")
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
    _required("abg from --rms-nm", {"correlation_um": options.correlation_um} if options.correlation_um else {},
              "correlation_um")  # fmt: skip
    delta_n = DELTA_N if options.delta_n is None else options.delta_n
    return abg_from_rms(
        options.rms_nm * 1e-3, options.correlation_um, options.wavelength_nm * 1e-3, delta_n, options.R,
        options.raw_integral,
    )  # fmt: skip


def _harvey_shack(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
    from mistray.scatter.harvey_shack import HarveyShack

    return HarveyShack(**given)


def _k_correlation(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
    from mistray.scatter.k_correlation import KCorrelation

    _required("k_correlation", given, "rms_nm", "B_um", "slope")
    return KCorrelation(**given)


def _edge_diffraction(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
    from mistray.scatter.edge_diffraction import EdgeDiffraction

    _required("edge_diffraction", given, "width_mm")
    return EdgeDiffraction(**given)


def _gaussian(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
    from mistray.scatter.gaussian import Gaussian

    _required("gaussian_lobe", given, "total", "width")
    return Gaussian(**given)


def _phong(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
    from mistray.scatter.phong import Phong

    _required("phong", given, "b0", "exponent")
    return Phong(**given)


def _polynomial(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
    from mistray.scatter.polynomial import Polynomial

    _required("polynomial", given, "coefficients")
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

    _required("psd_table", given, "file")
    return PsdTable.read(given.pop("file"), **given)


def _particulate(given: dict[str, Any], options: argparse.Namespace) -> Scatter:
    from mistray.scatter.particulate import Particulate

    return Particulate(**given)


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


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "abg": Kind(
            ("A", "B", "g", "reference_nm", "rms_nm", "correlation_um", "delta_n", "raw_integral"), _abg
        ),
        "harvey_shack": Kind(("b0", "l", "s", "rms_nm", "reference_nm"), _harvey_shack),
        "k_correlation": Kind(
            ("rms_nm", "B_um", "slope", "band_limited", "theory", "reference_nm"), _k_correlation
        ),
        "gaussian_lobe": Kind(("total", "width"), _gaussian),
        "psd_table": Kind(("file", "scale", "beyond", "theory"), _psd_table),
        "polynomial": Kind(("coefficients", "d"), _polynomial),
        "phong": Kind(("b0", "exponent"), _phong),
        "particulate": Kind(
            ("level", "coverage_percent", "slope", "particle", "min_um", "max_um"), _particulate
        ),
        "edge_diffraction": Kind(("width_mm", "law"), _edge_diffraction),
        "paint": Kind(("reflectance", "b0", "l", "s", "n", "preset"), _paint),
    }
)  # fmt: skip
CATALOGUE = Kind((), _catalogue)
TABLE = Kind(("cosine_corrected", "beyond", "anisotropy"), _table)

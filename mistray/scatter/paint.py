"""Paints and other diffuse surfaces: a Lambertian part and a glossy lobe."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from mistray.errors import MistrayError, errors_of
from mistray.named_values import finite_of
from mistray.param import Param, fixed
from mistray.physics import harvey_shack
from mistray.physics.paint import gain
from mistray.ranges import BINDER_INDEX, SHARE, TEXT
from mistray.scatter.lobe import EVENT, RELATIVE_TO, Lobe, Placement, RatioTable
from mistray.scatter.numbers import FALLING, KNEE, PEAK
from mistray.scatter.total import lobe_total

# Reflectances of presets, all Lambertian; only published numbers are listed here
PRESETS: Mapping[str, float] = MappingProxyType(
    {
        "flat_black": 0.045,  # barrel of a phone camera, at normal incidence; study of that camera with FRED
        "black_lambertian": 0.04,  # FRED's default models
        "white_lambertian": 0.96,
        "good_black_paint": 0.03,  # TracePro webinar on stray light: "several are in the 3 percent range"
        "black_anodise": 0.35,  # the same: "black anodized aluminum can be 35 % reflective"
    }
)
CHECKED_COSINES = np.linspace(0.0, 1.0, 33)
COS_NODES = 257
ROUNDING = 1e-9


@dataclass(frozen=True)
class Paint(Placement):
    """
    Lambertian surface with an optional glossy lobe, BSDF = ρ/π + b0 [1 + (r/l)²]^(s/2) sqrt(F(θi) F(θs))/F(0).

    ρ is the reflectance, r = |β - β0|, and F the unpolarised Fresnel reflectance of the binder's index n; without n the
    last factor is 1. Both parts are reciprocal. The total must be at most 1 at every angle of incidence, because the
    glossy part of a paint with n grows up to 1/F(0) times towards grazing incidence.

    Attributes
    ----------
    reflectance : float
        Reflectance ρ of the Lambertian part, 0 … 1.
    b0 : float
        Peak of the glossy lobe at normal incidence, 1/sr; 0 for no lobe.
    l, s : float
        Shoulder (direction cosine, > 0) and exponent (< 0) of the glossy lobe.
    n : float, optional
        Refractive index of the binder, > 1; about 1.5 for most paints.
    spectrum : str
        Factor of the reflectance over wavelength, nm: ``"400:0.02, 700:0.05"``, linear between its points and unknown
        beyond them. Empty if the reflectance is the same at every wavelength.
    event, side, name
        Options of `Placement`; by default a paint only reflects.
    relative_to : {"incident", "specular"}
        Reference of the BSDF, see `Placement`. By default it is absolute, and its light is taken from the absorbed
        light.

    Raises
    ------
    MistrayError
        If a parameter is out of range, nothing is scattered, or more than all light is scattered at some angle.
    """

    reflectance: float = Param("1", SHARE, "reflectance ρ of the Lambertian part").field(0.0)
    b0: float = replace(PEAK, doc="peak of the glossy lobe at normal incidence").field(0.0)
    l: float = KNEE.field(0.1)  # noqa: E741 (its name in the literature)
    s: float = FALLING.field(-2.0)
    n: float | None = Param(
        "1", BINDER_INDEX, "index of the binder, about 1.5, with which the lobe grows towards grazing angles", 0.0
    ).field(None)
    spectrum: str = fixed(
        "string",
        TEXT,
        "factor of ``reflectance`` over wavelength in nm, linear between: ``400:0.02, 700:0.05, 1100:0.6``; "
        "``reflectance`` is then 1 by default",
    ).field("")
    _: KW_ONLY
    event: str = EVENT.field("reflection")
    relative_to: str = RELATIVE_TO.field("incident")

    also = MappingProxyType(
        {
            "preset": Param(
                "string",
                TEXT,
                f"reflectance of a paint by name: {', '.join(f'``{name}``' for name in PRESETS)}; see "
                "`mistray.scatter.paint.PRESETS`",
                default=None,
            )
        }
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        with errors_of(self.title):
            brightest = max(_points(self.spectrum)[1], default=1.0) * self.reflectance
        if brightest == 0 and self.b0 == 0:
            raise MistrayError(f"{self.title}: reflectance and b0 are 0, nothing is scattered; leave the model out")
        total, angle_deg = _most_scattered(brightest, self.b0, self.l, self.s, self.n)
        if total > 1 + ROUNDING:
            raise MistrayError(
                f"{self.title}: scatters {total:.4g} of the light at {angle_deg:.3g}°; lower reflectance or b0"
            )

    @classmethod
    def of(cls, resolve: Callable[[str], str] = str, **properties: Any) -> Paint:
        """
        Return the model with given properties, see `Placement.of`; `preset` sets the reflectance.

        With `spectrum` and without `preset`, the reflectance is 1 by default.
        """
        if "preset" not in properties:
            usual = {"reflectance": 1.0} if properties.get("spectrum") else {}
            return super().of(**usual | properties)
        if "reflectance" in properties:
            raise MistrayError(f"{cls.__name__}: preset and reflectance given; give one of them")
        return cls.preset(**properties)

    @classmethod
    def preset(cls, preset: str, **options: Any) -> Paint:
        """
        Return a paint whose reflectance is one of `PRESETS`; Lambertian, unless `options` add a glossy lobe.

        Parameters
        ----------
        preset : str
            Name of the paint.
        **options
            Values of attributes other than `reflectance`.

        Raises
        ------
        MistrayError
            If no preset has this name, or for the reasons of the class.
        """
        if preset not in PRESETS:
            close = difflib.get_close_matches(preset, PRESETS, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"there are {', '.join(PRESETS)}"
            raise MistrayError(f"paint preset '{preset}' is unknown; {hint}")
        return cls(PRESETS[preset], **{"name": preset, **options})

    def event_lobes(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> tuple[Lobe, ...]:
        """
        Return the lobes of an event, see `Placement.event_lobes`.

        A part whose amplitude is 0 has no lobe. Raise `MistrayError` outside the wavelengths of `spectrum`.
        """
        return _lobes(
            self.reflectance * self._factor(wavelength_nm),
            self.b0,
            self.l,
            self.s,
            self.n,
            event=event,
            shares=self.shares,
        )

    def _factor(self, wavelength_nm: float) -> float:
        """
        Return the factor by which the paint's spectrum multiplies its reflectance at a wavelength, nm; 1 without one.

        Raise `MistrayError` outside the spectrum.
        """
        at, values = _points(self.spectrum)
        if at and not at[0] <= wavelength_nm <= at[-1]:
            raise MistrayError(
                f"{self.title}: {wavelength_nm:g} nm is outside its spectrum, {at[0]:g} … {at[-1]:g} nm; add a point"
            )
        return float(np.interp(wavelength_nm, at, values)) if at else 1.0


@lru_cache(maxsize=256)
def _points(spectrum: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """
    Return wavelengths, nm, and reflectance factors from a string such as "400:0.02, 700:0.05"; empty for "".

    Raise `MistrayError` if a pair is malformed or wavelengths do not ascend.
    """
    found: list[tuple[float, float]] = []
    for word in spectrum.replace(",", " ").split():
        nm, factor = (finite_of(part) for part in word.partition(":")[::2])
        if nm is None or factor is None or nm <= 0 or factor < 0:
            raise MistrayError(f"spectrum holds '{word}'; write wavelength:factor, such as 550:0.04")
        if found and nm <= found[-1][0]:
            raise MistrayError(f"spectrum has {nm:g} nm after {found[-1][0]:g} nm; let wavelengths ascend")
        found.append((nm, factor))
    return tuple(nm for nm, _ in found), tuple(factor for _, factor in found)


def _lobes(
    reflectance: float,
    b0: float,
    l: float,  # noqa: E741
    s: float,
    n: float | None,
    **options: Any,
) -> tuple[Lobe, ...]:
    lobes = []
    if reflectance > 0:
        level = reflectance / math.pi
        lobes.append(Lobe(profile=lambda r: np.full_like(r, level), centre="normal", **options))
    if b0 > 0:
        ratio = None if n is None else _growth(n)
        lobes.append(Lobe(profile=lambda r: np.asarray(harvey_shack.bsdf(r, b0, l, s)), ratio=ratio, **options))
    return tuple(lobes)


@lru_cache(maxsize=256)
def _most_scattered(
    reflectance: float,
    b0: float,
    l: float,  # noqa: E741
    s: float,
    n: float | None,
) -> tuple[float, float]:
    """
    Return the largest fraction of the incident light that a paint scatters, and the angle of incidence, degrees.

    Parameters are attributes of `Paint`; the largest is that at `CHECKED_COSINES`.
    """
    lobes = _lobes(reflectance, b0, l, s, n, event="reflection")
    total = np.sum([lobe_total(lobe, CHECKED_COSINES, 1.0, 1.0) for lobe in lobes], axis=0)
    worst = int(np.argmax(total))
    return float(total[worst]), math.degrees(math.acos(CHECKED_COSINES[worst]))


@lru_cache(maxsize=8)
def _growth(n: float) -> RatioTable:
    """Return a table of the glossy lobe's factor sqrt(F(θi) F(θs))/F(0) over both cosines; n is the binder's index."""
    cosines = np.linspace(0, 1, COS_NODES)
    return RatioTable(np.repeat(gain(cosines[:, None], cosines, n)[..., None], 2, axis=2), axes="cosines")

"""Refractive indices from the material strings of a scene.

A material string is one of

=====================  ===============================================================================
``air``, ``vacuum``    n = 1; glass indices are relative to air, as catalogues give them
``1.5168``             a constant index
``nd=1.544 Vd=56.1``   index at the d line and Abbe number: two-term Cauchy, see `cauchy_index`
``N-BK7``              a glass of `GLASSES`: Sellmeier formula, see `sellmeier_index`
=====================  ===============================================================================

Wavelengths are in nm. Only real indices so far: absorption belongs to coatings, A = 1 - R - T.
"""

from __future__ import annotations

import difflib
import math
import re
from dataclasses import dataclass
from functools import lru_cache

from mistray.errors import MistrayError

LINE_D_NM = 587.5618
LINE_F_NM = 486.1327
LINE_C_NM = 656.2725

CAUCHY_RANGE_NM = (400.0, 1000.0)
"""Range in which nd and Vd are taken for enough; see `cauchy_index` for the error."""

_SCHOTT = "Schott optical glass data sheets, 2017 collection"
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_ND_VD = re.compile(rf"nd\s*=\s*({_NUMBER})\s*[,;\s]\s*Vd\s*=\s*({_NUMBER})", re.IGNORECASE)


@dataclass(frozen=True)
class Glass:
    """Sellmeier constants of one material.

    Attributes
    ----------
    b : tuple of three float
        Strengths, dimensionless.
    c_um2 : tuple of three float
        Squared resonance wavelengths, µm².
    range_nm : tuple of two float
        Where the constants hold.
    source : str
        Who published them.
    """

    b: tuple[float, float, float]
    c_um2: tuple[float, float, float]
    range_nm: tuple[float, float]
    source: str


GLASSES: dict[str, Glass] = {
    "N-BK7": Glass(
        (1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653), (310.0, 2325.0), _SCHOTT
    ),
    "N-SK16": Glass(
        (1.34317774, 0.241144399, 0.994317969), (0.00704687339, 0.0229005, 92.7508526), (370.0, 2325.0), _SCHOTT
    ),
    "N-LAK9": Glass(
        (1.46231905, 0.344399589, 1.15508372), (0.00724270156, 0.0243353131, 85.4686868), (370.0, 2325.0), _SCHOTT
    ),
    "F2": Glass(
        (1.34533359, 0.209073176, 0.937357162), (0.00997743871, 0.0470450767, 111.886764), (334.0, 2325.0), _SCHOTT
    ),
    "N-F2": Glass(
        (1.39757037, 0.159201403, 1.2686543), (0.00995906143, 0.0546931752, 119.248346), (370.0, 2325.0), _SCHOTT
    ),
    "N-SF5": Glass(
        (1.52481889, 0.187085527, 1.42729015), (0.011254756, 0.0588995392, 129.141675), (370.0, 2325.0), _SCHOTT
    ),
    "SF6": Glass(
        (1.72448482, 0.390104889, 1.04572858), (0.0134871947, 0.0569318095, 118.557185), (370.0, 2325.0), _SCHOTT
    ),
    "N-SF6": Glass(
        (1.77931763, 0.338149866, 2.08734474), (0.0133714182, 0.0617533621, 174.01759), (370.0, 2325.0), _SCHOTT
    ),
    "N-SF11": Glass(
        (1.73759695, 0.313747346, 1.89878101), (0.013188707, 0.0623068142, 155.23629), (370.0, 2325.0), _SCHOTT
    ),
    "fused silica": Glass(
        (0.6961663, 0.4079426, 0.8974794),
        (0.0684043**2, 0.1162414**2, 9.896161**2),
        (210.0, 3710.0),
        "I. H. Malitson, J. Opt. Soc. Am. 55, 1205 (1965)",
    ),
    "sapphire": Glass(
        (1.4313493, 0.65054713, 5.3414021),
        (0.0726631**2, 0.1193242**2, 18.028251**2),
        (200.0, 5000.0),
        "ordinary ray: I. H. Malitson and M. J. Dodge, J. Opt. Soc. Am. 62, 1405 (1972)",
    ),
}


@lru_cache(maxsize=4096)
def refractive_index(material: str, wavelength_nm: float) -> float:
    """Real refractive index.

    Parameters
    ----------
    material : str
        See the module's table; names ignore case and outer blanks.
    wavelength_nm : float
        Greater than 0, nm.

    Returns
    -------
    float
        n ≥ 1.

    Raises
    ------
    MistrayError
        If the name is unknown, a number is below 1, or the wavelength lies outside of the material's range.
    """
    text = material.strip()
    if not wavelength_nm > 0:
        raise MistrayError(f"material '{text}': wavelength {wavelength_nm:g} nm; it must be greater than 0")
    if text.lower() in ("air", "vacuum"):
        return 1.0
    if re.fullmatch(_NUMBER, text):
        return _at_least_one(text, float(text))
    match = _ND_VD.fullmatch(text)
    if match:
        nd, vd = float(match[1]), float(match[2])
        _at_least_one(text, nd)
        if not vd > 0:
            raise MistrayError(f"material '{text}': Vd = {vd:g}; it must be greater than 0")
        _check_range(text, wavelength_nm, CAUCHY_RANGE_NM)
        return cauchy_index(nd, vd, wavelength_nm)
    for name, glass in GLASSES.items():
        if name.lower() == text.lower():
            _check_range(name, wavelength_nm, glass.range_nm)
            return sellmeier_index(glass, wavelength_nm)
    raise MistrayError(f"material '{text}' is unknown; {_suggestion(text)}")


def cauchy_index(nd: float, vd: float, wavelength_nm: float) -> float:
    """Index of a glass of which only nd and Vd are known: n = A + B/λ².

    A and B follow from n(d) = nd and n(F) - n(C) = (nd - 1)/Vd. The two numbers say nothing about partial dispersion,
    so a third term would be a guess. Greatest error against the Sellmeier constants of `GLASSES`:

    ============  ==================  =======================
    range, nm     crowns (Vd > 50)    dense flints (Vd = 25)
    ============  ==================  =======================
    480 … 660     1e-4                7e-4
    430 … 700     2.5e-4              3.5e-3
    400 … 1000    2e-3                7.5e-3
    ============  ==================  =======================
    """
    b = (nd - 1) / vd / (LINE_F_NM**-2 - LINE_C_NM**-2)
    return nd + b * (wavelength_nm**-2 - LINE_D_NM**-2)


def sellmeier_index(glass: Glass, wavelength_nm: float) -> float:
    """Index from n² = 1 + Σ B λ²/(λ² - C), λ in µm (W. Sellmeier, 1871; the form of the Schott catalogue)."""
    square = (wavelength_nm * 1e-3) ** 2
    return math.sqrt(1 + sum(b * square / (square - c) for b, c in zip(glass.b, glass.c_um2, strict=True)))


def _at_least_one(text: str, index: float) -> float:
    if not 1 <= index < math.inf:
        raise MistrayError(f"material '{text}': index {index:g}; a real index is at least 1")
    return index


def _check_range(name: str, wavelength_nm: float, range_nm: tuple[float, float]) -> None:
    low, high = range_nm
    if not low <= wavelength_nm <= high:
        raise MistrayError(
            f"material '{name}': {wavelength_nm:g} nm is outside of its {low:g} … {high:g} nm; "
            "use a wavelength inside or give a constant index"
        )


def _suggestion(text: str) -> str:
    names = {name.lower(): name for name in GLASSES}
    close = [names[key] for key in difflib.get_close_matches(text.lower(), names, n=3, cutoff=0.5)]
    forms = "air, a number, 'nd=… Vd=…' or a glass name"
    return f"did you mean {' or '.join(close)}? Else use {forms}" if close else f"use {forms}: {', '.join(GLASSES)}"

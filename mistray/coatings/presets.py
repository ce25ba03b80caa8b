"""Coatings by name: textbook designs with constant indices, and two protected metal mirrors.

=====================  =============================================================================================
``mgf2_quarter_wave``  1.38 (MgF2-like), one quarter wave. On n = 1.5168: R = 1.2835 % at the design wavelength
``v_coat``             1.38 and 2.10, 0.31797 and 0.06703 waves. R = 0 at the design wavelength on n = 1.5168
``bbar3``              quarter-half-quarter: 1.38, 2.10, 1.63 with 0.25, 0.5, 0.25 waves. R ≤ 0.26 % from 450 to 650 nm
``bbar4``              1.38, 2.10, 1.38, 2.10 with 0.2389, 0.5079, 0.0834, 0.0552 waves. R ≤ 0.33 %, 0.085 % in the
                       mean, from 420 to 680 nm
``protected_al``       half a wave of 1.60 (SiO-like) on 150 nm of aluminium; opaque
``protected_ag``       half a wave of 1.46 (SiO2-like) on 250 nm of silver; opaque
=====================  =============================================================================================

The first layer is the outermost. The constant indices (1.38, 1.46, 1.60, 1.63, 2.10; k = 0) are those that the designs
were made with; the metals are the materials ``Al`` and ``Ag``, with their dispersion. Figures are for 550 nm, normal
incidence. The designs for glass are made for n = 1.5168 and do well from 1.45 to 1.65; for others take layers. The
designs of one to three layers are classical (H. A. Macleod, *Thin-Film Optical Filters*, chapters 4 and 5); the
fourth and the thicknesses of the V-coat were computed for this collection. No preset is a vendor's coating.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass

from mistray.coatings.stack import Layer, Stack, waves
from mistray.errors import MistrayError


@dataclass(frozen=True)
class Preset:
    """
    A design.

    Attributes
    ----------
    films : tuple of (str, float)
        Materials and optical thicknesses in waves, the outermost first.
    metal : (str, float) or None
        Metal under them and its thickness in nm.
    """

    films: tuple[tuple[str, float], ...]
    metal: tuple[str, float] | None = None


PRESETS = {
    "mgf2_quarter_wave": Preset((("1.38", 0.25),)),
    "v_coat": Preset((("1.38", 0.3179699730700221), ("2.10", 0.06703201072908692))),
    "bbar3": Preset((("1.38", 0.25), ("2.10", 0.5), ("1.63", 0.25))),
    "bbar4": Preset((("1.38", 0.2389), ("2.10", 0.5079), ("1.38", 0.0834), ("2.10", 0.0552))),
    "protected_al": Preset((("1.60", 0.5),), ("Al", 150.0)),
    "protected_ag": Preset((("1.46", 0.5),), ("Ag", 250.0)),
}


def preset(name: str, design_nm: float = 550.0) -> Stack:
    """
    A coating of the table above.

    Parameters
    ----------
    name : str
    design_nm : float
        Wavelength for which the optical thicknesses are meant, nm. Metals keep their thickness.

    Raises
    ------
    MistrayError
        If the name is unknown or the wavelength is not positive.
    """
    design = PRESETS.get(name)
    if design is None:
        close = difflib.get_close_matches(name, PRESETS, n=1, cutoff=0.5)
        hint = f"did you mean '{close[0]}'? There are" if close else "choose one of"
        raise MistrayError(f"coating preset '{name}' is unknown; {hint} {', '.join(PRESETS)}")
    if not design_nm > 0:
        raise MistrayError(f"coating preset '{name}': design_nm = {design_nm:g}; it must be greater than 0")
    layers = tuple(waves(material, thickness, design_nm) for material, thickness in design.films)
    if design.metal is not None:
        layers += (Layer(*design.metal),)
    return Stack(layers, name=name, opaque=design.metal is not None)

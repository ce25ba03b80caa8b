"""Coatings by name: textbook designs with constant indices, and two protected metal mirrors.

=====================  =============================================================================================
``mgf2_quarter_wave``  1.38 (MgF2-like), one quarter wave. On n = 1.5168: R = 1.2835 % at the design wavelength
``v_coat``             1.38 and 2.10, 0.31797 and 0.06703 waves. R = 0 at the design wavelength on n = 1.5168
``bbar3``              quarter-half-quarter: 1.38, 2.10, 1.63 with 0.25, 0.5, 0.25 waves. R ≤ 0.26 % from 450 to 650 nm
``bbar4``              1.38, 2.10, 1.38, 2.10 with 0.2389, 0.5079, 0.0834, 0.0552 waves. R ≤ 0.33 %, 0.085 % in the
                       mean, from 420 to 680 nm
``zns_mwir``           2.20 (ZnS-like), one quarter wave at 4 µm. On germanium R = 3.8 % in the mean from 3 to 5 µm
``zns_lwir``           the same at 10 µm. On germanium R = 2.8 % in the mean from 8 to 12 µm
``bbar4_mwir``         1.40 (YF3-like), 2.20, 4.00 (Ge-like), 2.20 with 0.2716, 0.3165, 0.1092, 0.0601 waves of 4 µm.
                       On germanium R = 0.4 % in the mean from 3 to 5 µm
``bbar4_lwir``         the same materials with 0.2109, 0.1431, 0.0624, 0.0588 waves of 10 µm.
                       On germanium R = 0.05 % in the mean from 8 to 12 µm
``protected_al``       half a wave of 1.60 (SiO-like) on 150 nm of aluminium; opaque
``protected_ag``       half a wave of 1.46 (SiO2-like) on 250 nm of silver; opaque
=====================  =============================================================================================

The first layer is the outermost. The constant indices (k = 0) are those that the designs were made with; the metals are
the materials ``Al`` and ``Ag``, with their dispersion. Figures are for the wavelength of the design, normal incidence.
The designs for glass are made for n = 1.5168, those of the infrared for germanium;
`mistray.coatings.fitted_to_substrate` fits them to other bodies. The designs of one to three layers are classical (H.
A. Macleod, *Thin-Film Optical Filters*, chapters 4 and 5); those of four layers and the thicknesses of the V-coat were
computed for this collection. ZnS is hard and adheres to germanium; fluorides are softer, and absorb beyond 10 µm. No
preset is a vendor's coating.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass

from mistray.coatings.stack import Layer, Stack, waves
from mistray.errors import MistrayError

DEFAULT_NM = 550.0
VISIBLE_3, VISIBLE_4 = (450 / 550, 650 / 550), (420 / 550, 680 / 550)
MWIR, LWIR = (0.75, 1.25), (0.8, 1.2)  # of 4 and of 10 µm


@dataclass(frozen=True)
class Preset:
    """
    Design of a preset coating: its layers, the band in which R is small, and the body that it is made for.

    Attributes
    ----------
    films : tuple of (str, float)
        Material and optical thickness in waves of each layer, the outermost first.
    metal : (str, float) or None
        Metal under the layers and its thickness, nm.
    design_nm : float
        Default wavelength of the optical thicknesses, nm.
    band : (float, float)
        Band in which R is to be small, in units of that wavelength.
    substrate : float
        Refractive index of the body that the coating is designed for.
    """

    films: tuple[tuple[str, float], ...]
    metal: tuple[str, float] | None = None
    design_nm: float = DEFAULT_NM
    band: tuple[float, float] = (0.98, 1.02)
    substrate: float = 1.5168

    def centre_nm(self, design_nm: float) -> float:
        """Return the wavelength, nm, of the optical thicknesses: `design_nm`, or the preset's own if that is 550 nm."""
        return self.design_nm if design_nm == DEFAULT_NM else design_nm


PRESETS = {
    "mgf2_quarter_wave": Preset((("1.38", 0.25),)),
    "v_coat": Preset((("1.38", 0.3179699730700221), ("2.10", 0.06703201072908692))),
    "bbar3": Preset((("1.38", 0.25), ("2.10", 0.5), ("1.63", 0.25)), band=VISIBLE_3),
    "bbar4": Preset((("1.38", 0.2389), ("2.10", 0.5079), ("1.38", 0.0834), ("2.10", 0.0552)), band=VISIBLE_4),
    "zns_mwir": Preset((("2.20", 0.25),), None, 4000.0, MWIR, 4.025),
    "zns_lwir": Preset((("2.20", 0.25),), None, 10000.0, LWIR, 4.003),
    "bbar4_mwir": Preset(
        (("1.40", 0.2716), ("2.20", 0.3165), ("4.00", 0.1092), ("2.20", 0.0601)), None, 4000.0, MWIR, 4.025
    ),
    "bbar4_lwir": Preset(
        (("1.40", 0.2109), ("2.20", 0.1431), ("4.00", 0.0624), ("2.20", 0.0588)), None, 10000.0, LWIR, 4.003
    ),
    "protected_al": Preset((("1.60", 0.5),), ("Al", 150.0)),
    "protected_ag": Preset((("1.46", 0.5),), ("Ag", 250.0)),
}


def preset(name: str, design_nm: float = 550.0) -> Stack:
    """
    Return a preset coating; the table of this module lists the names.

    Parameters
    ----------
    name : str
        Name of the preset.
    design_nm : float
        Wavelength of the optical thicknesses, nm. The default, 550, stands for that of the design. Metals keep their
        thickness.

    Raises
    ------
    MistrayError
        If the name is unknown or the wavelength is not positive.

    Examples
    --------
    >>> bbar = mistray.coatings.preset("bbar3")
    >>> [layer.material for layer in bbar.layers]
    ['1.38', '2.10', '1.63']
    >>> found = mistray.coatings.spectrum(bbar, [450, 550, 650], [0])
    >>> found.R[:, 0, 0].round(4)
    array([0.0027, 0.0018, 0.0001])
    """
    design = PRESETS.get(name)
    if design is None:
        close = difflib.get_close_matches(name, PRESETS, n=1, cutoff=0.5)
        hint = f"did you mean '{close[0]}'? There are" if close else "choose one of"
        raise MistrayError(f"coating preset '{name}' is unknown; {hint} {', '.join(PRESETS)}")
    if not design_nm > 0:
        raise MistrayError(f"coating preset '{name}': design_nm = {design_nm:g}; it must be greater than 0")
    layers = tuple(waves(material, thickness, design.centre_nm(design_nm)) for material, thickness in design.films)
    if design.metal is not None:
        layers += (Layer(*design.metal),)
    return Stack(layers, name=name, opaque=design.metal is not None)

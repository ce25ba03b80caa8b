"""Surface types of CODE V beside spheres and even aspheres, as sags: toroids, cylinders, anamorphic aspheres, XYP.

Formulas: CODE V's reference, as D. C. O'Shea and J. L. Bentley, *Designing Optics Using CODE V* (SPIE, 2018), and
files that CODE V wrote have them. With c the curvature in y (CUY, RDY) and cx that in x (CUX, RDX):

- ``YTO`` and ``CYL``: the profile in y with K, A, B, … turned about a line parallel to y at 1/cx.
- ``XTO``: the profile in x with K, A, B, … turned about a line parallel to x at 1/c.
- ``AAS``: a biconic with K and KX, and AR ((1 - AP) x² + (1 + AP) y²)² + BR ((1 - BP) x² + (1 + BP) y²)³ + ….
- ``ODD``: of no command; R1, A2, R3 … are coefficients of r, r², r³ …, as other programs have them.
- ``SPS XYP``: a conic and Σ Cj (x/r)^m (y/r)^n with r = NRADIUS; C2 is of x, C3 of y, C4 of x², C5 of xy, ….
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from mistray.errors import MistrayError
from mistray.physics.sags.terms import XY_ORDERS

KINDS = ("YTO", "XTO", "CYL", "AAS", "XYP", "ODD")
ANAMORPHIC = tuple(f"{letter}{what}" for letter in "ABCD" for what in "RP")
_XYP_TERM = re.compile(r"C(\d{1,3})")
_XYP_TERMS = 66  # to the tenth order


def sag_of(kind: str, curvature_x: float, conic: float, extra: Mapping[str, float], unit: float) -> dict[str, float]:
    """
    Numbers of a `Row.sag`, in mm.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    curvature_x : float
        1/unit of the file.
    conic : float
        That in y.
    extra : mapping of str to float
        KX, AR, AP, …; K, NRADIUS and C2, C3, … of XYP.
    unit : float
        mm.

    Raises
    ------
    MistrayError
        Of an unknown coefficient, or a missing or impossible NRADIUS.
    """
    if kind in ("YTO", "CYL", "XTO"):
        return {"toroid_curvature": curvature_x / unit} | _powers(extra, unit)
    if kind == "ODD":
        return _powers(extra, unit)
    if kind == "AAS":
        found = {"curvature_x": curvature_x / unit, "conic_x": extra.get("KX", 0.0)}
        for n, letter in enumerate("ABCD", start=2):
            size, ratio = extra.get(f"{letter}R", 0.0), extra.get(f"{letter}P", 0.0)
            for i in range(n + 1 if size else 0):
                part = math.comb(n, i) * (1 - ratio) ** i * (1 + ratio) ** (n - i)
                found[f"xy_{2 * i}_{2 * (n - i)}"] = size * part * unit ** (1 - 2 * n)
        return {name: value for name, value in found.items() if value or name == "curvature_x"}
    terms = {name: value for name, value in extra.items() if value and name not in ("NRADIUS", "K", "KX")}
    radius = extra.get("NRADIUS", 1.0 if not terms else 0.0)
    if not radius > 0:
        raise MistrayError(f"XYP with NRADIUS {radius:g}; give a normalisation radius above 0")
    found = {}
    for name, value in terms.items():
        place = _XYP_TERM.fullmatch(name)
        if place is None or not 2 <= int(place[1]) <= _XYP_TERMS:
            raise MistrayError(f"SCO {name}: XYP has K, NRADIUS and C2 to C{_XYP_TERMS}; remove it")
        i, j = XY_ORDERS[int(place[1]) - 1]
        found[f"xy_{i}_{j}"] = value * unit / (radius * unit) ** (i + j)
    return found


def _powers(extra: Mapping[str, float], unit: float) -> dict[str, float]:
    """Coefficients of powers by the names of `Row.sag`."""
    powers = {name.lower(): value for name, value in extra.items() if re.fullmatch(r"[AR]\d+", name)}
    return {name: value * unit ** (1 - int(name[1:])) for name, value in powers.items()}

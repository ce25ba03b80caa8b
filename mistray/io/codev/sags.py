"""Conversion of CODE V's toroids, cylinders, anamorphic aspheres and polynomial surfaces to sags.

Formulas follow D. C. O'Shea and J. L. Bentley, *Designing Optics Using CODE V* (SPIE, 2018), and files that CODE V
wrote. Here c is the curvature in y (CUY, RDY) and cx the curvature in x (CUX, RDX):

- ``YTO`` and ``CYL``: the profile in y with K, A, B, … turned about a line parallel to y at 1/cx.
- ``XTO``: the profile in x with K, A, B, … turned about a line parallel to x at 1/c.
- ``AAS``: a biconic with K and KX, and AR ((1 - AP) x² + (1 + AP) y²)² + BR ((1 - BP) x² + (1 + BP) y²)³ + ….
- ``SPS``: a conic (K, or C1) and terms over r = NRADIUS:

  - ``XYP``: Σ Cj (x/r)^m (y/r)^n; C2 is of x, C3 of y, C4 of x², C5 of xy, ….
  - ``ZRN``: standard Zernike polynomials, 1 at the rim; C(j+1) is that of index j in the order of CODE V, which is
    1, ρ cos φ, ρ sin φ, ρ² cos 2φ, 2ρ² - 1, ρ² sin 2φ, …. C69 is NRADIUS.
  - ``ZFR``: Fringe Zernike polynomials; C2 is NRADIUS, C(j+3) that of index j.
  - ``ODD``: AR1, AR2, … (C2, C3, …) of ρ, ρ², …, NRADIUS (C33) 1 where it is missing or 0. R1, A2, R3 … of no command
    are coefficients of r, r², r³ …, as other programs have them.

Places of the coefficients of ZRN and ZFR: macro ``cv2macos.seq`` of the repository nasa-jpl/MACOS_resources, which
reads them from CODE V; the order of ZRN also follows from the files of its folder rodgers3, whose mirrors are
symmetric.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from mistray.errors import MistrayError
from mistray.physics.sags.terms import XY_ORDERS
from mistray.physics.sags.zernike import noll_orders

KINDS = ("YTO", "XTO", "CYL", "AAS", "XYP", "ZRN", "ZFR", "ODD")
SPECIAL = ("XYP", "ZRN", "ZFR", "ODD")
ANAMORPHIC = tuple(f"{letter}{what}" for letter in "ABCD" for what in "RP")
_TERM = re.compile(r"C(\d{1,3})")
_XYP_TERMS = 66  # to the tenth order
_ZRN_TERMS, _ZFR_TERMS, _ODD_TERMS = 66, 37, 30


def sag_of(kind: str, curvature_x: float, conic: float, extra: Mapping[str, float], unit: float) -> dict[str, float]:
    """
    Return the parameters that define the sag of a special surface, as for `Row.sag`, in mm and powers of it.

    Parameters
    ----------
    kind : str
        Surface type, one of `KINDS`.
    curvature_x : float
        Curvature in x, 1/unit of the file.
    conic : float
        Conic constant in y.
    extra : mapping of str to float
        Coefficients in units of the file, by name: KX, AR, AP, …; for special surfaces NRADIUS, C2, C3, … and names of
        terms.
    unit : float
        Length of the file's unit, mm.

    Raises
    ------
    MistrayError
        If a coefficient is unknown, or if an XYP, ZRN or ZFR with terms has no NRADIUS above 0.
    """
    if kind in ("YTO", "CYL", "XTO"):
        return {"toroid_curvature": curvature_x / unit} | _powers(extra, unit)
    if kind == "ODD":
        return _powers(extra, unit) | _odd(extra, unit)
    if kind in ("ZRN", "ZFR"):
        return _zernikes(kind, extra, unit)
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
        place = _TERM.fullmatch(name)
        if place is None or not 2 <= int(place[1]) <= _XYP_TERMS:
            raise MistrayError(f"SCO {name}: XYP has K, NRADIUS and C2 to C{_XYP_TERMS}; remove it")
        i, j = XY_ORDERS[int(place[1]) - 1]
        found[f"xy_{i}_{j}"] = value * unit / (radius * unit) ** (i + j)
    return found


def _powers(extra: Mapping[str, float], unit: float) -> dict[str, float]:
    """Return the coefficients of rⁿ, mm^(1-n), keyed by the names of `Row.sag`; parameters as in `sag_of`."""
    powers = {name.lower(): value for name, value in extra.items() if re.fullmatch(r"[AR]\d+", name)}
    return {name: value * unit ** (1 - int(name[1:])) for name, value in powers.items()}


def _odd(extra: Mapping[str, float], unit: float) -> dict[str, float]:
    """Return the coefficients of rⁿ of an ODD surface, mm^(1-n), by names of `Row.sag`; parameters as in `sag_of`."""
    radius = (extra.get("NRADIUS") or extra.get("C33") or 1.0) * unit
    found = {}
    for name, value in extra.items():
        order = _place(name, "ODD", r"AR", 1, _ODD_TERMS)
        if value and order:
            found[f"{'r' if order % 2 else 'a'}{order}"] = value * unit / radius**order
    return found


def _zernikes(kind: str, extra: Mapping[str, float], unit: float) -> dict[str, float]:
    """
    Return Zernike coefficients and normalisation radius of a ZRN or ZFR surface, mm, by their names in `Row.sag`.

    Parameters are as in `sag_of`. If all coefficients are 0, the result is empty. Raise `MistrayError` if the
    normalisation radius is not above 0.
    """
    radius_place, first, terms = ("C69", 1, _ZRN_TERMS) if kind == "ZRN" else ("C2", 3, _ZFR_TERMS)
    radius = extra.get("NRADIUS") or extra.get(radius_place, 0.0)
    ignored = {radius_place, *(("C68",) if kind == "ZRN" else ("C3",))}  # the number of the last term
    found: dict[str, float] = {}
    for name, value in extra.items():
        number = 0 if name in ignored else _place(name, kind, r"Z", first, terms)
        if not (value and number):
            continue
        if kind == "ZFR":
            found[f"fringe_{number}"] = value * unit
        else:
            n, m = standard_orders(number)
            j = noll_number(n, m)
            found[f"zernike_{j}"] = value * unit / math.sqrt((n + 1) * (2 if m else 1))
    if not found:
        return {}
    if not radius > 0:
        raise MistrayError(f"{kind} with NRADIUS {radius:g}; give a normalisation radius above 0")
    return found | {"zernike_radius" if kind == "ZRN" else "fringe_radius": radius * unit}


def standard_orders(j: int) -> tuple[int, int]:
    """Return radial order n and azimuthal order m of the ZRN Zernike polynomial of index `j`; m < 0 is a sine."""
    n = (math.isqrt(8 * j - 7) - 1) // 2
    place = j - n * (n + 1) // 2 - 1  # 0 … n
    return n, n - 2 * place


def noll_number(n: int, m: int) -> int:
    """Return the Noll index of the Zernike polynomial of orders n (radial) and m (azimuthal, < 0 for a sine)."""
    first = n * (n + 1) // 2 + 1
    return next(j for j in range(first, first + n + 1) if noll_orders(j) == (n, m))


def _place(name: str, kind: str, head: str, first: int, terms: int) -> int:
    """
    Return the index of a polynomial term named as Z5, or as the coefficient C6; 0 for names of other quantities.

    `head` is the letter before the index, term j is the coefficient C(j + `first`), and `terms` is the last index.
    Raise `MistrayError` for an unknown name.
    """
    if name in ("NRADIUS", "K", "KX", "C1") or re.fullmatch(r"[AR]\d+", name):
        return 0
    by_name = re.fullmatch(rf"{head}(\d{{1,3}})", name)
    by_place = _TERM.fullmatch(name)
    number = int(by_name[1]) if by_name else int(by_place[1]) - first if by_place else 0
    if kind == "ODD" and name == "C33":
        return 0
    if not 1 <= number <= terms:
        raise MistrayError(f"SCO {name}: {kind} has K, NRADIUS and {terms} terms from C{first + 1} on; remove it")
    return number

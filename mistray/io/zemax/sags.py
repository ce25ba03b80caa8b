"""Conversion of Zemax surface types to sags: meaning of their parameters (PARM) and extra data (XDAT).

Formulas and places of the numbers are from OpticStudio's manual, "Sequential Surfaces" (Lens Data Editor), in lens
units; ρ is r over the normalisation radius.

===========  ==========================================================================================================
EVENASPH     PARM i: of r^2i
ODDASPHE     PARM i: of r^i
XASPHERE     XDAT 1 number of terms, 2 radius, then of ρ², ρ⁴, …
XOSPHERE     the same with ρ, ρ², ρ³, …
IRREGULA     PARM 5 spherical aberration, 6 astigmatism, 7 coma at the semi-diameter: of ρ⁴, (y/r)², ρ² y/r
TOROIDAL     PARM 1 radius of rotation (0 is a plane: a cylinder), PARM i: of y^(2i-2); XDAT as of SZERNSAG
BICONICX     PARM 1 radius in x (0 is a plane), 2 conic constant in x
SZERNSAG     PARM i: of r^2i; XDAT 1 number of terms, 2 radius, then those of the standard Zernike polynomials
FZERNSAG     the same with Fringe Zernike polynomials
XPOLYNOM     XDAT 1 number of terms, 2 radius, then of x, y, x², xy, y², x³, … over the radius
QED_TYPE     XDAT 1 type (0: Qbfs), 2 number of terms, 3 radius, then those of Forbes's polynomials
TILTSURF     PARM 1 slope in x, 2 slope in y; the surface has no curvature
===========  ==========================================================================================================
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from mistray.errors import MistrayError
from mistray.io.zemax.lines import ZemaxLine, ZemaxSection
from mistray.physics.geometry.sag import trimmed
from mistray.physics.sags.terms import XY_ORDERS, length_power
from mistray.prescription.sequential.table import Row

MOST_PARAMETERS, MOST_EXTRA = 12, 241
_EVEN_TERMS, _ODD_TERMS, _TOROID_TERMS = 8, 8, 7
_HIGHEST_EVEN = 20  # order that a surface of revolution takes


@dataclass
class SagNumbers:
    """
    Parameters of the sag of a surface in a Zemax file, in lens units.

    Attributes
    ----------
    owner : str
        Name of the surface, for messages.
    parameters, extra : dict of int to float
        PARM and XDAT values, keyed by index. A surface type removes the ones that it uses, so that the rest can be
        reported.
    lines : dict of (str, int) to ZemaxLine
        Lines of the values, keyed by keyword and index.
    unit : float
        Lens unit, mm.
    semi_diameter : float
        Semi-diameter of the surface, lens units; 0 if the file has none.
    """

    owner: str
    unit: float
    semi_diameter: float = 0.0
    parameters: dict[int, float] = field(default_factory=dict)
    extra: dict[int, float] = field(default_factory=dict)
    lines: dict[tuple[str, int], ZemaxLine] = field(default_factory=dict)

    @classmethod
    def of(cls, section: ZemaxSection, unit: float, semi_diameter: float = 0.0) -> SagNumbers:
        """
        Return the values in the PARM and XDAT lines of a surface's section, and remove these lines.

        `unit` and `semi_diameter` are as in the class. Raise `MistrayError` if an index is out of range or repeated.
        """
        found = cls(section.name, unit, semi_diameter)
        for key, values, most in (("PARM", found.parameters, MOST_PARAMETERS), ("XDAT", found.extra, MOST_EXTRA)):
            for line in section.take_all(key):
                place, value = line.whole(0, "the number of the parameter"), line.value(1, "its value")
                if place in values:
                    first = found.lines[key, place]
                    raise line.error(f"parameter {place} is there already, on line {first.number}; remove one")
                if not 0 <= place <= most:
                    raise line.error(f"parameter {place} of {section.name}; they are numbered from 1 to {most}")
                values[place] = value
                found.lines[key, place] = line
        return found

    def take(self, place: int) -> float:
        """Remove and return the parameter (PARM) at a place; 0 if it is missing."""
        return self.parameters.pop(place, 0.0)

    def series(self) -> tuple[float, tuple[float, ...]]:
        """
        Remove and return the normalisation radius, in lens units, and the terms in the extra data.

        Without terms a radius of 0, or none, is returned as 1. Raise `MistrayError` if there are terms without a
        positive radius.
        """
        count = self.extra.pop(1, 0.0)
        radius = self.extra.pop(2, 0.0)
        terms = trimmed(self.extra.pop(2 + k, 0.0) for k in range(1, int(max(count, 0.0)) + 1))
        if terms and not radius > 0:
            line = self.lines.get(("XDAT", 2)) or self.lines["XDAT", 1]
            raise line.error(f"{self.owner} has {len(terms)} terms over a radius of {radius:g}; give one above 0")
        return radius or 1.0, terms

    def left(self) -> list[tuple[str, ZemaxLine]]:
        """Return the names, such as "parameter 3", of values that are not 0 and were not used, with their lines."""
        rest = [("PARM", place) for place, value in self.parameters.items() if value]
        rest += [("XDAT", place) for place, value in self.extra.items() if value]
        return [(f"{'parameter' if key == 'PARM' else 'extra datum'} {n}", self.lines[key, n]) for key, n in rest]


def _even(n: SagNumbers) -> dict[str, float]:
    return {f"a{2 * i}": n.take(i) for i in range(1, _EVEN_TERMS + 1)}


def _odd(n: SagNumbers) -> dict[str, float]:
    return {f"{'r' if i % 2 else 'a'}{i}": n.take(i) for i in range(1, _ODD_TERMS + 1)}


def _extended(n: SagNumbers) -> dict[str, float]:
    radius, terms = n.series()
    return {f"a{2 * i}": _scaled(term, radius, 2 * i) for i, term in enumerate(terms, 1)}


def _extended_odd(n: SagNumbers) -> dict[str, float]:
    radius, terms = n.series()
    return {f"{'r' if i % 2 else 'a'}{i}": _scaled(term, radius, i) for i, term in enumerate(terms, 1)}


def _irregular(n: SagNumbers) -> dict[str, float]:
    for place, what in ((1, "decentre"), (2, "decentre"), (3, "tilt"), (4, "tilt"), (8, "angle")):
        if n.take(place):
            raise n.lines["PARM", place].error(
                f"{n.owner}: an irregular surface with {what}s of its own is not read; put coordinate breaks around it"
            )
    spherical, astigmatism, coma = (n.take(place) for place in (5, 6, 7))
    if not (spherical or astigmatism or coma):
        return {}
    r = n.semi_diameter
    if not r > 0:
        raise n.lines["PARM", max(place for _, place in n.lines)].error(
            f"{n.owner}: an irregular surface needs its semi-diameter (DIAM); add it"
        )
    return {
        "a4": spherical / r**4,
        "xy_0_2": astigmatism / r**2,
        "xy_2_1": coma / r**3,
        "xy_0_3": coma / r**3,
    }


def _toroid(n: SagNumbers) -> dict[str, float]:
    radius = n.take(1)
    profile = {f"a{2 * i}": n.take(i + 1) for i in range(1, _TOROID_TERMS + 1)}
    return {"toroid_curvature": 1 / radius if radius else 0.0, **profile, **_zernikes(n, "zernike")}


def _biconic(n: SagNumbers) -> dict[str, float]:
    radius, conic = n.take(1), n.take(2)
    return {"curvature_x": 1 / radius if radius else 0.0, "conic_x": conic}


def _zernikes(n: SagNumbers, kind: str) -> dict[str, float]:
    radius, terms = n.series()
    found = {f"{kind}_{j}": term for j, term in enumerate(terms, 1) if term}
    return found | ({f"{kind}_radius": radius} if found else {})


def _polynomial(n: SagNumbers) -> dict[str, float]:
    radius, terms = n.series()
    return {f"xy_{i}_{j}": _scaled(t, radius, i + j) for (i, j), t in zip(XY_ORDERS[1:], terms, strict=False) if t}


def _forbes(n: SagNumbers) -> dict[str, float]:
    kind = n.extra.pop(1, 0.0)
    if kind:
        raise n.lines["XDAT", 1].error(f"{n.owner} is a Q asphere of type {kind:g}; type 0, Qbfs, is read")
    n.extra = {place - 1: value for place, value in n.extra.items()}
    n.lines = {(key, place - (key == "XDAT")): line for (key, place), line in n.lines.items()}
    radius, terms = n.series()
    return {f"qbfs_{m}": term for m, term in enumerate(terms) if term} | ({"q_radius": radius} if terms else {})


def _scaled(term: float, radius: float, order: int) -> float:
    return term / radius**order


KINDS: dict[str, Any] = {
    "STANDARD": lambda n: {},
    "EVENASPH": _even,
    "ODDASPHE": _odd,
    "XASPHERE": _extended,
    "XOSPHERE": _extended_odd,
    "IRREGULA": _irregular,
    "TOROIDAL": _toroid,
    "BICONICX": _biconic,
    "SZERNSAG": lambda n: _even(n) | _zernikes(n, "zernike"),
    "FZERNSAG": lambda n: _even(n) | _zernikes(n, "fringe"),
    "XPOLYNOM": _polynomial,
    "QED_TYPE": _forbes,
    "TILTSURF": lambda n: {"slope_x": n.take(1), "slope_y": n.take(2)},
}


def figure_of(kind: str, n: SagNumbers, curvature: float, conic: float, head: ZemaxLine) -> dict[str, Any]:
    """
    Return radius, conic, coefficients and sag as arguments of `Row`, in mm.

    Parameters
    ----------
    kind : str
        Surface type, one of `KINDS`.
    n : SagNumbers
        Parameters of the surface; those that the type does not use stay in it.
    curvature, conic : float
        Curvature, 1/lens unit, and conic constant.
    head : ZemaxLine
        First line of the surface, for messages.

    Raises
    ------
    MistrayError
        If the parameters of the type are not valid, or mistray has no such term.
    """
    curved = 0.0 if kind == "TILTSURF" else curvature / n.unit
    found = {
        name: value * n.unit ** (length_power(name) or 0)
        for name, value in KINDS[kind](n).items()
        if value or name in ("curvature_x", "toroid_curvature")
    }
    for name in found:
        if length_power(name) is None:
            raise head.error(f"{n.owner}: mistray has no term {name}; leave it out")
    if found.get("a2") and set(found) <= {f"a{i}" for i in range(2, 31, 2)} and (not curved or conic == -1):
        # c r²/2 + a2 r² is a paraboloid again; a plane is one with c = 0
        curved, conic = curved + 2 * found.pop("a2"), -1.0
    orders = range(4, max((int(name[1:]) for name in found if name[0] == "a"), default=2) + 1, 2)
    coefficients = [found.pop(f"a{order}", 0.0) for order in orders if order <= _HIGHEST_EVEN]
    return {
        "radius": 1 / curved if curved else math.inf,
        "conic": conic,
        "coefficients": tuple(coefficients),
        "sag": found,
    }


def type_of(row: Row) -> tuple[str, list[str]]:
    """
    Return the Zemax surface type for a row, and its lines PARM and XDAT.

    Raises
    ------
    MistrayError
        If no type of `KINDS` has all terms of its sag.
    """
    even = {f"a{2 * i}": a for i, a in enumerate(row.coefficients, start=2) if a}
    given = {name: value for name, value in {**even, **row.sag}.items() if value or name in _SHAPES}
    heads = {name.split("_")[0] if "_" in name else name.rstrip("0123456789") for name in given}
    numbers: dict[int, float] = {}
    extra: dict[int, float] = {}
    kind = "STANDARD"
    if "curvature_x" in given:
        kind = "BICONICX"
        curvature = given.pop("curvature_x")
        numbers = {1: 1 / curvature if curvature else 0.0, 2: given.pop("conic_x", 0.0)}
    elif "toroid_curvature" in given:
        kind = "TOROIDAL"
        curvature = given.pop("toroid_curvature")
        numbers = {1: 1 / curvature if curvature else 0.0}
        numbers |= {i + 1: given.pop(f"a{2 * i}", 0.0) for i in range(1, _TOROID_TERMS + 1)}
        extra = _written_zernikes(given, "zernike")
    elif heads & {"zernike", "fringe"}:
        name = "zernike" if "zernike" in heads else "fringe"
        kind = "SZERNSAG" if name == "zernike" else "FZERNSAG"
        numbers = {i: given.pop(f"a{2 * i}", 0.0) for i in range(1, _EVEN_TERMS + 1)}
        extra = _written_zernikes(given, name)
    elif "qbfs" in heads:
        kind, last = "QED_TYPE", max(int(name[5:]) for name in given if name.startswith("qbfs_"))
        terms = {4 + m: given.pop(f"qbfs_{m}", 0.0) for m in range(last + 1)}
        extra = {1: 0.0, 2: float(last + 1), 3: given.pop("q_radius"), **terms}
    elif "r" in heads:
        kind = "ODDASPHE"
        numbers = {i: given.pop(f"{'r' if i % 2 else 'a'}{i}", 0.0) for i in range(1, _ODD_TERMS + 1)}
    elif "xy" in heads:
        kind, extra = "XPOLYNOM", _written_polynomial(given)
    elif "slope" in heads and row.radius in (0.0, math.inf):
        kind, numbers = "TILTSURF", {1: given.pop("slope_x", 0.0), 2: given.pop("slope_y", 0.0)}
    elif any(given.get(f"a{order}") for order in range(2 * _EVEN_TERMS + 2, 31, 2)):
        kind = "XASPHERE"
        last = max(int(name[1:]) for name in given) // 2
        extra = {1: float(last), 2: 1.0, **{2 + i: given.pop(f"a{2 * i}", 0.0) for i in range(1, last + 1)}}
    elif given:
        kind, numbers = "EVENASPH", {i: given.pop(f"a{2 * i}", 0.0) for i in range(1, _EVEN_TERMS + 1)}
    if given:
        raise MistrayError(
            f"surface {row.number} '{row.label}': no surface type of .zmx files has {', '.join(sorted(given))} beside "
            "the rest of its sag; fit it again with fewer terms"
        )
    while numbers and not numbers[max(numbers)]:
        numbers.pop(max(numbers))
    lines = [f"PARM {place} {value:.16g}" for place, value in sorted(numbers.items())]
    return kind, lines + [f"XDAT {place} {value:.16g} 0 0 1" for place, value in sorted(extra.items())]


_SHAPES = ("curvature_x", "toroid_curvature")


def _written_zernikes(given: dict[str, float], kind: str) -> dict[int, float]:
    """Return Zemax's extra data, by index, for the Zernike terms in `given`, and remove them there; {} without any."""
    terms = {int(name.rpartition("_")[2]): name for name in given if name.startswith(f"{kind}_") and name[-1].isdigit()}
    radius = given.pop(f"{kind}_radius", 1.0)
    if not terms:
        return {}
    found = {2 + j: given.pop(name) for j, name in terms.items()}
    return {1: float(max(terms)), 2: radius} | {place: found.get(place, 0.0) for place in range(3, max(found) + 1)}


def _written_polynomial(given: dict[str, float]) -> dict[int, float]:
    found = {k: given.pop(f"xy_{i}_{j}") for k, (i, j) in enumerate(XY_ORDERS[1:], 1) if f"xy_{i}_{j}" in given}
    last = max(found, default=0)
    return {1: float(last), 2: 1.0} | {2 + k: found.get(k, 0.0) for k in range(1, last + 1)}

"""Polynomial and binomial BSDF models for measured surfaces, in the form of Greynolds."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.param import Param
from mistray.physics import polynomial
from mistray.ranges import POSITIVE
from mistray.scatter.lobe import Lobe, Placement, RatioTable

DIFFUSE, LORENTZIAN = re.compile(r"c(\d)(\d)(\d)"), re.compile(r"l(\d)(\d)")
D = 1e4  # FRED's own start
# Nodes of the ratio to the carrier: angle of the specular direction, log r and ψ; only the first cell past the horizon
# read, and further out a polynomial may be anything
NODES, R_MIN, MOST_U = (37, 121, 37), 1e-3, 1.5
# Of the check of a fit: nodes, and the largest BSDF, 1/sr, that single precision still takes
FEW, LARGEST = (7, 9, 7), 1e12
COEFFICIENT = Param(doc="coefficient of the polynomial", default=0.0)


def is_coefficient(name: str) -> bool:
    """True if a property is a coefficient of the model: ``c`` and three digits, or ``l`` and two."""
    return bool(DIFFUSE.fullmatch(name) or LORENTZIAN.fullmatch(name))


def sums_of(coefficients: Mapping[str, Any]) -> tuple[dict[tuple[int, int, int], Any], dict[tuple[int, int], Any]]:
    """Return two dicts of coefficients by their exponents: those of the diffuse sum and of the Lorentzian sum."""
    diffuse, lorentzian = {}, {}
    for name, value in coefficients.items():
        if match := DIFFUSE.fullmatch(name):
            i, j, k = map(int, match.groups())
            diffuse[i, j, k] = value
        elif match := LORENTZIAN.fullmatch(name):
            j, k = map(int, match.groups())
            lorentzian[j, k] = value
    return diffuse, lorentzian


def carrier(r: Any, coefficients: Mapping[str, Any], d: Any) -> Any:
    """
    Return the BSDF, 1/sr, of two directions symmetric about the normal, whose direction cosines differ by r.

    All other pairs with this distance have a smooth ratio to it. Coefficients, by name, and `d` are those of
    `Polynomial`.
    """
    t = r * r
    return polynomial.bsdf((0.5 * t, 0.0625 * t * t, -0.25 * t), t, *sums_of(coefficients), d)


def depends_on_distance_alone(names: Iterable[str]) -> bool:
    """True if coefficients with these names make a BSDF of |β - β0| alone: c000, and Lorentzian ones without V."""
    return all(name == "c000" or (name[0] == "l" and name[2] == "0") for name in names)


@dataclass(frozen=True)
class Polynomial(Placement):
    """
    BSDF = 10^(a polynomial in the invariants of two directions), the same for both events and from both sides.

    Equation and source: `mistray.physics.polynomial`.

    Attributes
    ----------
    coefficients : tuple of (str, float)
        Names and values. ``cijk`` multiplies (U + W)^i (U W)^j V^k, and ``ljk`` multiplies V^k log10(1 + d^j T).
        ``c000`` is required; missing coefficients are 0.
    d : float
        Base d of the Lorentzian terms, > 0.

    Raises
    ------
    MistrayError
        If a name is not that of a coefficient or occurs twice, ``c000`` is missing, a value is not finite, or the BSDF
        is not below 1e12/sr.
    """

    coefficients: tuple[tuple[str, float], ...]
    d: float = Param("1", POSITIVE, "the Lorentzian part bends at |β - β0| = d^(-j/2)").field(D)

    def __post_init__(self) -> None:
        super().__post_init__()
        names = [name for name, _ in self.coefficients]
        for name, value in self.coefficients:
            if not is_coefficient(name):
                raise MistrayError(f"{self.title}: '{name}' is not a coefficient; use c and 3 digits or l and 2")
            if not math.isfinite(value):
                raise MistrayError(f"{self.title}: {name} is {value:g}; give a finite number")
        if "c000" not in names or len(set(names)) < len(names):
            raise MistrayError(f"{self.title}: coefficients {', '.join(names) or 'none'}; give each once, and c000")
        with np.errstate(all="ignore"):
            whole, over_carrier = self._tabled(FEW)
        largest = float(np.max(np.maximum(whole, over_carrier)))
        if not (np.all(whole > 0) and largest < LARGEST):  # NaN is refused too
            raise MistrayError(
                f"{self.title}: its BSDF runs from {np.min(whole):.3g} to {np.max(whole):.3g} 1/sr; "
                "the coefficients are too large, fit fewer"
            )

    @classmethod
    def param(cls, name: str) -> Param | None:
        """Return a parameter by name, see `Placement.param`; each coefficient is a parameter."""
        return COEFFICIENT if is_coefficient(name) else super().param(name)

    @classmethod
    def of(cls, resolve: Callable[[str], str] = str, **properties: Any) -> Polynomial:
        """Return the model with given properties, see `Placement.of`; coefficients are properties by their names."""
        named = sorted(filter(is_coefficient, properties), key=lambda name: (name != "c000", name))
        others = {name: value for name, value in properties.items() if not is_coefficient(name)}
        return cls(tuple((name, float(properties[name])) for name in named), **others)

    @property
    def values(self) -> dict[str, float]:
        """Coefficients, and the other differentiable parameters of the model, by name."""
        return dict(self.coefficients) | super().values

    def changed(self, **values: float) -> Polynomial:
        """Return a copy in which some coefficients or `d`, given by name, are replaced; see `Placement.changed`."""
        coefficients = tuple((name, values.get(name, number)) for name, number in self.coefficients)
        return replace(self, coefficients=coefficients, d=values.get("d", self.d))

    def event_lobes(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> tuple[Lobe, ...]:
        """Return the one lobe of an event, see `Placement.event_lobes`."""
        named = dict(self.coefficients)

        def profile(r: np.ndarray) -> np.ndarray:
            return np.asarray(carrier(r, named, self.d))

        ratio = None if depends_on_distance_alone(named) else self._ratio()
        return (Lobe(event, profile, shares=self.shares, ratio=ratio),)

    def _ratio(self) -> RatioTable:
        """Return the table of the BSDF divided by its `carrier`, extended smoothly past the horizon."""
        return RatioTable(np.ascontiguousarray(self._tabled(NODES)[1]), R_MIN, "angular")

    def _tabled(self, nodes: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Return the BSDF, 1/sr, and its ratio to `carrier` on grids `nodes` of specular angle, log r and azimuth ψ."""
        named = dict(self.coefficients)
        sine, r = np.sin(np.linspace(0, np.pi / 2, nodes[0])), np.geomspace(R_MIN, 2, nodes[1])
        sine, r, psi = np.ix_(sine, r, np.linspace(0, np.pi, nodes[2]))
        along, w = sine * r * np.cos(psi), sine * sine
        u = np.minimum(w + 2 * along + r * r, MOST_U)
        whole = polynomial.bsdf((u + w, u * w, w + along), r * r, *sums_of(named), self.d)
        return np.asarray(whole), np.asarray(whole / carrier(r, named, self.d))

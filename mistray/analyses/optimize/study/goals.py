"""Contributions of the terms of a design study to its merit, which the optimiser minimises.

The value of a term is v, and v₀ at the first start. Its weight is w, its tolerance t, its limit b, and its floor as a
share of v₀ is f. The merit is the sum of

    minimise   w ln((v + f v₀) / (v₀ + f v₀))
    at_least   w max(0, r)², r = 1 - (v - b) / (t |b|)
    at_most    w max(0, r)², r = 1 - (b - v) / (t |b|)
    keep       w r²,         r = (v - v₀) / (t |v₀|)

A limit costs w where it is just met, and nothing once the value is t |b| or more inside the limit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import drjit as dr
import numpy as np

from mistray.analyses.optimize.search.point import Pieces
from mistray.analyses.optimize.study.model import Term
from mistray.errors import MistrayError


def limit_of(term: Term, start: float) -> float | None:
    """Return the limit of a term, in its unit, or None if it has none; `start` is the term's value at the start."""
    return term.limit if term.limit_of_start is None else term.limit_of_start * start


def holds(term: Term, value: float, start: float) -> bool:
    """True if a term's goal permits a value, given the value at the start; "minimise" permits all."""
    if term.goal == "minimise":
        return True
    if term.goal == "keep":
        return abs(value - start) <= term.tolerance * abs(start)
    limit = limit_of(term, start)
    assert limit is not None
    return value >= limit if term.goal == "at_least" else value <= limit


def residual(term: Term, start: float) -> tuple[float, float]:
    """Return the value v of a term, in its unit, at which its residual r is 0, and dr/dv; not for "minimise"."""
    limit = limit_of(term, start)
    if limit is None:
        return start, 1 / (term.tolerance * abs(start))
    width = term.tolerance * abs(limit)
    return (limit + width, -1 / width) if term.goal == "at_least" else (limit - width, 1 / width)


def contribution(term: Term, value: Any, start: float) -> Any:
    """
    Return the contribution of a term to the merit.

    Parameters
    ----------
    term : Term
        Term of the study.
    value : mi.Float64
        Value in the unit of the term.
    start : float
        Its value at the start.

    Returns
    -------
    mi.Float64
        Contribution, dimensionless.
    """

    def number(x: float) -> Any:  # no literal, with which the kernel would change
        return dr.opaque(type(value), x)

    if term.goal == "minimise":
        floor = term.floor_of_start * start
        return term.weight * dr.log((value + number(floor)) / number(start + floor))
    zero, by_value = residual(term, start)
    r = (value - number(zero)) * number(by_value)
    return term.weight * dr.square(r if term.goal == "keep" else dr.maximum(r, 0))


def by_value(term: Term, value: float, start: float) -> float:
    """Return the derivative of a term's contribution to the merit with respect to its value, per unit of the term."""
    if term.goal == "minimise":
        return term.weight / (value + term.floor_of_start * start)
    zero, slope = residual(term, start)
    r = (value - zero) * slope
    return 2 * term.weight * slope * (r if term.goal == "keep" else max(r, 0.0))


def least_merit(terms: Sequence[Term]) -> float:
    """Return the least possible merit, dimensionless: all terms to be minimised are 0, and no limit adds a penalty."""
    floors = ((term.weight, term.floor_of_start) for term in terms if term.goal == "minimise")
    return sum((weight * math.log(floor / (1 + floor)) for weight, floor in floors), 0.0)


def pieces(
    terms: Sequence[Term], values: Mapping[str, float], slopes: Mapping[str, np.ndarray], start: Mapping[str, float]
) -> Pieces:
    """
    Return the gradient of the smooth part of the merit, and the residuals and gradients of its penalties.

    Parameters
    ----------
    terms : sequence of Term
        Terms of the study.
    values, start : mapping of str to float
        Values of the terms by name, here and at the start, in their units.
    slopes : mapping of str to (n,) float64
        Derivatives of the values with respect to the variables, by name of the term.
    """
    size = len(next(iter(slopes.values())))
    smooth = np.zeros(size)
    weights, residuals, rows, one_sided = [], [], [], []
    for term in terms:
        value, slope = values[term.name], slopes[term.name]
        if term.goal == "minimise":
            smooth += by_value(term, value, start[term.name]) * slope
            continue
        zero, factor = residual(term, start[term.name])
        weights.append(term.weight)
        residuals.append((value - zero) * factor)
        rows.append(slope * factor)
        one_sided.append(term.goal != "keep")
    return Pieces(
        smooth,
        np.array(weights, dtype=np.float64),
        np.array(residuals, dtype=np.float64),
        np.reshape(rows, (len(rows), size)).astype(np.float64),
        np.array(one_sided, dtype=bool),
    )


def check(terms: Sequence[Term], values: Mapping[str, float], start: Mapping[str, float], where: str, at: str) -> None:
    """
    Raise `MistrayError` if the terms' values give no merit: they are not finite or do not suit their goals.

    Parameters
    ----------
    terms : sequence of Term
        Terms of the study.
    values, start : mapping of str to float
        Values of the terms by name, here and at the start, in their units.
    where, at : str
        Name of the study and of the point, for the message.
    """
    for term in terms:
        value = values[term.name]
        this = f"{where}, term '{term.name}'"
        if not math.isfinite(value):
            raise MistrayError(f"{this}: its value is {value} at {at}; change the bounds or the term")
        if term.goal == "minimise" and not start[term.name] > 0:
            raise MistrayError(
                f"{this}: its value is {start[term.name]:g} at the start ({at}), which cannot be minimised; where no "
                "light goes there take more rays, another start or another term"
            )
        if term.goal == "minimise" and value < 0:
            raise MistrayError(f"{this}: its value is {value:g} at {at}; what is to be minimised must not be negative")
        if term.goal == "keep" and start[term.name] == 0:
            raise MistrayError(f"{this}: its value at the start is 0, which cannot be kept within a share of it")
        if limit_of(term, start[term.name]) == 0:
            raise MistrayError(f"{this}: its limit is 0; the tolerance is relative to it, give another number")

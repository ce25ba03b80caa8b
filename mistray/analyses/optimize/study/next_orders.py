"""Repeated verification of an optimisation with one more event allowed on each path, on the same seeds."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np

from mistray.analyses.optimize.study.comparison import Comparison, Levels, compare
from mistray.analyses.optimize.study.model import DesignStudy, Term
from mistray.analyses.optimize.study.terms import of_layers
from mistray.metrics.next_order import LIMITS, NextOrder, decided, next_limits
from mistray.sampling.sources import spectrum_of
from mistray.settings import Settings
from mistray.surfaces.surfaces import SurfaceTable

LEAST_SEEDS = 3

Measure = Callable[[DesignStudy, int, float], tuple[Levels, ...]]
"""The terms of a study in some designs, on so many seeds, or on fewer, `LEAST_SEEDS` at least, after a time in s."""


def with_next_orders(
    study: DesignStudy, scene: Any, first: tuple[Levels, Levels], seconds: float, measure: Measure
) -> tuple[Comparison, tuple[NextOrder, ...]]:
    """
    Return the comparison of two designs after measuring both with one more scatter event, and with one more reflection.

    Parameters
    ----------
    study : DesignStudy
        Study of the design.
    scene : mi.Scene
        Loaded scene.
    first : (Levels, Levels)
        Terms of the given design and of the result, by the study as it is.
    seconds : float
        Time for all measurements, s.
    measure : callable
        Measures the terms of both designs on the seeds of `first`, or on fewer if the time does not suffice.

    Returns
    -------
    (Comparison, tuple of NextOrder)
        Comparison of the designs, and the change of the result by each further event. The comparison includes the event
        that changes a term of the result most, if that change matters (see `NextOrder.matters`).
    """
    limits = [limit for limit in LIMITS if _raised(study, scene, limit)]
    found: list[tuple[tuple[Levels, ...], NextOrder]] = []
    for limit in limits:
        of_term = _raised(study, scene, limit)
        terms = tuple(
            replace(term, traced={**term.traced, limit: of_term[term.name]}) if term.name in of_term else term
            for term in study.terms
        )
        levels = measure(replace(study, terms=terms), len(first[1].seeds), seconds / len(limits))
        found.append((levels, _compared(first[1], levels[1], limit, of_term)))
    orders = decided([order for _, order in found])
    chosen = next((levels for (levels, _), order in zip(found, orders, strict=True) if order.taken), first)
    return compare(*chosen), orders


def _raised(study: DesignStudy, scene: Any, limit: str) -> dict[str, int]:
    """
    Return, by name of the term, the limit on events called `limit`, raised by one.

    Terms without such a limit are left out.
    """
    found: dict[str, int] = {}
    names = {f.name for f in fields(Settings)}
    for term in study.terms:
        if of_layers(term) or not _takes(term, limit):
            continue
        given = {key: value for key, value in term.traced.items() if key in names}
        line = spectrum_of(scene, term.traced.get("wavelength_nm"), term.traced.get("weights"))[0][0]
        limits = next_limits(Settings.without_sources(scene, **given), SurfaceTable(scene, float(line)))
        if limit in limits:
            found[term.name] = limits[limit]
    return found


def _takes(term: Term, limit: str) -> bool:
    """True if the function behind a term accepts a limit as an argument; a user's function may not."""
    if not callable(term.kind):
        return True
    named = inspect.signature(term.kind).parameters.values()
    return any(p.name == limit or p.kind == p.VAR_KEYWORD for p in named)


def _compared(first: Levels, more: Levels, limit: str, of_term: dict[str, int]) -> NextOrder:
    """Return the change of the terms in `of_term`, see `_raised`, from one measurement to another on common seeds."""
    count = len(more.seeds)
    before = np.stack([first.of(name) for name in of_term])
    after = np.stack([more.of(name) for name in of_term])
    apart = after - before[:, :count]

    def error(values: np.ndarray) -> np.ndarray:
        return np.asarray(values.std(axis=1, ddof=1) / np.sqrt(values.shape[1]))

    return NextOrder(
        limit,
        max(of_term.values()),
        tuple(of_term),
        before[:, :count].mean(axis=1),
        error(before[:, :count]),
        after.mean(axis=1),
        error(after),
        error(apart),
    )

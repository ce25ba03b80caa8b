"""Reads the sections ``[[term]]`` and ``[trace]`` of a study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mistray.errors import MistrayError
from mistray.optimize.study.model import GOALS, Term
from mistray.optimize.study.terms import (
    KINDS,
    LIGHT,
    OF_LAYERS,
    check_term,
    of_layers,
    old_arguments,
    own_arguments,
    traced_arguments,
)
from mistray.optimize.toml.section import Section, nearest

TERM_KEYS = ("name", "kind", "goal", "weight", "limit", "limit_of_start", "tolerance", "floor_of_start")
TRACE_KEYS = traced_arguments("path_power")
LIMITED = ("at_least", "at_most")


def read_traced(section: Section) -> dict[str, Any]:
    """Settings of traces among the keys of a section, checked as far as that goes without knowing what they are for."""
    found: dict[str, Any] = {}
    for key, value in section.content.items():
        if key == "field_deg":
            fields = section.spaced(key, -90.0, "degrees")
            if fields is not None and not all(-90 < angle < 90 for angle in fields):
                raise section.fail(key, f"is {list(fields)}; angles lie between -90 and 90 degrees")
            found[key] = fields
        elif key == "wavelength_nm":
            found[key] = section.spaced(key, 1e-3, "nm")
        elif key == "weights":
            found[key] = section.numbers(key)
            if min(found[key]) <= 0:
                raise section.fail(key, f"is {list(found[key])}; weights are greater than 0")
        elif isinstance(value, list):
            found[key] = tuple(value)
        else:
            found[key] = value
    if "weights" in found:
        count = len(found.get("wavelength_nm", ()))
        if len(found["weights"]) != count:
            raise section.fail(
                "weights", f"has {len(found['weights'])} entries for {count} wavelength_nm; give one each"
            )
    return found


def read_term(section: Section, trace: Mapping[str, Any]) -> Term:
    """
    One term of a study.

    Parameters
    ----------
    section : Section
    trace : mapping
        Settings of traces that the term has unless it says otherwise.
    """
    kind = section.content.get("kind")
    if kind is None:
        raise section.fail("kind", f"is missing; choose from {', '.join(KINDS)}")
    if not callable(kind) and kind not in KINDS:
        raise section.fail("kind", f"is {kind!r}; {nearest(str(kind), KINDS)}")
    called = kind if isinstance(kind, str) else getattr(kind, "__name__", "term")
    own, settings = own_arguments(kind), traced_arguments(kind)
    section = section.renamed(old_arguments(kind))
    section.known((*TERM_KEYS, *own, *(key for key in settings if key not in own)))
    for key, needed in own.items():
        if needed and key not in section.content:
            raise section.fail(key, f"is missing; kind = '{called}' needs it")
    goal = section.choice("goal", None, GOALS)
    limit, limit_of_start = section.finite("limit"), section.finite("limit_of_start")
    given = [key for key in ("limit", "limit_of_start") if key in section.content]
    if goal in LIMITED and len(given) != 1:
        what = "is one limit too many" if given else "is missing"
        raise section.fail(given[1] if given else "limit", f'{what}; with goal = "{goal}" give limit or limit_of_start')
    if goal not in LIMITED and given:
        raise section.fail(given[0], f'has no meaning with goal = "{goal}"; remove it')
    floor = Term.floor_of_start
    if "floor_of_start" in section.content:
        if goal != "minimise":
            raise section.fail("floor_of_start", f'has no meaning with goal = "{goal}"; remove it')
        floor = section.positive("floor_of_start", floor)
    here = {key: value for key, value in section.content.items() if key in settings and key not in own}
    if "wavelength_nm" in here and "weights" not in here:  # those of [trace] belong to its own wavelengths
        trace = {key: value for key, value in trace.items() if key not in LIGHT}
    traced = {key: value for key, value in trace.items() if key in settings and key not in own}
    read = read_traced(Section(section.title, section.place, here, section.folder))
    term = Term(
        section.text("name", called),
        kind,
        goal,
        section.positive("weight", Term.weight),
        limit,
        limit_of_start,
        section.positive("tolerance", Term.tolerance),
        floor,
        {key: tuple(v) if isinstance(v := section.content[key], list) else v for key in own if key in section.content},
        {**traced, **read},
    )
    if kind in OF_LAYERS and "coatings" in term.own:
        names = term.own["coatings"]
        if not isinstance(names, tuple) or not names or not all(isinstance(name, str) for name in names):
            raise section.fail("coatings", f"is {section.content['coatings']!r}; give a list of names of [[coating]]")
    if not callable(kind):
        try:
            check_term(term)
        except MistrayError as error:
            raise section.fail(f"(kind '{kind}'):", str(error)) from None
    return term


def check_coatings(terms: tuple[Term, ...], names: list[str], section: Section) -> None:
    """Raise if a term of layers names a coating that the study lacks, or has none to count."""
    for number, term in enumerate(terms, start=1):
        if not of_layers(term):
            continue
        if not names:
            raise section.fail(f"term[{number}]", f"of kind '{term.kind}' is about layers; add a section [[coating]]")
        for name in term.own.get("coatings", ()):
            if name not in names:
                raise section.fail(f"term[{number}].coatings", f"names '{name}'; {nearest(name, names)}")

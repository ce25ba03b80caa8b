"""Reader of the sections ``[[term]]`` and ``[trace]`` of a design study."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import MISSING
from typing import Any

from mistray.analyses.optimize.study.model import Term
from mistray.analyses.optimize.study.terms import (
    KINDS,
    LIGHT,
    OF_LAYERS,
    check_term,
    check_worst,
    of_layers,
    own_arguments,
    traced_arguments,
)
from mistray.analyses.pst.metrics.by_name import SETTINGS
from mistray.errors import MistrayError, nearest
from mistray.ranges import FIELD_DEG, WAVELENGTH_NM
from mistray.toolkit.toml_section import TomlSection, keys_of

TRACE_KEYS = traced_arguments("path_power")
SPACED = {"field_deg": FIELD_DEG, "wavelength_nm": WAVELENGTH_NM}


def read_traced(section: TomlSection, keys: Iterable[str]) -> dict[str, Any]:
    """
    Return the trace settings at the given keys of a section, after the checks that hold for all kinds of terms.

    Raises
    ------
    MistrayError
        If a value is impossible, or weights do not agree with wavelengths.
    """
    found: dict[str, Any] = {}
    for key in keys:
        value = section.content[key]
        if key in SPACED:
            found[key] = section.spaced(key, SPACED[key])
        elif key == "weights":
            found[key] = section.numbers(key)
            if min(found[key]) <= 0:
                raise section.fail(key, f"is {list(found[key])}; weights are greater than 0")
        else:
            if key in SETTINGS:
                section.value(key, SETTINGS[key])  # refused here, by its place; kept as it is written
            found[key] = tuple(value) if isinstance(value, list) else value
    if "weights" in found:
        count = len(found.get("wavelength_nm", ()))
        if len(found["weights"]) != count:
            raise section.fail(
                "weights", f"has {len(found['weights'])} entries for {count} wavelength_nm; give one each"
            )
    return found


def read_term(section: TomlSection, trace: Mapping[str, Any]) -> Term:
    """
    Return the merit term in a section ``[[term]]`` of a study.

    Parameters
    ----------
    section : TomlSection
        Section of the TOML file.
    trace : mapping
        Settings of traces that the term has unless its section says otherwise.

    Raises
    ------
    MistrayError
        If the kind or a key is unknown, a key is missing, or a value is impossible.
    """
    kind = section.content.get("kind")
    if kind is None:
        raise section.fail("kind", f"is missing; choose from {', '.join(KINDS)}")
    if not callable(kind) and kind not in KINDS:
        raise section.fail("kind", f"is {kind!r}; {nearest(str(kind), KINDS)}")
    called = kind if isinstance(kind, str) else getattr(kind, "__name__", "term")
    own, settings = own_arguments(kind), traced_arguments(kind)
    section.known((*keys_of(Term), *own, *(key for key in settings if key not in own)))
    for key, needed in own.items():
        if needed and key not in section.content:
            raise section.fail(key, f"is missing; kind = '{called}' needs it")
    here = [key for key in section.content if key in settings and key not in own]
    if "wavelength_nm" in here and "weights" not in here:  # those of [trace] belong to its own wavelengths
        trace = {key: value for key, value in trace.items() if key not in LIGHT}
    traced = {key: value for key, value in trace.items() if key in settings and key not in own}
    read = read_traced(section, here)
    own_values = {key: section.content[key] for key in own if key in section}
    known = {
        "kind": kind,
        "own": {key: tuple(value) if isinstance(value, list) else value for key, value in own_values.items()},
        "traced": {**traced, **read},
    }
    term = section.make(Term, known, name=called, goal=MISSING)  # a file says what a term is for
    if "floor_of_start" in section and term.goal != "minimise":
        raise section.fail("floor_of_start", f'has no meaning with goal = "{term.goal}"; remove it')
    if kind in OF_LAYERS and "coatings" in section:
        section.texts("coatings", "a list of names of [[coating]]")
    try:
        check_worst(term)
        if not callable(kind):
            check_term(term)
    except MistrayError as error:
        raise section.fail(f"(kind '{called}'):", str(error)) from None
    return term


def check_coatings(terms: tuple[Term, ...], names: list[str], section: TomlSection) -> None:
    """Raise `MistrayError` if a term on layers names a coating that is not in `names`, or there is no coating."""
    for number, term in enumerate(terms, start=1):
        if not of_layers(term):
            continue
        if not names:
            raise section.fail(f"term[{number}]", f"of kind '{term.kind}' is about layers; add a section [[coating]]")
        for name in term.own.get("coatings", ()):
            if name not in names:
                raise section.fail(f"term[{number}].coatings", f"names '{name}'; {nearest(name, names)}")

"""Reads a study from TOML; every message is one line with the file, the key and the remedy."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mistray.errors import MistrayError
from mistray.optimize.search import METHODS
from mistray.optimize.search.nlopt import ALGORITHMS, installed
from mistray.optimize.study.model import SEEDS, Optimizer, Study
from mistray.optimize.study.terms import of_layers, old_arguments
from mistray.optimize.toml.read_coating import read_coating
from mistray.optimize.toml.read_term import TRACE_KEYS, check_coatings, read_term, read_traced
from mistray.optimize.toml.read_variable import read_variable
from mistray.optimize.toml.section import Section

PATIENCE = {"sqp": 3, "lbfgsb": 2, "adam": 10, "nlopt": 10}  # steps
STARTS = 4  # with coatings
SECTIONS = ("trace", "term", "variable", "coating", "optimizer")


def read_study(source: str | Path | Mapping[str, Any]) -> Study:
    """
    Read a study.

    Parameters
    ----------
    source : str, Path or mapping
        A TOML file, or its content as a dictionary. See docs/optimization.md for the keys. Files of materials are
        sought relative to the TOML file. In a dictionary the kind of a term may be a function, see `Term`.

    Raises
    ------
    MistrayError
        If the file is missing or no TOML, a key is unknown or missing, or a value is impossible; one line with the
        file, the key and the remedy.
    """
    if isinstance(source, Mapping):
        return _read(Section("study", "", source, Path()), "study")
    return _read(Section.of_file(source, "study"), str(Path(source)))


def _read(whole: Section, name: str) -> Study:
    whole.known(SECTIONS)
    trace = whole.table("trace").renamed(old_arguments("path_power"))
    trace.known(TRACE_KEYS)
    shared = read_traced(trace)
    terms = tuple(read_term(section, shared) for section in whole.tables("term"))
    if all(of_layers(term) for term in terms):
        raise whole.fail("term", "is missing, or all are about layers alone; add a section [[term]] about light")
    coatings = tuple(read_coating(section, k) for k, section in enumerate(whole.tables("coating"), start=1))
    variables = tuple(read_variable(section) for section in whole.tables("variable"))
    if not coatings and not variables:
        raise whole.fail("variable", "is missing: nothing may change; add a section [[variable]] or [[coating]]")
    for key, names in (("term", [t.name for t in terms]), ("coating", [c.name for c in coatings])):
        for one in names:
            if names.count(one) > 1:
                raise whole.fail(f"{key}.name", f"'{one}' is given twice; give every [[{key}]] a name of its own")
    check_coatings(terms, [coating.name for coating in coatings], whole)
    limits = any(term.goal != "minimise" for term in terms)
    optimizer = read_optimizer(whole.table("optimizer"), limits, bool(coatings))
    return Study(name, terms, variables, coatings, optimizer)


def read_optimizer(section: Section, limits: bool, coatings: bool) -> Optimizer:
    """
    Section ``[optimizer]``.

    Parameters
    ----------
    section : Section
    limits : bool
        Whether a term has a limit or is kept: the method is then "sqp" unless the section says otherwise.
    coatings : bool
        Whether there are coatings, for which there are starts to be found.
    """
    section.known(Optimizer.__dataclass_fields__)
    method = section.choice("method", "sqp" if limits else "lbfgsb", tuple(METHODS))
    for key, owner in (("algorithm", "nlopt"), ("decay", "adam")):
        if key in section.content and method != owner:
            raise section.fail(key, f'has no meaning with method = "{method}"; remove it')
    seeds = section.choice("seeds", Optimizer.seeds, SEEDS)
    if seeds == "fresh" and method != "adam":
        raise section.fail(
            "seeds", f'is \'fresh\', which method = "{method}" cannot work with; take "fixed", or method = "adam"'
        )
    if method == "nlopt":
        try:
            installed()
        except MistrayError as error:
            raise section.fail("method:", str(error)) from None
    return Optimizer(
        method,
        section.choice("algorithm", Optimizer.algorithm, ALGORITHMS),
        section.whole("steps", Optimizer.steps, 0, 10_000),
        section.number("step_size", Optimizer.step_size, 1e-6, 1.0),
        section.number("decay", Optimizer.decay, 0.1, 1.0),
        section.number("tolerance", Optimizer.tolerance, 0.0, 1.0),
        section.whole("patience", PATIENCE[method], 1, 1000),
        seeds,
        section.whole("seed", Optimizer.seed, 0, 2**31),
        section.whole("starts", STARTS if coatings else 1, 1, 100),
        section.whole("searches", Optimizer.searches, 1, 100),
    )

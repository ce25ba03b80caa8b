"""Reader of design studies in TOML; every error message is one line with file, key and remedy."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mistray.analyses.optimize.search.nlopt import installed
from mistray.analyses.optimize.study.model import PATIENCE, STARTS, DesignStudy, Optimizer, check_names
from mistray.analyses.optimize.study.terms import of_layers
from mistray.analyses.optimize.toml.read_coating import read_coating
from mistray.analyses.optimize.toml.read_term import TRACE_KEYS, check_coatings, read_term, read_traced
from mistray.analyses.optimize.toml.read_variable import read_variable
from mistray.errors import MistrayError
from mistray.toolkit.toml_section import TomlSection

SECTIONS = ("trace", "term", "variable", "coating", "optimizer")


def read_study(source: str | Path | Mapping[str, Any]) -> DesignStudy:
    """
    Return a design study read from a TOML file or from a mapping.

    Parameters
    ----------
    source : str, Path or mapping
        A TOML file, or its content as a dictionary. See docs/optimization.md for the keys. Files of materials are
        sought relative to the TOML file. In a dictionary the kind of a term may be a function, see `Term`.

    Raises
    ------
    MistrayError
        If the file is missing or not TOML, a key is unknown or missing, or a value is impossible; one line with the
        file, the key and the remedy.

    Examples
    --------
    >>> study = mistray.optimize.read_study(
    ...     {
    ...         "term": [{"kind": "path_power", "selection": "ghost", "goal": "minimise"}],
    ...         "coating": [{"name": "ar", "surfaces": ["L1_front"], "layers": "MgF2 80", "thickness_nm": [60, 150]}],
    ...     }
    ... )
    >>> study.terms[0].name, study.coatings[0].bounds_nm
    ('path_power', ((60.0, 150.0),))
    """
    whole = TomlSection.of(source, "study")
    whole.known(SECTIONS)
    trace = whole.table("trace")
    trace.known(TRACE_KEYS)
    shared = read_traced(trace, trace.content)
    terms = tuple(read_term(section, shared) for section in whole.tables("term"))
    if all(of_layers(term) for term in terms):
        raise whole.fail("term", "is missing, or all are about layers alone; add a section [[term]] about light")
    coatings = tuple(read_coating(section, k) for k, section in enumerate(whole.tables("coating"), start=1))
    variables = tuple(read_variable(section) for section in whole.tables("variable"))
    if not coatings and not variables:
        raise whole.fail("variable", "is missing: nothing may change; add a section [[variable]] or [[coating]]")
    check_names(terms, coatings, whole.title)
    check_coatings(terms, [coating.name for coating in coatings], whole)
    limits = any(term.goal != "minimise" for term in terms)
    optimizer = read_optimizer(whole.table("optimizer"), limits, bool(coatings))
    return DesignStudy(
        "study" if isinstance(source, Mapping) else str(Path(source)), terms, variables, coatings, optimizer
    )


def read_optimizer(section: TomlSection, limits: bool, coatings: bool) -> Optimizer:
    """
    Return the settings of the section ``[optimizer]``.

    Parameters
    ----------
    section : TomlSection
        Section of the TOML file.
    limits : bool
        Whether a term has a limit or is kept: the method is then "sqp" unless the section says otherwise.
    coatings : bool
        Whether the study has coatings: the search then has four starts unless the section says otherwise.

    Raises
    ------
    MistrayError
        If a key is unknown or does not belong to the method, a value is impossible, or NLopt is not installed.
    """
    method = section.content.get("method", "sqp" if limits else Optimizer.method)
    starts = STARTS if coatings else Optimizer.starts
    optimizer = section.make(Optimizer, method=method, patience=PATIENCE.get(str(method), 1), starts=starts)
    for key, owner in (("algorithm", "nlopt"), ("decay", "adam")):
        if key in section and method != owner:
            raise section.fail(key, f'has no meaning with method = "{method}"; remove it')
    if method == "nlopt":
        try:
            installed()
        except MistrayError as error:
            raise section.fail("method:", str(error)) from None
    return optimizer

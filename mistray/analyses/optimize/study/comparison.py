"""Comparison of two designs on random seeds that the search has not used."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.analyses.optimize.request import SEEDS
from mistray.analyses.optimize.study.goals import holds, limit_of
from mistray.analyses.optimize.study.model import DesignStudy, Term
from mistray.analyses.optimize.study.state import Step
from mistray.analyses.optimize.study.terms import cell_settings, of_layers, of_pst, traced_metric
from mistray.errors import MistrayError, in_words
from mistray.estimate import Estimate
from mistray.metrics.changes.first_surfaces import Entering, FirstLight, spoils
from mistray.metrics.metric import Metric
from mistray.metrics.views import added_light, light_since
from mistray.ranges import ANYTHING, ByName
from mistray.ranges import SEEDS as SEED_COUNT
from mistray.result import KeyNumber, Result
from mistray.toolkit.rows import column

FALSE_ALARM = 0.01  # of `worse`, if nothing has changed
WORTH_TELLING = 0.01  # relative growth


@dataclass(frozen=True)
class ComparisonCell:
    """
    Key of a value: term, field angle and wavelength.

    Attributes
    ----------
    term : str
        Name of the term.
    field_deg : float or None
        Field angle, degrees; None: all fields of the term.
    wavelength_nm : float or None
        Wavelength, nm; None: all wavelengths of the term with their weights.
    """

    term: str
    field_deg: float | None = None
    wavelength_nm: float | None = None

    @property
    def whole(self) -> bool:
        """True if the value is for all fields and wavelengths of the term together."""
        return self.field_deg is None and self.wavelength_nm is None


@dataclass(frozen=True, repr=False)
class Levels(Result, table="..tables:levels_table", figure="..figures:levels_figure"):
    """
    Values of a study's terms in one scene, each in its unit, for every seed.

    Attributes
    ----------
    seeds : tuple of int
        Seeds of the random numbers of the traces.
    values : dict of ComparisonCell to (seeds,) float64
        Values in the unit of the term; NaN where a term has none, such as an RMS spot without light.
    units : dict of str to str
        Unit by name of the term.
    light : dict of str to FirstLight
        Light of all seeds by the first surface that it meets, for each field angle in words.

    Examples
    --------
    >>> term = {"kind": "path_power", "selection": "ghost", "goal": "minimise", "rays": 2000}
    >>> shift = {"parameters": ["window_front.y"], "low": -0.1, "high": 0.1}
    >>> study = mistray.optimize.read_study({"term": [term], "variable": [shift]})
    >>> levels = mistray.optimize.measure(mistray.load("lens_and_window"), study, seeds=2)
    >>> for cell, values in levels.values.items():
    ...     print(f"{cell.term}: {values.mean():.4f} {levels.units[cell.term]}, {values.size} seeds")
    path_power: 0.0135 W/W, 2 seeds
    """

    seeds: tuple[int, ...]
    values: dict[ComparisonCell, np.ndarray]
    units: dict[str, str] = field(default_factory=dict)
    light: dict[str, FirstLight] = field(default_factory=dict)

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the number of seeds, and the mean of each term with its standard error, by label."""
        means = {f"{name} [{self.units.get(name, '1')}]": value for name, value in self.means.items()}
        return {"seeds": len(self.seeds), **means}

    @property
    def means(self) -> dict[str, Estimate]:
        """Mean over the seeds of each term as a whole, in its unit, with its standard error."""
        count = len(self.seeds)
        return {
            cell.term: Estimate(
                float(np.mean(values)), float(np.std(values, ddof=1)) / math.sqrt(count) if count > 1 else math.nan
            )
            for cell, values in self.values.items()
            if cell.whole
        }

    def of(self, term: str) -> np.ndarray:
        """Return the value of a term over all its fields and wavelengths for each seed, (seeds,), in its unit."""
        return self.values[ComparisonCell(term)]

    def including(self, numbers: Mapping[str, float], units: Mapping[str, str]) -> Levels:
        """Return a copy with further terms, whose exact values and units are given by name; all seeds have the same."""
        for name, given in (("numbers", numbers), ("units", units)):
            ByName(ANYTHING, "{'weight': 1.0}").check(name, given)
        exact = {ComparisonCell(name): np.full(len(self.seeds), value) for name, value in numbers.items()}
        return dataclasses.replace(self, values={**self.values, **exact}, units={**self.units, **units})


@dataclass(frozen=True, kw_only=True)
class ComparisonRow:
    """
    Mean of a term over the seeds before and after optimisation, in `unit`; both designs trace the same rays.

    `ratio` is before over after: above 1 if the value is lower after optimisation, NaN if it is 0 then.
    """

    term: str = column("name of the term")
    unit: str = column("unit of the values")
    field_deg: float | None = column(
        "field angle, degrees; None: all fields of the term", None, digits="g", empty="all"
    )
    wavelength_nm: float | None = column("wavelength, nm; None: all of the term", None, digits="g", empty="all")
    before: float = column("value in the given design")
    before_se: float = column("its standard error")
    after: float = column("value in the result")
    after_se: float = column("its standard error")
    ratio: float = column("before over after", head="before / after")
    ratio_se: float = column("its standard error, which is smaller than theirs")

    @property
    def whole(self) -> bool:
        """True if the row is for all fields and wavelengths of the term together."""
        return self.field_deg is None and self.wavelength_nm is None


@dataclass(frozen=True, repr=False)
class Comparison(Result, table="..tables:rows_table", figure="..figures:comparison_figure"):
    """
    Comparison of two designs, before and after optimisation, on the same independent seeds.

    Attributes
    ----------
    seeds : tuple of int
        Seeds of the random numbers of the traces; empty in a comparison from the seed of the search (`of_search`).
    rows : tuple of ComparisonRow
        Rows of each term: the whole, each field, each wavelength, each field at each wavelength.
    entering : mapping of str to tuple of Entering
        Surfaces that light meets first in the second design but not in the first, by field angle in words.

    Examples
    --------
    >>> term = {"kind": "path_power", "selection": "ghost", "goal": "minimise", "rays": 2000}
    >>> shift = {"parameters": ["window_front.y"], "low": -0.1, "high": 0.1}
    >>> study = mistray.optimize.read_study({"term": [term], "variable": [shift]})
    >>> scenes = mistray.load("lens_and_window"), mistray.coat("lens_and_window", {"*": "mgf2_quarter_wave"})
    >>> found = mistray.optimize.compare(*(mistray.optimize.measure(scene, study, seeds=2) for scene in scenes))
    >>> print(f"{found.rows[0].ratio:.3f} ± {found.rows[0].ratio_se:.3f} times less")
    3.435 ± 0.002 times less
    """

    seeds: tuple[int, ...]
    rows: tuple[ComparisonRow, ...]
    entering: Mapping[str, tuple[Entering, ...]] = field(default_factory=dict)

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the first term before and after, their ratio, and the number of seeds, by label."""
        row = self.total
        before, after = Estimate(row.before, row.before_se), Estimate(row.after, row.after_se)
        numbers = {f"{row.term} before [{row.unit}]": before, f"after [{row.unit}]": after}
        return {**numbers, "before/after [1]": Estimate(row.ratio, row.ratio_se), "seeds": len(self.seeds)}

    @property
    def spoiled(self) -> bool:
        """True if so much light enters by new first surfaces that less stray light is no improvement."""
        return any(spoils(entering) for entering in self.entering.values())

    @property
    def total(self) -> ComparisonRow:
        """Row of the first term over all its fields and wavelengths."""
        return self.rows[0]

    def of(self, term: str) -> ComparisonRow:
        """Return the row of a term over all its fields and wavelengths."""
        return next(row for row in self.rows if row.term == term and row.whole)

    def marginals(self) -> Iterator[ComparisonRow]:
        """Iterate over the rows of whole terms, of single fields and of single wavelengths, without the pairs."""
        return (row for row in self.rows if row.field_deg is None or row.wavelength_nm is None)


def measure(
    scene: Any,
    study: DesignStudy,
    seeds: int = SEEDS,
    times: float = 1.0,
    paths: bool = False,
    *,
    least: int = 2,
    seconds: float = math.inf,
) -> Levels:
    """
    Return the traced terms of a study, measured on seeds that the search does not use: those after the study's own.

    Terms on coating layers are not among them.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    study : DesignStudy
        Study of the design.
    seeds : int
        Number of seeds, at least 2.
    times : float
        Factor on the number of rays of the terms for each seed.
    paths : bool
        Keep the paths of PSTs too, for `Levels.light`.
    least : int
        Number of seeds that are traced whatever the time, at least 2.
    seconds : float
        Time limit, s: no further seed is begun if it would not end within it.

    Returns
    -------
    Levels
        Values of the seeds that were traced; NaN for a term that raises `MistrayError`, as without light.

    Examples
    --------
    >>> term = {"kind": "path_power", "selection": "ghost", "goal": "minimise", "rays": 2000}
    >>> shift = {"parameters": ["window_front.y"], "low": -0.1, "high": 0.1}
    >>> study = mistray.optimize.read_study({"term": [term], "variable": [shift]})
    >>> levels = mistray.optimize.measure(mistray.load("lens_and_window"), study, seeds=2)
    >>> levels.seeds
    (1, 2)
    """
    SEED_COUNT.check("seeds", seeds)
    numbers = tuple(study.optimizer.seed + 1 + k for k in range(seeds))
    metrics: dict[ComparisonCell, Metric] = {}
    for term in study.terms:
        if not of_layers(term):
            metrics |= _cells(term, scene)
    views = {view.key: view for metric in metrics.values() for view in metric.views}
    values = {cell: np.zeros(seeds) for cell in metrics}
    light: dict[str, FirstLight] = {}
    began, done = time.perf_counter(), 0
    for j, seed in enumerate(numbers):
        spent = time.perf_counter() - began
        if j >= least and spent * (j + 1) / j > seconds:
            break
        seen = {key: view.observe(scene, times, {"seed": seed, "paths": paths}) for key, view in views.items()}
        for look in seen.values():
            light = added_light(light, look.first_light())
        for cell, metric in metrics.items():
            observations = [seen[view.key] for view in metric.views]
            try:
                values[cell][j] = float(dr.detach(mi.Float64(metric.function(observations)))[0])
            except MistrayError:
                values[cell][j] = np.nan  # no light there, or too little
        done = j + 1
    values = {cell: row[:done] for cell, row in values.items()}
    return Levels(numbers[:done], values, {cell.term: metric.unit for cell, metric in metrics.items()}, light)


def try_terms(study: DesignStudy, scene: Any) -> None:
    """
    Trace each term that is a user's function once, at its last field and wavelength alone.

    Raises
    ------
    MistrayError
        If a function fails there, so that this is known before the search.
    """
    for term in study.terms:
        if not callable(term.kind):
            continue
        try:
            metric = list(_cells(term, scene).values())[-1]
            metric.value(seed=study.optimizer.seed)
        except Exception as error:
            raise MistrayError(
                f"study '{study.name}', term '{term.name}': its function fails at one field and one wavelength: "
                f"{in_words(error)}; it must take field_deg and wavelength_nm of one entry too"
            ) from error


def of_search(study: DesignStudy, before: Step, after: Step) -> Comparison:
    """
    Return the comparison of two steps of a search, from its own seed, before verification.

    It has one row per term. Standard errors are NaN, and so is a ratio to 0; units are empty.
    """
    rows, unknown = [], dict.fromkeys(("before_se", "after_se", "ratio_se"), np.nan)
    for term in study.terms:
        b, a = before.terms[term.name], after.terms[term.name]
        ratio = b / a if a else np.nan
        rows.append(ComparisonRow(term=term.name, unit="", before=b, after=a, ratio=ratio, **unknown))
    return Comparison((), tuple(rows))


def worse(comparison: Comparison, terms: Sequence[Term]) -> list[ComparisonRow]:
    """
    Return the single fields, wavelengths and pairs of both at which a term has become worse, the worst first.

    A term to be minimised has grown there by more than 1 %, a term to be kept has left its tolerance, or a limit that
    held before is broken. Each of the n rows is tested by Student's t on the seeds, at the level 1 % / n. If nothing
    has changed, the list is empty with a probability of at least 99 % (Bonferroni). A term that had a value before, but
    has none after, is worse whatever its goal.

    Parameters
    ----------
    comparison : Comparison
        Design before and after, on equal seeds.
    terms : sequence of Term
        Terms of the study.
    """
    from scipy.stats import t as student

    goals = {term.name: term for term in terms}
    rows = [row for row in comparison.rows if not row.whole and np.isfinite(row.before) and (row.before or row.after)]
    if not rows:
        return []
    far = float(student.ppf(1 - FALSE_ALARM / len(rows), len(comparison.seeds) - 1))
    found = [row for row in rows if _suffers(goals[row.term], row, far)]
    # From 0, to 0 or to no value is worst
    return sorted(found, key=lambda row: min(row.ratio, 1 / row.ratio) if row.ratio and np.isfinite(row.ratio) else 0.0)


def _suffers(term: Term, row: ComparisonRow, far: float) -> bool:
    """
    True if a term has become worse in a row by more than `far` standard errors.

    By its goal, it has grown (by more than `WORTH_TELLING` too), left its tolerance, or broken a limit that held
    before. Without a value after, it is worse.
    """
    margin = far * row.ratio_se  # NaN where it is 0 after
    if math.isnan(row.after):
        return True
    if term.goal == "minimise":
        return row.ratio + margin < 1 and row.ratio * (1 + WORTH_TELLING) < 1
    if term.goal == "keep" and row.after == 0:
        return term.tolerance < 1 and abs(row.before) > far * row.before_se
    if term.goal == "keep":
        least, most = 1 / (1 + term.tolerance), np.inf if term.tolerance >= 1 else 1 / (1 - term.tolerance)
        return row.ratio + margin < least or row.ratio - margin > most
    limit = limit_of(term, row.before)
    assert limit is not None
    missing = limit - row.after if term.goal == "at_least" else row.after - limit
    # after - L before = after (1 - L before / after); where all seeds are dark after, the error is that of L before
    apart_se = abs(row.after) * row.ratio_se if row.after else row.before_se
    error = row.after_se if term.limit_of_start is None else abs(term.limit_of_start) * apart_se
    return holds(term, row.before, row.before) and missing > far * error


def _cells(term: Term, scene: Any) -> dict[ComparisonCell, Metric]:
    """
    Return the metrics of a term as a whole, for each field, for each wavelength, and for each pair of both.

    A PST, or a single field or wavelength, is not split.
    """
    fields = list(term.traced.get("field_deg") or ())
    lines = list(term.traced.get("wavelength_nm") or ())
    fields, lines = ([] if of_pst(term) or len(v) < 2 else v for v in (fields, lines))
    cells: list[tuple[float | None, int | None]] = [(None, None), *((angle, None) for angle in fields)]
    cells += [(None, k) for k in range(len(lines))] + [(angle, k) for angle in fields for k in range(len(lines))]
    result = {}
    for angle, k in cells:
        metric = traced_metric(term, scene, 0, **cell_settings(term.traced, angle, k))  # each measurement has its seed
        result[ComparisonCell(term.name, angle, None if k is None else lines[k])] = metric
    return result


def compare(before: Levels, after: Levels) -> Comparison:
    """
    Return the comparison of two designs measured with the same study and seeds: means, ratios, standard errors.

    Raises
    ------
    MistrayError
        If the seeds or the terms of both differ.

    Examples
    --------
    >>> term = {"kind": "path_power", "selection": "ghost", "goal": "minimise", "rays": 2000}
    >>> shift = {"parameters": ["window_front.y"], "low": -0.1, "high": 0.1}
    >>> study = mistray.optimize.read_study({"term": [term], "variable": [shift]})
    >>> scenes = mistray.load("lens_and_window"), mistray.coat("lens_and_window", {"*": "mgf2_quarter_wave"})
    >>> before, after = (mistray.optimize.measure(scene, study, seeds=2) for scene in scenes)
    >>> found = mistray.optimize.compare(before, after)
    >>> print(f"{found.rows[0].before:.4f} before, {found.rows[0].after:.4f} after")
    0.0135 before, 0.0039 after
    """
    if before.seeds != after.seeds:
        raise MistrayError("the two measurements differ in seeds; measure both scenes with the same study")
    if before.values.keys() != after.values.keys():
        raise MistrayError("the two measurements differ in terms; measure both scenes with the same study")
    rows = []
    for cell, b in before.values.items():
        a = after.values[cell]
        root = np.sqrt(len(b))
        ratio, ratio_se = np.nan, np.nan
        if a.mean() != 0:
            ratio = b.mean() / a.mean()
            ratio_se = (b - ratio * a).std(ddof=1) / abs(a.mean()) / root  # of a ratio of means
        rows.append(
            ComparisonRow(
                **vars(cell),
                unit=before.units.get(cell.term, ""),
                before=float(b.mean()),
                before_se=float(b.std(ddof=1) / root),
                after=float(a.mean()),
                after_se=float(a.std(ddof=1) / root),
                ratio=float(ratio),
                ratio_se=float(ratio_se),
            )
        )
    return Comparison(before.seeds, tuple(rows), light_since(before.light, after.light))

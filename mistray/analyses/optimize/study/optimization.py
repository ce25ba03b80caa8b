"""Optimisation of parameters of a scene: starts, searches along the gradient, and verification on other seeds."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mistray.analyses.optimize.request import DesignRequest
from mistray.analyses.optimize.study.checkpoint import Checkpoint
from mistray.analyses.optimize.study.comparison import (
    Comparison,
    Levels,
    compare,
    measure,
    of_search,
    try_terms,
)
from mistray.analyses.optimize.study.merit import Merit
from mistray.analyses.optimize.study.model import DesignStudy
from mistray.analyses.optimize.study.next_orders import LEAST_SEEDS, with_next_orders
from mistray.analyses.optimize.study.searches import Progress, Searches
from mistray.analyses.optimize.study.starts import starts
from mistray.analyses.optimize.study.state import Start, State, Step
from mistray.analyses.optimize.study.study_scene import PlacedDesign, StudyScene, band, open_scene, place
from mistray.analyses.optimize.study.terms import UNITS_OF_LAYERS, layer_value, of_layers, traced_metric
from mistray.analyses.optimize.study.variables import Variables, find_variables
from mistray.analyses.optimize.toml.read_study import read_study
from mistray.coatings import LAYER_PARAMETERS, Stack
from mistray.errors import MistrayError, in_words
from mistray.metrics.changes.gaps import Contacts, Gap
from mistray.metrics.next_order import NextOrder
from mistray.metrics.parameters import SHAPE_KINDS
from mistray.metrics.views import seen_unpolarized
from mistray.ranges import SECONDS
from mistray.ranges import SEEDS as SEED_COUNT
from mistray.result import KeyNumber, Result
from mistray.scene import load
from mistray.scene.load import find
from mistray.scene.recoat import SharedCoating
from mistray.toolkit.analysis import analysis

SHARE_OF_SEARCH = 0.6  # of the time that is given; the comparison has the rest


@dataclass(frozen=True, repr=False)
class Optimization(Result, table="..tables:all_terms_table", figure="..figures:search_figure"):
    """
    Result of `optimize`: steps of all searches, best step, and comparison with the given design.

    Attributes
    ----------
    study : DesignStudy
        Study of the design.
    source : Path
        The scene file.
    placed : tuple of PlacedDesign
        The coatings of the study and their surfaces.
    band_nm : tuple of float
        Wavelengths for which the coatings are made, ascending, nm; empty without coatings.
    variables : Variables
        Variables of the study in this scene.
    thickness_keys : dict of str to str
        Name of a coating of the study → key of its thicknesses.
    starts : tuple of Start
        Starts of the searches; the first is the given design.
    steps : tuple of Step
        All steps of all searches.
    ended : dict
        Index of a start → why its search ended. Starts that were only evaluated are not in it.
    best : Step
        Step of the searches that is the result.
    comparison : Comparison
        The given design and the result on independent seeds, with the further event on each path that matters; on the
        seeds of the search if `unverified`.
    next_orders : tuple of NextOrder
        Change of the result's terms by one more scatter event, and by one more reflection; empty if not measured.
    unverified : str
        The error that ended the comparison; empty if there was none.
    gaps : tuple of Gap
        Surfaces that meet in the given design and are apart in the result, see `mistray.metrics.changes.gaps`.
    left_out : tuple of str
        Effects that the gradients do not contain.
    edge_widths : dict
        Width of the zones at rims over their radii, for the gradient of "merit", or of each term if the method needs
        them one by one. Gradients that meet no rims are missing.
    search_seconds, traced_seconds, verification_seconds : float
        Time of the searches, of the traces and derivatives in them, and of the comparison, s.

    Examples
    --------
    >>> study = {
    ...     "term": [{"kind": "path_power", "selection": "ghost", "goal": "minimise", "rays": 1000}],
    ...     "coating": [{"name": "ar", "surfaces": ["L1_front"], "layers": "MgF2 80", "thickness_nm": [60, 150]}],
    ... }
    >>> found = mistray.optimize.optimize("lens_and_window", study, steps=2, verification_seeds=2, next_order=False)
    >>> row = found.comparison.rows[0]
    >>> print(f"{row.before:.5f} before, {row.after:.5f} after")
    0.01254 before, 0.01236 after
    >>> found.coatings[0].surfaces
    ('L1_front',)
    """

    study: DesignStudy
    source: Path
    placed: tuple[PlacedDesign, ...]
    band_nm: tuple[float, ...]
    variables: Variables
    thickness_keys: dict[str, str]
    starts: tuple[Start, ...]
    steps: tuple[Step, ...]
    ended: dict[int, str]
    best: Step
    comparison: Comparison
    next_orders: tuple[NextOrder, ...]
    unverified: str
    gaps: tuple[Gap, ...]
    left_out: tuple[str, ...]
    edge_widths: dict[str, float]
    search_seconds: float
    traced_seconds: float
    verification_seconds: float

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the first term before and after, their ratio, and the number of variables, by label."""
        return {**self.comparison.key_numbers(), "variables": len(self.variables)}

    @property
    def before(self) -> dict[str, float]:
        """Start value of each variable, in its unit, by name."""
        return dict(zip(self.variables.names, self.variables.start.tolist(), strict=True))

    @property
    def after(self) -> dict[str, float]:
        """Optimised value of each variable, in its unit, by name."""
        return dict(zip(self.variables.names, self.best.x, strict=True))

    def thickness_nm(self, coating: str, step: Step | None = None) -> np.ndarray:
        """Return the layer thicknesses of a coating in nm, (layers,), in the result or at another step."""
        return self.variables.parameters((step or self.best).x)[self.thickness_keys[coating]]

    def stack(self, coating: str, step: Step | None = None) -> Stack:
        """Return the layers of a coating in the result or at another step, with the changes of n and k."""
        moved = self.variables.parameters((step or self.best).x)
        plugin = self.thickness_keys[coating].rpartition(".")[0]
        (start,) = (item.group.start for item in self.placed if item.group.name == coating)
        columns = {name: moved[key] for name in LAYER_PARAMETERS if (key := f"{plugin}.{name}") in moved}
        layers = (
            dataclasses.replace(layer, **{name: float(column[k]) for name, column in columns.items()})  # type: ignore[arg-type]
            for k, layer in enumerate(start.layers)
        )
        return dataclasses.replace(start, layers=tuple(layers))

    @property
    def coatings(self) -> list[SharedCoating]:
        """Optimised coatings, in the form that `mistray.scene.recoat` takes; changes of n and k are in `parameters`."""
        return [item.shared(self.thickness_nm(item.group.name)) for item in self.placed]

    @property
    def parameters(self) -> dict[str, np.ndarray]:
        """Optimised values, (entries,), of all moved parameters but layer thicknesses, by key, in their units."""
        moved = self.variables.parameters(self.best.x)
        return {key: value for key, value in moved.items() if key not in self.thickness_keys.values()}


def run(
    scene: str | Path,
    request: DesignRequest,
    study: str | Path | Mapping[str, Any] | DesignStudy,
    *,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    seconds: float | None = None,
) -> Optimization:
    """
    Minimise the merit of a study over its variables.

    Every search follows the gradient of the traced merit within the bounds of the variables. The result is a local
    minimum at best; several starts make a better one likely, no more. The measurement of both designs with one more
    event takes at most the time of the first measurement, or that of three seeds. A search may exploit light beyond its
    limits. If one more event changes a term of the result by more than 5 % and two errors, the comparison includes it.

    Parameters
    ----------
    scene : str or Path
        Scene XML file or name of a shipped scene.
    request : DesignRequest
    study : str, Path, mapping or DesignStudy
        Study, or its TOML file, or the content of one as a mapping; see docs/optimization.md.
    checkpoint : str or Path, optional
        File that holds the state after every evaluation; None: the state is not kept.
    resume : bool
        Go on from the checkpoint; the result is the same as without interruption.
    progress : callable, optional
        Called after each step with the `Step` and the `Start` of its search.
    seconds : float, optional
        Time for the searches and the comparison, s; the comparison then has fewer seeds, at least 2. Searches that it
        ends can be resumed from the checkpoint.

    Returns
    -------
    Optimization

    Raises
    ------
    MistrayError
        If the study or the scene cannot be used, `resume` lacks a checkpoint or has that of something else, a minimised
        term is 0 or any value is not finite at the start, or the function of a term fails in a trial before the search.
        A later point without a merit only ends its search. An error after the search is reported in the result.

    Examples
    --------
    >>> study = {
    ...     "term": [{"kind": "path_power", "selection": "ghost", "goal": "minimise", "rays": 1000}],
    ...     "coating": [{"name": "ar", "surfaces": ["L1_front"], "layers": "MgF2 80", "thickness_nm": [60, 150]}],
    ... }
    >>> found = mistray.optimize.optimize("lens_and_window", study, steps=2, verification_seeds=2, next_order=False)
    >>> print(f"{found.best.x[0]:.0f} nm instead of {found.steps[0].x[0]:.0f} nm")
    106 nm instead of 80 nm
    """
    read = study if isinstance(study, DesignStudy) else read_study(study)
    if request.steps is not None:
        read = dataclasses.replace(read, optimizer=dataclasses.replace(read.optimizer, steps=request.steps))
    if resume and checkpoint is None:
        raise MistrayError("resume needs a checkpoint; name the file of the state to go on from")
    end = None if seconds is None else time.perf_counter() + SECONDS.check("seconds", seconds)
    source = find(scene)
    file = None if checkpoint is None else Checkpoint(Path(checkpoint), source, read.fingerprint)
    state = file.read() if file is not None and resume else State()
    bare = load(source)
    placed = place(bare, read)
    wavelengths, weights = band(bare, read) if placed else ((), ())
    with open_scene(source, placed) as opened:
        variables = find_variables(read, opened.params, opened.known, opened.thickness_keys)
        if not state.starts:
            state.starts = starts(variables, placed, wavelengths, weights, read.optimizer.starts, read.optimizer.seed)
        try_terms(read, opened.scene)
        contacts = Contacts(opened.scene)
        merit = Merit(read, opened.scene, opened.params, variables, opened.thickness_keys)
        searches = Searches(
            *(merit, variables.shares, variables.values, read.optimizer, state, file, progress),
            seconds=None if end is None else SHARE_OF_SEARCH * (end - time.perf_counter()),
        )
        searches.run()
        seeds = request.verification_seeds
        if end is not None:  # both designs are traced on every seed
            measurements = 2 * (2 if request.next_order else 1)
            in_time = int((end - time.perf_counter()) / (measurements * searches.each))
            seeds = min(max(in_time, int(SEED_COUNT.low)), seeds)
        best = searches.best
        started = time.perf_counter()
        designs = variables.start, np.array(best.x)
        orders: tuple[NextOrder, ...] = ()
        unpolarized: tuple[str, ...] = ()
        unverified = ""

        def both(asked: DesignStudy, seeds: int, seconds: float, least: int = LEAST_SEEDS) -> tuple[Levels, Levels]:
            before = _levels(asked, opened, variables, designs[0], seeds, least, seconds / 2)
            return before, _levels(asked, opened, variables, designs[1], len(before.seeds), len(before.seeds))

        try:
            levels = both(read, seeds, math.inf)
            comparison = compare(*levels)
            if request.next_order and (end is None or time.perf_counter() < end):
                spent = time.perf_counter() - started
                left = spent if end is None else min(spent, end - time.perf_counter())
                comparison, orders = with_next_orders(read, opened.scene, levels, left, both)
            variables.apply(opened.params, designs[1])
            metrics = [
                traced_metric(term, opened.scene, read.optimizer.seed) for term in read.terms if not of_layers(term)
            ]
            unpolarized = tuple(seen_unpolarized(opened.scene, [view for metric in metrics for view in metric.views]))
        except Exception as error:  # what the search has found is not lost to it
            unverified, comparison = in_words(error), of_search(read, searches.steps[0], best)
            variables.apply(opened.params, designs[1])
        gaps = contacts.opened(opened.scene)  # which is the result now
    return Optimization(
        study=read,
        source=source,
        placed=placed,
        band_nm=wavelengths,
        variables=variables,
        thickness_keys=opened.thickness_keys,
        starts=tuple(state.starts),
        steps=tuple(searches.steps),
        ended=searches.ended,
        best=best,
        comparison=comparison,
        next_orders=orders,
        unverified=unverified,
        gaps=gaps,
        left_out=(*state.left_out, *unpolarized),
        edge_widths=state.edge_widths,
        search_seconds=state.seconds,
        traced_seconds=state.traced_seconds,
        verification_seconds=time.perf_counter() - started,
    )


optimize = analysis("optimize", DesignRequest, run, positional=("study",))


def _levels(
    study: DesignStudy,
    opened: StudyScene,
    variables: Variables,
    x: np.ndarray,
    seeds: int,
    least: int,
    seconds: float = math.inf,
) -> Levels:
    """Measure all terms on several seeds with the variables set to `x`, and return their values; see `measure`."""
    variables.apply(opened.params, x)
    layers = [term for term in study.terms if of_layers(term)]
    numbers = {
        term.name: layer_value(term, study.coatings, opened.thickness_keys, variables.parameters(x))[0]
        for term in layers
    }
    kinds = {opened.known[key].kind for key in variables.parameters(x) if key in opened.known}
    paths = not kinds.isdisjoint(SHAPE_KINDS)
    found = measure(opened.scene, study, seeds, paths=paths, least=min(least, seeds), seconds=seconds)
    return found.including(numbers, {t.name: UNITS_OF_LAYERS[t.kind] for t in layers})

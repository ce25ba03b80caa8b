"""Searches of a study from all its starts, and their resumption after an interruption."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from mistray.analyses.optimize.search import METHODS, stop_reason
from mistray.analyses.optimize.search.point import Pieces, Point
from mistray.analyses.optimize.study.checkpoint import Checkpoint
from mistray.analyses.optimize.study.model import Optimizer
from mistray.analyses.optimize.study.state import Evaluation, Start, State, Step
from mistray.errors import MistrayError, UnfinishedError, in_words

STEPS_USED = "all steps used"
TIME_USED = "the time was up"
LIMITS_HOLD = "all limits hold"
ZERO = "all that was to be minimised is 0, and all limits hold"
EXACT = 1e-12  # relative error of a merit that is known exactly

Progress = Callable[[Step, Start], None]


class Problem(Protocol):
    """Interface of the merit that is minimised, such as `mistray.analyses.optimize.study.merit.Merit`."""

    start: dict[str, float] | None
    edge_widths: dict[str, float]

    @property
    def least(self) -> float:
        """Least possible value of the merit, dimensionless."""

    def evaluate(self, y: np.ndarray, number: int) -> dict[str, Any]:
        """
        Return merit and gradient at a point, (n,): variables as fractions of the way from the low to the high bound.

        `number` is the index of the evaluation in its search, from 0. For the dictionary see `Merit.evaluate`.
        """

    def pieces(self, at: Evaluation) -> Pieces | None:
        """Return the smooth part and the penalties of an evaluated merit; None if the method does not need them."""

    def broken(self, values: dict[str, float]) -> tuple[str, ...]:
        """Return the names of the terms whose values, in their units, break their limits; see `Merit.broken`."""


class Ended(Exception):
    """Exception that ends a search; its text gives the reason."""


class Searches:
    """
    Searches for the least merit from all starts, which share one problem and one state.

    Every evaluation is kept. After an interruption each search begins again from its start, and the kept evaluations
    take the place of new ones. All methods are deterministic, so it returns to where it was and continues from there.

    Parameters
    ----------
    problem : Problem
        Merit that is minimised.
    shares, values : callable
        Functions that convert values of the variables, (n,), in their units to fractions of the way from the low to the
        high bound, and back.
    optimizer : Optimizer
        Settings of the search.
    state : State
        State with its starts.
    file : Checkpoint, optional
        File in which the state is kept; None: it is not kept.
    progress : callable, optional
        Called after each step with the step and the start of its search.
    seconds : float, optional
        Time for all searches, s; None: no limit. The first start is always evaluated; after it nothing begins that
        would end too late.

    Attributes
    ----------
    steps : list of Step
        Steps in the order in which the searches make them.
    ended : dict
        Index of a start → reason for the end of its search. Starts that were only evaluated are not in it.
    """

    def __init__(
        self,
        problem: Problem,
        shares: Callable[[np.ndarray], np.ndarray],
        values: Callable[[np.ndarray], np.ndarray],
        optimizer: Optimizer,
        state: State,
        file: Checkpoint | None = None,
        progress: Progress | None = None,
        seconds: float | None = None,
    ) -> None:
        self._started, self._made = time.perf_counter(), 0
        self._seconds = seconds
        self.problem, self.shares, self.values, self.optimizer = problem, shares, values, optimizer
        self.state, self.file, self.progress = state, file, progress
        self.steps: list[Step] = []
        self.ended: dict[int, str] = {}
        self._began = time.perf_counter() - state.seconds
        self._asked = 0  # evaluations that the searches have requested, kept ones included
        self._known = [len(search) for search in state.evaluations] + [0] * len(state.starts)
        if state.evaluations and state.evaluations[0]:
            problem.start = state.evaluations[0][0].terms
            problem.edge_widths = state.edge_widths

    def run(self) -> None:
        """Evaluate all starts for which there is time, then search from those with the lowest merit."""
        while len(self.state.evaluations) < len(self.state.starts):
            self.state.evaluations.append([])
        first = []
        for number, start in enumerate(self.state.starts):
            if number and not self.state.evaluations[number] and self._is_time_used():
                break
            first.append(self._at(number, 0, self.shares(start.x)))
            self._asked += 1
            self._note(number, 0, first[-1], self._known[number] == 0)
        for number in sorted(range(len(first)), key=lambda n: first[n].merit)[: self.optimizer.searches]:
            self._search(number)

    @property
    def best(self) -> Step:
        """
        Step that is the result of the optimisation.

        With fixed seeds, or before any search has ended, it is the step of the least merit. With fresh seeds the least
        merit is the luckiest. The result is then the last step of the search with the least mean over its last
        `patience` merits.
        """
        if self.optimizer.seeds == "fixed" or not self.ended:
            return min(self.steps, key=lambda step: step.merit)
        lasts = {}
        for number in self.ended:
            own = [step for step in self.steps if step.start == number]
            lasts[number] = float(np.mean([step.merit for step in own[-self.optimizer.patience :]]))
        winner = min(lasts, key=lambda number: lasts[number])
        return [step for step in self.steps if step.start == winner][-1]

    def _at(self, start: int, number: int, y: np.ndarray) -> Evaluation:
        """
        Return evaluation `number` of the search from the start of index `start`: a saved one, or else a new one.

        The saved one must be at the point `y`, see `Problem.evaluate`; otherwise `MistrayError` is raised.

        Raises
        ------
        Ended
            If a point other than the start has no merit. An error at the start itself, or an `UnfinishedError`, is
            raised unchanged.
        """
        kept = self.state.evaluations[start]
        if number < len(kept):
            if not np.array_equal(kept[number].y, y):
                raise MistrayError(
                    "checkpoint: the search asks for other points than before, as with another version of SciPy; run "
                    "without resuming"
                )
            return kept[number]
        try:
            result = self.problem.evaluate(y, number)
        except UnfinishedError:
            raise
        except Exception as error:  # of a function of one's own as well
            if number == 0:
                raise
            raise Ended(f"the next point has no merit: {in_words(error)}") from None
        self._made += 1
        # What is left out comes with numbers that differ from point to point; the last ones stay
        left_out = [*self.state.left_out, *result.pop("left_out")]
        self.state.left_out = list({text.partition(":")[0]: text for text in left_out}.values())
        kept.append(Evaluation(y=y.copy(), seconds=time.perf_counter() - self._began, **result))
        if self.file is not None:
            self.file.write(self.state)
        return kept[-1]

    def _is_time_used(self) -> bool:
        """True if another evaluation of mean duration would end after the time limit; False without a limit."""
        return self._seconds is not None and time.perf_counter() - self._started + self.each > self._seconds

    @property
    def each(self) -> float:
        """
        Mean time of an evaluation, s, slightly overestimated because the first ones compile kernels.

        Before the first evaluation of this run it is that of the continued run, or 0 for a new one.
        """
        if self._made:
            return (time.perf_counter() - self._started) / self._made
        return self.state.seconds / max(sum(map(len, self.state.evaluations)), 1)

    def _note(self, start: int, step: int, at: Evaluation, new: bool) -> None:
        """Store step number `step` of a search, and report it if it is `new`, not one made before an interruption."""
        starts, most = len(self.state.starts), self.optimizer.steps
        searches = min(starts, self.optimizer.searches)
        done = starts + len(self.ended) * most + step if step else start + 1
        self.steps.append(
            Step(
                start=start,
                step=step,
                evaluations=self._asked,
                merit=at.merit,
                merit_se=at.merit_se,
                terms=dict(at.terms),
                broken=self.problem.broken(at.terms),
                gradient_norm=float(np.linalg.norm(at.free_slope)),
                seconds=at.seconds,
                x=tuple(self.values(at.y).tolist()),
                share_done=min(done / (starts + searches * most), 1.0),  # steps of an earlier run may be more
            )
        )
        if new and self.progress is not None:
            self.progress(self.steps[-1], self.state.starts[start])

    def _search(self, start: int) -> None:
        """Minimise the merit from the start of index `start`, and store the reason why the search ended."""
        kept = self.state.evaluations[start]
        asked = 0
        merits = [kept[0].merit]

        def function(y: np.ndarray) -> Point:
            nonlocal asked
            if asked >= len(kept) and len(merits) > self.optimizer.steps:
                raise Ended(STEPS_USED)
            if asked >= len(kept) and self._is_time_used():
                raise Ended(TIME_USED)
            at = self._at(start, asked, y)
            self._asked += asked > 0  # the start itself is counted already
            asked += 1
            return Point(at.merit, at.slope, self.problem.pieces(at))

        def after(y: np.ndarray) -> None:
            at = next(evaluation for evaluation in reversed(kept[:asked]) if np.array_equal(evaluation.y, y))
            self._note(start, len(merits), at, asked > self._known[start])
            merits.append(at.merit)
            if asked < len(kept):  # a search that went on before goes on now
                return
            least = self.problem.least
            if at.merit <= least + EXACT * abs(least):
                raise Ended(ZERO if least < 0 else LIMITS_HOLD)
            how = self.optimizer
            reason = stop_reason(merits, how.tolerance, how.patience, how.seeds == "fresh")
            if reason is not None:
                raise Ended(reason)

        try:
            self.ended[start] = METHODS[self.optimizer.method](function, kept[0].y, self.optimizer, after)
        except Ended as reason:
            self.ended[start] = str(reason)

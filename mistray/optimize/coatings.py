"""Makes a metric small by the thicknesses of coatings: start designs, searches along the traced gradient, proof."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from mistray.errors import MistrayError
from mistray.optimize.checkpoint import Checkpoint, State, Step
from mistray.optimize.designs import CoatedScene, Design, Placed, place, spectrum
from mistray.optimize.gradient import LEFT_OUT, gradient
from mistray.optimize.read_study import read_study
from mistray.optimize.starts import starts
from mistray.optimize.study import Study
from mistray.optimize.verify import Comparison, compare, measure
from mistray.scene import load
from mistray.scene.load import find
from mistray.scene.recoat import SharedCoating

FIRST_STEP_NM = 5.0  # the largest change of a thickness in the first step of a search
SMALL_STEPS = 2  # so many in a row end a search
STEPS_USED = "all steps used"

Progress = Callable[[Step, Design], None]


@dataclass(frozen=True)
class Optimization:
    """
    Result of `optimize_coatings`.

    Attributes
    ----------
    study : Study
    source : Path
        The scene file.
    placed : tuple of Placed
        The coatings and their surfaces.
    band_nm : tuple of float
        Wavelengths of the metric, ascending, nm.
    designs : tuple of Design
        The start designs; the first is the given one.
    steps : tuple of Step
        All steps of all searches, in the order of time.
    ended : dict
        Number of a start → why its search ended. Starts that were only evaluated are not in it.
    best : Design
        The result.
    comparison : Comparison
        The given start and the result on independent seeds.
    left_out : tuple of str
        What the gradients do not contain.
    search_seconds, verification_seconds : float
    """

    study: Study
    source: Path
    placed: tuple[Placed, ...]
    band_nm: tuple[float, ...]
    designs: tuple[Design, ...]
    steps: tuple[Step, ...]
    ended: dict[int, str]
    best: Design
    comparison: Comparison
    left_out: tuple[str, ...]
    search_seconds: float
    verification_seconds: float

    @property
    def best_step(self) -> Step:
        """The step with the smallest metric."""
        return min(self.steps, key=lambda step: step.value)

    @property
    def coatings(self) -> list[SharedCoating]:
        """The resulting coatings, for `mistray.scene.recoat`."""
        return [item.shared(self.best.thickness_nm[item.group.name]) for item in self.placed]


def optimize_coatings(
    scene: str | Path,
    study: str | Path | Mapping[str, Any] | Study,
    *,
    steps: int | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Optimization:
    """
    Find thicknesses of coatings that make a metric small.

    Every search goes along the gradient of the traced metric (L-BFGS-B on the logarithm of the metric, within the
    bounds of the thicknesses). All evaluations trace the same rays, so that the metric is a smooth function of the
    thicknesses. What comes out is a local minimum of that function; several starts make a better one likely, no more.

    Parameters
    ----------
    scene : str or Path
        Scene XML file or name of a shipped scene.
    study : str, Path, mapping or Study
        See docs/optimization.md.
    steps : int, optional
        Most steps of each search, instead of the study's.
    checkpoint : str or Path, optional
        File that holds the state after every step.
    resume : bool
        Go on from the checkpoint.
    progress : callable, optional
        Called after each step with the `Step` and the start `Design` of its search.

    Returns
    -------
    Optimization

    Raises
    ------
    MistrayError
        If the study or the scene cannot be used, the metric is 0, or the checkpoint belongs to something else.
    """
    read = study if isinstance(study, Study) else read_study(study)
    if steps is not None:
        if steps < 0:
            raise MistrayError(f"steps is {steps}; it must not be negative")
        read = dataclasses.replace(read, optimizer=dataclasses.replace(read.optimizer, steps=steps))
    if resume and checkpoint is None:
        raise MistrayError("resume needs a checkpoint; name the file of the state to go on from")
    source = find(scene)
    file = None if checkpoint is None else Checkpoint(Path(checkpoint), source, read.fingerprint)
    state = file.read() if file is not None and resume else State()
    bare = load(source)
    placed = place(bare, read)
    band, weights = spectrum(bare, read.metric)
    if not state.designs:
        state.designs = starts(placed, band, weights, read.optimizer.starts, read.metric.seed)
    coated = CoatedScene(source, placed)
    search = _Search(coated, read, state, file, progress)
    search.run()
    best = state.best()
    design = Design(
        state.designs[best.start].name, {name: np.array(d, dtype=np.float64) for name, d in best.thickness_nm.items()}
    )
    started = time.perf_counter()
    levels = []
    for thickness in (state.designs[0].thickness_nm, design.thickness_nm):
        coated.apply(thickness)
        levels.append(measure(coated.scene, read.metric))
    return Optimization(
        read,
        source,
        placed,
        band,
        tuple(state.designs),
        tuple(state.steps),
        dict(state.ended),
        design,
        compare(*levels),
        (LEFT_OUT,),
        state.steps[-1].seconds,
        time.perf_counter() - started,
    )


class _Search:
    """The searches from all starts, which share one scene and one state."""

    def __init__(
        self, coated: CoatedScene, study: Study, state: State, file: Checkpoint | None, progress: Progress | None
    ) -> None:
        self.coated, self.study, self.state, self.file, self.progress = coated, study, state, file, progress
        self.metric = study.metric.metric(coated.scene)
        self.names = list(coated.keys)
        bounds = [bound for item in coated.placed for bound in item.group.bounds_nm]
        self.low, self.high = np.array(bounds).T
        self.parts = np.cumsum([len(item.group.bounds_nm) for item in coated.placed])[:-1]
        done = state.steps[-1] if state.steps else None
        self.evaluations = done.evaluations if done else 0
        self.began = time.perf_counter() - (done.seconds if done else 0.0)

    def run(self) -> None:
        """Evaluate all starts, then search from the best ones."""
        for number, design in enumerate(self.state.designs):
            if not any(step.start == number for step in self.state.steps):
                d = np.concatenate([design.thickness_nm[name] for name in self.names])
                self.note(number, 0, d, *self.evaluate(d))
        first = [next(s for s in self.state.steps if s.start == n) for n in range(len(self.state.designs))]
        ranked = sorted(range(len(first)), key=lambda number: first[number].value)
        for number in ranked[: self.study.optimizer.searches]:
            if number not in self.state.ended or self.state.ended[number] == STEPS_USED:
                self.descend(number)

    def evaluate(self, d: np.ndarray) -> tuple[float, float, np.ndarray]:
        """Value of the metric, its standard error and d log(metric)/d thickness."""
        self.coated.apply(dict(zip(self.names, np.split(d, self.parts), strict=True)))
        result = gradient(self.metric, self.coated.params)
        self.evaluations += 1
        if not result.value > 0:
            raise MistrayError(
                f"study '{self.study.name}': the metric is {result.value:g}; no light goes the paths "
                f"'{self.study.metric.paths}', choose others or more rays"
            )
        slopes = np.concatenate([result.gradient[self.coated.keys[name]] for name in self.names])
        if not np.all(np.isfinite(slopes)):
            raise MistrayError(
                f"study '{self.study.name}': the gradient is not finite at thicknesses {np.round(d, 3).tolist()} nm; "
                "change the bounds so that they leave these out"
            )
        return result.value, result.value_se, slopes / result.value

    def free(self, d: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Slope of the layers that are not held by a bound."""
        held = ((d <= self.low) & (slope > 0)) | ((d >= self.high) & (slope < 0))
        return np.where(held, 0.0, slope)

    def note(self, start: int, step: int, d: np.ndarray, value: float, error: float, slope: np.ndarray) -> None:
        """Add a step to the state and save it."""
        thickness = {name: part.tolist() for name, part in zip(self.names, np.split(d, self.parts), strict=True)}
        norm = float(np.linalg.norm(self.free(d, slope)))
        seconds = time.perf_counter() - self.began
        self.state.steps.append(Step(start, step, self.evaluations, value, error, norm, seconds, thickness))
        if self.file is not None:
            self.file.write(self.state)
        if self.progress is not None:
            self.progress(self.state.steps[-1], self.state.designs[start])

    def descend(self, start: int) -> None:
        """Search from the last step of one start."""
        last = self.state.last(start)
        begin, limit = last.step, self.study.optimizer.steps
        if begin >= limit:
            self.state.ended[start] = STEPS_USED
            return
        d0 = np.concatenate([last.thickness_nm[name] for name in self.names])
        known: dict[bytes, tuple[float, float, np.ndarray]] = {}

        def at(d: np.ndarray) -> tuple[float, float, np.ndarray]:
            key = np.asarray(d).tobytes()
            if key not in known:
                known[key] = self.evaluate(d)
            return known[key]

        slope = self.free(d0, at(d0)[2])
        largest = float(np.max(np.abs(slope)))
        if largest == 0:
            self.state.ended[start] = "the gradient is 0"
            return
        # The first trial of L-BFGS-B is the gradient itself: in units of `scale` nm it moves no layer by more than that
        scale = np.sqrt(FIRST_STEP_NM / largest)
        values = [at(d0)[0]]
        taken = begin
        ended = STEPS_USED

        def function(x: np.ndarray) -> tuple[float, np.ndarray]:
            value, _, slope = at(np.clip(x * scale, self.low, self.high))
            return float(np.log(value)), slope * scale

        def after(x: np.ndarray) -> None:
            nonlocal taken, ended
            d = np.clip(x * scale, self.low, self.high)
            taken += 1
            self.note(start, taken, d, *at(d))
            values.append(at(d)[0])
            recent = values[-SMALL_STEPS - 1 :]
            gains = -np.diff(np.log(recent))
            if len(gains) == SMALL_STEPS and np.all(gains < self.study.optimizer.tolerance):
                ended = "converged"
                raise StopIteration

        outcome = minimize(
            function,
            d0 / scale,
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip(self.low / scale, self.high / scale, strict=True)),
            callback=after,
            options={"maxiter": limit - begin, "ftol": 0.0, "gtol": 0.0},
        )
        if ended == STEPS_USED and taken < limit:
            ended = "converged" if outcome.success else f"no lower value along the gradient ({outcome.message})"
        self.state.ended[start] = ended
        if self.file is not None:
            self.file.write(self.state)

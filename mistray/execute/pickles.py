"""
Pickling of scenes and of objects built from them, for results that go to another process or are kept by the user.

A scene is pickled as the source that it was loaded from, with its parameters. Tables of surfaces and runs are made of
it again, and must be what the kernel has read; the sums of runs are kept. What cannot be made again is a `Missing`.
"""

from __future__ import annotations

import copyreg
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.execute.by_parts import filled
from mistray.execute.scene_numbers import StoredScene
from mistray.execute.scene_task import agree, kernel_arrays
from mistray.execute.tracer import Preparation, Run
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import DTYPES, upload

OWN = ("rays", "seed", "unit", "parts", "executed")  # what a run has of its own, beside what it was prepared with
Arrays = list[np.ndarray]


class Missing:
    """
    Stand-in for a part of a result that cannot be rebuilt in this process; using it raises an error with the reason.

    Parameters
    ----------
    reason : str
        Message of the error.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "reason":  # asked for by Python itself
            raise AttributeError(name)
        raise MistrayError(self.reason)


def register() -> None:
    """Register functions for pickling and copying scenes of the active variant, frames, surface tables and runs."""
    frames = {getattr(mi, name) for name in dir(mi) if name.startswith("Scalar") and "Transform4" in name}
    reducers: dict[Any, Callable[[Any], Any]] = {mi.Scene: _scene, SurfaceTable: _table, Run: _run}
    for kind, reduce in (reducers | dict.fromkeys(frames, _frame)).items():
        copyreg.pickle(kind, reduce)


def _or_missing(make: Callable[..., Any], *given: Any) -> Any:
    """Return the result of a function, or a `Missing` with the reason if it raises `MistrayError`."""
    try:
        return make(*given)
    except MistrayError as error:
        return Missing(str(error))


def _scene(scene: mi.Scene) -> tuple[Any, ...]:
    stored = _or_missing(_stored, scene)
    return (Missing, (stored.reason,)) if isinstance(stored, Missing) else (_or_missing, (StoredScene.load, stored))


def _stored(scene: mi.Scene) -> StoredScene:
    stored = StoredScene.of(scene)
    try:
        pickle.dumps(stored.source)
    except (TypeError, AttributeError, pickle.PicklingError) as error:
        raise MistrayError(
            f"the scene of this result was loaded from objects that cannot be pickled ({error}); load it from plain "
            "values or a file, and repeat the analysis"
        ) from None
    return stored


def _frame(frame: Any) -> tuple[Any, ...]:
    return _made_frame, (type(frame).__name__, np.array(frame.matrix))


def _made_frame(kind: str, matrix: np.ndarray) -> Any:
    if not kind.startswith("Scalar") or "Transform4" not in kind:
        raise ValueError(kind)
    return getattr(mi, kind)(matrix)


def _table(table: SurfaceTable) -> tuple[Any, ...]:
    detectors = [table.ids[k] for k in table.detectors]
    made = table.scene, table.wavelength_nm, detectors, table.optics.stokes, table.design_mirrors, kernel_arrays(table)
    return _or_missing, (_made_table, *made)


def _made_table(
    scene: mi.Scene,
    wavelength_nm: float,
    detectors: list[str],
    stokes: bool,
    mirrors: frozenset[int],
    arrays: Arrays,
) -> SurfaceTable:
    table = SurfaceTable(scene, wavelength_nm, detectors, stokes).with_mirrors(mirrors)
    _check(arrays, kernel_arrays(table))
    return table


def _run(run: Run) -> tuple[Any, ...]:
    own = {name: getattr(run, name) for name in OWN}
    arrays = kernel_arrays(run.table, run.scattering)
    capacity = run.ledger.capacity if run.ledger is not None else 0
    return _or_missing, (_made_run, run.prepared, run.number, run.table.detectors, arrays, own, capacity)


def _made_run(
    prepared: Preparation, number: int, detectors: list[int], arrays: Arrays, own: dict[str, Any], capacity: int
) -> Run:
    run = replace(prepared.runs[number], **own)
    if run.table.detectors != detectors:
        (detector,) = detectors
        run = replace(run, table=run.table.on(detector))
    _check(arrays, kernel_arrays(run.table, run.scattering))
    if not capacity or run.executed is None or run.executed.paths is None:
        return run
    # The ledger finds the paths in slots of its own
    paths = run.executed.paths
    ledger, slots = filled(run, paths.keys, paths.events, paths.lengths, capacity)
    return replace(run, ledger=ledger, executed=replace(run.executed, paths=replace(paths, slots=slots)))


def reduced_array(array: Any) -> tuple[Any, ...]:
    """Return function and arguments from which pickle makes a Dr.Jit array again, in the active variant."""
    return _made_array, (type(array).__name__, np.array(array))


def _made_array(kind: str, values: np.ndarray) -> Any:
    if kind not in DTYPES:
        raise ValueError(kind)
    return upload(getattr(mi, kind), values)


MAKERS = (Missing, Preparation, StoredScene.load, _or_missing, _made_array, _made_frame, _made_table, _made_run)
"""All that pickles of these types call, and what files of results may call, see `mistray.toolkit.saved_result`."""


def _check(before: Arrays, now: Arrays) -> None:
    """Raise `MistrayError` if the arrays that the kernel would read now differ from those of the pickled result."""
    if not agree(before, now):
        raise MistrayError(
            "the scene, or a file that it names, was changed after this result was computed and before it was pickled; "
            "pickle it before, or repeat the analysis"
        )

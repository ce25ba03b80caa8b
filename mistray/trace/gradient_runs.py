"""Derivatives of a metric by all parameters of a scene, run by run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from mistray.errors import MistrayError
from mistray.execute.tracer import Run
from mistray.gradients.run_gradient import run_gradient
from mistray.gradients.table_gradient import GradientRequest, TableGradient
from mistray.recorders.path_derivative import MOMENTS, HitDerivative, PathDerivative
from mistray.trace.paths import PathTable


def table_gradients(
    runs: Sequence[Run], path_table: Callable[[], PathTable], derivative: HitDerivative, request: GradientRequest
) -> Iterator[TableGradient]:
    """Yield the gradients of `mistray.trace.Trace.table_gradients`; metrics of paths call `path_table`."""
    traced, planned = round(sum(float(run.started.sum()) for run in runs)), sum(run.rays for run in runs)
    if traced != planned:
        raise MistrayError(f"only {traced} of {planned} rays were traced; gradients need all of them")
    path = derivative.path
    maps = derivative.map_of_path
    for number, run in enumerate(runs):
        # Chain rule: from the metric's derivative by W to that by the flux of a start ray
        pixel = None if derivative.pixel is None else run.unit * np.asarray(derivative.pixel, dtype=np.float64)
        by_path = None
        if path is not None or maps is not None:
            paths = path_table()
            located = [paths.locate(path_id) for path_id in range(len(paths))]
            here = np.array([k for k, (where, _, _) in enumerate(located) if where == number], dtype=np.int64)
            by_path = PathDerivative.of_paths(
                np.array([located[k][2] for k in here], dtype=np.uint64),
                np.array([located[k][1] for k in here], dtype=np.int64),
                run.unit * np.asarray(path)[here] if path is not None else np.zeros((len(here), MOMENTS)),
                np.asarray(maps)[here] if maps is not None else np.zeros(len(here), dtype=np.int64),
            )
        # Runs that the metric does not depend on are not traced again
        if pixel is not None and not pixel.any():
            pixel = None
        if pixel is None and (by_path is None or not by_path.coefficients.any()):
            continue
        started = time.perf_counter()
        raw = run_gradient(run, by_path, pixel, request)
        raw.seconds = time.perf_counter() - started
        yield raw

"""Derivatives of a metric by all parameters of a scene, run by run."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from mistray.errors import MistrayError
from mistray.gradients.run_gradient import run_gradient
from mistray.gradients.table_gradient import GradientRequest, TableGradient
from mistray.recorders.path_derivative import MOMENTS, HitDerivative, PathDerivative

if TYPE_CHECKING:
    from mistray.trace.result import Trace


def table_gradients(t: Trace, derivative: HitDerivative, request: GradientRequest) -> Iterator[TableGradient]:
    """Yield the derivatives of a metric with respect to the parameters of a scene, run by run, by tracing again."""
    if t.rays_traced != t.rays_planned:
        raise MistrayError(f"only {t.rays_traced} of {t.rays_planned} rays were traced; gradients need all of them")
    path, maps = derivative.path, derivative.map_of_path
    of_runs = None if path is None and maps is None else t.paths.located()
    for number, run in enumerate(t.runs):
        # Chain rule: from the metric's derivative by W to that by the flux of a start ray
        pixel = None if derivative.pixel is None else run.unit * np.asarray(derivative.pixel, dtype=np.float64)
        by_path = None
        if of_runs is not None:
            own = of_runs[number]
            by_path = PathDerivative.of_paths(
                own.keys,
                own.slots,
                run.unit * np.asarray(path)[own.ids] if path is not None else np.zeros((len(own.ids), MOMENTS)),
                np.asarray(maps)[own.ids] if maps is not None else np.zeros(len(own.ids), dtype=np.int64),
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

"""Calls of all functions that return results, for tests of what results have in common."""

import inspect
import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pandas as pd

import mistray
from mistray import Metric, analysis, optimize, report, sweeps
from mistray.execute.pickles import Missing
from mistray.execute.tracer import Run
from mistray.gradients.pst_gradient import PstRays
from mistray.result import Result
from mistray.scatter.abg import ABg
from mistray.scatter.k_correlation import KCorrelation
from mistray.surfaces.surfaces import SurfaceTable

load = mistray.load
X = np.arange(3.0)
PROCESS = mi.Scene | mi.Object | Run | SurfaceTable | PstRays | Missing  # compared by what they trace


def coated_metric() -> Metric:
    return optimize.path_power(load("coated.xml"), "ghost", rays=64)


def line(values: np.ndarray) -> optimize.Modelled:
    return optimize.Modelled(values[0] * X, np.zeros((3, 3)), X[:, None])


def gradient() -> Any:
    metric = coated_metric()
    return optimize.gradient(metric, mi.traverse(metric.scene), keys=["p0_*.R"])


def measured() -> Any:
    return optimize.measure(load("coated.xml"), optimize.read_study("study.toml"), 2)


# Each analysis, and other public functions of a scene that return results
CALLS: dict[str, Callable[[], Any]] = {
    "mistray.analysis.critical_rays": lambda: analysis.critical_rays(load("coated.xml"), rays=100),
    "mistray.analysis.first_level": lambda: analysis.first_level(load("window.xml"), [5], rays=500),
    "mistray.analysis.ghosts": lambda: analysis.ghosts(load("coated.xml"), [0, 1], rays=500),
    "mistray.analysis.image_quality": lambda: analysis.image_quality(load("mirror.xml"), grid=16),
    "mistray.analysis.objects": lambda: analysis.objects(load("tube.xml"), rays=500),
    "mistray.analysis.pst": lambda: analysis.pst(load("window.xml"), [5], rays=500),
    "mistray.analysis.study": lambda: analysis.study(load("window.xml"), [5], [0], rays=200),
    "mistray.analysis.thermal": lambda: analysis.thermal(load("warm.xml"), rays=500),
    "mistray.analysis.transfer": lambda: analysis.transfer(load("mirror.xml"), rays=200),
    "mistray.analysis.transfer_of_bsdf": lambda: analysis.transfer_of_bsdf(ABg(0.0025, 0.001, 1.8), 550.0),
    "mistray.analysis.transfer_of_spectrum": lambda: analysis.transfer_of_spectrum(KCorrelation(2.0, 10.0, 2.5), 550.0),
    "mistray.optimize.optimize": lambda: optimize.optimize("bare.xml", "study.toml", verification_seeds=2),
    "mistray.optimize.sensitivity": lambda: optimize.sensitivity(coated_metric(), keys=["p0_*.bsdf.R"], check=False),
    "mistray.report.export_step": lambda: report.export_step(load("coated.xml"), "coated.step"),
    "mistray.report.view": lambda: report.view(load("coated.xml"), rays=100),
    "mistray.sweeps.rank_edits": lambda: sweeps.rank_edits(load("window.xml"), [5], rays=500, keys=["front.z"]),
    "mistray.sweeps.sweep": lambda: sweeps.sweep(load("coated.xml"), 0, rays=64, cache=False),
    "mistray.sweeps.sweep_pst": lambda: sweeps.sweep_pst(load("window.xml"), {"far": {"rear.z": 1.0}}, [5], rays=500),
    "mistray.optimize.bodies": lambda: optimize.bodies(optimize.parameters(load("plate"))),
    "mistray.optimize.budget": lambda: optimize.budget("rough.xml", "budget.toml"),
    "mistray.optimize.compare": lambda: optimize.compare(measured(), measured()),
    "mistray.optimize.fit": lambda: optimize.fit(line, X, 0.1 * np.ones(3), {"a": 0.5}),
    "mistray.optimize.gradient": gradient,
    "mistray.optimize.measure": measured,
    "mistray.optimize.parameters": lambda: optimize.parameters(load("coated.xml")),
    "mistray.optimize.read_study": lambda: optimize.read_study("study.toml"),
    "mistray.scene.load": lambda: load("coated.xml"),
    "mistray.trace.trace": lambda: mistray.trace(load("coated.xml"), rays=64),
}
LONG = {
    *("mistray.analysis.first_level", "mistray.analysis.study", "mistray.optimize.budget", "mistray.optimize.optimize"),
    *("mistray.report.view", "mistray.sweeps.rank_edits", "mistray.sweeps.sweep_pst"),
}


def result_classes(of: type[Result] = Result) -> Iterator[type[Result]]:
    """All classes of results of the modules that are imported."""
    for kind in of.__subclasses__():
        yield from ([kind] if kind.__module__.startswith("mistray.") else [])
        yield from result_classes(kind)


def data(value: Any, place: str = "", within: tuple[int, ...] = ()) -> Iterator[tuple[str, Any]]:
    """All numbers and texts in an object with their places, but for what belongs to the process."""
    if id(value) in within:
        return
    within = (*within, id(value))
    if isinstance(value, pd.DataFrame | pd.Series):
        yield place, value.to_csv()
    elif isinstance(value, np.ndarray) and value.dtype != object:
        yield place, (value.shape, value.tobytes())
    elif isinstance(value, Mapping | list | tuple | set | frozenset | np.ndarray):
        items = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, item in items:
            yield from data(item, f"{place}[{key if isinstance(key, str | int | float) else type(key)}]", within)
    elif value is None or isinstance(value, PROCESS) or dr.is_array_v(value):
        yield place, None
    elif hasattr(value, "to_plotly_json"):
        yield place, json.loads(value.to_json())
    elif hasattr(value, "__dict__") and not isinstance(value, type) and not inspect.isroutine(value):
        for name, item in vars(value).items():
            yield from data(item, f"{place}.{name}", within)
    else:
        yield place, repr(value)

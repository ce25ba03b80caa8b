"""Forward traces of a scene, from its sources to its detectors, and their results."""

from mistray._variant import active_variant, ensure_variant

if active_variant() is None:  # types of the variant are used while modules are imported
    ensure_variant()

from mistray.execute.pickles import register
from mistray.settings import Settings
from mistray.trace.energy import Energy, FluxReport, SurfaceFlux
from mistray.trace.forward import trace
from mistray.trace.history import RayHistory
from mistray.trace.host.polarization_choice import PolarizationChoice
from mistray.trace.path_row import PathRow
from mistray.trace.paths import PathTable
from mistray.trace.result import Trace

__all__ = [
    "Energy",
    "FluxReport",
    "PathRow",
    "PathTable",
    "PolarizationChoice",
    "RayHistory",
    "Settings",
    "SurfaceFlux",
    "Trace",
    "trace",
]

register()

# `mistray.trace` is the function, not this package: what docstrings call mistray.trace.Settings is found on it, too
vars(trace).update({name: globals()[name] for name in __all__ if name != "trace"})


def __dir__() -> list[str]:
    return sorted(__all__)

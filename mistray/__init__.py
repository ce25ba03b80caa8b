"""mistray: stray light in optical systems, on Mitsuba 3 and Dr.Jit.

Importing the package selects libLLVM, activates a Mitsuba variant if none is active, and registers the plugins. If this
fails, the import still succeeds, so that ``mistray doctor`` can say why. The first use of a public name then raises.
The command ``mistray`` does this at the first use of a public name, since each command selects its own variant, and
``mistray --help`` needs none.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

from mistray.supervisor import hold


def _is_command() -> bool:
    """Whether this process runs the command, as a script called ``mistray`` or as ``python -m mistray``."""
    # What the interpreter was given, up to the program; while a package is imported for -m, sys.argv[0] is "-m"
    words = sys.orig_argv[: len(sys.orig_argv) - len(sys.argv) + 1]
    return bool(words) and os.path.splitext(os.path.basename(words[-1]))[0] == "mistray"


if _is_command():
    hold()  # before what takes longer to import

from mistray._variant import ensure_variant, set_threads  # noqa: E402
from mistray.errors import MistrayError, MistrayWarning, UnfinishedError  # noqa: E402

if TYPE_CHECKING:
    from mistray import (
        analysis,
        coatings,
        materials,
        mechanics,
        optimize,
        physics,
        prescription,
        report,
        scene,
        sweeps,
    )
    from mistray.analysis import (
        FirstLevel,
        GhostReport,
        ImageQuality,
        Objects,
        Pst,
        Study,
        ThermalReport,
        Transfer,
        first_level,
        ghosts,
        image_quality,
        objects,
        pst,
        study,
        thermal,
        transfer,
    )
    from mistray.cluster import distribute
    from mistray.explore import Explorer
    from mistray.optimize import Metric, gradient, sensitivity
    from mistray.prescription import Coating, Detector, Prescription, Scatter, Source, Structure, Surface
    from mistray.report import StepExport, View, export_step, view
    from mistray.scene import coat, load  # type: ignore[no-redef]
    from mistray.sweeps import Sweep, sweep
    from mistray.trace import Trace, trace

_HOMES = {
    "coat": "mistray.scene",
    "load": "mistray.scene",
    "trace": "mistray.trace",
    "Trace": "mistray.trace",
    "ghosts": "mistray.analysis",
    "image_quality": "mistray.analysis",
    "ImageQuality": "mistray.analysis",
    "GhostReport": "mistray.analysis",
    "first_level": "mistray.analysis",
    "FirstLevel": "mistray.analysis",
    "objects": "mistray.analysis",
    "Objects": "mistray.analysis",
    "pst": "mistray.analysis",
    "Pst": "mistray.analysis",
    "study": "mistray.analysis",
    "Study": "mistray.analysis",
    "thermal": "mistray.analysis",
    "export_step": "mistray.report",
    "StepExport": "mistray.report",
    "view": "mistray.report",
    "View": "mistray.report",
    "ThermalReport": "mistray.analysis",
    "transfer": "mistray.analysis",
    "Transfer": "mistray.analysis",
    "distribute": "mistray.cluster",
    "Explorer": "mistray.explore",
    "Metric": "mistray.optimize",
    "gradient": "mistray.optimize",
    "sweep": "mistray.sweeps",
    "Sweep": "mistray.sweeps",
    "sensitivity": "mistray.optimize",
    "Coating": "mistray.prescription",
    "Scatter": "mistray.prescription",
    "Detector": "mistray.prescription",
    "Prescription": "mistray.prescription",
    "Source": "mistray.prescription",
    "Structure": "mistray.prescription",
    "Surface": "mistray.prescription",
}
_MODULES = (
    "analysis",
    "coatings",
    "materials",
    "mechanics",
    "optimize",
    "physics",
    "prescription",
    "report",
    "scatter",
    "scene",
    "scenes",
    "sweeps",
)

__all__ = [
    "Coating",
    "Detector",
    "Explorer",
    "FirstLevel",
    "GhostReport",
    "ImageQuality",
    "Metric",
    "MistrayError",
    "MistrayWarning",
    "Objects",
    "Prescription",
    "Pst",
    "Scatter",
    "Source",
    "StepExport",
    "Structure",
    "Study",
    "Surface",
    "Sweep",
    "ThermalReport",
    "Trace",
    "Transfer",
    "UnfinishedError",
    "View",
    "analysis",
    "coat",
    "coatings",
    "distribute",
    "ensure_variant",
    "export_step",
    "first_level",
    "ghosts",
    "gradient",
    "image_quality",
    "load",
    "materials",
    "mechanics",
    "objects",
    "optimize",
    "physics",
    "prescription",
    "pst",
    "report",
    "scatter",
    "scene",
    "scenes",
    "sensitivity",
    "set_threads",
    "study",
    "sweep",
    "sweeps",
    "thermal",
    "trace",
    "transfer",
    "view",
]


def _bind() -> None:
    """Activate a variant, then bind `load` and `trace` here; `trace` is the function, not the package of that name."""
    ensure_variant()
    for name in ("load", "trace"):
        globals()[name] = getattr(importlib.import_module(_HOMES[name]), name)


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'mistray' has no attribute '{name}'")
    _bind()
    if name in _MODULES:
        return importlib.import_module(f"mistray.{name}")
    try:
        return getattr(importlib.import_module(_HOMES[name]), name)
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("mistray.analyses"):
            raise
        raise AttributeError(f"mistray.{name}: {error.name} is not installed; install mistray anew") from None


def __dir__() -> list[str]:
    return sorted(__all__)


if not _is_command():
    with contextlib.suppress(MistrayError):  # raised again, with its remedy, by the first use of a public name
        _bind()

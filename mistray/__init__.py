"""mistray: stray light in optical systems, on Mitsuba 3 and Dr.Jit.

Importing the package settles libLLVM, makes a Mitsuba variant active if none is, and registers the plugins. Where that
is impossible the import still succeeds, so that ``mistray doctor`` can say why; the first use of a public name raises.
"""

from __future__ import annotations

import contextlib
import importlib
from typing import TYPE_CHECKING, Any

from mistray._variant import ensure_variant
from mistray.errors import MistrayError

if TYPE_CHECKING:
    from mistray import analysis, coatings, materials, mechanics, optimize, physics, prescription, report, scene
    from mistray.analysis import (  # type: ignore[no-redef]
        FirstLevel,
        GhostReport,
        Objects,
        Pst,
        Study,
        ThermalReport,
        first_level,
        ghosts,
        objects,
        pst,
        study,
        thermal,
    )
    from mistray.optimize import Metric, gradient, sensitivity  # type: ignore[no-redef]
    from mistray.prescription import Detector, Prescription, Source, Structure, Surface
    from mistray.report import View, view  # type: ignore[no-redef]
    from mistray.scene import load  # type: ignore[no-redef]
    from mistray.trace import Trace, trace

_HOMES = {
    "load": "mistray.scene",
    "trace": "mistray.trace",
    "Trace": "mistray.trace",
    "ghosts": "mistray.analysis",
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
    "view": "mistray.report",
    "View": "mistray.report",
    "ThermalReport": "mistray.analysis",
    "Metric": "mistray.optimize",
    "gradient": "mistray.optimize",
    "sensitivity": "mistray.optimize",
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
)

__all__ = [
    "Detector",
    "FirstLevel",
    "GhostReport",
    "Metric",
    "MistrayError",
    "Objects",
    "Prescription",
    "Pst",
    "Source",
    "Structure",
    "Study",
    "Surface",
    "ThermalReport",
    "Trace",
    "View",
    "analysis",
    "coatings",
    "ensure_variant",
    "first_level",
    "ghosts",
    "gradient",
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
    "sensitivity",
    "study",
    "thermal",
    "trace",
    "view",
]


def _bind() -> None:
    """Bind the names that need the kernel; `trace` is the function, though a package has the same name."""
    ensure_variant()
    for name in ("load", "trace"):
        globals()[name] = getattr(importlib.import_module(_HOMES[name]), name)


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'mistray' has no attribute '{name}'")
    _bind()
    if name in _MODULES:
        return importlib.import_module(f"mistray.{name}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)


with contextlib.suppress(MistrayError):  # raised again, with its remedy, by the first use of a public name
    _bind()

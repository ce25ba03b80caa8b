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
from typing import Any

from mistray.supervisor import hold


def _is_command() -> bool:
    """True if this process runs the ``mistray`` command, as a script or as ``python -m mistray``."""
    # What the interpreter was given, up to the program; while a package is imported for -m, sys.argv[0] is "-m"
    words = sys.orig_argv[: len(sys.orig_argv) - len(sys.argv) + 1]
    return bool(words) and os.path.splitext(os.path.basename(words[-1]))[0] == "mistray"


if _is_command():
    hold()  # before what takes longer to import

from mistray._variant import ensure_variant, set_threads  # noqa: E402
from mistray.errors import MistrayError, MistrayWarning, UnfinishedError  # noqa: E402

_HOMES = {
    "mistray.analysis": (
        *("FirstLevel", "GhostReport", "ImageQuality", "Objects", "Pst", "Study", "ThermalReport", "Transfer"),
        *("first_level", "ghosts", "image_quality", "objects", "pst", "study", "thermal", "transfer"),
    ),
    "mistray.cluster": ("distribute",),
    "mistray.explore": ("Explorer",),
    "mistray.optimize": ("Metric", "gradient", "sensitivity"),
    "mistray.prescription": ("Coating", "Detector", "Prescription", "Scatter", "Source", "Structure", "Surface"),
    "mistray.report": ("ProgressBar", "StepExport", "View", "export_step", "load_result", "view"),
    "mistray.scene": ("coat", "load"),
    "mistray.sweeps": ("Sweep", "sweep"),
    "mistray.trace": ("Trace", "trace"),
}
_MODULES = (
    *("analysis", "coatings", "materials", "mechanics", "optimize", "physics", "prescription", "report", "scatter"),
    *("scene", "scenes", "sweeps"),
)
_homes = {name: home for home, names in _HOMES.items() for name in names}

__all__ = ["MistrayError", "MistrayWarning", "UnfinishedError", "ensure_variant", "set_threads", *_MODULES, *_homes]
__all__ += ["__version__"]  # looked up on first use, which takes as long as all of `mistray --help`
__all__.sort()


def _bind() -> None:
    """Activate a Mitsuba variant, and define `load` and `trace` here; `trace` is the function, not the subpackage."""
    ensure_variant()
    for name in ("load", "trace"):
        globals()[name] = getattr(importlib.import_module(_homes[name]), name)


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'mistray' has no attribute '{name}'")
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("mistray")
    _bind()
    if name in _MODULES:
        return importlib.import_module(f"mistray.{name}")
    try:
        return getattr(importlib.import_module(_homes[name]), name)
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("mistray.analyses"):
            raise
        raise AttributeError(f"mistray.{name}: {error.name} is not installed; install mistray anew") from None


def __dir__() -> list[str]:
    return sorted(__all__)


if not _is_command():
    with contextlib.suppress(MistrayError):  # raised again, with its remedy, by the first use of a public name
        _bind()

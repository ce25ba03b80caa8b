"""The kernel: from a scene to the ledger of its light paths.

Its modules use types of the active variant while they are imported, so that one is made active first.
"""

from mistray._variant import active_variant, ensure_variant

if active_variant() is None:
    ensure_variant()

from mistray.trace.energy import Energy, FluxReport, SurfaceFlux
from mistray.trace.forward import trace
from mistray.trace.history import RayHistory
from mistray.trace.paths import PathRow, PathTable
from mistray.trace.result import Trace
from mistray.trace.settings import Settings

__all__ = ["Energy", "FluxReport", "PathRow", "PathTable", "RayHistory", "Settings", "SurfaceFlux", "Trace", "trace"]

"""The kernel: from a scene to the ledger of its light paths."""

from mistray.trace.energy import Energy, FluxReport, SurfaceFlux
from mistray.trace.history import RayHistory
from mistray.trace.paths import PathRow, PathTable
from mistray.trace.result import Trace, trace
from mistray.trace.settings import Settings

__all__ = ["Energy", "FluxReport", "PathRow", "PathTable", "RayHistory", "Settings", "SurfaceFlux", "Trace", "trace"]

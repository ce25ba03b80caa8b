"""Recorders, which collect results during a trace: flux sums, images, paths, whole rays, directions, derivatives."""

from mistray._variant import active_variant, ensure_variant

# Types of the variant are used while modules are imported: one must be active before
if active_variant() is None:
    ensure_variant()

from mistray.recorders.flux_maps.far_field import FarField
from mistray.recorders.flux_maps.flux_split import FluxSplit, SplitRow
from mistray.recorders.flux_maps.probe import Probe
from mistray.recorders.flux_maps.surface_maps import SurfaceMap, SurfaceMaps
from mistray.recorders.recorder import Branch, Departure, Recorder, Return, Segment, Visit

__all__ = [
    "Branch",
    "Departure",
    "FarField",
    "FluxSplit",
    "Probe",
    "Recorder",
    "Return",
    "Segment",
    "SplitRow",
    "SurfaceMap",
    "SurfaceMaps",
    "Visit",
]


def __dir__() -> list[str]:
    return sorted(__all__)

"""Checks of a ghost analysis before tracing, and computation of its further tables afterwards."""

from __future__ import annotations

import mitsuba as mi

from mistray.analyses.ghosts.request import GhostsRequest, GhostTables
from mistray.analyses.ghosts.result import GhostReport
from mistray.recorders.flux_maps.surface_maps import SurfaceMaps
from mistray.trace.check_paths import check_paths
from mistray.trace.elsewhere import check_columns, check_where
from mistray.trace.path_filter import PathFilter
from mistray.trace.photometry import check_light


def check_tables(scene: mi.Scene, request: GhostsRequest, shown: GhostTables) -> None:
    """
    Raise `MistrayError` if a requested table cannot be made of the scene.

    That is if a filter or place names what the scene lacks, a filter needs a column that is known on the detector
    alone, or the wavelengths do not suffice for photometric values or colours.
    """
    selections = [shown.filter] if shown.filter else []
    check_paths(scene, [*selections, *(shown.maps or ())])
    if shown.rays_at:
        check_paths(scene, [f'H("{name}")' for name in check_where(shown.rays_at)])
    elsewhere = selections if shown.rays_at else []  # than on the detector light is known by its events alone
    if shown.maps:
        recorders = [sensor.recorder() for sensor in scene.sensors() if hasattr(sensor, "recorder")]
        if any(isinstance(one, SurfaceMaps) for one in recorders):
            elsewhere = [*elsewhere, *shown.maps]
    for text in elsewhere:
        check_columns(PathFilter(text))
    wavelengths = request.light.get("wavelength_nm")
    if shown.photometric:
        check_light(scene, wavelengths)
    if shown.colour:
        from mistray.analyses.ghosts.colour import check_wavelengths  # which needs Matplotlib

        own = {float(nm) for emitter in scene.emitters() for nm in getattr(emitter, "wavelengths_nm", ())}
        check_wavelengths(wavelengths or sorted(own))


def prepare(report: GhostReport, shown: GhostTables) -> None:
    """Compute the additional tables that are requested, so that errors appear before anything is drawn."""
    report.photometric = shown.photometric
    if shown.maps:
        report.map_light(shown.maps)
    for field in report:
        report.table(field)  # ranked by peak it needs maps
        if shown.filter:
            report.filtered(field, shown.filter)
        if shown.aliases is not None:
            report.aliased(field, shown.aliases)
        if shown.path_analysis:
            report.path_analysis(field, *shown.sorted_by)

"""Section on photometric results in the report of a ghost analysis, if they were requested."""

from __future__ import annotations

import numpy as np

from mistray.analyses.ghosts.result import GhostReport
from mistray.estimate import Estimate
from mistray.recorders.flux_maps.far_field import FarField
from mistray.recorders.flux_maps.probe import Probe
from mistray.recorders.flux_maps.surface_maps import SurfaceMaps
from mistray.toolkit.irradiance import highest_cell
from mistray.toolkit.pages.model import NotePart, Section, Table, Value, columns

NOTE = (
    "Light as the eye weighs it: 683.002 lm/W times V of the CIE 1924 observer, 2°, at each wavelength traced. On "
    "the detector it is what is absorbed, elsewhere what arrives. The highest is the largest of many values with noise."
)


def photometric_section(report: GhostReport) -> Section | None:
    """
    Return the section on luminous flux, lm, illuminance, lx, intensity, cd, and luminance, cd/m².

    It is None if not requested.
    """
    if not report.photometric:
        return None
    flux: list[list[Value]] = []
    bright: list[list[Value]] = []
    for field, t in report.items():
        for name in t.detectors:
            own = t.on(name)
            flux.append([f"{field:g}", name, Estimate(*own.luminous_flux)])
            bright.append(_highest(field, name, "illuminance", *own.illuminance, "lx"))
        for name, recorder in t.recorders.items():
            if isinstance(recorder, Probe):
                bright.append(_highest(field, name, "illuminance", *recorder.illuminance, "lx"))
                if recorder.directions > 1:
                    bright.append(_highest(field, name, "luminance", *recorder.luminance, "cd/m²"))
            elif isinstance(recorder, FarField):
                bright.append(_highest(field, name, "luminous intensity", *recorder.luminous_intensity, "cd"))
            elif isinstance(recorder, SurfaceMaps):
                for surface, found in recorder.illuminance.items():
                    bright.append(_highest(field, surface, "illuminance", *found, "lx"))
    tables = [
        Table(columns("field [deg]", "<detector", "luminous flux [lm]"), flux, "luminous_flux"),
        Table(columns("field [deg]", "<where", "<what", "highest", "<unit"), bright, "photometric"),
    ]
    return Section("photometric", "Photometric units", [NotePart(NOTE), *tables], "Photometric")


def _highest(field: float, where: str, what: str, value: np.ndarray, se: np.ndarray, unit: str) -> list[Value]:
    """
    Return a table row of the brightest cell of a map, whose values, errors and unit are `value`, `se` and `unit`.

    `field` is the field angle, degrees, `where` the name of the detector, recorder or surface, `what` the quantity.
    """
    return [f"{field:g}", where, what, highest_cell(value, se)[1], unit]

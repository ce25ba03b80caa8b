"""Plugin `surface_maps`: irradiance of walls and other surfaces, by position on them."""

from __future__ import annotations

import mitsuba as mi

from mistray.param import documented, fixed, take
from mistray.plugins.sensors.passing_sensor import PassingSensor
from mistray.ranges import FILM_SIDE, TEXT
from mistray.recorders.flux_maps.surface_maps import AZIMUTHS, LENGTHS, SurfaceMaps


@documented
class SurfaceMapsSensor(PassingSensor):
    r"""
    Maps of surfaces (:monosp:`surface_maps`): irradiance of walls, unrolled over azimuth and length.

    It belongs at the top level of the scene. Each `mistray.trace` of the scene has a `mistray.recorders.SurfaceMaps`
    under the id of the sensor. ``mi.render`` with the ``straylight`` integrator gives the irradiance (surfaces ×
    lengths, azimuths, 1) in W/mm², one surface below the other in the order of their ids.

    .. parameters::

    None of these is differentiable. Traces by workers refuse scenes with it; Mitsuba's own integrators cannot render
    it.

    .. code-block:: xml

        <sensor type="surface_maps" id="walls">
            <string name="surfaces" value="barrel* hood"/>
            <integer name="azimuths" value="72"/>
        </sensor>

    .. code-block:: python

        {"type": "surface_maps", "surfaces": "barrel* hood", "azimuths": 72}
    """

    what = "surface maps"
    placed = False
    properties = {
        "surfaces": fixed(
            "string",
            TEXT,
            "patterns of ids of surfaces or of parts, separated by blanks; by default all opaque surfaces that are "
            "neither mirrors nor detectors",
            "",
            otherwise="walls",
        ),
        "azimuths": fixed(
            "1", FILM_SIDE, "cells around the axis of a round surface, or along x of a rectangle", AZIMUTHS
        ),
        "lengths": fixed(
            "1", FILM_SIDE, "cells along z of a tube or a cone, radius of a ring, or y of a rectangle", LENGTHS
        ),
    }

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.surfaces = tuple(take(self, props, "surfaces").split())
        self.azimuths = take(self, props, "azimuths")
        self.lengths = take(self, props, "lengths")
        self.recorder()  # refuses what maps cannot be

    def recorder(self) -> SurfaceMaps:
        """Return a new recorder of the maps, see `PassingSensor.recorder`."""
        return SurfaceMaps(self.name, self.surfaces, self.azimuths, self.lengths)


mi.register_sensor("surface_maps", lambda props: SurfaceMapsSensor(props))

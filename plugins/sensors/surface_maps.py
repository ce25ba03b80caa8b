"""Plugin `surface_maps`: irradiance of walls and other surfaces, by position on them."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.sensors.passing_sensor import PassingSensor
from mistray.ranges import FILM_SIDE
from mistray.recorders.passing.surface_maps import AZIMUTHS, LENGTHS, SurfaceMaps


class SurfaceMapsSensor(PassingSensor):
    r"""
    Maps of surfaces (:monosp:`surface_maps`): irradiance of walls, unrolled over azimuth and length.

    It belongs at the top level of the scene. Each `mistray.trace` of the scene has a `mistray.recorders.SurfaceMaps`
    under the id of the sensor. ``mi.render`` with the ``straylight`` integrator gives the irradiance (surfaces ×
    lengths, azimuths, 1) in W/mm², one surface below the other in the order of their ids.

    ========== ====== ========= ======= =========================================================================
    parameter  unit   range     default meaning
    ========== ====== ========= ======= =========================================================================
    surfaces   string           walls   patterns of ids of surfaces or of parts, with blanks between; by default all
                                        opaque surfaces that are neither mirrors nor detectors
    azimuths   1      1 … 65536 36      cells around the axis of a round surface, or along x of a rectangle
    lengths    1      1 … 65536 24      cells along z of a tube or a cone, radius of a ring, or y of a rectangle
    ========== ====== ========= ======= =========================================================================

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

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.surfaces = tuple(str(props.get("surfaces", "")).split())
        self.azimuths = int(FILM_SIDE.check("azimuths", props.get("azimuths", AZIMUTHS), self.owner))
        self.lengths = int(FILM_SIDE.check("lengths", props.get("lengths", LENGTHS), self.owner))
        self.recorder()  # refuses what maps cannot be

    def recorder(self) -> SurfaceMaps:
        """Return a new recorder of the maps, see `PassingSensor.recorder`."""
        return SurfaceMaps(self.name, self.surfaces, self.azimuths, self.lengths)


mi.register_sensor("surface_maps", lambda props: SurfaceMapsSensor(props))

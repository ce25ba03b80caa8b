"""Plugin `flux_split`: absorbed, reflected, transmitted and scattered flux at surfaces."""

from __future__ import annotations

import mitsuba as mi

from mistray.param import documented, fixed, take
from mistray.plugins.sensors.passing_sensor import PassingSensor
from mistray.ranges import TEXT
from mistray.recorders.flux_maps.flux_split import FluxSplit


@documented
class FluxSplitSensor(PassingSensor):
    r"""
    Split of flux (:monosp:`flux_split`): flux that surfaces absorb, reflect, transmit and scatter.

    It belongs at the top level of the scene. Each `mistray.trace` of the scene has a `mistray.recorders.FluxSplit`
    under the id of the sensor. ``mi.render`` with the ``straylight`` integrator gives (surfaces, 6, 1) in W: incident,
    absorbed, specular reflection and transmission, scattered reflection and transmission.

    .. parameters::

    It is not differentiable. Traces by workers refuse scenes with it; Mitsuba's own integrators cannot render it.

    .. code-block:: xml

        <sensor type="flux_split" id="split">
            <string name="surfaces" value="barrel* L1_*"/>
        </sensor>

    .. code-block:: python

        {"type": "flux_split", "surfaces": "barrel* L1_*"}
    """

    what = "flux split"
    placed = False
    properties = {
        "surfaces": fixed(
            "string", TEXT, "patterns of ids of surfaces or of parts, separated by blanks", "", otherwise="all"
        )
    }

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.surfaces = tuple(take(self, props, "surfaces").split())

    def recorder(self) -> FluxSplit:
        """Return a new recorder of the split of flux, see `PassingSensor.recorder`."""
        return FluxSplit(self.name, self.surfaces)


mi.register_sensor("flux_split", lambda props: FluxSplitSensor(props))

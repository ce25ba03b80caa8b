"""Plugin `far_field`: light that leaves a scene, by direction."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.plugins.sensors.passing_sensor import PassingSensor
from mistray.ranges import FILM_SIDE
from mistray.recorders.passing.far_field import EDGE_DEG, FarField

MOST_RINGS = FILM_SIDE.high


class FarFieldSensor(PassingSensor):
    r"""
    Far field (:monosp:`far_field`): radiant intensity of the light that leaves the scene.

    It belongs at the top level of the scene. Each `mistray.trace` of the scene has a `mistray.recorders.FarField` under
    the id of the sensor. ``mi.render`` with the ``straylight`` integrator gives the intensity (rings, azimuths, 1) in
    W/sr.

    ========== ========= ========= ======== ===================================================================
    parameter  unit      range     default  meaning
    ========== ========= ========= ======== ===================================================================
    edges_deg  string              0:180:2  borders of the rings in the angle from its z axis, ascending: numbers
                                            within 0 … 180, or first:last:step
    azimuths   1         1 … 65536 1        number of equal cells around the axis; the first begins at y, and they
                                            proceed towards -x
    to_world   transform rigid     identity its frame; only its rotation matters
    ========== ========= ========= ======== ===================================================================

    None of these is differentiable. Traces by workers refuse scenes with far fields; Mitsuba's own integrators cannot
    render them.

    .. code-block:: xml

        <sensor type="far_field" id="sky">
            <string name="edges_deg" value="90:180:5"/>
            <integer name="azimuths" value="8"/>
        </sensor>

    .. code-block:: python

        {"type": "far_field", "edges_deg": "0, 1, 2, 5, 10, 90", "azimuths": 8}
    """

    what = "far field"

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.edges_deg = self._edges(str(props.get("edges_deg", "0:180:2")))
        self.azimuths = int(FILM_SIDE.check("azimuths", props.get("azimuths", 1), self.owner))
        self.recorder()  # refuses what a far field cannot be

    def _edges(self, text: str) -> list[float]:
        """Return the numbers in a list, or in a range with both of its ends, degrees."""
        try:
            numbers = [float(part) for part in text.replace(":", " ").replace(",", " ").split()]
        except ValueError:
            numbers = []
        if not numbers or text.count(":") not in (0, 2) or (":" in text and len(numbers) != 3):
            raise MistrayError(f"{self.owner}: edges_deg is '{text}'; give angles such as 0, 5, 90 or first:last:step")
        if ":" not in text:
            return numbers
        first, last, step = (*EDGE_DEG.check_each("edges_deg", numbers[:2], self.owner), numbers[2])
        if not (step > 0 and first < last <= first + MOST_RINGS * step):
            raise MistrayError(
                f"{self.owner}: edges_deg is '{text}'; the range must go up, by {MOST_RINGS} steps at most"
            )
        count = round((last - first) / step)
        if abs(first + count * step - last) > 1e-6 * step:
            raise MistrayError(
                f"{self.owner}: edges_deg is '{text}'; its last angle must be a step; change one of them"
            )
        return [float(edge) for edge in np.linspace(first, last, count + 1)]

    def recorder(self) -> FarField:
        """Return a new recorder of the far field, see `PassingSensor.recorder`."""
        return FarField(self.name, self.edges_deg, self.azimuths, axis=self.matrix[:3, 2], up=self.matrix[:3, 1])


mi.register_sensor("far_field", lambda props: FarFieldSensor(props))

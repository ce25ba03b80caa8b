"""Plugin `far_field`: radiant intensity of the light that leaves a scene, by direction."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.param import documented, fixed, take
from mistray.plugins.sensors.passing_sensor import FRAME, PassingSensor
from mistray.ranges import FILM_SIDE, TEXT
from mistray.recorders.flux_maps.far_field import EDGE_DEG, FarField

MOST_RINGS = FILM_SIDE.high


@documented
class FarFieldSensor(PassingSensor):
    r"""
    Far field (:monosp:`far_field`): radiant intensity of the light that leaves the scene.

    It belongs at the top level of the scene. Each `mistray.trace` of the scene has a `mistray.recorders.FarField` under
    the id of the sensor. ``mi.render`` with the ``straylight`` integrator gives the intensity (rings, azimuths, 1) in
    W/sr.

    .. parameters::

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
    properties = {
        "edges_deg": fixed(
            "string",
            TEXT,
            "borders of the rings in the angle from its z axis, ascending: numbers within 0 … 180, or first:last:step",
            "0:180:2",
        ),
        "azimuths": fixed(
            "1",
            FILM_SIDE,
            "number of equal cells around the axis; the first begins at y, and they proceed towards -x",
            1,
        ),
        **FRAME,
    }

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.edges_deg = self._edges(take(self, props, "edges_deg"))
        self.azimuths = take(self, props, "azimuths")
        self.recorder()  # refuses what a far field cannot be

    def _edges(self, text: str) -> list[float]:
        """
        Return cell borders, degrees, from a string: a list, or a range ``first:last:step`` with both of its ends.

        Raise `MistrayError` if the string is not valid.
        """
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
        _, up, axis = self.matrix[:3, :3].T.tolist()
        return FarField(self.name, self.edges_deg, self.azimuths, axis=axis, up=up)


mi.register_sensor("far_field", lambda props: FarFieldSensor(props))

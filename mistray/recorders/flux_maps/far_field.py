"""Recorder of the far field: radiant intensity of the light that leaves the scene, by direction."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.ranges import FILM_PIXELS, FILM_SIDE, Range
from mistray.recorders.flux_maps.cells import PassingLight, cell_of
from mistray.recorders.flux_maps.probe import frame_of, vector_of
from mistray.recorders.recorder import Memory, Segment
from mistray.recorders.sampled import Sampled
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import opaque

EDGE_DEG = Range(0.0, 180.0, unit="degrees")


class FarField(PassingLight):
    """
    Recorder of the radiant intensity of light that leaves the scene, by direction, as seen from far away.

    It is given to `mistray.trace` among ``recorders``.

    Parameters
    ----------
    name : str
        Name in the trace, see `mistray.trace.Trace.recorders`.
    edges_deg : sequence of float
        Borders of the cells in the angle from the axis, degrees, ascending, 0 … 180.
    azimuths : int
        Number of cells around the axis, of equal width; the first begins at `up`, and they go towards -x of the frame
        whose y is `up` and whose z is the axis.
    axis, up : (3,) float
        Directions in the world, of any length: light that leaves along `axis` is at 0°, and `up` marks azimuth 0.

    Raises
    ------
    MistrayError
        If the name is blank, borders do not ascend, a value is out of range, or directions are 0 or parallel.

    Examples
    --------
    >>> sky = mistray.recorders.FarField("sky", edges_deg=[0, 90, 180])
    >>> t = mistray.trace(mistray.load("lens_and_window"), rays=10_000, recorders=[sky])
    >>> sky.flux_of_rings.value.round(1)  # W, forwards and backwards
    array([ 0. , 58.3])
    >>> print(f"{t.energy.escaped_W:.1f} W by the ledger")
    58.3 W by the ledger
    """

    kind, unit = "far field", "W/sr"

    def __init__(
        self,
        name: str,
        edges_deg: Sequence[float] = tuple(range(0, 181, 2)),
        azimuths: int = 1,
        axis: Sequence[float] = (0.0, 0.0, 1.0),
        up: Sequence[float] = (0.0, 1.0, 0.0),
    ) -> None:
        owner = f"far field '{name}'"
        edges = np.array(EDGE_DEG.check_each("edges_deg", edges_deg, owner))
        if len(edges) < 2 or not np.all(np.diff(edges) > 0):
            raise MistrayError(f"{owner}: edges_deg {edges.tolist()} do not ascend; give two or more that do")
        FILM_SIDE.check("azimuths", azimuths, owner)
        FILM_PIXELS.check("number of its cells", (len(edges) - 1) * azimuths, owner)
        self.edges_deg, self.azimuths = edges, int(azimuths)
        self._axes = frame_of(vector_of("axis", axis, owner), vector_of("up", up, owner), owner)
        super().__init__(name, (len(edges) - 1) * self.azimuths)

    def lay_out(self, table: SurfaceTable) -> None:
        """Upload the borders of the direction cells and the axes of the far-field frame to the device."""
        # Borders in the sine of half the angle, which float32 resolves at 0° and, nearly as well, at 180°
        self._borders = mi.Float(np.sin(np.radians(self.edges_deg) / 2).astype(np.float32))
        self._on_device = [opaque(mi.Vector3f, axis) for axis in self._axes]

    def travel(self, segment: Segment, memory: Memory) -> None:
        """Add the flux of rays that leave the scene to the cells of their directions."""
        # Row, by the angle from the axis
        right, up, axis = self._on_device
        half_sine = 0.5 * dr.norm(segment.heading - axis)
        count = len(self.edges_deg)
        row = dr.binary_search(
            0, count, lambda k: dr.gather(mi.Float, self._borders, dr.minimum(k, count - 1)) <= half_sine
        )
        inside = segment.active & segment.leaves & (row > 0)
        # A direction straight back, at 180°, belongs to the last cell
        last = dr.opaque(mi.Bool, bool(self.edges_deg[-1] == EDGE_DEG.high))
        inside &= (row < count) | last
        row = dr.minimum(row, count - 1) - 1
        # Column, by the azimuth from `up`
        turn = dr.atan2(-dr.dot(segment.heading, right), dr.dot(segment.heading, up)) / (2 * dr.pi)
        turn = dr.select(turn < 0, turn + 1, turn)
        column = cell_of(turn * self.azimuths, self.azimuths)
        self.add(segment.start, mi.UInt32(row) * self.azimuths + column, segment.flux, inside)

    @property
    def flux_of_rings(self) -> Sampled:
        """Flux in each ring of cells around the axis, (rows,), W, with its noise."""
        return self.flux.reshaped(-1, self.azimuths).total(1)

    @property
    def solid_angle_sr(self) -> np.ndarray:
        """Solid angle of one cell in each row, (rows,), sr."""
        cos = np.cos(np.radians(self.edges_deg))
        return (cos[:-1] - cos[1:]) * 2 * np.pi / self.azimuths

    @property
    def intensity(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean radiant intensity over each cell and its standard error, (rows, azimuths) each, W/sr."""
        return self._by_solid_angle(self.flux)

    @property
    def luminous_intensity(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean luminous intensity over each cell and its standard error, (rows, azimuths) each, cd."""
        return self._by_solid_angle(self.luminous_flux)

    def _by_solid_angle(self, flux: Sampled) -> tuple[np.ndarray, np.ndarray]:
        rows, size = flux.reshaped(-1, self.azimuths), self.solid_angle_sr[:, None]
        return rows.value / size, rows.se / size

    image = intensity

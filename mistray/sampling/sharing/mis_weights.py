"""
MIS weights of forward rays, backward rays and connections by the balance heuristic.

A path from a cell of directions to the detector can be found by forward and by backward rays. Each direction has a
density of such paths, in rays per étendue at either end and per solid angle at each scatter event. The étendue
n² cos θ dω dA is conserved by mirrors and lenses, so that specular events cancel. The balance heuristic (E. Veach,
Robust Monte Carlo methods for light transport simulation, 1997, section 9.2) weights technique i by

    w_i = n_i p_i / Σ_k n_k p_k,

where n_i is its number of rays and p_i its density. Only ratios matter: in the code one backward ray is the unit,
`forward` is n p of forward rays, `connected` that of connections. Any weights that add up to 1 leave the estimate
unbiased, so that branch probabilities may be left out of the densities.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.kernel.light_vertices import LightVertices
from mistray.kernel.scatter_shares import CONNECTED
from mistray.recorders.direction_recorder import MisWeights
from mistray.recorders.path_key import COUNT_MASK
from mistray.recorders.recorder import Departure, Visit
from mistray.sampling.detector_start import DetectorStart
from mistray.sampling.sharing.cell_waves import CellWaves
from mistray.sampling.sharing.path_classes import PathClassVariances
from mistray.sampling.sharing.start_map import DeviceMap, StartMap
from mistray.surfaces.upload import upload_rows


@dataclass(frozen=True, eq=False)
class Sharing:
    """
    Numbers of forward rays and connections that supplement a backward trace, and densities of their starts.

    Attributes
    ----------
    points : (p, 3) float64
        Hull of the scene that the light covers, from `mistray.sampling.plane_wave.hull_points`.
    starts : StartMap
        Densities of the start points of forward rays.
    rays : (c,) float64
        Number of forward rays of each cell per backward ray of the whole trace.
    starts_per_connection : (c,) float64
        Number of start rays of each cell per connection, which picks one of their light vertices, see
        `mistray.kernel.light_vertices`; all 0: there are no connections.
    windows, forward_windows : (2, n, WAYS) float64, optional
        Inverse upper and lower bounds of `mistray.kernel.kernel_scene.WeightWindows`, for backward and for forward
        rays; 0 for no bound. None: there are no weight windows.
    values : (c,) float64, optional
        Value of a unit of throughput of forward rays by cell, for their weight windows; None: 1.
    unscattered : (c,) float64, optional
        Number of further forward rays, which are not scattered, per ray of `rays`. They alone carry the unscattered
        light; they cost little, and find narrow entrances. None: there are none, and `rays` carry all light.
    ends : StartMap, optional
        Map of one cell, of the starts of backward rays on the lit side of the detector. None: they start without a map.
    path_classes : PathClassVariances, optional
        Variances of path classes, for derivatives with respect to parameters that move paths; None: not estimated.
    """

    points: np.ndarray
    starts: StartMap
    rays: np.ndarray
    starts_per_connection: np.ndarray
    windows: np.ndarray | None = None
    forward_windows: np.ndarray | None = None
    values: np.ndarray | None = None
    unscattered: np.ndarray | None = None
    ends: StartMap | None = None
    path_classes: PathClassVariances | None = None

    @property
    def connects(self) -> bool:
        """True if backward rays are connected to light vertices."""
        return bool(self.starts_per_connection.any())


class Balance:
    """
    Weights of forward rays, backward rays and connections by the balance heuristic, which share each path among them.

    Parameters
    ----------
    sharing : Sharing
        Numbers and start densities of forward rays and connections.
    waves : CellWaves
        Plane wave of each cell, from which forward rays start.
    start : DetectorStart
        Start of the backward trace.
    """

    def __init__(self, sharing: Sharing, waves: CellWaves, start: DetectorStart) -> None:
        self.waves, self.start = waves, start
        self.starts = DeviceMap(sharing.starts)
        self._take(sharing)

    def at(self, sharing: Sharing) -> Balance:
        """Return a copy, without light vertices, for other numbers of rays and other start densities."""
        found = copy(self)
        found._take(sharing)
        if sharing.starts is not self.sharing.starts:
            found.starts = DeviceMap(sharing.starts)  # uploaded only if it has changed
        return found

    def of_pass(self, mean_weight: float, vertices: LightVertices | None) -> Balance:
        """
        Return a copy with MIS weights for the backward rays of one pass.

        `mean_weight` is the mean of their start weights, which corrects the rounding of their number: no density has
        this factor. They are connected to the light vertices, if there are any.
        """
        found = copy(self)
        found._per_mean_weight = dr.opaque(mi.Float, 1 / mean_weight)
        found._vertices = vertices
        return found

    def _take(self, sharing: Sharing) -> None:
        self._vertices: LightVertices | None = None
        self._per_mean_weight = dr.opaque(mi.Float, 1.0)
        self.sharing = sharing
        # Connections per étendue of a cell
        self._starts_per_connection = upload_rows(mi.Float, sharing.starts_per_connection / self.waves.etendue)
        # n p of forward rays over that of backward rays, which start over the étendue π A of the detector: first for
        # scattered light, then for unscattered light
        both = sharing.rays, sharing.rays * (1.0 if sharing.unscattered is None else sharing.unscattered)
        per_etendue = np.concatenate(both) * np.pi * self.start.area / np.tile(self.waves.etendue, 2)
        self._per_etendue = upload_rows(mi.Float, per_etendue)
        self._cells = dr.opaque(mi.UInt32, len(self.waves.areas))  # opaque, so that it makes no new kernel

    def backward(self, departure: Departure, cell: mi.UInt32, active: mi.Bool) -> MisWeights:
        """
        Return the MIS weights, 0 … 1, of paths of backward rays that leave the scene within a cell of directions.

        The weight of a connected ray that leaves on another path than that of its light vertex is 0.
        """
        # Density with which forward rays would have started on the path
        p = mi.Vector3f(*departure.node[:3])
        place = self.waves.place(cell, p, -departure.heading, active)
        density = self.starts.density(cell, place, active)
        # MIS weight: n_i p_i/Σ n_k p_k, relative to the backward ray
        start_weight = departure.start.w * self._per_mean_weight
        own_ratio = self._forward_ratio(cell, departure.scatters, density, start_weight, active)
        forward = own_ratio * _or_one(departure.pdf_ratio)
        connected = self._connections(cell, density, departure.connection_ratio, active)
        own = dr.rcp(1 + forward + connected)
        start = departure.start
        assert start.normal is not None
        outward = start.normal * dr.select(dr.dot(start.normal, start.d) < 0, mi.Float(-1), 1)
        end = [*self.start.place(start.o, start.d, outward), start_weight]
        weights = MisWeights(forward * own, own, connected * own, density, place, end)
        # A connected ray contributes only if it leaves on the path of its light vertex
        if self._vertices is not None and departure.light_vertex is not None:
            light_vertex = departure.light_vertex
            number = (light_vertex & (CONNECTED - 1)) - 1
            astray = (light_vertex != 0) & ~self._vertices.comes_from(
                number, departure, cell, active & (light_vertex != 0)
            )
            weights = weights._replace(backward=dr.select(astray, 0, own))
        return weights

    def forward(self, visit: Visit) -> MisWeights:
        """
        Return the MIS weights, 0 … 1, of paths of forward rays that meet the detector.

        Where no backward ray starts, the weight of forward rays is 1.
        """
        start, active, it = visit.start, visit.detected, visit.interaction
        assert start.cell is not None
        assert start.scale is not None
        # Densities at either end: of the backward start at the hit, and of the forward start
        weight = self.start.weight_at(it.p, -visit.state["d"], -it.axis, active)
        density = dr.rcp(start.scale)
        forward = self._forward_ratio(start.cell, visit.state["scatters"], density, weight, active)
        backward = _or_one(visit.pdf_ratio)
        connected = backward * self._connections(start.cell, density, visit.connection_ratio, active)
        # MIS weight: n_i p_i/Σ n_k p_k; where backward rays do not start, or never get, forward rays have weight 1
        there, per_sum = dr.isfinite(forward), dr.rcp(forward + backward + connected)
        return MisWeights(
            dr.select(there, forward * per_sum, 1),
            dr.select(there, backward * per_sum, 0),
            dr.select(there, connected * per_sum, 0),
            density,
            end=[*self.start.place(it.p, -visit.state["d"], -it.axis), weight],
        )

    def _forward_ratio(
        self, cell: mi.UInt32, scatters: mi.UInt32, density: mi.Float, start_weight: mi.Float, active: mi.Bool
    ) -> mi.Float:
        """
        Return the start density of forward rays over that of backward rays, both in rays per étendue.

        `density` is that of the start map, of mean 1, and `start_weight` that of the backward ray on the path.
        """
        # Unscattered light has forward rays of its own, in the second half of the table
        row = cell + dr.select((scatters & COUNT_MASK) == 0, self._cells, 0)
        return dr.gather(mi.Float, self._per_etendue, row, active) * density * start_weight

    def _connections(
        self, cell: mi.UInt32, density: mi.Float, connection_ratio: mi.Float | None, active: mi.Bool
    ) -> mi.Float:
        """
        Return the expected connections that find a path per backward ray, see `PdfRatios.connection_ratios`.

        `density` is that of the start map, of mean 1. The result is 0 where rays are not connected.
        """
        if connection_ratio is None:
            return mi.Float(0)
        return dr.gather(mi.Float, self._starts_per_connection, cell, active) * density * connection_ratio


def _or_one(pdf_ratio: mi.Float | None) -> mi.Float:
    return mi.Float(1) if pdf_ratio is None else pdf_ratio

"""How the two directions share the light: the balance heuristic between rays with the light and rays against it.

A path from a cell of directions to the detector can be found by rays that follow the light and by rays that go against
it. Each direction has a density of such paths, in units of rays per étendue at either end and per solid angle at each
scatter event; the étendue n² cos θ dω dA is the same before and behind mirrors and lenses, so that speculars cancel.
Both directions count a path in proportion to their densities (E. Veach, Robust Monte Carlo methods for light transport
simulation, 1997, section 9.2). Any weights that add up to 1 leave the mean as it is, so that chances of branches may be
left out of the densities.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.kernel.scatter_shares import JOINED
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.path_key import COUNT_MASK
from mistray.recorders.recorder import Departure, Visit
from mistray.recorders.weighing import PathShares
from mistray.sampling.detector_start import DetectorStart
from mistray.sampling.plane_wave import PlaneWaves
from mistray.sampling.sharing.families import FamilyVariances
from mistray.sampling.sharing.light_vertices import LightVertices
from mistray.sampling.sharing.start_map import DeviceMap, StartMap
from mistray.surfaces.upload import upload


@dataclass(frozen=True, eq=False)
class Sharing:
    """
    Rays with the light beside a trace against it.

    Attributes
    ----------
    points : (p, 3) float64
        What the light covers, from `mistray.sampling.plane_wave.hull_points`.
    starts : StartMap
        Where they start.
    rays : (c,) float64
        Of each cell, for one of all rays against the light.
    linked : (c,) float64
        Start rays of each cell whose points of light are picked, for one connection, see
        `mistray.sampling.sharing.light_vertices`; all 0: there are no connections.
    windows : (2, n, WAYS) float64, optional
        "many" and "few" of `mistray.kernel.kernel_scene.WeightWindows`, for rays against the light; None: there are
        none.
    unscattered : (c,) float64, optional
        Rays with the light beside each of those, which are not scattered: light that nothing scatters is theirs alone.
        They cost little, and find the narrow ways in. None: there are none, and the others have all light.
    families : FamilyVariances, optional
        For derivatives by what moves paths; None: there are none.
    """

    points: np.ndarray
    starts: StartMap
    rays: np.ndarray
    linked: np.ndarray
    windows: np.ndarray | None = None
    unscattered: np.ndarray | None = None
    families: FamilyVariances | None = None

    @property
    def connects(self) -> bool:
        """Whether there are connections."""
        return bool(self.linked.any())


class Balance:
    """
    Which share of a path the rays of either direction count.

    Parameters
    ----------
    sharing : Sharing
    grid : DirectionGrid
    start : DetectorStart
        Of the trace against the light.
    centre : (3,) float64
        What positions on the device are relative to, mm.
    """

    def __init__(self, sharing: Sharing, grid: DirectionGrid, start: DetectorStart, centre: np.ndarray) -> None:
        waves = PlaneWaves(sharing.points, grid)
        cells = [waves.at(i, j, 0.0, 1.0) for i, j in np.ndindex(*grid.shape)]
        self.areas = np.array([wave.area for wave in cells])
        self._etendue = self.areas * np.repeat(grid.solid_angle, grid.shape[1])
        self.numbers = [upload(mi.Float, column) for column in np.array([wave.numbers for wave in cells]).T]
        self.rotation, self.centre = cells[0].rotation, cells[0].centre - centre
        self.start = start
        self.extent = float(np.ptp(sharing.points, axis=0).max())  # of the scene, mm
        self.starts = DeviceMap(sharing.starts)
        self._take(sharing)

    def at(self, sharing: Sharing) -> Balance:
        """That of another sharing of the same light."""
        found = copy(self)
        found._take(sharing)
        if sharing.starts is not self.sharing.starts:
            found.starts = DeviceMap(sharing.starts)
        return found

    def beside(self, vertices: LightVertices) -> Balance:
        """That of rays which are connected to points of light."""
        found = copy(self)
        found._vertices = vertices
        return found

    def _take(self, sharing: Sharing) -> None:
        self._vertices: LightVertices | None = None
        self.sharing = sharing
        self._linked = upload(mi.Float, sharing.linked / self._etendue)
        # Of light that something scatters, and of light that nothing does
        both = sharing.rays, sharing.rays * (1.0 if sharing.unscattered is None else sharing.unscattered)
        per_etendue = np.concatenate(both) * np.pi * self.start.area / np.tile(self._etendue, 2)
        self._per_etendue = upload(mi.Float, per_etendue)

    def against(self, departure: Departure, cell: mi.UInt32, active: mi.Bool) -> PathShares:
        """See `mistray.recorders.weighing.Weighing`."""
        point = self.start_of(departure, cell, active)
        density = self.starts.density(cell, point, active)
        along = self._with_light(cell, departure.scatters, density, departure.start.w, active) * _or_one(departure.odds)
        linked = self._connections(cell, density, departure.link, active)
        share = dr.rcp(1 + along + linked)
        shares = PathShares(along * share, share, linked * share)
        if self._vertices is not None and departure.joint is not None:
            joint = departure.joint
            number = (joint & (JOINED - 1)) - 1
            astray = (joint != 0) & ~self._vertices.comes_from(number, departure, cell, active & (joint != 0))
            shares = shares._replace(against=dr.select(astray, 0, share))
        return shares

    def along(self, visit: Visit) -> PathShares:
        """See `mistray.recorders.weighing.Weighing`."""
        start, active, it = visit.start, visit.detected, visit.interaction
        assert start.cell is not None
        assert start.scale is not None
        weight = self.start.weight_at(it.p, -visit.state["d"], -it.axis, active)
        density = dr.rcp(start.scale)
        along = self._with_light(start.cell, visit.state["scatters"], density, weight, active)
        against = _or_one(visit.odds)
        linked = against * self._connections(start.cell, density, visit.link, active)
        # Where rays against the light do not start, or never come by, those with it count all
        there, share = dr.isfinite(along), dr.rcp(along + against + linked)
        return PathShares(
            dr.select(there, along * share, 1),
            dr.select(there, against * share, 0),
            dr.select(there, linked * share, 0),
        )

    def start_of(self, departure: Departure, cell: mi.UInt32, active: mi.Bool) -> list[mi.Float]:
        """See `mistray.recorders.weighing.StartWeighing`."""
        p = departure.start.o if departure.node is None else mi.Vector3f(*departure.node[:3])
        return self._point(cell, p, -departure.heading, active)

    def density(self, cell: mi.UInt32, point: list[mi.Float], active: mi.Bool) -> mi.Float:
        """See `mistray.recorders.weighing.StartWeighing`."""
        return self.starts.density(cell, point, active)

    def _point(self, cell: mi.UInt32, p: mi.Vector3f, d: mi.Vector3f, active: mi.Bool) -> list[mi.Float]:
        """Points of the unit cube of the light of a cell that goes along d through p, see `wave_rays`."""
        low, high, azimuth, half_azimuth, middle_x, middle_y, half_x, half_y, is_round, _ = (
            dr.gather(mi.Float, column, cell, active) for column in self.numbers
        )
        x_axis, y_axis, z_axis = (
            mi.Vector3f(*(dr.opaque(mi.Float, float(v)) for v in column)) for column in self.rotation.T
        )
        x, y, z = (dr.dot(d, axis) for axis in (x_axis, y_axis, z_axis))
        sine2 = dr.fma(x, x, y * y)
        sine = dr.sqrt(sine2)
        u = (sine2 / (2 * (1 + z)) - low) / (high - low)
        there = sine > 1e-12
        s, c = dr.select(there, -x / sine, 0), dr.select(there, y / sine, 1)
        turn = dr.atan2(s, c) - azimuth
        turn = turn - 2 * dr.pi * dr.round(turn / (2 * dr.pi))
        v = 0.5 * (turn / half_azimuth + 1)
        radial = c * y_axis - s * x_axis
        across, along = c * x_axis + s * y_axis, z * radial - sine * z_axis
        q = p - mi.Vector3f(*(dr.opaque(mi.Float, float(value)) for value in self.centre))
        a, b = (dr.dot(q, across) - middle_x) / half_x, (dr.dot(q, along) - middle_y) / half_y
        square = mi.warp.uniform_disk_to_square_concentric(mi.Point2f(a, b))
        a, b = dr.select(is_round > 0, square.x, 0.5 * (a + 1)), dr.select(is_round > 0, square.y, 0.5 * (b + 1))
        return [dr.clip(value, 0, 1 - 2.0**-24) for value in (a, b, u, v)]

    def _with_light(
        self, cell: mi.UInt32, scatters: mi.UInt32, density: mi.Float, start_weight: mi.Float, active: mi.Bool
    ) -> mi.Float:
        """Rays with the light for one against it, of the same étendue at their starts."""
        row = cell + dr.select((scatters & COUNT_MASK) == 0, mi.UInt32(len(self.areas)), 0)
        return dr.gather(mi.Float, self._per_etendue, row, active) * density * start_weight

    def _connections(self, cell: mi.UInt32, density: mi.Float, link: mi.Float | None, active: mi.Bool) -> mi.Float:
        """Connections that find a path for one ray against the light, see `mistray.kernel.odds.Odds.linked`."""
        if link is None:
            return mi.Float(0)
        return dr.gather(mi.Float, self._linked, cell, active) * density * link


def _or_one(odds: mi.Float | None) -> mi.Float:
    return mi.Float(1) if odds is None else odds

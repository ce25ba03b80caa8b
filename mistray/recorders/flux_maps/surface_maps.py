"""Maps of the light on walls and other surfaces, unrolled: azimuth or x across; length, radius or y along."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.ranges import FILM_PIXELS, FILM_SIDE
from mistray.recorders.flux_maps.cells import MM2_PER_M2, SurfaceLight, cell_of
from mistray.recorders.recorder import Memory, Visit
from mistray.recorders.sampled import Sampled
from mistray.surfaces.families.cone import Cone
from mistray.surfaces.families.sag_surface import NODES, WEIGHTS, SagSurface
from mistray.surfaces.optics import DETECTOR, MIRROR, OPAQUE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

Array = npt.NDArray[np.float64]

AZIMUTHS, LENGTHS = 36, 24
KINDS = 2  # sums of a cell: incident and absorbed flux


@dataclass(frozen=True)
class Unrolled:
    """
    Surface unrolled to rows and columns of cells: its coordinates with their range, and the areas of the cells.

    Attributes
    ----------
    number : int
        Index of the surface.
    round : bool
        Whether the columns are azimuths; otherwise they are x.
    along : str
        Coordinate of the rows: "z" of a tube or a cone, "radius" of a ring or a lens, "y" of a rectangle.
    low, high : float
        Range of that coordinate, mm; z is measured from the vertex.
    half_width : float
        Half width of a rectangle, mm; 0 for a round surface.
    areas : (rows,) float64
        Areas of the cells of each row, mm².
    """

    number: int
    round: bool
    along: str
    low: float
    high: float
    half_width: float
    areas: Array


@dataclass(frozen=True, eq=False)
class SurfaceMap:
    """
    Map of the incident and absorbed flux on one unrolled surface.

    Attributes
    ----------
    surface, part : str
        Id of the surface, and name of the part that it belongs to.
    along : str
        Coordinate of the rows: "z" of a tube or a cone, "radius" of a ring, a lens or a mirror, "y" of a rectangle.
    along_mm : (rows + 1,) float64
        Borders of the rows, mm; z is that of the frame of the shape.
    across : str
        Coordinate of the columns: "azimuth", measured from x of the frame of the shape towards y, or "x".
    across_borders : (columns + 1,) float64
        Borders of the columns, degrees or mm.
    areas : (rows,) float64
        Areas of the cells of each row, on the surface, mm².
    places : (rows, columns, 3) float64
        Centres of the cells in the world, mm.
    corners : (rows + 1, columns + 1, 3) float64
        Corners of the cells in the world, mm.
    incident, absorbed : Sampled
        Incident and absorbed flux of the cells, with their noise, (rows, columns), W.

    Examples
    --------
    >>> walls = mistray.recorders.SurfaceMaps("walls", surfaces="barrel_*", azimuths=12, lengths=4)
    >>> t = mistray.trace(mistray.load("lens_and_window"), rays=10_000, recorders=[walls])
    >>> wall = walls.maps["barrel_1_wall"]
    >>> irradiance, error = wall.irradiance
    >>> irradiance.shape, wall.along, wall.across
    ((4, 12), 'z', 'azimuth')
    >>> print(f"{wall.power[0]:.2f} W meet the wall")
    0.92 W meet the wall
    """

    surface: str
    part: str
    along: str
    along_mm: Array
    across: str
    across_borders: Array
    areas: Array
    places: Array
    corners: Array
    incident: Sampled
    absorbed: Sampled

    @property
    def irradiance(self) -> tuple[Array, Array]:
        """Irradiance of both sides together by cell and its standard error, (rows, columns) each, W/mm²."""
        return self.incident.value / self.areas[:, None], self.incident.se / self.areas[:, None]

    @property
    def absorbed_irradiance(self) -> tuple[Array, Array]:
        """Absorbed flux per area by cell and its standard error, (rows, columns) each, W/mm²."""
        return self.absorbed.value / self.areas[:, None], self.absorbed.se / self.areas[:, None]

    @property
    def power(self) -> tuple[float, float]:
        """Total flux that meets both sides of the surface, and its standard error, W."""
        return self.incident.whole

    @property
    def absorbed_power(self) -> tuple[float, float]:
        """Total flux that the surface absorbs, and its standard error, W, as in the energy ledger."""
        return self.absorbed.whole

    @property
    def peak(self) -> tuple[int, int]:
        """Row and column, from 0, of the cell with the highest irradiance."""
        row, column = np.unravel_index(int(np.argmax(self.irradiance[0])), self.incident.value.shape)
        return int(row), int(column)

    @property
    def unrolled_mm(self) -> tuple[float, float, float, float]:
        """
        Extent x0, x1, y0, y1 of the unrolled map, mm.

        A round surface is as wide as its area divided by the range of `along_mm`.
        """
        low, high = float(self.along_mm[0]), float(self.along_mm[-1])
        if self.across == "x":
            return float(self.across_borders[0]), float(self.across_borders[-1]), low, high
        # Mean circumference: area over the length along the rows
        slant = high - low
        round_it = float(self.areas.sum()) * (len(self.across_borders) - 1)
        return 0.0, round_it / slant, low, high


class SurfaceMaps(SurfaceLight):
    """
    Recorder of maps of the light that meets surfaces, by position on them; they show hot spots on walls.

    It is given to `mistray.trace` among ``recorders``. Tubes and cones are unrolled over azimuth and z, rings, lenses
    and mirrors over azimuth and radius, flat rectangles over x and y. Both sides contribute, and light that comes back
    to a surface contributes again.

    Parameters
    ----------
    name : str
        Name in the trace, see `mistray.trace.Trace.recorders`.
    surfaces : str or sequence of str
        Patterns of ids of surfaces or of parts, with ``*``, ``?`` and ``[…]``; none: all opaque surfaces that are
        neither mirrors nor detectors.
    azimuths, lengths : int
        Number of cells across and along each surface.

    Raises
    ------
    MistrayError
        For a blank name or values out of range; during the trace, if a pattern names no surface, if no surface can be
        unrolled, or if an earlier trace was of other surfaces.

    Examples
    --------
    >>> walls = mistray.recorders.SurfaceMaps("walls", azimuths=12, lengths=4)
    >>> t = mistray.trace(mistray.load("lens_and_window"), rays=10_000, recorders=[walls])
    >>> list(walls.maps)[:3]
    ['L1_edge', 'barrel_1_wall', 'window_edge']
    >>> watts, error = walls.power
    >>> print(f"{watts:.1f} W meet opaque surfaces")
    3.4 W meet opaque surfaces
    """

    kind, unit = "surface maps", "W/mm²"

    kernel_by = ("shape", "cells")

    def __init__(
        self, name: str, surfaces: str | Sequence[str] = (), azimuths: int = AZIMUTHS, lengths: int = LENGTHS
    ) -> None:
        owner = f"surface maps '{name}'"
        self.shape = (
            int(FILM_SIDE.check("lengths", lengths, owner)),
            int(FILM_SIDE.check("azimuths", azimuths, owner)),
        )
        FILM_PIXELS.check("number of its cells", azimuths * lengths, owner)
        self._unrolled: list[Unrolled] = []
        self.left_out: dict[str, str] = {}
        super().__init__(name, surfaces, KINDS * azimuths * lengths)

    def lay_out(self, table: SurfaceTable) -> None:
        """Unroll the chosen surfaces into cells, and upload the coefficients by which a hit finds its cell."""
        numbers = self.chosen(table)
        # Cells and borders are those of the first trace: later ones add to them
        if not self._unrolled:
            self._find(table, numbers)
        # Row of a hit: a linear function of z, radius and y whose coefficients belong to the surface, so that the
        # kernel does not branch
        rows, columns = self.shape
        place = np.zeros(table.count, dtype=np.uint32)
        weights, across = np.zeros((table.count, 4)), np.zeros(table.count)
        for number, one in enumerate(self._unrolled):
            step = rows / (one.high - one.low)
            place[one.number] = number + 1
            factors = {"z": (step, 0.0, 0.0), "radius": (0.0, step, 0.0), "y": (0.0, 0.0, step)}[one.along]
            weights[one.number] = *factors, -one.low * step
            across[one.number] = 0.0 if one.round else columns / (2 * one.half_width)
        self._place = upload(mi.UInt32, place)
        self._weights = upload(mi.Float, weights)
        self._across = upload(mi.Float, across)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Add each hit's incident and absorbed flux to the cell of its surface."""
        cell, active = self.cell(visit)
        self.add(visit.start, cell, visit.weight, active)
        self.add(visit.start, cell + self.shape[0] * self.shape[1], dr.maximum(visit.absorbed, 0), active)

    def cell(self, visit: Visit) -> tuple[mi.UInt32, mi.Bool]:
        """Return the index of the cell for each hit's incident flux, and a mask of hits on mapped surfaces."""
        rows, columns = self.shape
        s, q = visit.surface, visit.interaction.local
        place = dr.gather(mi.UInt32, self._place, s, visit.active)
        active = visit.active & (place > 0)
        # Row, by z, radius or y
        weights = dr.gather(mi.Vector4f, self._weights, s, active)
        radius = dr.sqrt(q.x * q.x + q.y * q.y)
        row = dr.fma(weights.x, q.z, dr.fma(weights.y, radius, dr.fma(weights.z, q.y, weights.w)))
        # Column, by azimuth or x
        turn = dr.atan2(q.y, q.x) / (2 * dr.pi)
        turn = dr.select(turn < 0, turn + 1, turn) * columns
        per_mm = dr.gather(mi.Float, self._across, s, active)
        column = dr.select(per_mm > 0, dr.fma(q.x, per_mm, 0.5 * columns), turn)
        return (KINDS * (place - 1) * rows + cell_of(row, rows)) * columns + cell_of(column, columns), active

    def surfaces_by_default(self, table: SurfaceTable) -> list[int]:
        """Return the indices of the opaque surfaces that are neither mirrors nor detectors."""
        words = table.optics.host_words
        return [k for k in table.listed if (words[k] & (OPAQUE | MIRROR | DETECTOR)) == OPAQUE]

    def _find(self, table: SurfaceTable, numbers: list[int]) -> None:
        """
        Unroll the surfaces with these indices; record the reason in `left_out` for those that cannot be unrolled.

        Raises
        ------
        MistrayError
            If none of them can be unrolled, or there are too many cells.
        """
        for k in numbers:
            one = _unroll(table, k, *self.shape)
            if isinstance(one, str):
                self.left_out[table.ids[k]] = one
            else:
                self._unrolled.append(one)
        # A scene without any map is an error; single surfaces are only left out
        if not self._unrolled:
            why = next(iter(self.left_out.items()), ("the scene", "it has no opaque surface that is no mirror"))
            raise MistrayError(f"{self._owner}: no surface can be unrolled; {why[0]}: {why[1]}")
        rows, columns = self.shape
        cells = KINDS * len(self._unrolled) * rows * columns
        FILM_PIXELS.check("number of its cells", cells, self._owner)
        self.resize(cells)
        self._dark = [self._dark_map(table, one) for one in self._unrolled]

    def _dark_map(self, table: SurfaceTable, one: Unrolled) -> SurfaceMap:
        """Return a map of zero flux: borders of its rows and columns, and its cells' points in the world, mm."""
        rows, columns = self.shape
        shape = table.shapes[one.number]
        along = np.linspace(one.low, one.high, rows + 1)
        across = np.linspace(0, 360, columns + 1)
        if not one.round:
            across = np.linspace(-one.half_width, one.half_width, columns + 1)
        middles = [0.5 * (borders[:-1] + borders[1:]) for borders in (along, across)]
        places, corners = _points(table, one, *middles), _points(table, one, along, across)
        if one.along == "z":  # from the vertex to the frame of the shape
            frame = np.asarray(shape.matrix, dtype=np.float64)
            along = along + float((table.vertices[one.number] - frame[:3, 3]) @ frame[:3, 2])
        dark = Sampled(np.zeros(self.shape), np.zeros((*self.shape, 1)))
        names = table.ids[one.number], table.parts[one.number]
        of_columns = "azimuth" if one.round else "x"
        return SurfaceMap(*names, one.along, along, of_columns, across, one.areas, places, corners, dark, dark)

    @property
    def maps(self) -> dict[str, SurfaceMap]:
        """
        Maps of the incident and absorbed flux on surfaces, by their ids.

        Raises
        ------
        MistrayError
            If nothing has been traced yet.
        """
        return self.maps_of(self.flux)

    @property
    def illuminance(self) -> dict[str, tuple[Array, Array]]:
        """Illuminance by cell and its standard error, (rows, columns) each, lx, by the ids of the surfaces."""
        found = self.maps_of(self.luminous_flux.scaled(MM2_PER_M2))
        return {name: one.irradiance for name, one in found.items()}

    def maps_of(self, flux: Sampled) -> dict[str, SurfaceMap]:
        """Return maps by surface id from the flux of all cells, (cells,), W, which may be that of selected paths."""
        cells = flux.reshaped(-1, KINDS, *self.shape)
        # One map a surface: incident and absorbed flux lie one after the other
        return {
            one.surface: replace(one, incident=cells[k, 0], absorbed=cells[k, 1]) for k, one in enumerate(self._dark)
        }

    @property
    def power(self) -> tuple[float, float]:
        """Total flux that meets all mapped surfaces and its standard error, W."""
        return self.flux.reshaped(-1, KINDS, *self.shape)[:, 0].whole

    @property
    def image(self) -> tuple[Array, Array]:
        """Irradiance by cell and its standard error, (surfaces × rows, columns) each, W/mm²: one map below another."""
        both = [one.irradiance for one in self.maps.values()]
        return np.concatenate([value for value, _ in both]), np.concatenate([se for _, se in both])

    @property
    def image_size(self) -> int:
        """Number of cells of all maps."""
        return self.cells // KINDS


def _points(table: SurfaceTable, one: Unrolled, along: Array, across: Array) -> Array:
    """
    Return the points of a surface at all pairs of its coordinates, (m, n, 3), in the world, mm.

    `along` is in mm; `across` is in degrees on a round surface, else in mm.
    """
    piece = table.pieces[one.number]
    u, v = np.meshgrid(along, across, indexing="ij")
    # Radius and z of the surface in its own frame
    turn = np.radians(v)
    if isinstance(piece, Cone):
        radius, z = np.asarray(piece.radius(u)), u
    else:
        assert isinstance(piece, SagSurface)
        radius, z = u, np.zeros_like(u) if piece.flat else piece.sag(u * u)
    x, y = (radius * np.cos(turn), radius * np.sin(turn)) if one.round else (v, u)
    return np.asarray(np.stack([x, y, z], axis=-1) @ table.rotations[one.number].T + table.vertices[one.number])


def _unroll(table: SurfaceTable, number: int, rows: int, columns: int) -> Unrolled | str:
    """Return the surface of index `number` unrolled to rows × columns of cells, or why it cannot be unrolled."""
    if number >= len(table.pieces):
        return "it is a mesh or a shape of Mitsuba's own; give it as frustum or asphere"
    piece = table.pieces[number]
    if isinstance(piece, Cone):
        low, high = piece.z_range
        z = np.linspace(low, high, rows + 1)
        radius = np.abs(piece.radius(z))
        # Lateral area of a truncated cone: π (r_0 + r_1) times its slant height
        slant = np.hypot(1.0, piece.slope) * (high - low) / rows
        return Unrolled(number, True, "z", low, high, 0.0, np.pi * (radius[:-1] + radius[1:]) * slant / columns)
    if isinstance(piece, SagSurface) and piece.outer:
        return Unrolled(number, True, "radius", piece.inner, piece.outer, 0.0, _rings(piece, rows) / columns)
    if isinstance(piece, SagSurface) and piece.flat:
        x, y = piece.half_size
        return Unrolled(number, False, "y", -y, y, x, np.full(rows, 4 * x * y / (rows * columns)))
    return "it is neither round nor a flat rectangle"


def _rings(piece: SagSurface, rows: int) -> Array:
    """Return the areas of rings of equal width in radius, (rows,), mm²: exact for planes, by quadrature otherwise."""
    r = np.linspace(piece.inner, piece.outer, rows + 1)
    if piece.flat:
        return np.asarray(np.pi * (r[1:] ** 2 - r[:-1] ** 2))
    # ∫ 2π r √(1 + sag'²) dr, with nodes that are dense at the outer border: at the rim of a hemisphere sag' diverges
    width = (r[1:] - r[:-1])[:, None]
    radius = r[1:, None] - width * NODES**2
    slope = 2 * radius * piece.sag_derivative(radius**2)
    return np.asarray((2 * np.pi * radius * np.hypot(1.0, slope) * 2 * width * NODES) @ WEIGHTS)

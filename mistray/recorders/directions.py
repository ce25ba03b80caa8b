"""Cells of incident directions over which a point source transmittance is averaged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.known_arguments import known_arguments
from mistray.ranges import AZIMUTH_DEG, AZIMUTH_WIDTH_DEG, CELL_WIDTH_DEG, PST_FIELD_DEG

CELL_DEG = 2.0  # width of a cell by default
SAME_DEG = 1e-9  # difference of two angles that is rounding


@dataclass(frozen=True, eq=False)
class DirectionGrid:
    """
    Grid of cells of directions, by field angle and azimuth about an axis.

    A cell holds the directions of light whose field angle is within `edges_deg` and whose azimuth is within half of
    `azimuth_cell_deg` of the cell's own.

    Attributes
    ----------
    field_deg : (n,) float64
        Field angles, degrees, ascending, 0 … 90.
    edges_deg : (n, 2) float64
        Smallest and largest field angle of each cell, degrees; cells do not overlap.
    azimuths_deg : (m,) float64
        Azimuths, degrees, from +y towards -x, as for a `collimated` source.
    azimuth_cell_deg : float
        Width of a cell in azimuth, degrees; 360: all azimuths together.
    rotation : (3, 3) float64
        Columns: x, y and z axis of the frame that the angles are measured in; light at 0° travels along z.

    Raises
    ------
    MistrayError
        From `of`: for angles or widths out of range, angles that do not ascend, an azimuth given twice, or cells that
        overlap.
    """

    field_deg: np.ndarray
    edges_deg: np.ndarray
    azimuths_deg: np.ndarray
    azimuth_cell_deg: float
    rotation: np.ndarray

    @classmethod
    @known_arguments
    def of(
        cls,
        field_deg: float | Sequence[float] | np.ndarray,
        azimuths_deg: float | Sequence[float] | np.ndarray | None = None,
        cell_deg: float | None = None,
        azimuth_cell_deg: float | None = None,
        rotation: np.ndarray | None = None,
    ) -> DirectionGrid:
        """
        Create a grid of cells of directions around field angles and azimuths, degrees.

        Parameters
        ----------
        field_deg : float or sequence of float
            Field angles, -90 … 90; a negative angle is the positive one at the opposite azimuth, as for a `collimated`
            source. If there are angles of both signs, all cells have both azimuths.
        azimuths_deg : float or sequence of float, optional
            Azimuths; by default one cell holds all azimuths, and the sign of a field angle does not matter.
        cell_deg : float, optional
            Width of the cells in field angle; by default 2°, or the smallest distance of two angles if that is less.
        azimuth_cell_deg : float, optional
            Width of the cells in azimuth; by default the smallest distance of two azimuths, at most 10° for a single
            one.
        rotation : (3, 3) float64, optional
            Columns: axes of the frame that the angles are measured in; by default those of the world.

        Raises
        ------
        MistrayError
            For angles or widths out of range, angles that do not ascend, an azimuth given twice, cells that overlap, or
            `azimuth_cell_deg` without `azimuths_deg`.
        """
        # Field angles and the borders of their cells
        given = np.array(PST_FIELD_DEG.check_each("field_deg", field_deg))
        if np.min(np.diff(given), initial=np.inf) <= SAME_DEG:
            raise MistrayError("field_deg must ascend; sort the field angles and give each once")
        angles = np.sort(np.abs(given))
        angles = angles[np.diff(angles, prepend=-1.0) > SAME_DEG]
        apart = float(np.min(np.diff(angles), initial=np.inf))
        width = min(CELL_DEG, apart) if cell_deg is None else float(cell_deg)
        CELL_WIDTH_DEG.check("cell_deg", width)
        if width > apart * (1 + 1e-9):
            raise MistrayError(
                f"cell_deg is {width:g}; it must be at most the distance of two angles, {apart:g} degrees"
            )
        edges = np.clip(np.stack([angles - width / 2, angles + width / 2], axis=1), 0.0, 90.0)
        # Azimuths, with the opposite ones of negative field angles, and the width of their cells
        if azimuths_deg is None:
            if azimuth_cell_deg is not None:
                raise MistrayError("azimuth_cell_deg is given without azimuths_deg; give the azimuths too")
            azimuths, span = np.zeros(1), 360.0
        else:
            azimuths = np.array(AZIMUTH_DEG.check_each("azimuths_deg", azimuths_deg))
            span = min(10.0, _least_gap(azimuths)) if len(azimuths) == 1 else _least_gap(azimuths)
            if np.any(given < 0):
                opposite = azimuths + np.where(azimuths > 0, -180, 180)
                new = opposite[np.min(_apart(opposite[:, None], azimuths), axis=1) > SAME_DEG]
                azimuths = np.append(azimuths, new) if np.any(given >= 0) else opposite
            # The opposite azimuths may lie closer than the given ones
            least = _least_gap(azimuths)
            span = min(span, least)
            if azimuth_cell_deg is not None:
                AZIMUTH_WIDTH_DEG.check("azimuth_cell_deg", azimuth_cell_deg)
                if azimuth_cell_deg > least * (1 + 1e-9):
                    raise MistrayError(
                        f"azimuth_cell_deg is {azimuth_cell_deg:g}; it must be at most the distance of two azimuths, "
                        f"{least:g} degrees"
                    )
                span = float(azimuth_cell_deg)
            elif span <= 0:
                raise MistrayError("azimuths_deg holds an azimuth twice; give each once")
        return cls(angles, edges, azimuths, span, np.eye(3) if rotation is None else np.asarray(rotation))

    @property
    def shape(self) -> tuple[int, int]:
        """Number of field angles and number of azimuths of the grid, n and m."""
        return len(self.field_deg), len(self.azimuths_deg)

    @property
    def solid_angle(self) -> np.ndarray:
        """Solid angle of one cell at each field angle, sr, (n,); it is the same at all azimuths."""
        low, high = np.radians(self.edges_deg).T
        # cos low - cos high, exact for narrow cells
        band = 2 * np.sin(0.5 * (high + low)) * np.sin(0.5 * (high - low))
        return np.asarray(np.radians(self.azimuth_cell_deg) * band)

    @property
    def mean_cosine(self) -> np.ndarray:
        """Mean of cos θ over the solid angle of a cell, θ being the field angle, for each field angle, (n,)."""
        # ∫ cos θ sin θ dθ/∫ sin θ dθ
        low, high = np.cos(np.radians(self.edges_deg)).T
        return np.asarray(0.5 * (low + high))

    @known_arguments
    def nearest(self, field_deg: float, azimuth_deg: float = 0.0) -> tuple[int, int]:
        """
        Return the indices, by field angle and by azimuth, of the cell that holds a direction.

        Parameters
        ----------
        field_deg : float
            Field angle, degrees; a negative one is at the opposite azimuth.
        azimuth_deg : float
            Azimuth, degrees.

        Raises
        ------
        MistrayError
            If no cell holds it.
        """
        # Field angle, then azimuth; both allow for rounding at the borders
        if field_deg < 0:
            field_deg, azimuth_deg = -field_deg, azimuth_deg + 180
        i = int(np.argmin(np.abs(self.field_deg - field_deg)))
        low, high = self.edges_deg[i]
        if not low - 1e-9 <= field_deg <= high + 1e-9:
            raise MistrayError(
                f"angle {field_deg:g}° is in no cell; the nearest is that of {self.field_deg[i]:g}°, "
                f"{low:g} … {high:g}°"
            )
        apart = _apart(self.azimuths_deg, azimuth_deg)
        j = int(np.argmin(apart))
        if apart[j] > self.azimuth_cell_deg / 2 + 1e-9:
            raise MistrayError(f"azimuth {azimuth_deg:g}° is in no cell; the nearest is {self.azimuths_deg[j]:g}°")
        return i, j

    def facts(self) -> dict[str, Any]:
        """Return field angles, azimuths and cell borders, degrees, and the axes of the grid, for a result file."""
        return {
            "angles_deg": self.field_deg.tolist(),
            "edges_deg": self.edges_deg.tolist(),
            "azimuths_deg": self.azimuths_deg.tolist(),
            "azimuth_cell_deg": self.azimuth_cell_deg,
            "rotation": np.asarray(self.rotation).tolist(),
        }

    @classmethod
    def from_facts(cls, facts: dict[str, Any]) -> DirectionGrid:
        """Create a grid from the dictionary that `facts` has returned."""
        keys = ("angles_deg", "edges_deg", "azimuths_deg", "rotation")
        angles, edges, azimuths, rotation = (np.asarray(facts[key], dtype=np.float64) for key in keys)
        return cls(angles, edges, azimuths, float(facts["azimuth_cell_deg"]), rotation)


def _apart(a: np.ndarray, b: np.ndarray | float) -> np.ndarray:
    """Return the angles between azimuths a and b, degrees, 0 … 180."""
    return np.asarray(np.abs((a - b + 180) % 360 - 180))


def _least_gap(azimuths: np.ndarray) -> float:
    """Return the smallest angle between two neighbouring azimuths, degrees: 0 for equal ones, 360 for a single one."""
    # The first azimuth again, one turn on, closes the circle
    around = np.sort(azimuths % 360)
    gap = float(np.diff(np.append(around, around[0] + 360)).min())
    return gap if gap > SAME_DEG else 0.0

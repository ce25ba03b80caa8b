"""Cells of directions in which a point source transmittance is averaged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, AZIMUTH_WIDTH_DEG, CELL_WIDTH_DEG, PST_FIELD_DEG
from mistray.renamed import renamed

CELL_DEG = 2.0  # width of a cell where the angles say nothing


@renamed(angles_deg="field_deg")
@dataclass(frozen=True, eq=False)
class DirectionGrid:
    """
    Cells of field angle and azimuth about an axis.

    A cell holds the directions of light whose field angle is within `edges_deg` and whose azimuth is within half of
    `azimuth_cell_deg` of the cell's own.

    Attributes
    ----------
    field_deg : (n,) float64
        Field angles, ascending, 0 … 90.
    edges_deg : (n, 2) float64
        Smallest and largest field angle of each cell; cells do not overlap.
    azimuths_deg : (m,) float64
        Azimuths from +y towards -x, as of a `collimated` source.
    azimuth_cell_deg : float
        Width of a cell in azimuth; 360: all azimuths together.
    rotation : (3, 3) float64
        Columns: x, y and z axis of the frame that the angles are measured in; light at 0° travels along z.

    Raises
    ------
    MistrayError
        For angles outside -90 … 90°, that do not ascend, or cells that overlap.
    """

    field_deg: np.ndarray
    edges_deg: np.ndarray
    azimuths_deg: np.ndarray
    azimuth_cell_deg: float
    rotation: np.ndarray

    @classmethod
    @renamed(angles_deg="field_deg")
    def of(
        cls,
        field_deg: float | Sequence[float] | np.ndarray,
        azimuths_deg: float | Sequence[float] | np.ndarray | None = None,
        cell_deg: float | None = None,
        azimuth_cell_deg: float | None = None,
        rotation: np.ndarray | None = None,
    ) -> DirectionGrid:
        """
        Cells around angles.

        Parameters
        ----------
        field_deg : float or sequence of float
            -90 … 90; a negative angle is the positive one at the opposite azimuth, as of a `collimated` source. Where
            there are others too, all cells have both azimuths.
        azimuths_deg : float or sequence of float, optional
            By default one cell holds all azimuths, and the sign does not matter.
        cell_deg : float, optional
            Width of the cells in field angle; by default 2°, or the smallest distance of two angles if that is less.
        azimuth_cell_deg : float, optional
            By default the smallest distance of two azimuths, at most 10° for a single one.
        rotation : (3, 3) float64, optional
        """
        given = np.array(PST_FIELD_DEG.check_each("field_deg", field_deg))
        if np.min(np.diff(given), initial=np.inf) <= 0:
            raise MistrayError("field_deg must ascend; sort the field angles and give each once")
        angles = np.unique(np.abs(given))
        apart = float(np.min(np.diff(angles), initial=np.inf))
        width = min(CELL_DEG, apart) if cell_deg is None else float(cell_deg)
        CELL_WIDTH_DEG.check("cell_deg", width)
        if width > apart * (1 + 1e-9):
            raise MistrayError(
                f"cell_deg is {width:g}; it must be at most the distance of two angles, {apart:g} degrees"
            )
        edges = np.clip(np.stack([angles - width / 2, angles + width / 2], axis=1), 0.0, 90.0)
        if azimuths_deg is None:
            if azimuth_cell_deg is not None:
                raise MistrayError("azimuth_cell_deg is given without azimuths_deg; give the azimuths too")
            azimuths, span = np.zeros(1), 360.0
        else:
            azimuths = np.array(AZIMUTH_DEG.check_each("azimuths_deg", azimuths_deg))
            span = min(10.0, _least_gap(azimuths)) if len(azimuths) == 1 else _least_gap(azimuths)
            if np.any(given < 0):
                opposite = azimuths + np.where(azimuths > 0, -180, 180)
                new = opposite[~np.isin(opposite % 360, azimuths % 360)]
                azimuths = np.append(azimuths, new) if np.any(given >= 0) else opposite
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
        """Number of field angles and of azimuths."""
        return len(self.field_deg), len(self.azimuths_deg)

    @property
    def solid_angle(self) -> np.ndarray:
        """(n,) solid angle of a cell, sr; the same at all azimuths."""
        low, high = np.radians(self.edges_deg).T
        # cos low - cos high, exact for narrow cells
        band = 2 * np.sin(0.5 * (high + low)) * np.sin(0.5 * (high - low))
        return np.asarray(np.radians(self.azimuth_cell_deg) * band)

    @property
    def mean_cosine(self) -> np.ndarray:
        """(n,) mean of cos θ over the cell."""
        low, high = np.cos(np.radians(self.edges_deg)).T
        return np.asarray(0.5 * (low + high))

    @renamed(angle_deg="field_deg")
    def nearest(self, field_deg: float, azimuth_deg: float = 0.0) -> tuple[int, int]:
        """
        Cell of a direction.

        Parameters
        ----------
        field_deg : float
            A negative one is at the opposite azimuth.
        azimuth_deg : float

        Raises
        ------
        MistrayError
            If no cell holds it.
        """
        if field_deg < 0:
            field_deg, azimuth_deg = -field_deg, azimuth_deg + 180
        i = int(np.argmin(np.abs(self.field_deg - field_deg)))
        low, high = self.edges_deg[i]
        if not low - 1e-9 <= field_deg <= high + 1e-9:
            raise MistrayError(
                f"angle {field_deg:g}° is in no cell; the nearest is that of {self.field_deg[i]:g}°, "
                f"{low:g} … {high:g}°"
            )
        apart = np.abs((self.azimuths_deg - azimuth_deg + 180) % 360 - 180)
        j = int(np.argmin(apart))
        if apart[j] > self.azimuth_cell_deg / 2 + 1e-9:
            raise MistrayError(f"azimuth {azimuth_deg:g}° is in no cell; the nearest is {self.azimuths_deg[j]:g}°")
        return i, j

    def facts(self) -> dict[str, Any]:
        """The grid as plain numbers, to be stored with a result."""
        return {
            "angles_deg": self.field_deg.tolist(),
            "edges_deg": self.edges_deg.tolist(),
            "azimuths_deg": self.azimuths_deg.tolist(),
            "azimuth_cell_deg": self.azimuth_cell_deg,
            "rotation": np.asarray(self.rotation).tolist(),
        }

    @classmethod
    def from_facts(cls, facts: dict[str, Any]) -> DirectionGrid:
        """The grid of stored numbers."""
        angles, edges, azimuths = (
            np.asarray(facts[key], dtype=np.float64) for key in ("angles_deg", "edges_deg", "azimuths_deg")
        )
        return cls(
            angles,
            edges,
            azimuths,
            azimuth_cell_deg=float(facts["azimuth_cell_deg"]),
            rotation=np.array(facts["rotation"]),
        )


def _least_gap(azimuths: np.ndarray) -> float:
    """The smallest distance of two azimuths, degrees; 360 of a single one."""
    around = np.sort(azimuths % 360)
    return float(np.diff(np.append(around, around[0] + 360)).min())

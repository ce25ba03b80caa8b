"""Measured BSDF of a surface whose scatter changes when it is rotated about its normal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.scatter.measured.samples import (
    ANGLE_ROUNDING_DEG,
    LARGEST_GAP,
    SYMMETRY_TOLERANCE,
    BsdfSamples,
    check_anisotropy,
    check_rotations,
    half_circle,
    one_rotation,
    uncovered,
)


@dataclass(frozen=True, eq=False)
class RotatedSamples:
    """
    BSDF, or BSDF times cos θs, of an anisotropic surface at several rotations of the sample.

    Attributes
    ----------
    rotation_deg : (d,) float64
        Azimuth of the sample's x axis from that of the specular direction, counterclockwise as seen from the side of
        incidence. Angles ascend over less than 360°. Scatter is interpolated between two of them, also between the last
        and the first. A single one holds for all rotations.
    tables : tuple of BsdfSamples
        One table for each rotation, all on one grid.

    Raises
    ------
    MistrayError
        If the angles do not ascend or do not cover a full turn, or the tables do not match them.
    """

    rotation_deg: np.ndarray
    tables: tuple[BsdfSamples, ...]

    def __post_init__(self) -> None:
        angles = self.rotation_deg
        if len(self.tables) != len(angles) or not self.tables:
            raise MistrayError(f"{len(self.tables)} BSDF tables for {len(angles)} sample rotations; give one for each")
        first = self.tables[0]
        for one in self.tables[1:]:
            grids = ("specular_deg", "azimuth_deg", "polar_deg")
            same = all(np.array_equal(getattr(one, key), getattr(first, key)) for key in grids)
            if not same or (one.frame, one.event) != (first.frame, first.event):
                raise MistrayError(f"{self.title}: the tables of two sample rotations have not one grid; resample them")
        _check_round(self.title, angles)

    @cached_property
    def _content(self) -> tuple[Any, ...]:
        return (self.rotation_deg.tobytes(), self.tables)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RotatedSamples) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)

    @property
    def name(self) -> str:
        """Name of the file or other name, for error messages."""
        return self.tables[0].name

    @property
    def title(self) -> str:
        """Kind and name of the table, for error messages."""
        return self.tables[0].title

    @property
    def event(self) -> str | None:
        """Measured event, "reflection" or "transmission"; None if the file does not state it."""
        return self.tables[0].event


def by_rotation(
    title: str,
    rotation_deg: np.ndarray,
    azimuth_deg: np.ndarray,
    values: np.ndarray,
    anisotropy: str,
    table_of: Callable[[np.ndarray, np.ndarray], BsdfSamples],
    x_axis_deg: float = 0.0,
) -> BsdfSamples | RotatedSamples:
    """
    Return the table of data at several rotations of a sample: isotropic, averaged or anisotropic.

    Parameters
    ----------
    title : str
        Name of the table, for error messages.
    rotation_deg : (d,) float64
        Rotations as in `RotatedSamples`. Data at both 0° and 360° are one position, and are averaged. Angles over half
        a circle, from 0° with or without 180°, belong to a surface that is symmetric under half a turn.
    azimuth_deg : (b,) float64
        Azimuths, ascending from 0 to 180°, to 360°, or to one step before 360°.
    values : (d, a, b, c) float64
        BSDF, or BSDF times cos θs, 1/sr.
    anisotropy : {"error", "mean", "keep"}
        Whether scatter that differs between rotations, or between the sides of the plane of incidence, is refused,
        averaged or kept.
    table_of : callable
        Function that makes the table of one rotation from azimuths and values (a, b, c).
    x_axis_deg : float
        Azimuth of the sample's x axis at rotation 0, degrees.

    Returns
    -------
    BsdfSamples or RotatedSamples
        `RotatedSamples` only if there are such differences and they are kept.

    Raises
    ------
    MistrayError
        For the reasons of `one_rotation`, `half_circle`, `whole_circle` and `RotatedSamples`.
    """
    check_anisotropy(title, anisotropy)

    def isotropic(choice: str) -> BsdfSamples:
        return table_of(*half_circle(title, azimuth_deg, one_rotation(title, rotation_deg, values, choice), choice))

    if anisotropy != "keep":
        return isotropic(anisotropy)
    try:
        return isotropic("error")
    except MistrayError:
        pass  # anisotropic, or wrong: then the following says so
    azimuth, values = whole_circle(title, azimuth_deg, values)
    angles, values = _one_turn(title, rotation_deg, values)
    _check_round(title, angles)
    angles = np.mod(angles + x_axis_deg, 360.0)
    order = np.argsort(angles)
    return RotatedSamples(angles[order], tuple(table_of(azimuth, values[k]) for k in order))


def whole_circle(title: str, azimuth_deg: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return azimuths 0 … 360° and their values, (…, b, c). A half circle is mirrored, an open full circle closed.

    Raises
    ------
    MistrayError
        If the azimuths cover neither a half nor a full circle.
    """
    last = float(azimuth_deg[-1])
    if abs(last - 180) <= ANGLE_ROUNDING_DEG:
        mirrored = np.concatenate([azimuth_deg, 360 - azimuth_deg[-2::-1]])
        return mirrored, np.concatenate([values, values[..., -2::-1, :]], axis=-2)
    if abs(last - 360) <= ANGLE_ROUNDING_DEG:
        return azimuth_deg, values
    if last < 180 or 360 - last > LARGEST_GAP * float(np.max(np.diff(azimuth_deg))) + ANGLE_ROUNDING_DEG:
        raise uncovered(title, azimuth_deg)
    return np.append(azimuth_deg, 360.0), np.concatenate([values, values[..., :1, :]], axis=-2)


def _one_turn(title: str, rotation_deg: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return ascending sample rotations over one turn, degrees, (d,), each only once, and the data at them, (d, …).

    Rotations over half a turn are repeated with 180° added. Raise `MistrayError` if the data at 0° and 180° differ and
    there are none beyond.
    """
    span = float(rotation_deg[-1] - rotation_deg[0])
    check_rotations(title, rotation_deg)
    step = float(np.max(np.diff(rotation_deg))) if len(rotation_deg) > 1 else 360.0
    for turn in (360.0, 180.0):
        if abs(span - turn) <= ANGLE_ROUNDING_DEG:
            difference = float(np.max(np.abs(values[-1] - values[0])))
            if turn < 360 and difference > SYMMETRY_TOLERANCE * float(np.max(values)):
                raise MistrayError(
                    f"{title}: sample rotations {rotation_deg[0]:g} and {rotation_deg[-1]:g}° differ by "
                    f"{difference:.3g} 1/sr, and there are none beyond; give all rotations up to 360°"
                )
            ends = 0.5 * (values[:1] + values[-1:])
            rotation_deg, values = rotation_deg[:-1], np.concatenate([ends, values[1:-1]])
            span = float(rotation_deg[-1] - rotation_deg[0])
    if len(rotation_deg) > 1 and span < 180 - ANGLE_ROUNDING_DEG and 180 - span <= LARGEST_GAP * step:
        rotation_deg, values = np.concatenate([rotation_deg, rotation_deg + 180]), np.concatenate([values, values])
    return rotation_deg, values


def _check_round(title: str, angles: np.ndarray) -> None:
    """Raise `MistrayError` if sample rotations, degrees, do not ascend within a turn, or leave a part of it open."""
    check_rotations(title, angles, 360 - ANGLE_ROUNDING_DEG)
    left = 360 - (angles[-1] - angles[0])
    if len(angles) > 1 and left > LARGEST_GAP * float(np.max(np.diff(angles))) + ANGLE_ROUNDING_DEG:
        raise MistrayError(
            f"{title}: sample rotations from {angles[0]:g} to {angles[-1]:g}° leave {left:g}° open; complete the "
            "circle, as the symmetry of the surface allows, or set anisotropy to 'mean'"
        )

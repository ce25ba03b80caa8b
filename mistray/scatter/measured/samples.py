"""Measured BSDF: values on a grid of directions, for several directions of incidence."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from mistray.errors import MistrayError

FRAMES = ("specular", "normal")
ANGLE_ROUNDING_DEG = 1e-6
SYMMETRY_TOLERANCE = 1e-3  # of the largest value, between the two sides of the plane of incidence
RESOLVED = 0.03  # relative change of a total by half of the angles up to which a table resolves the scatter
FINE_DEG = 1.0  # longest step of the integral over the hemisphere, of two nodes
ANISOTROPY = ("error", "mean", "keep")
BEYOND = ("error", "hold", "zero")
LARGEST_GAP = 1.5  # of the gap left open, in units of the largest step, for angles that cover a full turn
# A direction below this cosine has no BSDF of its own: there f cos θs, which instruments measure, is 0/0 for f
HORIZON = 1e-6


@dataclass(frozen=True, eq=False)
class BsdfSamples:
    """
    BSDF, or BSDF times cos θs, of a surface at one rotation over the directions of incidence and scatter.

    Directions have a polar angle and an azimuth. In the frame "normal" the polar angle is θs, and azimuth 0 is that of
    the specular direction. In the frame "specular" the polar angle is counted from the specular direction, and azimuth
    0 points from there towards the normal. Azimuths run counterclockwise as seen from the side of incidence.

    Attributes
    ----------
    name : str
        Name of the file or other name, for error messages.
    frame : {"specular", "normal"}
        Frame of the polar angles and azimuths, see above.
    specular_deg : (a,) float64
        Angles of the specular direction, reflected or refracted, with the normal; ascending, 0 … 90°.
    azimuth_deg : (b,) float64
        Azimuths, ascending: 0 … 360°, or 0 … 180° if the scatter is symmetric about the plane of incidence.
    polar_deg : (c,) float64
        Polar angles, ascending from 0.
    values : (a, b, c) float64
        BSDF, or BSDF times cos θs, 1/sr.
    event : {"reflection", "transmission"}, optional
        Event that was measured, if the file declares it.
    stated : tuple of float, optional
        Total integrated scatter that the file states, and where, degrees: angle of the specular direction with the
        normal, and rotation of the sample.

    Raises
    ------
    MistrayError
        If the frame is unknown; a grid does not ascend, or is out of range; an azimuth or the polar angle 0 is missing;
        or values do not fit the grid, or are NaN, negative or infinite.
    """

    name: str
    frame: str
    specular_deg: np.ndarray
    azimuth_deg: np.ndarray
    polar_deg: np.ndarray
    values: np.ndarray
    event: str | None = None
    stated: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.frame not in FRAMES:
            raise MistrayError(f"{self.title}: frame '{self.frame}'; use {' or '.join(map(repr, FRAMES))}")
        grids = (
            ("incidence", self.specular_deg, 90.0),
            ("azimuth", self.azimuth_deg, 360.0),
            ("polar", self.polar_deg, 180.0),
        )
        for key, angles, most in grids:
            if np.any(np.diff(angles) <= 0):
                raise MistrayError(f"{self.title}: the {key} angles do not ascend; sort them, each once")
            if angles[0] < 0 or angles[-1] > most + ANGLE_ROUNDING_DEG:
                raise MistrayError(
                    f"{self.title}: {key} angles from {angles[0]:g} to {angles[-1]:g}°; they lie in 0 … {most:g}°"
                )
        if self.specular_deg[-1] > 90 - ANGLE_ROUNDING_DEG:
            raise MistrayError(f"{self.title}: light at 90° does not meet the surface; leave this angle out")
        if self.values.shape != (len(self.specular_deg), len(self.azimuth_deg), len(self.polar_deg)):
            raise MistrayError(
                f"{self.title}: {self.values.size} values for {len(self.specular_deg)} × {len(self.azimuth_deg)} × "
                f"{len(self.polar_deg)} angles; give one for each combination"
            )
        bad = ~(np.isfinite(self.values) & (self.values >= 0))
        if np.any(bad):
            i, j, k = (int(index[0]) for index in np.nonzero(bad))
            raise MistrayError(
                f"{self.title}: {self.values[i, j, k]:g} at incidence {self.specular_deg[i]:g}°, azimuth "
                f"{self.azimuth_deg[j]:g}°, polar angle {self.polar_deg[k]:g}°; a BSDF is finite and not negative"
            )
        needed = 360.0 if self.whole else 180.0
        if self.azimuth_deg[0] > ANGLE_ROUNDING_DEG or self.azimuth_deg[-1] < needed - ANGLE_ROUNDING_DEG:
            raise uncovered(self.title, self.azimuth_deg)
        if self.polar_deg[0] > ANGLE_ROUNDING_DEG:
            raise MistrayError(
                f"{self.title}: the polar angles begin at {self.polar_deg[0]:g}°; give the value at 0° that holds to "
                "the first of them"
            )

    @cached_property
    def _content(self) -> tuple[Any, ...]:
        arrays = (self.specular_deg, self.azimuth_deg, self.polar_deg, self.values)
        return (self.name, self.frame, self.event, self.stated, *(array.tobytes() for array in arrays))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, BsdfSamples) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)

    @property
    def title(self) -> str:
        """Kind and name of the table, for error messages."""
        return f"BSDF table '{self.name}'"

    @property
    def tables(self) -> tuple[BsdfSamples, ...]:
        """Tuple with this table alone, as `RotatedSamples.tables` holds one table per rotation."""
        return (self,)

    @property
    def rotation_deg(self) -> np.ndarray:
        """Rotation of the sample in this only table, degrees, (1,): 0."""
        return np.zeros(1)

    @property
    def whole(self) -> bool:
        """True if the azimuths cover a full turn, so that both sides of the plane of incidence may differ."""
        return bool(self.azimuth_deg[-1] > 180 + ANGLE_ROUNDING_DEG)

    @property
    def last_needed_deg(self) -> float:
        """Polar angle, degrees, up to which the grid must go to cover the hemisphere at every incidence."""
        return 90.0 if self.frame == "normal" else 90.0 + float(self.specular_deg[-1])

    def check_cover(self) -> None:
        """
        Check that the polar angles of the table cover the hemisphere.

        Raises
        ------
        MistrayError
            If the polar angles end too early; the message names the last angle and the one needed.
        """
        if self.polar_deg[-1] < self.last_needed_deg - ANGLE_ROUNDING_DEG:
            raise MistrayError(
                f"{self.title}: its polar angles end at {self.polar_deg[-1]:g}°, but at incidence "
                f"{self.specular_deg[-1]:g}° the hemisphere reaches to {self.last_needed_deg:g}°; complete the table, "
                "or set beyond to 'hold' (the last value) or 'zero'"
            )

    def directions(self) -> np.ndarray:
        """
        Return the unit vectors of the grid's directions, (a, b, c, 3).

        x points to the specular side of the plane of incidence. z points along the normal: for reflected light on the
        side of incidence, for transmitted light on the other side. x, y and the normal on the side of incidence are
        right-handed.
        """
        return self.directions_at(
            self.specular_deg[:, None, None], self.azimuth_deg[:, None], self.polar_deg[None, None, :]
        )

    def directions_at(self, specular_deg: np.ndarray, azimuth_deg: np.ndarray, polar_deg: np.ndarray) -> np.ndarray:
        """
        Return unit vectors, (…, 3), of polar angle and azimuth in the table's frame, at incidence `specular_deg`.

        All angles are in degrees and broadcast together.
        """
        phi, alpha, theta = (np.radians(angle) for angle in (azimuth_deg, polar_deg, specular_deg))
        y = np.sin(alpha) * np.sin(phi)
        along, towards = np.cos(alpha), np.sin(alpha) * np.cos(phi)
        if self.frame == "normal":
            parts = np.broadcast_arrays(towards, y, along, theta)[:3]
        else:
            x = along * np.sin(theta) - towards * np.cos(theta)
            parts = np.broadcast_arrays(x, -y, along * np.cos(theta) + towards * np.sin(theta))
        return np.stack(parts, axis=-1)

    def angles_of(self, specular_deg: float, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return polar angles and azimuths, degrees, (…), of unit vectors, (…, 3), at the incidence `specular_deg`."""
        x, y, z = np.moveaxis(directions, -1, 0)
        if self.frame == "specular":
            sin, cos = np.sin(np.radians(specular_deg)), np.cos(np.radians(specular_deg))
            x, y, z = z * sin - x * cos, -y, x * sin + z * cos
        azimuth = np.degrees(np.arctan2(y if self.whole else np.abs(y), x))
        return np.degrees(np.arctan2(np.hypot(x, y), z)), np.where(azimuth < 0, azimuth + 360, azimuth)

    def above(self, cosine_corrected: bool) -> np.ndarray:
        """Return a mask of grid directions above the horizon, (a, b, c); without cosine correction those on it, too."""
        return np.asarray(self.directions()[..., 2] > (HORIZON if cosine_corrected else -HORIZON))

    def bsdf(self, cosine_corrected: bool) -> np.ndarray:
        """
        Return the BSDF on the grid, 1/sr; values below the horizon have no meaning.

        Parameters
        ----------
        cosine_corrected : bool
            Whether the values are BSDF times cos θs.

        Returns
        -------
        (a, b, c) float64
            BSDF, 1/sr.
        """
        if not cosine_corrected:
            return self.values
        return np.asarray(self.values / np.maximum(self.directions()[..., 2], HORIZON))

    def held(self, grid: np.ndarray, above: np.ndarray) -> np.ndarray:
        """
        Return values on the grid, (a, b, c), with those outside the mask `above` replaced.

        The value at the last polar angle within the mask, of the same incidence and azimuth, takes their place.
        """
        last = np.maximum.accumulate(np.where(above, np.arange(len(self.polar_deg)), 0), axis=-1)
        return np.take_along_axis(grid, last, axis=-1)

    def at(self, grid: np.ndarray, index: int, directions: np.ndarray, beyond: str = "hold") -> np.ndarray:
        """
        Return the values of a function on the grid at directions, (…), bilinear in polar angle and azimuth.

        Parameters
        ----------
        grid : (a, b, c) float64
            Values of the function.
        index : int
            Index of the angle of incidence in `specular_deg`.
        directions : (…, 3) float64
            Unit vectors.
        beyond : {"hold", "zero", "error"}
            Value past the last polar angle: the last value, or 0; "error" does not occur after `check_cover`.
        """
        polar, azimuth = self.angles_of(float(self.specular_deg[index]), directions)
        j, v = _cell(self.azimuth_deg, azimuth)
        k, u = _cell(self.polar_deg, polar)
        plane = grid[index]
        values = (1 - v) * ((1 - u) * plane[j, k] + u * plane[j, k + 1])
        values += v * ((1 - u) * plane[j + 1, k] + u * plane[j + 1, k + 1])
        if beyond == "zero":
            values = np.where(polar > self.polar_deg[-1] + ANGLE_ROUNDING_DEG, 0.0, values)
        return np.asarray(values)

    def totals(self, cosine_corrected: bool = False, beyond: str = "hold") -> np.ndarray:
        """
        Return the total integrated scatter ∫ f cos θs dΩ, dimensionless, at each angle of incidence, (a,).

        `cosine_corrected` is that of `bsdf`, and `beyond` that of `at`.
        """
        polar, steps = _quadrature(self.polar_deg, 90.0 if self.frame == "normal" else 180.0)
        azimuth, turns = _quadrature(self.azimuth_deg, 360.0 if self.whole else 180.0)
        sides = 1 if self.whole else 2
        solid_angle = turns[:, None] * steps * np.sin(np.radians(polar))
        grid = self.held(self.bsdf(cosine_corrected), self.above(cosine_corrected))
        found = []
        for index, specular in enumerate(self.specular_deg):
            directions = self.directions_at(specular, azimuth[:, None], polar)
            values = self.at(grid, index, directions, beyond) * np.maximum(0.0, directions[..., 2])
            found.append(sides * float(np.sum(values * solid_angle)))
        return np.array(found)

    def resolved(self, beyond: str = "hold") -> bool:
        """
        True if a table of the BSDF resolves the scatter at all incidences.

        It does if every second polar angle and azimuth gives the `totals`, with the same `beyond`, within `RESOLVED`.
        """
        counts = self.values.shape[1:]
        if min(counts) < 3:
            return False
        azimuths, polars = (np.unique([*range(0, count, 2), count - 1]) for count in counts)
        values = self.values[:, azimuths[:, None], polars]
        half = replace(self, azimuth_deg=self.azimuth_deg[azimuths], polar_deg=self.polar_deg[polars], values=values)
        whole, coarse = (table.totals(beyond=beyond) for table in (self, half))
        return bool(np.all(np.abs(coarse - whole) <= RESOLVED * whole))

    def finer(self, step_deg: float) -> BsdfSamples:
        """
        Return the table with azimuths at most about `step_deg`, degrees, apart; unchanged if it has no wider steps.

        New values follow a monotone cubic over the azimuth, even about the plane of incidence where one side was
        measured.
        """
        parts = np.maximum(np.ceil(np.diff(self.azimuth_deg) / step_deg - 1e-6).astype(int), 1)
        if np.all(parts == 1):
            return self
        from scipy.interpolate import PchipInterpolator  # slow to import

        azimuth = np.interp(np.arange(parts.sum() + 1), np.append(0, np.cumsum(parts)), self.azimuth_deg)
        nodes, values = self.azimuth_deg, self.values
        if self.whole:
            nodes = np.concatenate([nodes[:-1] - 360, nodes, nodes[1:] + 360])
            values = np.concatenate([values[:, :-1], values, values[:, 1:]], axis=1)
        else:
            nodes = np.concatenate([-nodes[:0:-1], nodes, 360 - nodes[-2::-1]])
            values = np.concatenate([values[:, :0:-1], values, values[:, -2::-1]], axis=1)
        return replace(self, azimuth_deg=azimuth, values=PchipInterpolator(nodes, values, axis=1)(azimuth))


def _quadrature(nodes_deg: np.ndarray, last_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Return angles, degrees, and weights, rad, of an integral from 0 to `last_deg`; no step passes over a node."""
    even = np.linspace(0, last_deg, int(last_deg / FINE_DEG) + 1)
    edges = np.unique(np.concatenate([even, nodes_deg[nodes_deg < last_deg]]))
    half, middle = 0.5 * np.diff(edges)[:, None], 0.5 * (edges[1:] + edges[:-1])[:, None]
    angles = middle + half * np.array([-1, 1]) / np.sqrt(3)
    return angles.ravel(), np.radians(np.repeat(half.ravel(), 2))


def uncovered(title: str, azimuth_deg: np.ndarray) -> MistrayError:
    """Return the error for azimuths, degrees, that cover neither a half nor a full circle."""
    return MistrayError(
        f"{title}: azimuths from {azimuth_deg[0]:g} to {azimuth_deg[-1]:g}° do not cover the hemisphere; give "
        "0 … 180°, or 0 … 360°"
    )


def check_rotations(title: str, rotation_deg: np.ndarray, most: float = 360 + ANGLE_ROUNDING_DEG) -> None:
    """Raise `MistrayError` if rotations of a sample, degrees, do not ascend, or span more than `most`, degrees."""
    if np.any(np.diff(rotation_deg) <= 0) or rotation_deg[-1] - rotation_deg[0] > most:
        raise MistrayError(f"{title}: the sample rotations do not ascend within 360°; sort them, each once")


def check_anisotropy(title: str, anisotropy: str) -> None:
    """Raise `MistrayError` if `anisotropy` is not one of `ANISOTROPY`."""
    if anisotropy not in ANISOTROPY:
        raise MistrayError(f"{title}: anisotropy is '{anisotropy}'; use {' or '.join(map(repr, ANISOTROPY))}")


def one_rotation(title: str, rotation_deg: np.ndarray, values: np.ndarray, anisotropy: str = "error") -> np.ndarray:
    """
    Return data of several sample rotations reduced to one, as for an isotropic surface.

    Parameters
    ----------
    title : str
        Name of the table, for error messages.
    rotation_deg : (d,) float64
        Rotations, ascending over a full turn, with or without 360° in addition to 0°, or over a part that represents
        it.
    values : (d, …) float64
        Data at each rotation.
    anisotropy : {"error", "mean"}
        Whether different rotations are refused, or replaced by their mean over the angle.

    Returns
    -------
    (…) float64
        Data of one rotation.

    Raises
    ------
    MistrayError
        If the angles do not ascend, or rotations differ by more than 0.1 % of the largest value and are not averaged.
    """
    check_anisotropy(title, anisotropy)
    check_rotations(title, rotation_deg)
    if anisotropy == "error":
        difference = np.max(np.abs(values - values[0]), axis=tuple(range(1, values.ndim)))
        worst = int(np.argmax(difference))
        if difference[worst] > SYMMETRY_TOLERANCE * float(np.max(values)):
            raise MistrayError(
                f"{title}: sample rotations {rotation_deg[0]:g} and {rotation_deg[worst]:g}° differ by "
                f"{difference[worst]:.3g} 1/sr; anisotropic: set anisotropy to 'keep', or set anisotropy to 'mean'"
            )
        return np.asarray(values[0])
    gaps = np.diff(rotation_deg)
    if not len(gaps):
        return np.asarray(values[0])
    weight = np.zeros(len(rotation_deg))
    weight[:-1] += gaps
    weight[1:] += gaps
    # All round, or half round a surface that half a turn does not change: the last one is a neighbour of the first
    lefts = [turn - (rotation_deg[-1] - rotation_deg[0]) for turn in (360.0, 180.0)]
    weight[[0, -1]] += next((left for left in lefts if 0 <= left <= LARGEST_GAP * float(np.max(gaps))), 0.0)
    return np.asarray(np.tensordot(weight / weight.sum(), values, axes=1))


def half_circle(
    title: str, azimuth_deg: np.ndarray, values: np.ndarray, anisotropy: str = "error"
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return azimuths and data reduced to 0 … 180°; those that end there are returned as they are.

    Parameters
    ----------
    title : str
        Name of the table, for error messages.
    azimuth_deg : (b,) float64
        Azimuths, ascending from 0.
    values : (a, b, c) float64
        Data at the azimuths.
    anisotropy : {"error", "mean"}
        Whether different sides of the plane of incidence are refused, or replaced by their mean.

    Raises
    ------
    MistrayError
        If the two sides of the plane of incidence differ by more than 0.1 % of the largest value, which is anisotropic
        scatter, and are not averaged; or if an azimuth has no mirror image.
    """
    check_anisotropy(title, anisotropy)
    if azimuth_deg[-1] <= 180 + ANGLE_ROUNDING_DEG:
        return azimuth_deg, values
    first = azimuth_deg <= 180 + ANGLE_ROUNDING_DEG
    half = azimuth_deg[first]
    over, side, means = 360 - azimuth_deg[::-1], values[:, ::-1], values[:, first].copy()
    for j, angle in enumerate(half):
        near = np.abs(over - angle) < ANGLE_ROUNDING_DEG
        if not np.any(near):
            if angle > ANGLE_ROUNDING_DEG or azimuth_deg[0] > ANGLE_ROUNDING_DEG:
                raise MistrayError(f"{title}: azimuth {angle:g}° has no mirror image {360 - angle:g}°; give both")
            continue
        if anisotropy == "mean":
            means[:, j] = 0.5 * (values[:, j] + side[:, near][:, 0])
            continue
        difference = float(np.max(np.abs(side[:, near][:, 0] - values[:, j])))
        if difference > SYMMETRY_TOLERANCE * float(np.max(values)):
            raise MistrayError(
                f"{title}: azimuths {angle:g} and {360 - angle:g}° differ by {difference:.3g} 1/sr; "
                "anisotropic scatter needs anisotropy 'keep', or set anisotropy to 'mean' for the mean of both sides"
            )
    return half, means


def _cell(nodes: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the index of the interval of ascending `nodes` that holds each x, and the place of x in it, 0 … 1.

    A single node is both ends of the interval with the index -1, and the place in it is 0.
    """
    low = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    width = nodes[low + 1] - nodes[low]
    return low, np.clip(np.divide(x - nodes[low], width, out=np.zeros(np.shape(x)), where=width > 0), 0, 1)

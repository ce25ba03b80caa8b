"""Freeform surfaces with any sag and any outline; their normals point to +z."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.physics.geometry.outline import Outline, OutlineFigure
from mistray.surfaces.families.freeform_crossing import first_crossing
from mistray.surfaces.families.freeform_sag import LocalSag
from mistray.surfaces.families.outline_edge import FreeformFamily
from mistray.surfaces.families.sampled_crossings import sampled_crossings
from mistray.surfaces.gradient_columns import HIGH, OWN
from mistray.surfaces.surface import ENDS, Opening, TracedSurface
from mistray.surfaces.upload import upload

if TYPE_CHECKING:
    from mistray.surfaces.crossings import AxisRay

GRID = 101  # samples in each direction of an outline, at which sags are measured
STEEPER = 1.02  # factor from the steepest sampled slope to the bound of the slope
MARGIN = 1e-3  # margin of bounds, in units of the extent
SLAB = 2e-3  # margin of the kernel's slab on each side, in units of the size
SAMPLES = 96  # samples of a line, between which the host looks for crossings
MOST_CROSSINGS = 6
PARTS, ROWS = 16, 64  # subdivisions of a patch along x and along y, for its area


@dataclass(kw_only=True)
class Freeform(TracedSurface):
    """
    Freeform surface z = sag(x, y) within an outline; F = z - sag.

    Attributes
    ----------
    local : LocalSag
        Sag in a frame about the middle of the outline.
    outline : Outline
        Outline in the frame of the sag.
    half : (2,) float
        Half width and half height of the outline's box, mm.
    slope : float
        Upper bound of the surface's slope |dz/dr|.
    outermost : float
        Upper bound of the distance of the surface's points from the middle, mm.
    way : int
        Only light that travels along the axis in this direction, +1 or -1, meets the surface; 0: all light does.
    """

    local: LocalSag
    outline: Outline
    half: tuple[float, float]
    slope: float
    outermost: float
    way: int = 0

    @classmethod
    def of(
        cls, local: LocalSag, outline: Outline, half: tuple[float, float], wall: bool = False, way: int = 0
    ) -> Freeform:
        """
        Create the freeform from a sag and an outline, both in a frame about the middle of the outline.

        The arguments are attributes of the same names; `z_range`, `slope` and `outermost` follow from them.
        """
        x, y = outline.sample(GRID)
        z, across, along = local.sag.evaluate(x, y, local.numbers)
        steepest = float(np.max(np.hypot(across, along)))
        if local.sag.grid is not None:  # which may have more cells than there are samples
            steepest += abs(local.numbers["grid_scale"]) * local.sag.grid.grid.steepest
        beside = steepest * 2 * max(half) / GRID  # between the points of the grid
        beside += MARGIN * max(float(np.ptp(z)), 1e-6 * max(half))
        return cls(
            sign=1.0,
            z_range=(float(z.min()) - beside, float(z.max()) + beside),
            wall=wall,
            local=local,
            outline=outline,
            half=half,
            slope=STEEPER * steepest,
            outermost=_reach(outline, half),
            way=way,
        )

    # ---- facts

    @cached_property
    def family(self) -> FreeformFamily:
        """Family of the surface: the forms of its sag and outline, which determine the kernel's code."""
        return FreeformFamily.of(self.local.sag, self.outline)

    @property
    def values(self) -> dict[str, float]:
        """Parameter values of the surface's sag and outline, by name."""
        return {**self.local.numbers, **self.outline.numbers()}

    @property
    def size(self) -> float:
        return self.outermost

    @property
    def least_radius(self) -> float:
        return 0.0

    @property
    def sort(self) -> tuple[object, ...]:
        return type(self), self.local.sag, self.outline.form, self.way

    @property
    def columns(self) -> dict[str, float]:
        values = self.values
        return dict(zip(OWN, (values[name] for name in self.family.numbers), strict=False))

    @property
    def opening(self) -> Opening:
        """
        Clear aperture of the freeform as a flat figure: the bounding box of its outline.

        If the outline is a circle from which other figures are only cut, it is that circle.
        """
        if self._round:
            return Opening(0.0, (self.size, self.size))
        return Opening(0.0, self.half, rectangular=True)

    @property
    def _round(self) -> bool:
        first = self.outline.figures[0]
        return first.kind == "circle" and all(figure.sign == "-" for figure in self.outline.figures[1:])

    @property
    def detector_half(self) -> tuple[float, float]:
        return self.half

    # ---- rays on the host

    def crossings(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        reach = 1.01 * np.hypot(self.size, np.abs(self.z_range).max())
        # Beyond the box of the outline the sag goes on as at its sides
        with np.errstate(divide="ignore", invalid="ignore"):
            sides = np.concatenate([(side * np.array(self.half) - o[:, :2]) / d[:, :2] for side in (-1, 1)], axis=1)
        met = d[:, 2] * self.way >= 0
        return sampled_crossings(self.residual, o, d, reach, SAMPLES, MOST_CROSSINGS, met, sides)

    def inside(self, q: np.ndarray) -> np.ndarray:
        return np.asarray(self.outline.contains(q[:, 0], q[:, 1]))

    def _sag(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x, y = np.clip(x, -self.half[0], self.half[0]), np.clip(y, -self.half[1], self.half[1])
        z, across, along = self.local.sag.evaluate(x, y, self.values)
        return tuple(np.broadcast_to(v, np.shape(x)) for v in (z, across, along))  # type: ignore[return-value]

    def residual(self, q: np.ndarray) -> np.ndarray:
        return np.asarray(q[:, 2] - self._sag(q[:, 0], q[:, 1])[0])

    def gradient(self, q: np.ndarray) -> np.ndarray:
        _, across, along = self._sag(q[:, 0], q[:, 1])
        return 0.5 * np.stack([-across, -along, np.ones(len(q))], axis=1)

    # ---- points and areas

    @cached_property
    def _cells(self) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 2) of a grid over the outline, mm, and cumulative fractions of the surface's area at them."""
        x, y = self.outline.sample(2 * GRID)
        weight = np.cumsum(self._stretch(x, y))
        return np.stack([x, y], axis=1), weight / weight[-1]

    def _stretch(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the surface's area over its projection along the axis, at points x, y, mm, in their shape."""
        _, across, along = self._sag(x, y)
        return np.asarray(np.sqrt(1 + across**2 + along**2))

    def points(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        places, share = self._cells
        number = np.minimum(np.searchsorted(share, u), len(share) - 1)
        before = np.where(number, share[number - 1], 0.0)
        offset = np.stack([(u - before) / (share[number] - before), v], axis=1) - 0.5
        step = np.array(self.half) / GRID  # of a cell
        moved = places[number] + offset * step
        inside = self.outline.contains(moved[:, 0], moved[:, 1])[:, None]
        x, y = np.where(inside, moved, places[number]).T
        return np.stack([x, y, self._sag(x, y)[0]], axis=1)

    def proposals(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y = self.half[0] * (2 * u - 1), self.half[1] * (2 * v - 1)
        whole = 4 * self.half[0] * self.half[1]
        area = np.where(self.outline.contains(x, y), whole * self._stretch(x, y), 0.0)
        return np.stack([x, y, self._sag(x, y)[0]], axis=1), area

    def unit_square(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 0.5 + 0.5 * q[:, 0] / self.half[0], 0.5 + 0.5 * q[:, 1] / self.half[1]

    def areas(self, first: int, second: int) -> np.ndarray:
        width, height = self.half
        y = height * (2 * (np.arange(second * ROWS) + 0.5) / (second * ROWS) - 1)
        steps = np.tile(np.linspace(-width, width, first * PARTS + 1), (len(y), 1))
        borders = np.concatenate([figure.crossed(y) for figure in self.outline.figures], axis=1)
        x = np.sort(np.concatenate([steps, np.clip(np.nan_to_num(borders), -width, width)], axis=1), axis=1)
        middle, row = 0.5 * (x[:, 1:] + x[:, :-1]), np.broadcast_to(y[:, None], (len(y), x.shape[1] - 1))
        area = np.diff(x, axis=1) * np.where(self.outline.contains(middle, row), self._stretch(middle, row), 0.0)
        column = np.clip((first * (0.5 + 0.5 * middle / width)).astype(int), 0, first - 1)
        found = np.zeros((first, second))
        np.add.at(found, (column, np.repeat(np.arange(second), ROWS)[:, None]), area)
        return found * 2 * height / len(y)

    def hull(self, polygon: np.ndarray) -> np.ndarray:
        corners = np.array([[x, y] for x in (-1.0, 1.0) for y in (-1.0, 1.0)]) * self.half
        flat = self.size * polygon if self._round else corners
        return np.concatenate([np.column_stack([flat, np.full(len(flat), z)]) for z in self.z_range])

    # ---- rims

    circular_rims = False

    @property
    def rim_coordinate(self) -> int:
        return ENDS

    @property
    def rim_sizes(self) -> dict[int, float]:
        # In the family's coordinate the surface ends at 0
        return {HIGH: min(_least_half(figure) for figure in self.outline.figures if figure.sign != "-")}

    @property
    def reach(self) -> tuple[float, float]:
        return -2 * self.size, 0.0

    def rim_place(self, q: np.ndarray) -> np.ndarray:
        x, y = (upload(mi.Float64, column) for column in q.T[:2])
        return np.array(self.family.coordinate(x, y, None, self.values), dtype=np.float64)

    def rim_point(self, rim: int) -> np.ndarray:
        raise NotImplementedError("an outline has no circular rims")

    def tangent(self, point: np.ndarray) -> np.ndarray:
        raise NotImplementedError("an outline has no profile")

    # ---- kernel

    def numbers(self) -> dict[str, mi.Float]:
        return {name: dr.opaque(mi.Float, value) for name, value in self.kernel_values().items()}

    def kernel_values(self) -> Mapping[str, Any]:
        return {
            **self.values,
            **self.outline.grown(self.overlap).numbers(),
            **self.outline.turns(),
            "z": self.z,
            # Thicker than the rounding of a ray that comes from afar
            "z_low": self.z_range[0] - SLAB * self.size,
            "z_high": self.z_range[1] + SLAB * self.size,
            "size": self.size,
            "size2": (self.size + self.overlap) ** 2,
            "slope2": self.slope**2,
            "self_hit": self.self_hit,
            "half_x": self.half[0] + self.overlap,
            "half_y": self.half[1] + self.overlap,
        }

    def crossing(self, ray: AxisRay, numbers: dict[str, mi.Float], own: mi.Bool) -> mi.Float:
        return first_crossing(ray, self, numbers, own)


def _least_half(figure: OutlineFigure) -> float:
    """Return half the smallest width of an outline figure, mm; for a polygon, a quarter of its box's shorter side."""
    if figure.kind == "polygon":
        return 0.25 * float(np.ptp(figure.corners, axis=0).min())
    return min(figure.sizes)


def _reach(outline: Outline, half: tuple[float, float]) -> float:
    """Return an upper bound, mm, of the distance of an outline's points from the middle of its bounding box."""
    box = float(np.hypot(*half))
    first, *others = outline.figures
    if first.sign == "-":
        return box
    return min(box, max(figure.reach for figure in (first, *(one for one in others if one.sign == "+"))))

"""Pixel grid of the detector, and the images that light forms on it, with their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.recorders.recorder import Memory, Recorder, Visit
from mistray.recorders.sampled import Numbers, Sampled, error_rays, few_rays
from mistray.settings import BATCHES
from mistray.surfaces.upload import opaque

# Memory of the images of a detector by groups of batches, and the fewest groups
FILM_BYTES, LEAST_GROUPS = 1 << 24, 8
# Images after those of the groups: number of rays, and sums of the squares and fourth powers of their flux
WEIGHTS = 3
NEIGHBOURS = 5  # side in pixels of the square over which the moments of the weights are pooled, see `error_rays`


@dataclass
class Film:
    """
    Pixel grid of a detector, with the filter and the groups of batches by which hits are summed.

    Attributes
    ----------
    width, height : int
        Number of columns and of rows of pixels.
    x0, y0, per_mm_x, per_mm_y : mi.Float
        Lower left corner, mm, and pixels per mm along x and y, as opaque Dr.Jit variables.
    tent : bool
        Whether a hit is spread over the four nearest pixels by a tent filter of radius 1 pixel (bilinear weights);
        otherwise it contributes to the pixel that holds it.
    groups : int
        Number of groups of batches, a power of two; the film has an image for each, whose spread is the error of their
        sum. Where there are several, the film also has the `WEIGHTS`, from which the reliability of that error follows.
    image_of_slot : mi.UInt32 or None
        For maps of single paths: the `image_word` of the map of each ledger slot, 0 for none. None: all light forms one
        image.
    """

    width: int
    height: int
    x0: mi.Float
    y0: mi.Float
    per_mm_x: mi.Float
    per_mm_y: mi.Float
    groups: int
    image_of_slot: mi.UInt32 | None = None
    tent: bool = False

    @classmethod
    def of(cls, width: int, height: int, extent: Sequence[float], groups: int = 1, tent: bool = False) -> Film:
        """
        Create a grid of `width` × `height` pixels over the rectangle x0, x1, y0, y1 (mm) of the detector.

        `groups` and `tent` are the attributes of these names.
        """
        x0, x1, y0, y1 = extent
        numbers = x0, y0, width / (x1 - x0), height / (y1 - y0)
        left, low, per_mm_x, per_mm_y = (dr.opaque(mi.Float, float(number)) for number in numbers)
        return cls(width, height, left, low, per_mm_x, per_mm_y, groups, tent=tent)

    @property
    def images(self) -> int:
        """Number of images in memory: one per group of batches, plus `WEIGHTS` for the noise if there are several."""
        return self.groups + (WEIGHTS if self.groups > 1 else 0)

    def places(self, x: mi.Float, y: mi.Float) -> list[tuple[mi.UInt32, mi.Float | None]]:
        """
        Return the pixels that hits at a point of the detector, mm, contribute to, with their filter weights.

        What falls outside the film contributes to the nearest pixel of its border.

        Returns
        -------
        list of (mi.UInt32, mi.Float or None)
            Indices of pixels, row by row from the smallest y, and their filter weights; None, without a tent: 1.
        """
        along_x, along_y = (x - self.x0) * self.per_mm_x, (y - self.y0) * self.per_mm_y
        if not self.tent:
            return [(self._number(mi.Int32(along_x), mi.Int32(along_y)), None)]
        # Bilinear weights relative to the centres of the pixels
        low_x, low_y = dr.floor(along_x - 0.5), dr.floor(along_y - 0.5)
        part_x, part_y = along_x - 0.5 - low_x, along_y - 0.5 - low_y
        column, row = mi.Int32(low_x), mi.Int32(low_y)
        return [
            (self._number(column + i, row + j), (part_x if i else 1 - part_x) * (part_y if j else 1 - part_y))
            for j in (0, 1)
            for i in (0, 1)
        ]

    def _number(self, column: mi.Int32, row: mi.Int32) -> mi.UInt32:
        """Return the row-major index of the pixel in a column and row, both clipped to the film."""
        column, row = dr.clip(column, 0, self.width - 1), dr.clip(row, 0, self.height - 1)
        return mi.UInt32(row * self.width + column)


class Images(Recorder):
    """
    Recorder of images of the flux that a detector absorbs, in units of a start ray's flux.

    Parameters
    ----------
    film : Film
        Pixel grid of the detector.
    count : int, optional
        Number of images in memory; by default `Film.images`, those of one map.
    only : int, optional
        Surface index of the detector whose hits are recorded; None: those of all detectors.

    Attributes
    ----------
    sums : (count · height · width,) mi.Float64
        Flux in units of a start ray's, image by image; the `WEIGHTS` of a map follow the images of its groups.
    """

    def __init__(self, film: Film, count: int | None = None, only: int | None = None) -> None:
        self._film = film
        self._only = None if only is None else dr.opaque(mi.UInt32, only)
        self.sums = dr.zeros(mi.Float64, film.width * film.height * (film.images if count is None else count))
        dr.make_opaque(self.sums)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """
        Add each hit's absorbed flux to its pixel; if noise is estimated, also the powers of its weight.

        With `Film.image_of_slot` the pixel is in the map of the hit's path; hits on paths without a map are left out.
        """
        film = self._film
        # Image of the hit: of all light or of its path, and of its group of batches
        here = visit.counted if self._only is None else visit.counted & (visit.surface == self._only)
        size, first = film.width * film.height, mi.UInt32(0)
        on_film, by_group = here, mi.Bool(film.groups > 1)
        if film.image_of_slot is not None:
            word = dr.gather(mi.UInt32, film.image_of_slot, visit.slot, here)
            first, on_film, by_group = ((word >> 1) - 1) * size, here & (word > 0), (word & 1) > 0
        image = first + dr.select(by_group, group_of(visit.start.batch, film.groups) * size, 0)
        for pixel, share in film.places(*visit.position):
            flux = mi.Float64(visit.absorbed)
            if share is not None:
                flux *= mi.Float64(share)
            dr.scatter_reduce(dr.ReduceOp.Add, self.sums, flux, image + pixel, on_film)
            if film.groups > 1:  # moments of the weights, for `error_rays`
                square = flux * flux
                for number, weight in enumerate((mi.Float64(1), square, square * square), film.groups):
                    place = first + (number * size + pixel)
                    dr.scatter_reduce(dr.ReduceOp.Add, self.sums, weight, place, on_film & by_group)


@dataclass(frozen=True)
class Pixels(Sampled):
    """
    Image on a detector, with its noise by group of batches; row 0 is at the smallest y.

    Attributes
    ----------
    weights : (WEIGHTS, height, width) float64
        Number of rays and sums of the squares and fourth powers of their flux in each pixel; NaN where the noise is
        unknown.
    """

    weights: Numbers

    @classmethod
    def of_film(cls, film: Numbers, started: Numbers, scale: float = 1.0) -> Pixels:
        """
        Create an image with its noise from a film; the noise is unknown (NaN) where there is one image of all batches.

        Parameters
        ----------
        film : (images, height, width) float64
            Images of the groups, then the `WEIGHTS`, see `Film`.
        started : (BATCHES,) float64
            Start rays of the batches.
        scale : float, optional
            Factor from the unit of the film to that of the image, such as the flux of a start ray, W.
        """
        if len(film) == 1:
            noise, weights = (*film.shape[1:], 1), (WEIGHTS, *film.shape[1:])
            return cls(scale * film[0], np.broadcast_to(np.nan, noise), np.broadcast_to(np.nan, weights))
        groups = len(film) - WEIGHTS
        # Batches go last as a view: the arithmetic runs image by image, as the film lies in memory
        found = Sampled.of(np.moveaxis(scale * film[:groups], 0, -1), started.reshape(groups, -1).sum(axis=1))
        powers = scale ** np.array([0.0, 2.0, 4.0])
        return cls(found.value, found.apart, powers[:, None, None] * film[groups:])

    @property
    def none(self) -> Pixels:
        """Image of the same size with zero flux and zero noise."""
        return Pixels(*map(np.zeros_like, (self.value, self.apart, self.weights)))

    def __add__(self, other: Sampled) -> Pixels:
        """Return the sum of two images of independent light, with their noise combined."""
        assert isinstance(other, Pixels)
        both = super().__add__(other)
        return Pixels(both.value, both.apart, self.weights + other.weights)

    def __getitem__(self, chosen: Any) -> Sampled:
        few = self.few_rays[chosen]
        return Sampled(self.value[chosen], np.where(few[..., None], np.nan, self.apart[chosen]))

    @property
    def few_rays(self) -> np.ndarray:
        """Mask of pixels that too few rays meet for a standard error, (height, width) bool; see `error_rays`."""
        return self.few_in_squares(1)

    def few_in_squares(self, pixels: int) -> np.ndarray:
        """Return a mask of squares of `in_squares` that too few rays meet for a standard error, see `error_rays`."""

        def pool(values: Numbers) -> Numbers:
            # Sums over the neighbouring pixels, one axis after the other
            around = np.pad(values, NEIGHBOURS // 2)
            for axis in (0, 1):
                around = np.lib.stride_tricks.sliding_window_view(around, NEIGHBOURS, axis).sum(axis=-1)
            return around

        light, rays, squares, fourths = (in_squares(values, pixels) for values in (self.value, *self.weights))
        return few_rays(error_rays(rays, light, squares, fourths, pool))

    @property
    def se(self) -> Numbers:
        """Standard error of each pixel, (height, width), in the unit of the image; NaN in pixels of few rays."""
        return np.where(self.few_rays, np.nan, super().se)


class Box(Recorder):
    """
    Rectangle of the detector outside which hits are hidden from the recorders after it.

    Parameters
    ----------
    corners : sequence of float
        x0, x1, y0, y1 in the detector's frame, mm.
    """

    def __init__(self, corners: Sequence[float]) -> None:
        self._corners = opaque(mi.Vector4f, corners)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Exclude hits outside the rectangle from the sums of the recorders that follow."""
        (x, y), box = visit.position, self._corners
        # Not in place: `visit.detected` may be the same mask
        visit.counted = visit.counted & (x >= box.x) & (x <= box.y) & (y >= box.z) & (y <= box.w)


def image_word(first: int, by_group: bool) -> int:
    """Return an integer that encodes the index of a map's first image, and whether it has one per group of batches."""
    return 2 * (first + 1) + by_group


def groups_of(pixels: int) -> int:
    """Return the number of groups of batches with an image each, a power of 2: fewer for images of more pixels."""
    most = FILM_BYTES // (8 * pixels)
    return int(np.clip(1 << max(most, 1).bit_length() - 1, LEAST_GROUPS, BATCHES))


def group_of(batch: mi.UInt32, groups: int) -> mi.UInt32:
    """
    Return the index of the group of batches that each batch belongs to.

    `groups`, the number of groups, is a power of two, as is `BATCHES`: a shift divides.
    """
    return batch >> dr.opaque(mi.UInt32, (BATCHES // groups).bit_length() - 1)


def images_of(pixels: int) -> int:
    """Return the number of images in memory for one map with its noise: one per group of batches, plus `WEIGHTS`."""
    return groups_of(pixels) + WEIGHTS


def in_squares(image: Numbers, pixels: int) -> Numbers:
    """
    Return the sums of an image, (h, w), over squares of `pixels` × `pixels`, as a smaller image.

    Squares in the last row and column are cut off where the image ends.
    """
    rows, columns = (np.arange(0, size, pixels) for size in image.shape)
    return np.asarray(np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1))


def spreads(film: mi.Film) -> bool:
    """
    True if a detector's film spreads each hit over the four nearest pixels by a tent filter, see `Film`.

    Parameters
    ----------
    film : mi.Film
        Film of the detector; its hits are spread if its reconstruction filter is a ``tent``.

    Raises
    ------
    MistrayError
        For a tent whose radius is not 1 pixel.
    """
    kernel = film.rfilter()
    if kernel.class_name() != "TentFilter":
        return False
    if kernel.radius() != 1:
        raise MistrayError(
            f"the film's rfilter 'tent' has a radius of {kernel.radius():g} pixels; leave out its radius, which is 1"
        )
    return True

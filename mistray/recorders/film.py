"""The pixels of the detector, and the images that light makes on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.recorders.recorder import Memory, Recorder, Visit
from mistray.settings import BATCHES

FILM_BYTES, LEAST_GROUPS = 1 << 24, 8  # of the images of the detector of a run, by groups of batches


@dataclass
class Film:
    """
    Pixel grid of the detector.

    Attributes
    ----------
    width, height : int
    x0, y0, per_mm_x, per_mm_y : mi.Float
        Corner (mm) and pixels per mm, opaque.
    incident : bool
        Sum the flux that meets the detector instead of what it absorbs.
    tent : bool
        Spread a hit over the four nearest pixels, in proportion to how near their centres are; else it counts in the
        pixel that holds it.
    groups : int
        Of batches, a power of two; the film has an image for each of them, whose spread is the error of their sum.
    image_of_slot : mi.UInt32 or None
        For maps of single paths: the `image_word` of the map of each ledger slot, 0 for none.
    """

    width: int
    height: int
    x0: mi.Float
    y0: mi.Float
    per_mm_x: mi.Float
    per_mm_y: mi.Float
    groups: int
    incident: bool = False
    image_of_slot: mi.UInt32 | None = None
    tent: bool = False

    def image(self, batch: mi.UInt32, slot: mi.UInt32 | None, active: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
        """First pixel of the image where a hit counts, and whether it does."""
        group = batch >> dr.opaque(mi.UInt32, (BATCHES // self.groups).bit_length() - 1)
        if self.image_of_slot is not None:
            word = dr.gather(mi.UInt32, self.image_of_slot, slot, active)
            active &= word > 0
            group = (word >> 1) - 1 + dr.select((word & 1) > 0, group, 0)
        return group * (self.width * self.height), active

    def places(self, x: mi.Float, y: mi.Float) -> list[tuple[mi.UInt32, mi.Float | None]]:
        """
        Where a hit at a point of the detector counts.

        Returns
        -------
        list of (mi.UInt32, mi.Float or None)
            Numbers of pixels, row 0 at the smallest y, and the shares of the flux that they get; None: all of it.
        """
        along_x, along_y = (x - self.x0) * self.per_mm_x, (y - self.y0) * self.per_mm_y
        if not self.tent:
            return [(self._number(mi.Int32(along_x), mi.Int32(along_y)), None)]
        low_x, low_y = dr.floor(along_x - 0.5), dr.floor(along_y - 0.5)
        part_x, part_y = along_x - 0.5 - low_x, along_y - 0.5 - low_y
        column, row = mi.Int32(low_x), mi.Int32(low_y)
        return [
            (self._number(column + i, row + j), (part_x if i else 1 - part_x) * (part_y if j else 1 - part_y))
            for j in (0, 1)
            for i in (0, 1)
        ]

    def _number(self, column: mi.Int32, row: mi.Int32) -> mi.UInt32:
        """Number of a pixel, or of the nearest one beyond the border."""
        column, row = dr.clip(column, 0, self.width - 1), dr.clip(row, 0, self.height - 1)
        return mi.UInt32(row * self.width + column)


class Images(Recorder):
    """
    Images of a detector, or of what meets it.

    Parameters
    ----------
    film : Film
    count : int, optional
        Number of images; by default those of the film.
    only : int, optional
        Number of the detector where there are several.

    Attributes
    ----------
    sums : (count · height · width,) mi.Float64
        In units of a start ray.
    """

    def __init__(self, film: Film, count: int | None = None, only: int | None = None) -> None:
        self._film, self.incident = film, film.incident
        self._only = None if only is None else dr.opaque(mi.UInt32, only)
        self.sums = dr.zeros(mi.Float64, film.width * film.height * (film.groups if count is None else count))
        dr.eval(self.sums)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Add flux to pixels."""
        film = self._film
        here = visit.counted if self._only is None else visit.counted & (visit.surface == self._only)
        image, on_film = film.image(visit.start.batch, visit.slot, here)
        for pixel, share in film.places(*visit.position):
            flux = mi.Float64(visit.weight if film.incident else visit.absorbed)
            if share is not None:
                flux *= mi.Float64(share)
            dr.scatter_reduce(dr.ReduceOp.Add, self.sums, flux, image + pixel, on_film)


class Box(Recorder):
    """
    Leaves out hits of the detector beyond a rectangle, for the recorders after it.

    Parameters
    ----------
    corners : sequence of float
        x0, x1, y0, y1 in the detector's frame, mm.
    """

    def __init__(self, corners: Sequence[float]) -> None:
        self._corners = mi.Vector4f(*(dr.opaque(mi.Float, float(v)) for v in corners))

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Take lanes out."""
        (x, y), box = visit.position, self._corners
        visit.counted &= (x >= box.x) & (x <= box.y) & (y >= box.z) & (y <= box.w)


def image_word(first: int, by_group: bool) -> int:
    """The map of a path: number of its first image, and whether it has one for each group of batches or one in all."""
    return 2 * (first + 1) + by_group


def groups_of(pixels: int) -> int:
    """Groups of batches that have an image of so many pixels each: fewer where the images would be large."""
    most = FILM_BYTES // (8 * pixels)
    return int(np.clip(1 << max(most, 1).bit_length() - 1, LEAST_GROUPS, BATCHES))


def spreads(film: mi.Film) -> bool:
    """
    Whether the hits on a detector are spread over the pixels around them, see `Film`.

    Parameters
    ----------
    film : mi.Film
        Of the detector; spread where its reconstruction filter is a ``tent``.

    Raises
    ------
    MistrayError
        For a tent that is not two pixels wide.
    """
    kernel = film.rfilter()
    if kernel.class_name() != "TentFilter":
        return False
    if kernel.radius() != 1:
        raise MistrayError(
            f"the film's rfilter 'tent' has a radius of {kernel.radius():g} pixels; leave out its radius, which is 1"
        )
    return True

"""Events in the kernel, see `mistray.events`."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from mistray.events import AIMED_TRANSMITTED, RANDOM_TRANSMITTED, REFLECTED, TOTAL, TRANSMITTED, event_of
from mistray.kernel.interaction import Interaction
from mistray.recorders.path_key import AT_WALL, COUNT_MASK, NOT_DIFFRACTED, OPTICAL_SHIFT, RANDOM_SHIFT
from mistray.surfaces.optics import DIFFRACTS, Optics


def event_code(
    place: mi.UInt32, it: Interaction, reflect: mi.Bool, scattered: tuple[mi.Bool, mi.Bool, mi.Bool] | None
) -> mi.UInt32:
    """
    Return codes of events: number of the surface or medium, and how the ray leaves it; see `mistray.events`.

    Parameters
    ----------
    place : mi.UInt32
        Number of the surface or medium.
    it : Interaction
    reflect : mi.Bool
        Whether the ray leaves on the side that it came from.
    scattered : tuple of mi.Bool or None
        Whether the surface scattered the ray, whether the medium did, and whether it was aimed; None: nothing scatters.
    """
    # Specular events
    what = dr.select(reflect, dr.select(it.tir, mi.UInt32(TOTAL), mi.UInt32(REFLECTED)), mi.UInt32(TRANSMITTED))
    # Scattered: rays of different techniques are different events in the ledger
    if scattered is not None:
        surface, medium, aim = scattered
        technique = dr.select(aim, mi.UInt32(AIMED_TRANSMITTED), mi.UInt32(RANDOM_TRANSMITTED))
        what = dr.select(surface, technique + dr.select(reflect, mi.UInt32(1), 0), what)
        what = dr.select(medium, technique, what)
    return event_of(place, what)


def scatters_done(word: mi.UInt32) -> list[mi.UInt32]:
    """Return numbers of scatter events of paths from packed words: all, not aimed, and not at opaque surfaces."""
    return [(word >> shift) & COUNT_MASK for shift in (0, RANDOM_SHIFT, OPTICAL_SHIFT)]


def after_scatter(word: mi.UInt32, aim: mi.Bool, optical: mi.Bool, diffracted: mi.Bool) -> mi.UInt32:
    """Return packed scatter counts of paths after one more event, see `mistray.recorders.path_key.COUNT_MASK`."""
    # One word holds all three counts, so that a node stores a single integer
    count = 1 + dr.select(aim, 0, 1 << RANDOM_SHIFT) + dr.select(optical, mi.UInt32(1 << OPTICAL_SHIFT), 0)
    # `AT_WALL` is of the last event only; `NOT_DIFFRACTED` stays once it is set
    word = ((word & ~mi.UInt32(AT_WALL)) + count) | dr.select(diffracted, 0, mi.UInt32(NOT_DIFFRACTED))
    return word | dr.select(optical, 0, mi.UInt32(AT_WALL))


def is_diffraction(optics: Optics, it: Interaction, scatter: mi.Bool, reflect: mi.Bool) -> mi.Bool:
    """Whether an event at a surface is diffraction by an edge."""
    if not optics.diffracts:
        return mi.Bool(False)
    return scatter & ~reflect & ((it.word & DIFFRACTS) != 0)

"""Which branches of a node are not followed although they could be."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi


def kept_by_control(control: str, counted: mi.Bool, w_t: mi.Float, w_r: mi.Float) -> tuple[mi.Float, mi.Float]:
    """
    What `Settings.ray_control` leaves of transmitted and reflected light; mirrors and total reflection do not count.

    Parameters
    ----------
    control : {"transmit_specular", "reflect_specular", "halt_all"}
    counted : mi.Bool
        Whether the reflection is one that is counted.
    w_t, w_r : mi.Float
    """
    if control == "halt_all":
        return mi.Float(0), mi.Float(0)
    if control == "transmit_specular":
        return w_t, dr.select(~counted, w_r, 0)
    return mi.Float(0), w_r


def too_weak(
    limits: Sequence[mi.Float], scattered: mi.Bool, reflect: mi.Bool, child: mi.Float
) -> tuple[mi.Bool, mi.UInt32]:
    """
    Whether a branch is below the limit of its kind, and its number among the kinds.

    Parameters
    ----------
    limits : sequence of mi.Float
        Of reflected, transmitted, and scattered light in reflection and in transmission.
    scattered, reflect : mi.Bool
    child : mi.Float
        Flux of the branch.
    """
    of_scatter, of_specular = dr.select(reflect, limits[2], limits[3]), dr.select(reflect, limits[0], limits[1])
    number = dr.select(reflect, mi.UInt32(0), 1) + dr.select(scattered, mi.UInt32(2), 0)
    return child < dr.select(scattered, of_scatter, of_specular), number

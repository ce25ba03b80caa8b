"""Sources: what a segment costs of light of a point, against that of a collimated beam, with kernels compiled before.

Rays of a point that die at the first barrel make packets of SIMD idle; so do those of a beam that overfills the lens.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from rows import REPEATS, Row, measured
from systems import times

import mistray

SCENES = ("double_gauss", "phone_camera")
POINT = "point:0,0,-500"
BAR = 1.05


def point(name: str, rays: int, repeats: int) -> Row:
    """A point at 500 mm, into all directions, against the beam of the scene."""
    settings = {"rays": rays, "max_reflections": 2}
    here, there = (
        partial(mistray.trace, scene, **settings) for scene in (mistray.load(name, POINT), mistray.load(name))
    )
    return times(f"point_{name}", f"`{name}`: a point at 500 mm, the collimated beam", here, there, BAR, repeats)


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `sources`."""
    rays, repeats = (1 << 13, 1) if quick else (1 << 19, REPEATS)
    for name in SCENES:
        yield measured(f"point_{name}", f"a point before `{name}`", partial(point, name, rays, repeats))

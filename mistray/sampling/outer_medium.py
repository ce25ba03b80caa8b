"""
Medium outside of a scene, from which its light comes: what the first surface of the design path declares on that side.

Light of a lens or plate without an edge can go through the side of the glass, where no surface refracts it. Such rays
are found by it: forward ones meet a face from within, and backward ones leave the scene in glass. Both are lost.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from mistray.cache.remembered import remembered
from mistray.sampling.design_path import find_design_path
from mistray.sampling.importance_targets import signature
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

SAME_INDEX = 1e-3  # difference of refractive indices, relative, up to which media are one: air and vacuum

_known: dict[str, int] = {}


def outer_medium(table: SurfaceTable, scene: mi.Scene) -> str:
    """
    Return the name, in `Optics.media`, of the medium from which light of the design enters a scene.

    It is "unknown" without a design path, where no refracting surface of it declares its media, and where the medium
    absorbs or scatters, so that no light comes from far away.
    """
    key = signature(table, scene, table.detectors)
    # Equal media of two scenes may have other names
    return table.optics.media[remembered(_known, key, lambda: _first_declared(table, scene))]


def closed_media(table: SurfaceTable, outside: str) -> mi.Bool | None:
    """
    Return a mask of the media, by their positions, in which no ray can leave the scene; None: there are none.

    These are all whose refractive indices differ from that of the medium `outside`, see `outer_medium`.
    """
    if outside not in table.optics.media[1:]:
        return None
    n = table.optics.host_media_n
    other = np.abs(n / n[table.optics.media.index(outside)] - 1) > SAME_INDEX
    other[0] = False
    return upload(mi.Bool, other) if other.any() else None


def _first_declared(table: SurfaceTable, scene: mi.Scene) -> int:
    """
    Return the position in `Optics.media` of the medium before the first refracting surface of the design path.

    It is 0, unknown, if that medium absorbs or scatters, without a design path, and if none of its surfaces refracts.
    """
    path, optics = find_design_path(table, scene), table.optics
    for step in path.steps[:-1] if path is not None else ():
        if not step.reflects:
            medium = int(optics.declared[step.surface, int(not step.from_front)])
            return 0 if float(np.array(optics.extinction)[medium]) > 0 else medium
    return 0

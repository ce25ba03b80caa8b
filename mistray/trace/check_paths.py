"""Check that a scene can have the paths that a filter selects, before anything is traced."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.recorders.design_sequences import DesignSequences
from mistray.recorders.path_events import Events
from mistray.recorders.path_key import padded
from mistray.sampling.sources import source_emitters
from mistray.surfaces.surfaces import medium_id, named_shapes, part_of
from mistray.trace.filter_rows import Rows
from mistray.trace.path_filter import PathFilter
from mistray.trace.path_row import PathRow
from mistray.trace.ray_table import BY_RAY

COLUMNS = {f.name: np.zeros(0, dtype=object if f.type == "str" else np.float64) for f in fields(PathRow)}


def check_paths(scene: mi.Scene | None, selections: Iterable[str], of_rays: bool = False) -> None:
    """
    Raise `MistrayError` if filters (see `mistray.trace.path_filter`) are invalid or name something the scene lacks.

    Parameters
    ----------
    scene : mi.Scene or None
        Scene of the paths; None: the filters are only parsed.
    selections : iterable of str
        Filter expressions, path names or kinds.
    of_rays : bool
        Whether filters may also compare columns that only a ray has.

    Raises
    ------
    MistrayError
        For a filter that cannot be parsed, and for surfaces, kinds, sources and columns that do not exist.
    """
    requested = [PathFilter(text) for text in selections]
    if requested and scene is not None:
        # A table without rows has all the names, which is enough to find those that do not exist
        by_ray, shapes = BY_RAY if of_rays else frozenset(), named_shapes(scene)
        # As in `mistray.surfaces.surfaces.SurfaceTable`: surfaces first, then media, whose names are in brackets
        bsdfs: list[Any] = [shape.bsdf() for shape in shapes.values()]
        media = list(dict.fromkeys(getattr(bsdf, side, "").strip() for bsdf in bsdfs for side in ("front", "back")))
        emitters = enumerate(source_emitters(scene), start=1)
        rows = Rows(
            Events(*padded([]), [*shapes, *map(medium_id, media)], np.zeros(0, np.uint32), DesignSequences()),
            [*(part_of(*pair) for pair in shapes.items()), *media],
            {name: column for name, column in COLUMNS.items() if name not in by_ray},
            len(shapes),
            by_ray,
            [emitter.name or f"source_{number}" for number, emitter in emitters],
        )
        for one in requested:
            one.bounds(rows)

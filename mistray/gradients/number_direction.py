"""The direction in which the numbers of a scene move when its parameters do: the chain rule forward."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mistray.coatings import LAYER_PARAMETERS
from mistray.gradients.coating_gradient import IDEAL_PARAMETERS, layer_row_derivatives
from mistray.gradients.geometry_gradient import SHIFTS, column_derivatives, row_derivatives, shape_parameters
from mistray.gradients.replay_surfaces import TABLE_CHANNELS, Numbers
from mistray.surfaces.gradient_columns import GEOMETRY
from mistray.surfaces.optics import IDEAL, TABLED

if TYPE_CHECKING:
    from mistray.surfaces.surfaces import SurfaceTable


def number_direction(table: SurfaceTable, tangents: Mapping[tuple[int, str], np.ndarray]) -> Numbers:
    """
    How all numbers move.

    Parameters
    ----------
    table : SurfaceTable
    tangents : mapping
        Identity of a plugin and name of a parameter → (entries,) how fast the parameter moves.
    """
    optics = table.optics
    geometry = np.zeros((table.count, len(GEOMETRY)))
    for piece in table.pieces:
        shape = table.shapes[piece.index]
        for name in shape_parameters(shape):
            speed = tangents.get((id(shape), name))
            if speed is not None:
                geometry[piece.index] += float(speed[0]) * column_derivatives(shape, name)
    indices, ideal = np.zeros((table.count, 2)), np.zeros((table.count, 2))
    rows = np.zeros((optics.rows, TABLE_CHANNELS))
    for i, bsdf in enumerate(optics.bsdfs):
        kind = int(optics.host_words[i]) & 3
        first, _, total_first, total_last = (int(v) for v in optics.host_places[i])
        own = rows[first : total_first + total_last + 1]
        for side, name in enumerate(SHIFTS):
            speed = tangents.get((id(bsdf), name))
            if speed is not None:
                indices[i, side] += float(speed[0])
                if kind == TABLED:
                    own += float(speed[0]) * row_derivatives(optics, i, side)
        if bsdf.film is None:
            continue
        if kind == IDEAL:
            for column, name in enumerate(IDEAL_PARAMETERS):
                ideal[i, column] += float(tangents.get((id(bsdf.film), name), np.zeros(1))[0])
        elif kind == TABLED:
            for name in LAYER_PARAMETERS:
                speed = tangents.get((id(bsdf.film), name))
                if speed is not None:
                    (slopes,) = layer_row_derivatives(optics, [(i, np.arange(len(own)), [name])])
                    own += np.tensordot(np.asarray(speed, dtype=np.float64), slopes, axes=1)
    return Numbers(geometry, indices, rows, ideal)

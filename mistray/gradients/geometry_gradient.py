"""
Derivatives of surface geometry, as traced, with respect to the parameters of shape plugins.

The tracer describes surfaces by the columns of `mistray.surfaces.gradient_columns`, in the frame of their vertex. A
parameter of a shape moves the frame, the columns or both. The rates are central differences in float64 of the
functions that make the surfaces, `surface` and `vertex_frame` of the plugin.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.physics.geometry.pose import moved
from mistray.surfaces.gradient_columns import DISPLACEMENT, GEOMETRY, PARAMETER_COLUMNS, POSE


def geometry_columns(names: Iterable[str]) -> frozenset[str]:
    """
    Return the `GEOMETRY` columns, such as curvature or position, that given shape parameters may change.

    Raises
    ------
    MistrayError
        If a name is not that of a shape parameter with a derivative.
    """
    found: set[str] = set()
    for name in names:
        if name not in PARAMETER_COLUMNS:
            known = ", ".join(PARAMETER_COLUMNS)
            raise MistrayError(f"'{name}' is not a parameter of a shape with a derivative; use {known}")
        found |= PARAMETER_COLUMNS[name]
    return frozenset(found)


def shape_parameters(shape: Any) -> tuple[str, ...]:
    """Return the names of a shape's differentiable parameters; none for one of Mitsuba's own shapes."""
    return tuple(getattr(shape, "differentiable", ()))


def column_derivatives(shape: Any, name: str) -> np.ndarray:
    """
    Return the derivatives of a surface's `GEOMETRY` columns with respect to one parameter of its shape.

    Parameters
    ----------
    shape : mi.Shape
        Plugin of the surface.
    name : str
        Name of the parameter.

    Returns
    -------
    (len(GEOMETRY),) float64
        Rates per unit of the parameter: displacement and rotation in the frame of the vertex, mm and rad, then the
        columns in their units.
    """
    values, step = shape.values, shape.step(name)
    low, high = ({**values, name: values[name] + sign * step} for sign in (-1, 1))
    result = np.zeros(len(GEOMETRY))

    # Pose: displacement and rotation vector of the frame
    def frame(values: Mapping[str, float]) -> np.ndarray:
        return np.asarray(shape.vertex_frame(values, moved(shape.base, *(values[key] for key in POSE))))

    here, before, after = (frame(v) for v in (values, low, high))
    change = (after - before) / (2 * step)
    result[: len(DISPLACEMENT)] = here[:3, :3].T @ change[:3, 3]
    turn = here[:3, :3].T @ change[:3, :3]  # antisymmetric but for rounding: its vector is the rotation
    result[len(DISPLACEMENT) : len(POSE)] = 0.5 * np.array(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )
    # Columns of the shape
    if name not in POSE:
        with np.errstate(invalid="ignore"):  # a step may lie beyond the end of a conic, but its sag is in no column
            less, more = (shape.surface(v).columns for v in (low, high))
        for column in less | more:
            result[GEOMETRY.index(column)] = (more.get(column, 0.0) - less.get(column, 0.0)) / (2 * step)
    return result

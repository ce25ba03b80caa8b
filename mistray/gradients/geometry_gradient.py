"""
Chain rule from derivatives by numbers and indices of surfaces to derivatives by the parameters of their plugins.

The tracer describes surfaces by the columns of `mistray.surfaces.gradient_columns`, in the frame of their vertex. A
parameter of a shape moves the frame, the columns or both. The rates are central differences in float64 of the
functions that make the surfaces, `surface` and `vertex_frame` of the plugin. In the same way the index beside a coating
changes its rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.coatings.stack import Stack, outside_first
from mistray.errors import MistrayError
from mistray.physics.geometry.pose import moved
from mistray.surfaces.gradient_columns import DISPLACEMENT, GEOMETRY, PARAMETER_COLUMNS, POSE
from mistray.surfaces.optics import OPAQUE, TABLED, TRANSMISSION, node_cosines, refraction_rows, total_rows

if TYPE_CHECKING:
    from mistray.surfaces.optics import Optics
    from mistray.surfaces.surfaces import SurfaceTable

SHIFTS = ("n_front_shift", "n_back_shift")
# Wide, because at the critical angle a cosine of 0 has an error of 1e-8; a five-point formula makes up for it
INDEX_STEP, EQUAL_INDICES = 2e-3, 1e-9


def geometry_columns(names: Iterable[str]) -> frozenset[str]:
    """
    Return the names of the `GEOMETRY` columns that the named parameters of shapes may change.

    Raises
    ------
    MistrayError
        If a name is no parameter of a shape that has a derivative.
    """
    found: set[str] = set()
    for name in names:
        if name not in PARAMETER_COLUMNS:
            known = ", ".join(PARAMETER_COLUMNS)
            raise MistrayError(f"'{name}' is no parameter of a shape with a derivative; use {known}")
        found |= PARAMETER_COLUMNS[name]
    return frozenset(found)


def shape_parameters(shape: Any) -> tuple[str, ...]:
    """Return the names of a shape's differentiable parameters; none for one of Mitsuba's own shapes."""
    return tuple(getattr(shape, "differentiable", ()))


def geometry_gradient(
    table: SurfaceTable, geometry: np.ndarray, is_chosen: Callable[[Any, str], bool] = lambda owner, name: True
) -> Iterator[tuple[Any, str, np.ndarray]]:
    """
    Yield derivatives of a metric with respect to the parameters of shapes, by batch of start rays.

    Parameters
    ----------
    table : SurfaceTable
    geometry : (..., BATCHES, surfaces, len(GEOMETRY)) float64
        Derivatives with respect to the columns, see `mistray.gradients.table_gradient.Derivatives`.
    is_chosen : callable
        Takes a shape and a name; returns whether that derivative is requested. By default all are.

    Yields
    ------
    owner, name, gradient
        The shape, the name of the parameter, and the derivatives by batch, (..., BATCHES, 1).
    """
    for piece in table.pieces:
        shape, own = table.shapes[piece.index], geometry[..., piece.index, :]
        for name in shape_parameters(shape):
            if is_chosen(shape, name):
                moves = column_derivatives(shape, name)
                yield shape, name, (own @ moves)[..., None]


def index_gradient(
    table: SurfaceTable,
    indices: np.ndarray,
    is_chosen: Callable[[Any, str], bool] = lambda owner, name: True,
    rows: np.ndarray | None = None,
) -> Iterator[tuple[Any, str, np.ndarray]]:
    """
    Yield derivatives of a metric with respect to shifts of refractive indices, by batch of start rays.

    Parameters
    ----------
    table : SurfaceTable
    indices : (..., BATCHES, surfaces, 2) float64
        Derivatives with respect to the real indices in front and behind, R and T at the nodes of coatings held fixed.
    is_chosen : callable
        Takes an interface and a name; returns whether that derivative is requested. By default all are.
    rows : (BATCHES, rows, CHANNELS) float64, optional
        Derivatives with respect to the rows of the tables of R and T, which depend on the indices beside the coatings;
        without them R and T at the nodes are held fixed.

    Yields
    ------
    owner, name, gradient
        The interface, the name of the shift, and the derivatives by batch, (..., BATCHES, 1). An interface that several
        surfaces share is yielded once for each of them.
    """
    optics = table.optics
    for i, bsdf in enumerate(optics.bsdfs):
        for side, name in enumerate(SHIFTS):
            if not is_chosen(bsdf, name):
                continue
            found = indices[..., i, side]
            if rows is not None and int(optics.host_words[i]) & 3 == TABLED:
                first, _, total_first, total_last = (int(v) for v in optics.host_places[i])
                own = rows[:, first : total_first + total_last + 1, : TRANSMISSION + 1]
                found = found + np.tensordot(own, row_derivatives(optics, i, side), axes=2)
            yield bsdf, name, found[..., None]


def row_derivatives(optics: Optics, surface: int, side: int) -> np.ndarray:
    """
    Return the derivatives of a coating's R and T at table nodes with respect to a real index beside it.

    `side` is 0 for the index in front, 1 for the one behind.

    The nodes are held fixed: they are cosines in the rarer material, or, between equal indices, cosines of incidence.

    Returns
    -------
    (rows, 3) float64
        Derivatives of both parts of its table (refraction, total reflection): R from the front, R from the back and T.
    """
    sides = optics.complex_indices[surface]
    coating = optics.bsdfs[surface].coating
    if isinstance(coating, Stack) and coating.first == "outside":  # the order of the layers is held as well
        coating = replace(coating, first="front" if outside_first(*sides) else "back")
    setting = coating, optics.wavelength_nm
    opaque = bool(optics.host_words[surface] & OPAQUE)
    _, last, _, total_last = (int(v) for v in optics.host_places[surface])
    # Nodes of both parts of the table, and the step of the differences
    x, w = np.linspace(0.0, 1.0, last + 1), np.linspace(0.0, 1.0, total_last + 1)
    contrast = abs(sides[0].real - sides[1].real)
    same = opaque or contrast < EQUAL_INDICES
    step = INDEX_STEP if same else min(INDEX_STEP, contrast / 8)  # the rarer material stays the rarer one

    def rows(change: float) -> np.ndarray:
        front, back = (n + change * (k == side) for k, n in enumerate(sides))
        at_front, at_back = (x, x) if same else node_cosines(front.real, back.real, x)[:2]
        refraction = refraction_rows(*setting, (front, back), opaque, False, at_front, at_back)[:, :, 0]
        if same:  # there is no critical angle
            return np.concatenate([refraction, np.zeros((len(w), 3))])
        dense = node_cosines(front.real, back.real, w)[2]
        return np.concatenate([refraction, total_rows(*setting, (front, back), False, dense)[:, :, 0]])

    return (8 * (rows(step) - rows(-step)) - (rows(2 * step) - rows(-2 * step))) / (12 * step)


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
        Rates in mm, rad and the units of the columns, per unit of the parameter.
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

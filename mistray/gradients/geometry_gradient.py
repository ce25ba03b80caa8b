"""From derivatives by the numbers and the indices of surfaces to derivatives by the parameters of their plugins.

The tracer knows surfaces by the columns of `mistray.gradients.raw_gradient.GEOMETRY`, in the frame of their vertex. A
parameter of an `asphere` or a `frustum` moves the frame, the columns or both. How much, is found by central differences
in float64 of the very functions that make the surfaces, `mistray.surfaces.pieces`. In the same way the index beside a
coating changes its rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.coatings.stack import Stack, outside_first
from mistray.errors import MistrayError
from mistray.physics.pose import moved
from mistray.surfaces.gradient_columns import COEFFICIENTS, GEOMETRY
from mistray.surfaces.optics import OPAQUE, TABLED, TRANSMISSION, node_cosines, refraction_rows, total_rows
from mistray.surfaces.pieces import Piece, piece_numbers, vertex_frame

if TYPE_CHECKING:
    from mistray.surfaces.optics import Optics
    from mistray.surfaces.surfaces import SurfaceTable

DISPLACEMENT, ROTATION = ("x", "y", "z"), ("tilt_x", "tilt_y", "tilt_z")
POSE = (*DISPLACEMENT, *ROTATION)
RIMS = {
    "semi_diameter": "outer",
    "inner_semi_diameter": "inner",
    "half_width": "half_width",
    "half_height": "half_height",
}
HOLES = {"asphere": ("inner_semi_diameter",), "frustum": ("r0", "r1")}
# The columns that a parameter of a shape may move
_COLUMNS = {
    **dict.fromkeys(DISPLACEMENT, DISPLACEMENT),
    **dict.fromkeys(ROTATION, POSE),  # a frustum turns about its origin, which is not its vertex
    **{name: (name,) for name in ("curvature", "conic", *COEFFICIENTS)},
    **{name: (column,) for name, column in RIMS.items()},
    "r0": ("r0", "slope", "outer", "inner"),
    "r1": ("slope", "outer", "inner"),
    "z0": ("z", "slope", "z_low", "z_high"),
    "z1": ("slope", "z_low", "z_high"),
}
# Steps. Displacements are linear; of a tilt the relative error is its square in rad, 3e-10 / 6; others are in units of
# the surface's size
MM, DEGREES, RELATIVE = 1.0, 1e-3, 1e-5
SHIFTS = ("n_front_shift", "n_back_shift")
# Wide, for at the critical angle a cosine of 0 has the error 1e-8; five points make up for it
INDEX_STEP, EQUAL_INDICES = 2e-3, 1e-9


def geometry_columns(names: Iterable[str]) -> frozenset[str]:
    """
    The columns of `GEOMETRY` that parameters of shapes may move.

    Raises
    ------
    MistrayError
        If a name is no parameter of a shape that has a derivative.
    """
    found: set[str] = set()
    for name in names:
        if name not in _COLUMNS:
            raise MistrayError(f"'{name}' is no parameter of a shape with a derivative; use {', '.join(_COLUMNS)}")
        found.update(_COLUMNS[name])
    return frozenset(found)


def shape_parameters(shape: Any) -> tuple[str, ...]:
    """
    Names of the parameters of a shape that have a derivative; none for a stock shape.

    A flat `frustum` has none by ``z0`` or ``z1`` alone, which would make it a cone; ``z`` moves it. Nor has a hole of
    no radius.
    """
    if not hasattr(shape, "outer_radius"):
        return ()
    without = {name for name in HOLES[shape.kind] if shape.values.get(name) == 0}
    if shape.kind == "frustum":
        without = without | {"z0", "z1"} if shape.flat else set()
    return tuple(name for name in shape.values if name not in without)


def geometry_gradient(
    table: SurfaceTable, geometry: np.ndarray, wanted: Callable[[Any, str], bool] = lambda owner, name: True
) -> Iterator[tuple[Any, str, np.ndarray]]:
    """
    Derivatives of a metric by the parameters of shapes.

    Parameters
    ----------
    table : SurfaceTable
    geometry : (BATCHES, surfaces, len(GEOMETRY)) float64
        By the columns, see `RawGradient`.
    wanted : callable
        Says of a shape and a name whether its derivative is asked for; by default all are.

    Yields
    ------
    owner, name, gradient
        The shape, the name of the parameter, and the derivatives by batch, (BATCHES, 1).
    """
    for piece in table.pieces:
        shape, own = table.shapes[piece.index], geometry[:, piece.index]
        for name in shape_parameters(shape):
            if wanted(shape, name):
                moves = column_derivatives(shape.kind, shape.values, shape.base, name)
                yield shape, name, (own @ moves)[:, None]


def index_gradient(
    table: SurfaceTable,
    indices: np.ndarray,
    wanted: Callable[[Any, str], bool] = lambda owner, name: True,
    rows: np.ndarray | None = None,
) -> Iterator[tuple[Any, str, np.ndarray]]:
    """
    Derivatives of a metric by the shifts of refractive indices.

    Parameters
    ----------
    table : SurfaceTable
    indices : (BATCHES, surfaces, 2) float64
        By the real indices in front and behind, the rows of coatings held.
    wanted : callable
        Says of an interface and a name whether its derivative is asked for; by default all are.
    rows : (BATCHES, rows, CHANNELS) float64, optional
        By the rows of the tables of R and T, which depend on the indices beside the coatings; without them R and T at
        the nodes are held.

    Yields
    ------
    owner, name, gradient
        The interface, the name of the shift, and the derivatives by batch, (BATCHES, 1). An interface that several
        surfaces share comes once for each of them.
    """
    optics = table.optics
    for i, bsdf in enumerate(optics.bsdfs):
        for side, name in enumerate(SHIFTS):
            if not wanted(bsdf, name):
                continue
            found = indices[:, i, side]
            if rows is not None and int(optics.host_words[i]) & 3 == TABLED:
                first, _, total_first, total_last = (int(v) for v in optics.host_places[i])
                own = rows[:, first : total_first + total_last + 1, : TRANSMISSION + 1]
                found = found + np.tensordot(own, row_derivatives(optics, i, side), axes=2)
            yield bsdf, name, found[:, None]


def row_derivatives(optics: Optics, surface: int, side: int) -> np.ndarray:
    """
    Derivatives of the rows of a coated surface by the real index in front (side 0) or behind (1).

    The nodes are held: cosines in the rarer material, between equal indices those of incidence.

    Returns
    -------
    (rows, 3) float64
        Both parts of its table, R from the front, R from the back and T.
    """
    sides = optics.complex_indices[surface]
    coating = optics.bsdfs[surface].coating
    if isinstance(coating, Stack) and coating.first == "outside":  # the order of the layers is held as well
        coating = replace(coating, first="front" if outside_first(*sides) else "back")
    setting = coating, optics.wavelength_nm
    opaque = bool(optics.host_words[surface] & OPAQUE)
    _, last, _, total_last = (int(v) for v in optics.host_places[surface])
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


def column_derivatives(kind: str, values: Mapping[str, float], base: np.ndarray, name: str) -> np.ndarray:
    """
    Derivatives of the columns of `GEOMETRY` of a surface by one of its parameters.

    Parameters
    ----------
    kind : str
        "asphere" or "frustum".
    values : mapping of str to float
        Parameters of the shape, see the plugins.
    base : (4, 4) float64
        Its frame before it is displaced and tilted.
    name : str

    Returns
    -------
    (len(GEOMETRY),) float64
        mm, rad and the units of the columns, by the unit of the parameter.
    """
    step = _step(values, name)
    low, high = ({**values, name: values[name] + sign * step} for sign in (-1, 1))
    result = np.zeros(len(GEOMETRY))
    if name in (*POSE, "z0"):
        here, before, after = (_frame(kind, v, base) for v in (values, low, high))
        change = (after - before) / (2 * step)
        result[: len(DISPLACEMENT)] = here[:3, :3].T @ change[:3, 3]
        turn = here[:3, :3].T @ change[:3, :3]  # the matrix of a vector product, but for rounding
        result[len(DISPLACEMENT) : len(POSE)] = 0.5 * np.array(
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        )
    if name not in POSE:
        less, more = (_columns(kind, v) for v in (low, high))
        for column in less | more:
            result[GEOMETRY.index(column)] = (more.get(column, 0.0) - less.get(column, 0.0)) / (2 * step)
    return result


def _frame(kind: str, values: Mapping[str, float], base: np.ndarray) -> np.ndarray:
    return vertex_frame(kind, values, moved(base, *(values[name] for name in POSE)))


def _columns(kind: str, values: Mapping[str, float]) -> dict[str, float]:
    with np.errstate(invalid="ignore"):  # a step beyond the end of a conic; its sag is in no column
        return Piece(index=0, frame=0, axis=0, z=0.0, **piece_numbers(kind, values)).columns


def _step(values: Mapping[str, float], name: str) -> float:
    """Step of a parameter, in its unit."""
    if name in POSE:
        return MM if name in DISPLACEMENT else DEGREES
    if "r0" in values:
        return RELATIVE * abs(values["z1"] - values["z0"] or values["r1"] - values["r0"])
    size = values["semi_diameter"] if "semi_diameter" in values else max(values["half_width"], values["half_height"])
    powers = {"curvature": -1, "conic": 0} | {column: -3 - 2 * k for k, column in enumerate(COEFFICIENTS)}
    return float(RELATIVE * size ** powers.get(name, 1))

"""
Chain rule between the surface properties that a trace uses and the parameters of plugins.

The reverse mode converts derivatives of a metric with respect to surface properties to derivatives with respect to
parameters. The forward mode converts rates of change of parameters to those of surface properties.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.gradients.coating_gradient import (
    IDEAL_PARAMETERS,
    SHIFTS,
    layer_gradient,
    layer_tangent,
    row_derivatives,
    table_rows,
)
from mistray.gradients.geometry_gradient import column_derivatives, shape_parameters
from mistray.gradients.scatter_gradient import scatter_gradient
from mistray.gradients.surface_numbers import SurfaceNumbers
from mistray.gradients.table_gradient import TableGradient
from mistray.kernel.interaction import REFLECTION_AND_TRANSMISSION
from mistray.surfaces.gradient_columns import GEOMETRY
from mistray.surfaces.optics import IDEAL, REFLECTION_BACK, REFLECTION_FRONT, TABLED, TRANSMISSION, Optics
from mistray.surfaces.surfaces import SurfaceTable

Sums = dict[tuple[int, str], np.ndarray]
IsChosen = Callable[[Any, str], bool]
ByParameter = Iterator[tuple[Any, str, np.ndarray]]

NO_STOKES = (
    "gradients need polarization='unpolarized' and sources without stokes, jones or polarization_deg; the Stokes "
    "vector has no derivative yet"
)
NO_PARAMETERS = (
    "the scene has no parameter with a derivative: none of its shapes is an 'asphere', 'freeform' or 'frustum', and no "
    "'interface' has a coating or scatter above 0"
)


def without_derivative(key: str) -> str:
    """
    Return why a trace has no derivative with respect to a key of ``mi.traverse``; "" if the reason is not known.

    If there is a remedy, the text names it.

    Parameters
    ----------
    key : str
        Key of a value that belongs to one of Mitsuba's own plugins, such as ``"plate.to_world"``.
    """
    owner, _, name = key.rpartition(".")
    if name == "to_world" and not owner.endswith((".sensor", ".emitter")):
        return (
            "a shape of Mitsuba's own has no formula; draw it as an 'asphere', 'freeform' or 'frustum', which has "
            "derivatives with respect to x, y, z and tilts"
        )
    if name.startswith("vertex_"):
        return "vertices have none: they follow from a formula, and a mesh of Mitsuba's own has no formula"
    if f".{key}".rpartition(".emitter.")[1]:
        return "an emitter of Mitsuba's own has none; use a source of mistray"
    return ""


def number_rates(
    table: SurfaceTable, is_chosen: IsChosen, coatings: bool = True
) -> Iterator[tuple[Any, str, str, tuple[Any, ...], Any]]:
    """
    Yield the rates at which traced properties of surfaces change with plugin parameters other than those of layers.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    is_chosen : callable
        See `parameter_gradient`.
    coatings : bool
        Whether to include R and T of coatings.

    Yields
    ------
    owner, name, array, place, rates
        The plugin, the name of its parameter, the name of a field of `SurfaceNumbers`, the index of the values in it
        that change, and their rates per unit of the parameter. The rates have the shape of these values, or are one
        number. A parameter that changes several fields is yielded several times.
    """
    optics = table.optics
    for piece in table.pieces:
        shape = table.shapes[piece.index]
        for name in shape_parameters(shape):
            if is_chosen(shape, name):
                yield shape, name, "geometry", (piece.index, slice(None)), column_derivatives(shape, name)
    for i, bsdf in enumerate(optics.bsdfs):
        kind = int(optics.host_words[i]) & 3 if coatings else None
        for side, name in enumerate(SHIFTS):
            if is_chosen(bsdf, name):
                yield bsdf, name, "indices", (i, side), 1.0
                if kind == TABLED:
                    place = table_rows(optics, i), slice(TRANSMISSION + 1)
                    yield bsdf, name, "rows", place, row_derivatives(optics, i, side)
        for column, name in enumerate(IDEAL_PARAMETERS if kind == IDEAL else ()):
            if is_chosen(bsdf.film, name):
                yield bsdf.film, name, "ideal", (i, column), 1.0


def parameter_gradient(raw: TableGradient, is_chosen: IsChosen, rims: bool = False) -> ByParameter:
    """
    Yield derivatives of a metric with respect to the parameters of plugins, by batch of start rays.

    Parameters
    ----------
    raw : TableGradient
        Derivatives with respect to the properties of surfaces and sources.
    is_chosen : callable
        Takes a plugin and a name; returns whether that derivative is requested.
    rims : bool
        Whether to yield the boundary terms of rims instead of the derivatives with visibility held fixed.

    Yields
    ------
    owner, name, gradient
        The plugin that owns the parameter, its name, and the derivatives by batch, (BATCHES, entries), in the metric's
        unit per unit of the parameter. Boundary terms of rims are (w, BATCHES, entries), with one entry of the first
        axis for each width of the zones. A parameter may come several times; the parts add up.

    Raises
    ------
    MistrayError
        If derivatives with respect to coatings are present although the light is polarised, or if a scatter parameter
        has no derivative at its value.
    """
    found, table = raw.rims if rims else raw.inner, raw.table
    arrays = {"geometry": found.geometry, "indices": found.indices, "rows": found.rows}
    if found.rows is not None:
        if table.optics.stokes:
            raise MistrayError(NO_STOKES)
        arrays["ideal"] = _ideal(table.optics, found.rows)
        yield from layer_gradient(table.optics, found.rows, is_chosen)
    for owner, name, array, place, rates in number_rates(table, is_chosen, found.rows is not None):
        if (values := arrays[array]) is not None:
            yield owner, name, np.tensordot(values[(..., *place)], rates, axes=np.ndim(rates))[..., None]
    if found.scatter:
        yield from scatter_gradient(table, raw.scattering, found.scatter, is_chosen)
    for owner, name, values in found.sources:
        if is_chosen(owner, name):
            yield owner, name, values[..., None]


def _ideal(optics: Optics, rows: np.ndarray) -> np.ndarray:
    """
    Return derivatives with respect to R and T of ideal coatings, (BATCHES, surfaces, 2).

    `rows` is that of `Derivatives`. The entries of surfaces with other coatings mean nothing.
    """
    own = rows[:, optics.host_places[:, 0]]
    both = own[..., REFLECTION_AND_TRANSMISSION]
    R = own[..., REFLECTION_FRONT] + own[..., REFLECTION_BACK] + both
    return np.stack([R, own[..., TRANSMISSION] + both], axis=-1)


def number_tangent(table: SurfaceTable, tangents: Mapping[tuple[int, str], np.ndarray]) -> SurfaceNumbers:
    """
    Return the rates of change of geometry, refractive indices, R and T of all surfaces.

    The parameters of plugins move at the rates `tangents`.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    tangents : mapping
        (id of a plugin, name of a parameter) → (entries,) rate, in the unit of the parameter, per unit of a common
        variable.

    Returns
    -------
    SurfaceNumbers
        Rates, in the unit of each property, per unit of the same variable.
    """
    pairs = np.zeros((2, table.count, 2))
    found = SurfaceNumbers(
        np.zeros((table.count, len(GEOMETRY))), pairs[0], layer_tangent(table.optics, tangents), pairs[1]
    )
    for owner, name, array, place, rates in number_rates(table, lambda owner, name: (id(owner), name) in tangents):
        getattr(found, array)[place] += float(tangents[id(owner), name][0]) * rates
    return found


def gathered(raws: Iterable[TableGradient], is_chosen: IsChosen) -> tuple[Sums, Sums]:
    """
    Return derivatives of a metric, summed over traces, keyed by the ``id()`` of the plugin and the parameter's name.

    The first mapping has those with visibility held fixed, the second the boundary terms of rims. Shapes and units are
    those of `parameter_gradient`.
    """
    inner, rims = Sums(), Sums()
    for raw in raws:
        # A plugin that several surfaces share is yielded once for each: the parts add up
        for sums in (inner, rims):
            for owner, name, part in parameter_gradient(raw, is_chosen, rims=sums is rims):
                sums[id(owner), name] = sums.get((id(owner), name), 0.0) + part
    return inner, rims

"""Chain rule from the derivatives that the tracer accumulates to derivatives by the parameters of plugins."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from mistray.gradients.coating_gradient import coating_gradient
from mistray.gradients.geometry_gradient import geometry_gradient, index_gradient
from mistray.gradients.scatter_gradient import scatter_gradient
from mistray.gradients.table_gradient import TableGradient

Sums = dict[tuple[int, str], np.ndarray]
IsChosen = Callable[[Any, str], bool]
Derivatives = Iterator[tuple[Any, str, np.ndarray]]


def parameter_gradient(raw: TableGradient, is_chosen: IsChosen) -> Derivatives:
    """
    Yield derivatives by parameters, visibility held.

    Parameters
    ----------
    raw : TableGradient
    is_chosen : callable
        Takes a plugin and a name; returns whether that derivative is requested.

    Yields
    ------
    owner, name, gradient
        The plugin that owns the parameter, its name, and the derivatives by batch, (BATCHES, entries). A parameter may
        come several times; the parts add up.
    """
    # Interior terms: coatings, shapes, indices, scatter, sources
    if raw.rows is not None:
        yield from coating_gradient(raw.table.optics, raw.rows, is_chosen)
    if raw.geometry is not None:
        yield from geometry_gradient(raw.table, raw.geometry, is_chosen)
    if raw.indices is not None:
        yield from index_gradient(raw.table, raw.indices, is_chosen, raw.rows)
    if raw.scatter:
        yield from scatter_gradient(raw.table, raw.scattering, raw.scatter, is_chosen)
    for found in raw.sources:
        if is_chosen(found.owner, found.name):
            yield found.owner, found.name, found.inner[:, None]


def edge_gradient(raw: TableGradient, is_chosen: IsChosen) -> Derivatives:
    """
    Yield the boundary terms of rims as `parameter_gradient` does the interior ones.

    Their arrays are (w, BATCHES, entries), one entry of the first axis for each width of the zones.
    """
    if raw.edges is not None:
        yield from geometry_gradient(raw.table, raw.edges, is_chosen)
    if raw.edge_indices is not None:
        yield from index_gradient(raw.table, raw.edge_indices, is_chosen)
    for found in raw.sources:
        if len(found.edges) and is_chosen(found.owner, found.name):
            yield found.owner, found.name, found.edges[..., None]


def gathered(raws: Iterable[TableGradient], is_chosen: IsChosen) -> tuple[Sums, Sums]:
    """Sum `parameter_gradient` and `edge_gradient` over several traces, by identity of the plugin and name."""
    inner, rims = Sums(), Sums()
    for raw in raws:
        # A plugin that several surfaces share is yielded once for each: the parts add up
        for sums, found in (inner, parameter_gradient(raw, is_chosen)), (rims, edge_gradient(raw, is_chosen)):
            for owner, name, part in found:
                sums[id(owner), name] = sums.get((id(owner), name), 0.0) + part
    return inner, rims

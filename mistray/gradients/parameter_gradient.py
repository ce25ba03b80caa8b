"""From what the tracer knows of the derivatives of a metric to derivatives by the parameters of plugins."""

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


def parameter_gradient(raw: TableGradient, wanted: IsChosen) -> Derivatives:
    """
    Derivatives by parameters with visibility as it is.

    Parameters
    ----------
    raw : TableGradient
    wanted : callable
        Says of a plugin and a name whether its derivative is requested.

    Yields
    ------
    owner, name, gradient
        The plugin that owns the parameter, its name, and the derivatives by batch, (BATCHES, entries). A parameter may
        come several times; the parts add up.
    """
    if raw.rows is not None:
        yield from coating_gradient(raw.table.optics, raw.rows, wanted)
    if raw.geometry is not None:
        yield from geometry_gradient(raw.table, raw.geometry, wanted)
    if raw.indices is not None:
        yield from index_gradient(raw.table, raw.indices, wanted, raw.rows)
    if raw.scatter:
        yield from scatter_gradient(raw.table, raw.scattering, raw.scatter, wanted)
    for found in raw.sources:
        if wanted(found.owner, found.name):
            yield found.owner, found.name, found.inner[:, None]


def edge_gradient(raw: TableGradient, wanted: IsChosen) -> Derivatives:
    """The part of rims, as `parameter_gradient`, for each width of the zones: (w, BATCHES, entries)."""
    if raw.edges is not None:
        yield from geometry_gradient(raw.table, raw.edges, wanted)
    if raw.edge_indices is not None:
        yield from index_gradient(raw.table, raw.edge_indices, wanted)
    for found in raw.sources:
        if len(found.edges) and wanted(found.owner, found.name):
            yield found.owner, found.name, found.edges[..., None]


def gathered(raws: Iterable[TableGradient], wanted: IsChosen) -> tuple[Sums, Sums]:
    """Sums of `parameter_gradient` and of `edge_gradient`, by the identity of the plugin and the name."""
    inner, rims = Sums(), Sums()
    for raw in raws:
        for sums, found in (inner, parameter_gradient(raw, wanted)), (rims, edge_gradient(raw, wanted)):
            for owner, name, part in found:
                sums[id(owner), name] = sums.get((id(owner), name), 0.0) + part
    return inner, rims

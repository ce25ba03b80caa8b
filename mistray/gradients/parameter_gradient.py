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
ByParameter = Iterator[tuple[Any, str, np.ndarray]]


def parameter_gradient(raw: TableGradient, is_chosen: IsChosen, rims: bool = False) -> ByParameter:
    """
    Yield derivatives of a metric with respect to the parameters of plugins, by batch of start rays.

    Parameters
    ----------
    raw : TableGradient
    is_chosen : callable
        Takes a plugin and a name; returns whether that derivative is requested.
    rims : bool
        Whether to yield the boundary terms of rims instead of the derivatives with visibility held fixed.

    Yields
    ------
    owner, name, gradient
        The plugin that owns the parameter, its name, and the derivatives by batch, (BATCHES, entries); of rims
        (w, BATCHES, entries), one entry of the first axis for each width of the zones. A parameter may come several
        times; the parts add up.
    """
    found = raw.rims if rims else raw.inner
    if found.rows is not None:
        yield from coating_gradient(raw.table.optics, found.rows, is_chosen)
    if found.geometry is not None:
        yield from geometry_gradient(raw.table, found.geometry, is_chosen)
    if found.indices is not None:
        yield from index_gradient(raw.table, found.indices, is_chosen, found.rows)
    if found.scatter:
        yield from scatter_gradient(raw.table, raw.scattering, found.scatter, is_chosen)
    for owner, name, values in found.sources:
        if is_chosen(owner, name):
            yield owner, name, values[..., None]


def gathered(raws: Iterable[TableGradient], is_chosen: IsChosen) -> tuple[Sums, Sums]:
    """
    Return derivatives of a metric by plugin id and parameter name, summed over traces.

    The first mapping has those with visibility held fixed, the second the boundary terms of rims.
    """
    inner, rims = Sums(), Sums()
    for raw in raws:
        # A plugin that several surfaces share is yielded once for each: the parts add up
        for sums in (inner, rims):
            for owner, name, part in parameter_gradient(raw, is_chosen, rims=sums is rims):
                sums[id(owner), name] = sums.get((id(owner), name), 0.0) + part
    return inner, rims

"""Sums over start rays: addition of the sums of different rays, and compact transfer between processes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Self

import numpy as np


@dataclass(frozen=True, eq=False)
class Sums:
    """
    Base class of sums over start rays; `+` adds them field by field, of a field `largest` it takes the maximum.

    A field that is None holds no sums.
    """

    def __add__(self, other: Self) -> Self:
        """Return the sums over the start rays of both objects, see the class; a field None of one is the other's."""
        joined = {f.name: _joined(f.name, getattr(self, f.name), getattr(other, f.name)) for f in fields(self)}
        return type(self)(**joined)

    def __getstate__(self) -> dict[str, Any]:
        return {name: _packed(value) for name, value in self.__dict__.items()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update({name: _unpacked(value) for name, value in state.items()})


def _joined(name: str, a: Any, b: Any) -> Any:
    """
    Return one field of two added sums: the maximum for `largest`, else the sum; if one is None, the other.

    Tuples are joined entry by entry.
    """
    if a is None or b is None:
        return b if a is None else a
    if isinstance(a, tuple):
        return tuple(_joined(name, one, other) for one, other in zip(a, b, strict=True))
    return np.maximum(a, b) if name == "largest" else a + b


@dataclass(frozen=True)
class _Packed:
    """Array of float64 stored sparsely: its shape, its nonzero values, and their indices in the flat array."""

    shape: tuple[int, ...]
    values: np.ndarray
    where: np.ndarray


def _packed(value: Any) -> Any:
    """Return an array as `_Packed` if that is shorter; tuples and dataclasses are packed entry by entry."""
    if not isinstance(value, np.ndarray) or value.dtype != np.float64:
        return _each(_packed, value)
    # An index takes as many bytes as a value
    where = np.flatnonzero(value)
    return value if 2 * len(where) >= value.size else _Packed(value.shape, value.ravel()[where], where)


def _unpacked(value: Any) -> Any:
    if not isinstance(value, _Packed):
        return _each(_unpacked, value)
    whole = np.zeros(value.shape)
    whole.reshape(-1)[value.where] = value.values
    return whole


def _each(change: Callable[[Any], Any], value: Any) -> Any:
    """Return a tuple or a dataclass with `change` applied to each entry; anything else is returned unchanged."""
    if isinstance(value, tuple):
        return tuple(map(change, value))
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{name: change(part) for name, part in vars(value).items()})
    return value

"""Upload of host arrays to the device for the kernel, and download of vectors."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

import drjit as dr
import numpy as np

from mistray.errors import MistrayError

ALIGNMENT = 128  # bytes
DTYPES = {
    "Float": np.float32,
    "Float64": np.float64,
    "UInt": np.uint32,
    "UInt64": np.uint64,
    "Bool": np.bool_,
}


def opaque(kind: Any, values: Any) -> Any:
    """Return numbers as a vector of opaque Dr.Jit variables, such as ``mi.Vector3f``: kernels do not depend on them."""
    return kind(*(dr.opaque(dr.value_t(kind), float(value)) for value in values))


def upload(kind: Any, values: np.ndarray) -> Any:
    """
    Copy numbers to a Dr.Jit array whose memory always has the same alignment.

    Dr.Jit's array types adopt the memory of a NumPy array in place, and its alignment becomes part of the kernels that
    read it. Without a fixed alignment one trace could compile to different kernels.

    Parameters
    ----------
    kind : type
        Type of the array: ``mi.Float``, ``mi.UInt32``, ….
    values : ndarray
        Numbers of any shape, flattened in C order.
    """
    flat: np.ndarray = np.ascontiguousarray(values, dtype=DTYPES[kind.__name__]).ravel()
    room = np.empty(flat.nbytes + ALIGNMENT, dtype=np.uint8)
    first = -room.ctypes.data % ALIGNMENT
    aligned = room[first : first + flat.nbytes].view(flat.dtype)
    aligned[:] = flat
    return kind(aligned)


def download(vector: Any) -> np.ndarray:
    """
    Return a Dr.Jit vector as an array on the host, (n, components) float64.

    NumPy would ask Dr.Jit to reorder the components, by a kernel that has their number of entries as a literal. Each
    other number would compile a kernel.
    """
    dr.eval(vector)
    components = np.broadcast_arrays(*(np.array(component, dtype=np.float64) for component in vector))
    return np.array(components).T


def changed_numbers(
    parameters: Mapping[str, Any],
    owner: str,
    before: Mapping[str, float],
    loaded: Mapping[str, float],
    in_double: Container[str] = (),
) -> dict[str, float]:
    """
    Return the values of a plugin's differentiable parameters that differ from those `before`, by name.

    Parameters have single precision unless they are `in_double`. Values are compared as rounded to that, and those that
    are again what the scene gave have its digits, which are in `loaded`.

    Raises
    ------
    MistrayError
        If a parameter is not a single number; `owner` begins the message.
    """
    found = {}
    for name, value in parameters.items():
        entries = np.array(dr.detach(value), dtype=np.float64)
        if entries.shape != (1,):
            raise MistrayError(f"{owner}: {name} has {entries.size} entries; give one number")
        kind = np.float64 if name in in_double else np.float32
        if entries[0] != kind(before[name]):
            found[name] = loaded[name] if entries[0] == kind(loaded[name]) else float(entries[0])
    return found


def upload_rows(kind: Any, values: np.ndarray) -> Any:
    """
    Return numbers as a Dr.Jit array of at least two entries, from which kernels gather; see `upload`.

    An array of one entry would be uniform over all lanes, which makes another kernel than two entries do. A single
    number is therefore there twice.
    """
    return upload(kind, np.repeat(values, 2) if np.size(values) == 1 else values)

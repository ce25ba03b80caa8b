"""Upload of host arrays to the device for the kernel, and download of vectors."""

from __future__ import annotations

from collections.abc import Mapping
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


def numbers_of(parameters: Mapping[str, Any], owner: str) -> dict[str, float]:
    """
    Return the values of differentiable parameters, by name.

    Raise `MistrayError` if one is not a single number; `owner` begins the message.
    """
    for name, value in parameters.items():
        if len(value) != 1:
            raise MistrayError(f"{owner}: {name} has {len(value)} entries; give one number")
    return {name: float(dr.detach(value)[0]) for name, value in parameters.items()}


def upload_rows(kind: Any, values: np.ndarray) -> Any:
    """
    Return numbers as a Dr.Jit array of at least two entries, from which kernels gather; see `upload`.

    An array of one entry would be uniform over all lanes, which makes another kernel than two entries do. A single
    number is therefore there twice.
    """
    return upload(kind, np.repeat(values, 2) if np.size(values) == 1 else values)

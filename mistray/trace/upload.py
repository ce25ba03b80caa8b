"""Host arrays for the kernel."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np


def upload(kind: Any, values: np.ndarray) -> Any:
    """
    Copy numbers into a Dr.Jit array whose memory Dr.Jit has allocated.

    Dr.Jit's array types adopt the memory of a NumPy array as it lies. Where that is not aligned to 16 bytes or more, it
    reads vectors element by element, so that the same trace would compile to one kernel or another by chance.

    Parameters
    ----------
    kind : type
        ``mi.Float``, ``mi.UInt32``, …
    values : ndarray
        Flattened in C order.
    """
    array = dr.opaque(kind, 0) + kind(np.ascontiguousarray(values).ravel())
    dr.eval(array)
    return array

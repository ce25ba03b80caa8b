"""Mie scattering of particles on surfaces, which takes seconds to compute and is kept in the cache on disk."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from mistray.cache import kept
from mistray.physics.contamination import Cloud, check_distribution, cloud


@lru_cache(maxsize=32)
def kept_cloud(
    wavelength_um: float,
    index: complex,
    level: float,
    slope: float,
    min_um: float,
    max_um: float | None,
    immersion: float,
) -> Cloud:
    """
    Return the Mie scattering of particles, as `mistray.physics.contamination.cloud` does, from the cache if possible.

    Raises
    ------
    MistrayError
        For the reasons of `mistray.physics.contamination.cloud`.
    """
    check_distribution(level, slope, min_um, max_um)
    numbers = [wavelength_um, index.real, index.imag, level, slope, min_um, max_um, immersion]
    return kept(
        {"kind": "cloud of particles", "arguments": [None if number is None else float(number) for number in numbers]},
        lambda: cloud(wavelength_um, index, level, slope, min_um, max_um, immersion),
        lambda found: [found.extinction, found.scattering, np.asarray(found.nodes).tolist()],
        _read,
    )


def _read(content: Any) -> Cloud:
    """Return the `Cloud` of particles in the content of a cache file; raise ValueError or TypeError if it has none."""
    extinction, scattering, log_f = content
    numbers = np.array([extinction, scattering, *log_f], dtype=np.float64)
    if not (np.isfinite(numbers).all() and 0 <= scattering <= extinction * (1 + 1e-3)):
        raise ValueError("no cloud")
    return Cloud.of_nodes(extinction, scattering, log_f)

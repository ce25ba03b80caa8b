"""Disk cache for the Mie scattering of particles on surfaces, which takes seconds to compute.

A cloud depends on its arguments only, so that a cached one equals a computed one. If the cache cannot be read or
written, the cloud is computed every time, and a line in the log reports that once in a process.
"""

from __future__ import annotations

import json
import logging
from functools import lru_cache
from pathlib import Path

import numpy as np

from mistray.cache import Cache, code_fingerprint, key_of, open_cache
from mistray.physics.contamination import Cloud, check_distribution, cloud

LOG = logging.getLogger("mistray.cache")


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
    arguments = (wavelength_um, index, level, slope, min_um, max_um, immersion)
    given = open_cache()
    if given is None:
        return cloud(*arguments)
    cache = _cache(given.folder, given.limit_bytes)
    numbers = [wavelength_um, index.real, index.imag, level, slope, min_um, max_um, immersion]
    numbers = [None if number is None else float(number) for number in numbers]
    key = key_of({"kind": "cloud of particles", "code": code_fingerprint(), "arguments": numbers})
    told = len(cache.problems)
    found = cache.get(key, _read)
    if found is None:
        found = cloud(*arguments)
        cache.put(key, json.dumps([found.extinction, found.scattering, np.asarray(found.nodes).tolist()]).encode())
    for problem in cache.problems[told:]:
        LOG.warning(problem)
    return found


def _read(content: bytes) -> Cloud:
    """Return the `Cloud` of particles in the content of a cache file; raise ValueError or TypeError if it has none."""
    extinction, scattering, log_f = json.loads(content)
    numbers = np.array([extinction, scattering, *log_f], dtype=np.float64)
    if not (np.isfinite(numbers).all() and 0 <= scattering <= extinction * (1 + 1e-3)):
        raise ValueError("no cloud")
    return Cloud.of_nodes(extinction, scattering, log_f)


@lru_cache(maxsize=8)
def _cache(folder: Path, limit_bytes: int) -> Cache:
    """Return the disk cache in a folder, one object per process so that a problem is reported once."""
    return Cache(folder, limit_bytes)

"""Mie scattering of the particles of a surface, kept on disk: seconds of work for a few kilobytes.

A cloud is computed from its arguments and nothing else, so that one from the cache is the one that would be computed.
Where the cache cannot be read or written it is computed every time, and one line says so, once in a process.
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
    Return `mistray.physics.contamination.cloud` of these arguments, from the cache if it is there.

    Raises
    ------
    MistrayError
        As `mistray.physics.contamination.cloud`.
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
    """Return the cloud in a file of the cache; raise ValueError or TypeError if the content is no cloud."""
    extinction, scattering, log_f = json.loads(content)
    numbers = np.array([extinction, scattering, *log_f], dtype=np.float64)
    if not (np.isfinite(numbers).all() and 0 <= scattering <= extinction * (1 + 1e-3)):
        raise ValueError("no cloud")
    return Cloud.of_nodes(extinction, scattering, log_f)


@lru_cache(maxsize=8)
def _cache(folder: Path, limit_bytes: int) -> Cache:
    """Return the cache of this process, whose problems are logged once."""
    return Cache(folder, limit_bytes)

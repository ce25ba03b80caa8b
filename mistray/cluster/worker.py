"""Worker side of `mistray.distribute`, which does one part of a task at a time."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mistray._variant import ensure_variant, set_threads, use_plugins
from mistray.errors import MistrayError

if TYPE_CHECKING:
    from mistray.cluster.travel import Unpacked

_unpacked: dict[str, Unpacked] = {}  # by variant: a scene belongs to the one that it was loaded with
_threads = 0


def bring(content: bytes) -> bytes:
    """
    Return bytes as the result of a dask task.

    Workers pass such results on to each other, and compute them again if one is lost. Data that a client scatters would
    be lost with the worker that holds them.
    """
    return content


def do_part(
    content: bytes,
    scenes: list[bytes],
    names: list[str],
    digest: str,
    part: Any,
    surroundings: Mapping[str, str],
    sharing: Mapping[str, int],
) -> Any:
    """
    Do one part of a task and return its result.

    Parameters
    ----------
    content : bytes
        Packed task, see `mistray.cluster.travel.Parcel`.
    scenes : list of bytes
        Packed scenes of the task.
    names : list of str
        Hashes of the scenes.
    digest : str
        Hash of the task.
    part : object
        Part of the task to do.
    surroundings : mapping of str to str
        Versions, variant and plugins of the client, from `mistray.cluster.travel.surroundings`.
    sharing : mapping of str to int
        Number of workers on each host, which share its processor.

    Raises
    ------
    MistrayError
        If the worker has other versions than the client or several threads, or if the task raises it.
    """
    from distributed import get_worker

    worker = get_worker()
    if worker.state.nthreads != 1:
        raise MistrayError(
            f"worker {worker.address} has {worker.state.nthreads} threads; start it with --nthreads 1: a trace takes "
            "all cores by itself"
        )
    if surroundings.get("plugins"):
        use_plugins(surroundings["plugins"].split(","))
    ensure_variant(surroundings["variant"])
    from mistray.cluster.travel import Unpacked
    from mistray.cluster.travel import surroundings as own_surroundings

    for name, value in own_surroundings().items():
        if surroundings.get(name) != value:
            raise MistrayError(
                f"worker {worker.address} has {name} {value}, and {surroundings.get(name)} is used here; install the "
                "same on all machines"
            )
    global _threads
    threads = max(1, _processors() // sharing.get(host_of(worker.address), 1))
    if threads != _threads:  # each keeps to its share of the processor
        set_threads(threads)
        _threads = threads
    unpacked = _unpacked.setdefault(surroundings["variant"], Unpacked())
    task, made = unpacked.task(content, digest, dict(zip(names, scenes, strict=True)))
    return task.do(made, part)


def _processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def host_of(address: str) -> str:
    """Return the host in an address of the form tcp://host:port."""
    return address.rpartition("//")[2].rpartition(":")[0]

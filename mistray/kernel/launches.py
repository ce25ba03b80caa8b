"""
Launches of the kernel that last about a second, since a running launch can neither be stopped nor report its progress.

The first launch of a kernel takes a ray of each batch. The time that it ran, compilation left out, sets the number of
rays of the next launch, and of those of later traces like it. The rays of a launch are spread over all start rays of a
pass, so that those of the launches so far are a sample of the whole beam. A ray has its own random numbers, whichever
launch it is in.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Hashable, Iterator
from dataclasses import replace
from functools import lru_cache

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.interrupts import check, end_overdue
from mistray.recorders.start_rays import StartRays
from mistray.settings import BATCHES, Settings
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload
from mistray.time_budget import left

SECONDS = 1.0  # time that a launch should take
SHORTEST = 0.1  # s, at the end of a time budget: the overhead of a launch stays small
STRETCH = 1.5  # factor by which a launch may be longer if it is then the last one
GROWTH = 512.0  # largest growth of the number of rays from a launch to the next
PACKET, PACKETS = 16, 1 << 12  # fewest neighbours that stay together, since they walk similar trees; number of groups
KERNELS = 256  # kernels whose speed is remembered
GOLDEN = (5**0.5 - 1) / 2
MILLISECOND = 1e-3

compilations: list[float] = []  # seconds that LLVM took for the kernels of each first launch; 0 from the cache


class Launches:
    """
    Launches of one kernel, sized by its measured speed so that each takes about `SECONDS`.

    Attributes
    ----------
    on_device : float
        Time that the last launch ran on the device, s: without its recording and compilation.
    """

    def __init__(self) -> None:
        self.on_device = 0.0
        self._rate = 0.0  # rays per second
        self._compiled = False

    @property
    def lanes(self) -> int:
        """Number of rays that the next launch can trace in `SECONDS` or in the time left; at least `BATCHES`."""
        return self._lanes(min(SECONDS, max(left(), SHORTEST)))

    def _lanes(self, seconds: float) -> int:
        return max(BATCHES, int(self._rate * seconds))

    def run(
        self, start: StartRays, trace: Callable[[StartRays], object], seed: int = 0, whole: bool = False
    ) -> Iterator[int]:
        """
        Trace start rays in several launches, and yield the number of rays traced so far after each.

        Parameters
        ----------
        start : StartRays
            Start rays, one per lane.
        trace : callable
            Function that traces a part of the start rays.
        seed : int
            Seed of the order in which they are traced, see `Spread`.
        whole : bool
            Whether launches take `SECONDS` whatever the time budget: shorter ones would take longer together.

        Yields
        ------
        int
            Number of rays that have been traced: the first ones in the order that `seed` sets.

        Raises
        ------
        KeyboardInterrupt
            After a launch, if the exception of an interrupt was swallowed during it.
        """
        count, done = dr.width(start.lane), 0
        order: Spread | None = None
        while done < count:
            here, part = self._next(count - done, self._lanes(SECONDS) if whole else self.lanes), start
            if here < count:
                order = order or Spread(count, seed)
                numbers = order.next(done, here)
                part, here = start.take(upload(mi.UInt32, numbers)), len(numbers)
            self.time(here, lambda part=part: trace(part))  # type: ignore[misc]
            done += here
            yield done

    def whole(self, start: StartRays, trace: Callable[[StartRays], object]) -> None:
        """
        Trace all start rays regardless of the time budget, in launches as those of `run`.

        Raises
        ------
        KeyboardInterrupt
            After a launch, if an interrupt has waited for too long or its exception was swallowed during the launch.
        """
        count = dr.width(start.lane)
        for done in self.run(start, trace, whole=True):
            if done < count:
                end_overdue()

    @staticmethod
    def _next(left: int, most: int) -> int:
        """Return the size of the next launch, about `most` rays, such that launches share the rays `left` equally."""
        return left if left <= STRETCH * most else math.ceil(left / math.ceil(left / most))

    def time(self, lanes: int, work: Callable[[], object]) -> None:
        """
        Run a launch of `lanes` rays, and set the size of the next launch by the time that it took.

        A launch that is small and short, such as the last of a pass, leaves the size as it is.

        Raises
        ------
        KeyboardInterrupt
            If the exception of an interrupt was swallowed during the launch.
        """
        first, self._compiled = not self._compiled, True
        # The time of the first launch in the kernel alone is in Dr.Jit's history
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, first or dr.flag(dr.JitFlag.KernelHistory)):
            if first:
                dr.kernel_history_clear()
            began = time.perf_counter()
            work()
            dr.eval()
            launched = time.perf_counter()
            dr.sync_thread()
            ended = time.perf_counter()
            seconds, self.on_device = ended - began, ended - launched
            if first:
                kernels = dr.kernel_history()
                seconds = MILLISECOND * sum(kernel.get("execution_time", 0.0) for kernel in kernels)
                compilations.append(MILLISECOND * sum(kernel.get("backend_time", 0.0) for kernel in kernels))
        if lanes >= self.lanes / 4 or seconds > SECONDS:  # a short last launch of a pass is mostly overhead
            self._rate = lanes * min(1 / max(seconds, 1e-9), GROWTH / SECONDS)
        check()


@lru_cache(maxsize=KERNELS)
def _launches(*_: Hashable) -> Launches:
    return Launches()


def launches_of(table: SurfaceTable, settings: Settings, *writes: Hashable) -> Launches:
    """
    Return the `Launches` of a kernel, shared by all its traces, so that the measured speed is kept.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    settings : Settings
        Settings of the trace, of which the number of rays and the seed do not matter.
    *writes : hashable
        Outputs of the kernel, which tell kernels of the same scene apart.
    """
    return _launches(tuple(table.ids), replace(settings, rays=1, seed=0), *writes)


def golden_stride(count: int) -> int:
    """Return a step through 0 … count-1, modulo `count`, that meets each once, and early ones spread over all."""
    stride = max(1, round(GOLDEN * count))
    while math.gcd(stride, count) > 1:
        stride += 1
    return stride


class Spread:
    """
    Permutation of 0 … count-1 in which every prefix is spread evenly over the whole range.

    First comes one number of each of `BATCHES` equal blocks, then packets of neighbours, in steps of the golden ratio
    from a random packet on.

    Parameters
    ----------
    count : int
        Number of integers to permute.
    seed : int
        Seed of the random numbers.
    """

    def __init__(self, count: int, seed: int) -> None:
        rng = np.random.default_rng((seed, count))
        block = (np.arange(BATCHES) + (np.arange(BATCHES) * GOLDEN + rng.random()) % 1) * (count / BATCHES)
        self._size = max(1, count // (PACKET * PACKETS)) * PACKET
        packets = -(-count // self._size)
        stride = golden_stride(packets)
        self._first = np.unique(block.astype(np.int64))
        self._packets = (rng.integers(packets) + np.arange(packets) * stride) % packets
        # Ends of the packets: the numbers of the first group are left out of theirs, and the last packet may be short
        sizes = np.full(packets, self._size)
        sizes[-1] -= packets * self._size - count
        np.subtract.at(sizes, self._first // self._size, 1)
        self._ends = len(self._first) + np.cumsum(sizes[self._packets])
        self._count = count

    def next(self, done: int, rays: int) -> np.ndarray:
        """
        Return the next values of the permutation after its first `done`, about `rays` of them, in ascending order.

        While `done` is within the first group, all of that group is returned, whatever `rays` is.

        Returns
        -------
        (n,) int64
            Values of the permutation; none if it is at its end.
        """
        if done < len(self._first):
            return self._first
        low, high = np.searchsorted(self._ends, (done, done + rays), side="right")
        packets = np.sort(self._packets[low : max(high, low + 1)])
        found = (packets[:, None] * self._size + np.arange(self._size)).ravel()
        found = found[: np.searchsorted(found, self._count)]
        place = np.searchsorted(found, self._first)
        place = place[place < len(found)]
        return np.delete(found, place[np.isin(found[place], self._first)])

    def first(self, rays: int) -> np.ndarray:
        """
        Return the first `rays` numbers of the permutation, (n,), ascending, but at least all of the first group.

        `next` must have returned that many in total.
        """
        if rays <= len(self._first):
            return self._first
        return np.sort(np.concatenate([self._first, self.next(len(self._first), rays - len(self._first))]))

"""A backward trace whose passes other processes trace."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mistray.execute.by_parts import SceneTask
from mistray.execute.sparse import pack
from mistray.execute.workers import Job

if TYPE_CHECKING:
    from mistray.execute.backward import BackwardTrace

AHEAD = 2  # passes for each worker that are handed over before they are needed
Sums = dict[str, Any]


class Pass(NamedTuple):
    """One wavelength of a pass: the arguments of `BackwardTrace.band_sums`."""

    band: int
    done: int
    rays: int


class BackwardTask(SceneTask):
    """A backward trace, for `mistray.execute.workers`."""

    def make(self) -> BackwardTrace:
        """The same trace at a worker."""
        from mistray.execute.backward import BackwardTrace

        trace: BackwardTrace = self.build(BackwardTrace)
        return trace

    def do(self, made: BackwardTrace, part: Pass) -> tuple[Sums, dict[str, np.ndarray] | None]:
        """The sums of a wavelength of a pass, its maps without their zeros, and its paths."""
        made.forget_paths()
        sums: Sums = made.band_sums(*part)
        if "maps" in sums:
            sums["maps"] = sums["maps"].shape, pack(sums["maps"])
        return sums, made.paths()


class Ahead:
    """
    Passes that others trace, some of them before they are requested.

    Parameters
    ----------
    trace : BackwardTrace
    job : Job
    workers : int
    rays : int
        That the trace will take in all.
    """

    def __init__(self, trace: BackwardTrace, job: Job, workers: int, rays: int) -> None:
        self._trace, self._job, self._workers, self._planned = trace, job, workers, rays
        self._handed_over: set[Pass] = set()

    def whole_pass(self, done: int, rays: int) -> tuple[list[dict[str, np.ndarray]], list[dict[str, np.ndarray]]]:
        """What a pass adds to the sums at each wavelength, and its path tables, if there are any."""
        bands = range(len(self._trace.bands))
        total, size, number = float(self._trace.rays.sum()), rays, done
        while number == done or (total < self._planned and number < done + AHEAD * self._workers):
            for part in (Pass(band, number, size) for band in bands):
                if part not in self._handed_over:
                    self._job.submit(part)
                    self._handed_over.add(part)
            total, number = total + size, number + 1
            size = self._trace.pass_size(number)
        sums, path_sums = zip(*(self._job.result(Pass(band, done, rays)) for band in bands), strict=True)
        return [_whole(one) for one in sums], [one for one in path_sums if one is not None]


def _whole(sums: Sums) -> dict[str, np.ndarray]:
    """The sums with maps as arrays."""
    if "maps" not in sums:
        return sums
    shape, packed = sums["maps"]
    maps = np.zeros(shape)
    packed.add_to(maps)
    return {**sums, "maps": maps}

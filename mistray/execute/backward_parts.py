"""Backward traces by other processes: passes are sent, their sums come back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mistray.execute.by_parts import SceneTask
from mistray.execute.sparse import pack
from mistray.execute.workers import Job

if TYPE_CHECKING:
    from mistray.execute.backward import BackwardTrace

AHEAD = 2  # passes per worker that are handed over before they are needed
Sums = dict[str, Any]


class Pass(NamedTuple):
    """One wavelength of a pass, as the arguments of `BackwardTrace.band_sums`."""

    band: int
    done: int
    rays: int


class BackwardTask(SceneTask):
    """A backward trace, for `mistray.execute.workers`."""

    def make(self) -> BackwardTrace:
        """Return the same trace at a worker."""
        # Here, because that module imports this one
        from mistray.execute.backward import BackwardTrace

        trace: BackwardTrace = self.build(BackwardTrace)
        return trace

    def do(self, made: BackwardTrace, part: Pass) -> tuple[Sums, dict[str, np.ndarray] | None]:
        """Return the sums of a wavelength of a pass, with maps in sparse form, and its paths."""
        made.forget_paths()
        sums: Sums = made.band_sums(*part)
        if "maps" in sums:
            sums["maps"] = sums["maps"].shape, pack(sums["maps"])
        return sums, made.paths()


class Ahead:
    """
    Passes that workers trace, some of them before they are requested.

    Parameters
    ----------
    trace : BackwardTrace
    job : Job
    workers : int
        Number of workers.
    rays : int
        Number of rays that the trace will take in all.
    """

    def __init__(self, trace: BackwardTrace, job: Job, workers: int, rays: int) -> None:
        self._trace, self._job, self._workers, self._planned = trace, job, workers, rays
        self._handed_over: set[Pass] = set()

    def whole_pass(self, done: int, rays: int) -> tuple[list[dict[str, np.ndarray]], list[dict[str, np.ndarray]]]:
        """Return the sums of a pass at each wavelength, and its path tables, if there are any."""
        # Hand over this pass and those after it, as far as the planned rays go
        bands = range(len(self._trace.bands))
        total, size, number = float(self._trace.rays.sum()), rays, done
        while number == done or (total < self._planned and number < done + AHEAD * self._workers):
            for part in (Pass(band, number, size) for band in bands):
                if part not in self._handed_over:
                    self._job.submit(part)
                    self._handed_over.add(part)
            total, number = total + size, number + 1
            size = self._trace.pass_size(number)
        # Wait for this pass
        sums, path_sums = zip(*(self._job.result(Pass(band, done, rays)) for band in bands), strict=True)
        return [_whole(one) for one in sums], [one for one in path_sums if one is not None]


def _whole(sums: Sums) -> dict[str, np.ndarray]:
    """Return the sums with maps as dense arrays."""
    if "maps" not in sums:
        return sums
    shape, packed = sums["maps"]
    maps = np.zeros(shape)
    packed.add_to(maps)
    return {**sums, "maps": maps}

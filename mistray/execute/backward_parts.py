"""Backward traces by other processes: passes are sent, their sums come back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from mistray.execute.cell_sums import BackwardSums
from mistray.execute.workers import Job

if TYPE_CHECKING:
    from mistray.execute.backward import BackwardTrace

AHEAD = 2  # passes per worker that are handed over before they are needed


class Pass(NamedTuple):
    """One wavelength of a pass: numbers of the wavelength and the pass, and rays of the pass at all wavelengths."""

    band: int
    done: int
    rays: int


class Ahead:
    """
    Queue of passes that workers trace, some of them before they are requested.

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

    def whole_pass(self, parts: Sequence[Pass]) -> list[BackwardSums]:
        """Return the sums of a pass for each wavelength, traced by workers; hand over later passes to them."""
        # Hand over this pass and those after it, as far as the planned rays go
        _, done, size = parts[0]
        total, number = float(self._trace.rays.sum()), done
        while number == done or (total < self._planned and number < done + AHEAD * self._workers):
            for part in (one._replace(done=number, rays=size) for one in parts):
                if part not in self._handed_over:
                    self._job.submit(part)
                    self._handed_over.add(part)
            total, number = total + size, number + 1
            size = self._trace.pass_size(number)
        # Wait for this pass
        return [self._job.result(part) for part in parts]

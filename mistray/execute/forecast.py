"""Forecast of how long a trace takes, from its first launches, and advice on the setting that makes it long."""

from __future__ import annotations

import time
import warnings

from mistray.errors import MistrayWarning
from mistray.execute.tracer import Run
from mistray.recorders.tallies import SEGMENTS, STARTED, Tallies

LONG = 120.0  # s, beyond which a trace warns
FIRST_LOOK = 2.0  # s after the first launch of a run: the launches right after it are short and take longer per ray
LARGE_TREE = 10_000  # ray segments per start ray; a lens has some hundred


class Forecast:
    """
    Forecast of a trace's remaining time, which warns at most once, if that exceeds `LONG` seconds.

    Parameters
    ----------
    rays : int
        Number of rays of all runs together.
    warns : bool
        Whether to warn.
    """

    def __init__(self, rays: int, warns: bool = True) -> None:
        self._rays, self._warns = rays, warns
        self._run: Run | None = None  # run that is timed
        self._first = 0, 0.0  # rays at the end of its first launch, which includes compilation, and that time
        self._due = False

    def look(self, run: Run, done: int, tallies: Tallies) -> None:
        """
        Estimate the remaining time, once per run, and warn if it exceeds `LONG`.

        Parameters
        ----------
        run : Run
            Run that is traced.
        done : int
            Number of rays that are traced, those of other runs included.
        tallies : Tallies
            Sums of the rays of the run so far.

        Warns
        -----
        MistrayWarning
            If the remaining rays take longer than `LONG`.
        """
        now = time.perf_counter()
        if run is not self._run:
            self._run, self._first, self._due = run, (done, now), True
            return
        rays, then = self._first
        if not (self._warns and self._due) or now - then < FIRST_LOOK or done == rays:
            return
        self._due = False
        left = (now - then) / (done - rays) * (self._rays - done)
        if left > LONG:
            self._warns = False
            channels = tallies.read()["channels"]
            segments = float(channels[SEGMENTS].sum() / channels[STARTED].sum())
            warnings.warn(
                f"the trace takes {duration(left)} more: a start ray has {segments:.3g} ray segments; "
                f"{_remedy(run, segments)}, or give a time with seconds",
                MistrayWarning,
                stacklevel=2,
            )


def _remedy(run: Run, segments: float) -> str:
    """Return advice for a trace that takes long: which setting to change, with its present value."""
    settings = run.settings
    if segments < LARGE_TREE:
        return f"lower rays ({run.rays:.3g})"
    name = "max_events"
    if (run.scattering.any or run.table.optics.scatters) and settings.max_scatters > 1:
        name = "max_scatters"
    elif settings.max_reflections > 1:
        name = "max_reflections"
    return f"lower {name} ({getattr(settings, name)}), raise flux_threshold ({settings.flux_threshold:g})"


def duration(seconds: float) -> str:
    """Return a duration in seconds as text in minutes, hours or days, such as "3 min" or "5.2 h"."""
    for size, unit in ((86400.0, "days"), (3600.0, "h")):
        if seconds >= size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds / 60:.0f} min"

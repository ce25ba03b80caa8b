"""Choice of the wavelengths that are traced where a time budget is too short for all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mistray.light import Light
from mistray.messages import Message
from mistray.notes import Note
from mistray.sampling.sources import source_emitters, spectrum_of
from mistray.time_budget import coarse_first, is_limited, left, not_traced

FEWEST = 3  # wavelengths, however short the time is
PART = 0.35  # share of the remaining time for the overhead of wavelengths, which does not depend on their rays
TIMED_RAYS = 1000  # rays of a trace by which the overhead is measured


@dataclass(frozen=True)
class WavelengthChoice:
    """
    Wavelengths to trace, with weights that include those of omitted wavelengths nearby.

    Attributes
    ----------
    wavelengths_nm, weights : tuple of float
        Traced wavelengths, nm, and their weights; each includes the weights of the omitted wavelengths nearest to it.
    left_out_nm : tuple of float
        Omitted wavelengths, nm.
    """

    wavelengths_nm: tuple[float, ...]
    weights: tuple[float, ...]
    left_out_nm: tuple[float, ...] = field(default=())

    @classmethod
    def of(cls, wavelengths_nm: Sequence[float], weights: Sequence[float], most: int) -> WavelengthChoice:
        """
        Return a choice of at most `most` of the wavelengths, nm, but at least two, spread evenly and with both ends.

        The weight of each omitted wavelength is added to that of the chosen one nearest to it.
        """
        # Coarse steps first, which keeps both ends
        nm, shares = np.asarray(wavelengths_nm, dtype=float), np.asarray(weights, dtype=float)
        kept = np.sort(coarse_first(np.argsort(nm, kind="stable").tolist())[: max(most, 2)])
        nearest = np.abs(nm[:, None] - nm[kept]).argmin(axis=1)
        merged = np.bincount(nearest, weights=shares, minlength=len(kept))
        rest = np.delete(nm, kept)
        return cls(tuple(nm[kept].tolist()), tuple(merged.tolist()), tuple(rest.tolist()))

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments of `mistray.trace` that select the chosen wavelengths, nm, and their weights."""
        return {"wavelength_nm": self.wavelengths_nm, "weights": self.weights}

    @property
    def facts(self) -> dict[str, Any]:
        """Entry for the settings of a result that lists the omitted wavelengths, nm; empty if there are none."""
        return {"not_traced_nm": list(self.left_out_nm)} if self.left_out_nm else {}

    def notes(self, instead: str = "their light is traced at the nearest") -> list[Note]:
        """
        Return a note that lists the omitted wavelengths, nm, and ends with the words `instead`.

        The list is empty if all wavelengths are traced.
        """
        if not self.left_out_nm:
            return []
        names = [f"{nm:g}" for nm in sorted(self.left_out_nm)]
        text = not_traced(names, len(names) + len(self.wavelengths_nm), "wavelengths, nm")
        return [Message.FEWER_WAVELENGTHS.note(what=text, instead=instead)]


def in_time(wavelengths: Sequence[float], timed: Callable[[float], Any], traces: int = 1) -> int:
    """
    Return the number of wavelengths that can be traced within the time budget; at least `FEWEST`, if there are as many.

    All can be without a budget. The overhead of a wavelength is measured by two traces of few rays, of which the first
    compiles the kernel.

    Parameters
    ----------
    wavelengths : sequence of float
        Requested wavelengths, in the unit that `timed` takes.
    timed : callable
        Called with one of them; runs the trace that is timed, with `TIMED_RAYS`.
    traces : int
        Number of traces at each of them.
    """
    if not is_limited() or len(wavelengths) <= FEWEST:
        return len(wavelengths)
    # The second trace is the measurement
    seconds = 0.0
    for one in (wavelengths[len(wavelengths) // 2], wavelengths[0]):
        began = time.perf_counter()
        timed(one)
        seconds = time.perf_counter() - began
    return min(max(FEWEST, int(PART * left() / (traces * seconds))), len(wavelengths))


def chosen_wavelengths(scene: Any, light: Light, timed: Callable[..., Any], traces: int = 1) -> WavelengthChoice | None:
    """
    Return the wavelengths to trace if the time budget is too short for all of them, else None.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    light : Light
        Light of the trace and the detector that records it.
    timed : callable
        Called with ``wavelength_nm``, ``weights`` and ``rays``; runs the trace that is timed.
    traces : int
        Number of traces at all these wavelengths.

    Returns
    -------
    WavelengthChoice or None
        None if all wavelengths are traced: without a time budget, if the time is enough for all, or if no wavelengths
        are given and the sources have different ones.
    """
    own = {(tuple(emitter.wavelengths_nm), tuple(emitter.weights)) for emitter in source_emitters(scene)}
    if not is_limited() or (light.wavelength_nm is None and light.weights is None and len(own) != 1):
        return None
    nm, shares = spectrum_of(scene, light.wavelength_nm, light.weights)
    most = in_time(nm.tolist(), lambda one: timed(wavelength_nm=[one], weights=None, rays=TIMED_RAYS), traces)
    return WavelengthChoice.of(nm.tolist(), shares.tolist(), most) if most < len(nm) else None

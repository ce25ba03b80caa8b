"""Which of many wavelengths are traced, where a time budget is too short for all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mistray.notes import Code, Note
from mistray.sampling.sources import source_emitters, spectrum_of
from mistray.time_budget import coarse_first, is_limited, left, not_traced

FEWEST = 3  # wavelengths, however short the time is
PART = 0.35  # of the time that is left, for what wavelengths take whatever their rays
TIMED_RAYS = 1000


@dataclass(frozen=True)
class WavelengthChoice:
    """
    Wavelengths that are traced, and those that they stand for.

    Attributes
    ----------
    wavelengths_nm, weights : tuple of float
        The weight of each is its own and that of those left out to which it is the nearest.
    left_out_nm : tuple of float
    """

    wavelengths_nm: tuple[float, ...]
    weights: tuple[float, ...]
    left_out_nm: tuple[float, ...] = field(default=())

    @classmethod
    def of(cls, wavelengths_nm: Sequence[float], weights: Sequence[float], most: int) -> WavelengthChoice:
        """At most so many, two at least, spread over all with both ends."""
        nm, shares = np.asarray(wavelengths_nm, dtype=float), np.asarray(weights, dtype=float)
        kept = np.sort(coarse_first(np.argsort(nm, kind="stable").tolist())[: max(most, 2)])
        nearest = np.abs(nm[:, None] - nm[kept]).argmin(axis=1)
        merged = np.bincount(nearest, weights=shares, minlength=len(kept))
        rest = np.delete(nm, kept)
        return cls(tuple(nm[kept].tolist()), tuple(merged.tolist()), tuple(rest.tolist()))

    @property
    def arguments(self) -> dict[str, Any]:
        """What `mistray.trace` is given of them."""
        return {"wavelength_nm": self.wavelengths_nm, "weights": self.weights}

    @property
    def facts(self) -> dict[str, Any]:
        """For the settings of a result."""
        return {"not_traced_nm": list(self.left_out_nm)} if self.left_out_nm else {}

    def notes(self, instead: str = "their light is traced at the nearest") -> list[Note]:
        """One sentence that ends with what the result has instead of them, or none."""
        if not self.left_out_nm:
            return []
        names = [f"{nm:g}" for nm in sorted(self.left_out_nm)]
        text = not_traced(names, len(names) + len(self.wavelengths_nm), "wavelengths, nm")
        return [Note(f"{text}; {instead}", Code.WAVELENGTHS)]


def in_time(wavelengths: Sequence[float], timed: Callable[[float], Any], traces: int = 1) -> int:
    """
    How many of some wavelengths a time budget allows; all without one.

    What a wavelength takes whatever its rays is measured by two traces of few rays, of which the first compiles.

    Parameters
    ----------
    wavelengths : sequence of float
    timed : callable
        Called with one of them: traces what is timed, with `TIMED_RAYS`.
    traces : int
        Traces that are made at each of them.
    """
    if not is_limited() or len(wavelengths) <= FEWEST:
        return len(wavelengths)
    seconds = 0.0
    for one in (wavelengths[len(wavelengths) // 2], wavelengths[0]):
        began = time.perf_counter()
        timed(one)
        seconds = time.perf_counter() - began
    return min(max(FEWEST, int(PART * left() / (traces * seconds))), len(wavelengths))


def lines_of(scene: Any, wavelength_nm: Any, weights: Any) -> tuple[list[float], list[float]] | None:
    """Wavelengths and weights that a scene is traced at; None where its sources have wavelengths of their own."""
    own = {(tuple(emitter.wavelengths_nm), tuple(emitter.weights)) for emitter in source_emitters(scene)}
    if wavelength_nm is None and weights is None and len(own) != 1:
        return None
    nm, shares = spectrum_of(scene, wavelength_nm, weights)
    return nm.tolist(), shares.tolist()


def chosen_wavelengths(
    scene: Any, beam: Mapping[str, Any], timed: Callable[..., Any], traces: int = 1
) -> WavelengthChoice | None:
    """
    The wavelengths of a trace, where there is no time for all of them.

    Parameters
    ----------
    scene : mi.Scene
    beam : mapping
        What `mistray.trace` is given of the light; ``wavelength_nm`` and ``weights`` are read.
    timed : callable
        Called with ``wavelength_nm``, ``weights`` and ``rays``: traces what is timed.
    traces : int
        Traces that are made of all these wavelengths.

    Returns
    -------
    WavelengthChoice or None
        None where all are traced.
    """
    lines = lines_of(scene, beam.get("wavelength_nm"), beam.get("weights")) if is_limited() else None
    if lines is None:
        return None
    most = in_time(lines[0], lambda nm: timed(wavelength_nm=[nm], weights=None, rays=TIMED_RAYS), traces)
    return WavelengthChoice.of(*lines, most) if most < len(lines[0]) else None

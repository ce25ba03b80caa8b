"""Finished part of a sensitivity analysis, stored in a file from which a later run can continue."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from mistray._mitsuba_compat import holds_numbers, peek
from mistray.analyses.sensitivity.in_time import Taken
from mistray.analyses.sensitivity.proposals import TracedChange
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.files.saved_state import load_state, require_same, save_state
from mistray.metrics.changes.first_surfaces import Entering
from mistray.metrics.changes.gaps import Gap
from mistray.metrics.gradient import Gradient
from mistray.metrics.metric import Metric
from mistray.metrics.one_sided import FullKey

SAVED_S = 5.0  # at most this is lost of the perturbed systems where the process is killed
SAME = 1e-6  # relative difference of a metric that is traced again: sums in another order
_PARTS, _AT_RIMS = "parts_", "at_rims_"  # arrays of a parameter, by its number


class Finished:
    """
    Finished part of a sensitivity analysis: gradient, check of the proposed changes, and perturbed systems.

    Parameters
    ----------
    path : str, Path or None
        NumPy archive, always replaced as a whole; None: nothing is saved.
    signature : mapping
        Facts that must agree with a continued run, see `mistray.files.saved_state.require_same`.

    Attributes
    ----------
    taken : Taken or None
        Gradient; None if it has not been taken.
    check : TracedChange or None
        Traced check of the proposed changes; None until it has all of its seeds.
    systems : list of float
        Metrics of the first perturbed systems.
    """

    def __init__(self, path: str | Path | None, signature: Mapping[str, Any]) -> None:
        self._path, self._signature = path, dict(signature)
        self._saved = time.perf_counter()
        self.taken: Taken | None = None
        self.check: TracedChange | None = None
        self.systems: list[float] = []

    def take(self, taken: Taken) -> None:
        """Keep a gradient; the check and the perturbed systems of another gradient are dropped."""
        if taken is not self.taken:
            self.taken, self.check, self.systems = taken, None, []
            self.save()

    def add(self, value: float) -> None:
        """Store the metric of one more perturbed system; write the file if that was done more than 5 s ago."""
        self.systems.append(value)
        if time.perf_counter() - self._saved > SAVED_S:
            self.save()

    def save(self) -> None:
        """Write the state to its file, if there is one and there is a gradient to save."""
        self._saved = time.perf_counter()
        if self._path is None or self.taken is None:
            return
        found, taken = self.taken.found, self.taken
        keys = list(found.batches)
        arrays = {"noise": found.value_noise, "systems": np.array(self.systems, dtype=np.float64)}
        arrays |= {f"{_PARTS}{number}": found.batches[key] for number, key in enumerate(keys)}
        arrays |= {
            f"{_AT_RIMS}{number}": found.edge_batches[key]
            for number, key in enumerate(keys)
            if key in found.edge_batches
        }
        gradient = {name: getattr(found, name) for name in ("value", "value_se", "edge_width", "edge_number")}
        facts = {
            "signature": self._signature,
            "taken": {"times": taken.times, "seconds": taken.seconds, "look": taken.look},
            "gradient": gradient | {"left_out": found.left_out, "seconds": found.seconds},
            "full": {key: asdict(full) for key, full in found.full.items()},
            "keys": keys,
            "check": None if self.check is None else asdict(self.check),
        }
        save_state(self._path, arrays, facts)

    def read(self, path: str | Path, metric: Metric) -> None:
        """
        Read the finished part from a file, and trace the metric once to verify that it is the same.

        Raises
        ------
        MistrayError
            If there is no such file, it is damaged, or it belongs to another run.
        """
        arrays, facts = load_state(path)
        require_same(path, facts, self._signature)
        try:
            keys, gradient = facts["keys"], facts["gradient"]
            found = Gradient(
                **{**gradient, "seconds": tuple(gradient["seconds"])},
                value_noise=arrays["noise"],
                batches={key: arrays[f"{_PARTS}{number}"] for number, key in enumerate(keys)},
                edge_batches={
                    key: arrays[f"{_AT_RIMS}{number}"]
                    for number, key in enumerate(keys)
                    if f"{_AT_RIMS}{number}" in arrays
                },
                full={key: FullKey(**full) for key, full in facts["full"].items()},
                one_sided={},
            )
            times = float(facts["taken"]["times"])
            taken = Taken(metric.with_rays_times(times * metric.times), found=found, **facts["taken"])
            self.check = None if facts["check"] is None else _check(facts["check"])
            self.systems = arrays["systems"].tolist()
        except (KeyError, TypeError, ValueError, AttributeError):
            raise MistrayError(
                f"state '{path}' is damaged or of another command; remove it and run without resuming"
            ) from None
        _require_value(path, found.value, taken.metric.value())
        self.taken = taken


def numbers_hash(params: Any) -> str:
    """Return a hash of the numbers in `params` that plugins in Python hold, to detect that the scene was changed."""
    digest = hashlib.sha256()
    for key in params.keys():  # noqa: SIM118  SceneParameters iterates over pairs
        if params.properties[key][1] is None and holds_numbers(value := peek(params, key)):
            digest.update(key.encode() + np.array(value, dtype=np.float64).tobytes())
    return digest.hexdigest()


def signature_of(metric: Metric, params: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return the facts in which a saved run must agree.

    These are the metric, the numbers in `params` (see `numbers_hash`), and the arguments in `facts`.
    """
    about = {name: getattr(metric, name) for name in ("name", "field_deg", "wavelength_nm", "weights")}
    return {"metric": about, "settings": dict(metric.settings or {}), **facts, "scene": numbers_hash(params)}


def _check(saved: Mapping[str, Any]) -> TracedChange:
    """Return a `TracedChange` restored from its saved JSON values."""
    entering = {place: tuple(Entering(**one) for one in some) for place, some in saved["entering"].items()}
    gaps = tuple(Gap((str(a), str(b)), float(gap["gap_mm"])) for gap in saved["gaps"] for a, b in [gap["surfaces"]])
    image = None if saved["image"] is None else Estimate(*saved["image"])
    return TracedChange(Estimate(*saved["traced"]), image, gaps, entering, int(saved["seeds"]))


def _require_value(path: str | Path, was: float, value: float) -> None:
    """Raise `MistrayError` if a metric traced again differs from the saved one by more than 1e-6 of it."""
    if not math.isclose(value, was, rel_tol=SAME):
        raise MistrayError(
            f"state '{path}' belongs to another run: the metric was {was:.6g} and is {value:.6g}; use another "
            "file, or run without resuming"
        )

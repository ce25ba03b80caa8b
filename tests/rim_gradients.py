"""Derivatives of detected light by numbers that move rims, from zones of two widths, against known ones."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np
import pytest
from oracles.statistics import assert_z

import mistray
from mistray.optimize import Metric

WRONG = 1.3
Parts = dict[str, np.ndarray]


def parts_of(metric: Metric, keys: Sequence[str], edge_width: float | None = None) -> Parts:
    """Key → derivative by batch (2, 32), with zones of the width and of half of it."""
    found = mistray.gradient(metric, mi.traverse(metric.scene), keys, edge_width=edge_width)
    parts = {}
    for key in keys:
        wide = found.batches[key][:, 0]
        widths = found.edge_batches.get(key)
        more = 0.0 if widths is None else np.subtract(*widths[[found.edge_number + 1, found.edge_number], :, 0])
        parts[key] = np.stack([wide, wide + more])
    return parts


def power_parts(
    scene: mi.Scene, keys: Sequence[str], edge_width: float | None = None, field_deg: float = 0.0, **settings: int
) -> Parts:
    """Of the detected power, W."""
    settings = {"rays": 400_000, "max_scatters": 0} | settings
    metric = Metric(scene, lambda seen: seen[0].power("all"), field_deg=field_deg, settings=settings)
    return parts_of(metric, keys, edge_width)


def sums(by_batch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum over the 32 batches and its standard error."""
    return by_batch.sum(-1), by_batch.std(-1, ddof=1) * np.sqrt(by_batch.shape[-1])


def check(what: str, found: np.ndarray, expected: float, expected_se: float = 0.0) -> None:
    """Derivatives (2, 32) of two widths, none of which may pass with another sign, as 0, or if it is too large."""
    value, se = sums(found)
    assert_z(what, value, expected, np.hypot(se, expected_se), names=[what, f"{what}, half the width"])
    for factor in (-1.0, 0.0, WRONG):
        with pytest.raises(AssertionError):
            assert_z(what, factor * value, expected, np.hypot(abs(factor) * se, expected_se))

"""The check of how scattered light was sampled: shares, limits, words."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from mistray.analysis.aiming_check import sampling_check


@dataclass
class Surface:
    id: str
    aimed: float
    landed: float


@dataclass
class Traced:
    aiming: list[Surface] = field(default_factory=list)
    scattered_rays_per_start: float = 1.0
    largest_ray_share: float = 0.001
    effective_scattered_rays: float = 5000.0


def warnings_of(**values: Any) -> tuple[str, ...]:
    return sampling_check(Traced(**values)).warnings


def test_shares_are_those_of_the_rays():
    check = sampling_check(Traced([Surface("a", 1000, 250), Surface("b", 400, 400)]))
    assert [(row.surface, row.aimed, row.share_landed, row.low) for row in check.rows] == [
        ("a", 1000, 0.25, False),
        ("b", 400, 1.0, False),
    ]
    assert (check.hits_per_start, check.largest_share, check.effective_hits) == (1.0, 0.001, 5000.0)
    assert check.warnings == ()


def test_nothing_scatters_nothing_to_say():
    check = sampling_check(Traced([], 0.0, float("nan"), 0.0))
    assert (check.rows, check.warnings) == ((), ())
    assert np.isnan(check.largest_share)


@pytest.mark.parametrize(("landed", "low"), [(99, True), (100, False), (0, True)])
def test_few_aimed_rays_that_land_are_named(landed, low):
    check = sampling_check(Traced([Surface("window_front", 1000, landed)]))
    assert check.rows[0].low is low
    assert any("window_front" in text for text in check.warnings) is low


def test_a_share_of_a_few_rays_is_no_reason_to_warn():
    assert warnings_of(aiming=[Surface("a", 99, 0)]) == ()
    assert warnings_of(aiming=[Surface("a", 100, 0)]) != ()


def test_the_worst_surfaces_come_first_and_not_all():
    surfaces = [Surface(f"s{k}", 1000, 10 * k) for k in reversed(range(8))]
    (text,) = warnings_of(aiming=surfaces)
    assert "from s0 0 %, s1 1 %, s2 2 %, s3 3 %, s4 4 % and 3 more;" in text


@pytest.mark.parametrize(
    ("hits", "words"), [(0.099, "less than 0.1"), (0.1, None), (10.0, None), (10.1, "more than 10"), (0.0, "less than")]
)
def test_hits_per_start_ray(hits, words):
    texts = warnings_of(aiming=[Surface("a", 1000, 500)], scattered_rays_per_start=hits)
    assert len(texts) == (words is not None)
    assert words is None or words in texts[0]


def test_unaimed_scatter_is_judged_too():
    assert len(warnings_of(scattered_rays_per_start=0.001)) == 1


def test_one_ray_that_brings_much():
    assert warnings_of(largest_ray_share=0.049) == ()
    (text,) = warnings_of(largest_ray_share=0.2)
    assert "20 %" in text

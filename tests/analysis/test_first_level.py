"""First-level analysis: which limits each curve is traced with, and the table of them."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from oracles.small_scenes import plates_text
from report.fake_pst import fake_pst

import mistray
from mistray.analysis.pst.first_level import LIMITS, first_level
from mistray.errors import MistrayError


@pytest.fixture
def scene(load_scene):
    return load_scene(plates_text(1, R=0.1, T=0.9))


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    made: list[dict[str, Any]] = []

    def pst(scene: Any, field_deg: Any, *, progress: Any, **given: Any) -> Any:
        made.append(given)
        if progress:
            progress("state")
        return fake_pst(field_deg)

    monkeypatch.setattr(sys.modules[first_level.__module__], "pst", pst)
    return made


def test_each_curve_has_its_limits(scene, calls):
    found = first_level(scene, [0.0, 20.0], rays=1000, max_scatters=3, max_reflections=2)
    limits = [(call["max_scatters"], call["max_reflections"]) for call in calls]
    assert limits == [(1, 0), (3, 0), (0, 2), (3, 2)]
    assert all(call["rays"] == 1000 for call in calls)
    table = found.to_pandas()
    assert list(table.columns) == ["angle_deg", *(f"{name}{end}" for name in LIMITS for end in ("", "_se"))]
    np.testing.assert_array_equal(table.angle_deg, [0.0, 20.0])
    np.testing.assert_array_equal(table["all"], found.curves["all"].curve("stray")[0])
    np.testing.assert_array_equal(found.to_pandas("direct")["all"], found.curves["all"].curve("direct")[0])


def test_equal_limits_are_traced_once(scene, calls):
    """A scene whose own limit is one scatter event: its light without ghosts is that of one scatter event."""
    found = first_level(scene, [0.0, 20.0])
    assert len(calls) == 3
    assert found.curves["scatter once"] is found.curves["ghosts off"]


def test_other_limits_and_progress(scene, calls):
    seen = []
    limits = {"one ghost": {"max_reflections": 1}, "two": {"max_reflections": 2, "max_scatters": 0}}
    found = first_level(scene, [0.0, 20.0], limits=limits, progress=lambda *at: seen.append(at))
    assert list(found.curves) == ["one ghost", "two"]
    assert found.limits == limits
    assert seen == [("one ghost", "state"), ("two", "state")]


def test_bad_limits(scene, calls):
    with pytest.raises(MistrayError, match="limits is empty"):
        first_level(scene, limits={})
    with pytest.raises(MistrayError, match="'x' changes max_ghosts"):
        first_level(scene, limits={"x": {"max_ghosts": 1}})


@pytest.mark.long
def test_of_a_real_scene():
    """Less light under each limit; one scatter event at most is a part of all."""
    found = first_level(mistray.load("plate_and_wall"), [0.0, 30.0, 60.0], rays=40_000, max_scatters=2)
    table = found.to_pandas()
    slack = 5 * (table["all_se"] + table["scatter once_se"])
    assert np.all(table["scatter once"] <= table["all"] + slack)
    assert np.all(table["scatter off"] <= table["all"] + slack)
    multiple = found.curves["scatter once"].curve("multiple_scatter")[0]
    assert not np.any(multiple)
    assert np.any(found.curves["ghosts off"].curve("multiple_scatter")[0] > 0)
    assert not np.any(found.curves["ghosts off"].curve("ghost")[0])
    assert not np.any(found.curves["scatter off"].curve("single_scatter")[0])

"""First-level analysis: which limits each curve is traced with, and the table of them."""

from __future__ import annotations

import numpy as np
import pytest

import mistray
from mistray.errors import MistrayError

ANGLES = [0.0, 30.0, 60.0]


@pytest.fixture(scope="module")
def scene():
    return mistray.load("plate_and_wall")


@pytest.mark.long
def test_each_curve_has_its_limits(scene):
    """Less light under each limit; one scatter event at most is a part of all."""
    found = mistray.first_level(scene, ANGLES, rays=40_000, max_scatters=2, max_reflections=3)
    limits = {name: [one.facts["settings"][f"max_{what}"] for what in ("scatters", "reflections")]
              for name, one in found.curves.items()}  # fmt: skip
    assert limits == {"scatter once": [1, 0], "ghosts off": [2, 0], "scatter off": [0, 3], "all": [2, 3]}
    table = found.to_pandas()
    assert list(table.columns) == ["angle_deg", *(f"{name}{end}" for name in limits for end in ("", "_se"))]
    np.testing.assert_array_equal(table.angle_deg, ANGLES)
    np.testing.assert_array_equal(table["all"], found.curves["all"].curve("stray")[0])
    np.testing.assert_array_equal(found.to_pandas("direct")["all"], found.curves["all"].curve("direct")[0])
    slack = 5 * (table["all_se"] + table["scatter once_se"])
    assert np.all(table["scatter once"] <= table["all"] + slack)
    assert np.all(table["scatter off"] <= table["all"] + slack)
    assert not np.any(found.curves["scatter once"].curve("multiple_scatter")[0])
    assert np.any(found.curves["ghosts off"].curve("multiple_scatter")[0] > 0)
    assert not np.any(found.curves["ghosts off"].curve("ghost")[0])
    assert not np.any(found.curves["scatter off"].curve("single_scatter")[0])


def test_other_limits_and_progress(scene):
    """Equal limits are traced once: one scatter event is the scene's own limit."""
    found = mistray.first_level(scene, [0.0, 20.0], rays=1000)
    assert found.curves["scatter once"] is found.curves["ghosts off"]
    seen = []
    limits = {"one ghost": {"max_reflections": 1}, "two": {"max_reflections": 2, "max_scatters": 0}}
    found = mistray.first_level(scene, [0.0], limits=limits, rays=1000, progress=lambda name, now: seen.append(name))
    assert (list(found.curves), found.limits) == (list(limits), limits)
    assert list(dict.fromkeys(seen)) == list(limits)
    with pytest.raises(MistrayError, match="limits is empty"):
        mistray.first_level(scene, limits={})
    with pytest.raises(MistrayError, match="'x' changes max_ghosts"):
        mistray.first_level(scene, limits={"x": {"max_ghosts": 1}})

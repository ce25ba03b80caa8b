"""A backward run: what its result says of single rays, and how often it reads and saves its books."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lit_detector import lit
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml
from oracles.small_scenes import interface_xml

import mistray
from mistray.analyses.pst import backward_run
from mistray.analyses.pst.state import PstProgress
from mistray.execute.backward import BackwardTrace
from mistray.files.saved_state import load_state
from mistray.settings import Settings

pytestmark = pytest.mark.quick
RAYS = 8192  # less than a first pass: one pass


@pytest.fixture(scope="module")
def window(load_scene: Any) -> Any:
    rough = scattering_xml([bsdf_xml("abg", A=1e-3, B=1e-2, g=2.0)], "air", "1.5", R=0.4, T=0.5)
    return load_scene(
        scatter_scene(
            beam_xml(1.0),
            placed_xml("asphere", "front", rough, semi_diameter=4.0),
            placed_xml("asphere", "rear", interface_xml("1.5", "air", R=0.4, T=0.6), at=(0, 0, 1), semi_diameter=4.0),
            placed_xml("asphere", "detector", at=(0, 0, 2), pixels=4, semi_diameter=1.0),
        )
    )


def test_the_largest_share_is_of_the_scattered_light_alone(window: Any) -> None:
    """The strongest scattered ray of the same trace over the PST of the classes that scatter; ghosts do not count."""
    found = mistray.pst(window, [0.0, 30.0], cell_deg=10.0, rays=RAYS, max_scatters=2, paths=False, method="adjoint")
    trace = BackwardTrace(window, found.grid, Settings.of(window, max_scatters=2))
    trace.advance(RAYS)
    strongest = np.pi * trace.sums.largest / (found.grid.solid_angle[:, None] * RAYS)
    scattered = found.map(("single_scatter", "multiple_scatter"))[0]
    assert found.largest_share is not None
    np.testing.assert_allclose(found.largest_share * scattered, strongest, rtol=1e-6)
    assert np.all(strongest > 0)
    assert np.all(found.map("ghost")[0] > 0.5 * scattered)  # else ghosts would hardly show


@pytest.mark.core
def test_a_bare_detector_from_the_detector() -> None:
    """PST = cos θ where nothing is in the way; within 4 errors (false alarm 6e-5 each)."""
    scene = lit({"type": "collimated", "radius": 5.0, "distance": 1.0})
    found = mistray.pst(scene, [30.0, 60.0], method="adjoint", rays=1 << 16, seed=1, cell_deg=4.0)
    half = np.radians(2.0)
    for angle, value, se in zip(np.radians([30.0, 60.0]), found.value, found.standard_error, strict=True):
        exact = (np.cos(angle - half) + np.cos(angle + half)) / 2  # the mean over the solid angle of the cell
        assert se < 0.03 * exact
        assert abs(value - exact) < 4 * se


def test_what_has_been_saved_is_not_saved_again(window: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    state, counts = tmp_path / "state.npz", {"save_state": 0, "paths": 0}
    for place, name in ((backward_run, "save_state"), (BackwardTrace, "paths")):
        call = getattr(place, name)

        def counted(*given: Any, name: str = name, call: Any = call) -> Any:
            counts[name] += 1
            return call(*given)

        monkeypatch.setattr(place, name, counted)
    first = mistray.pst(window, [0.0, 30.0], cell_deg=10.0, rays=RAYS, state=state)
    assert counts == {"save_state": 1, "paths": 1}
    again = mistray.pst(window, [0.0, 30.0], cell_deg=10.0, rays=RAYS, state=state, resume=True)
    assert counts == {"save_state": 1, "paths": 2}
    np.testing.assert_array_equal(again.value, first.value)
    assert again.paths(0.0).equals(first.paths(0.0))


def test_an_interrupt_saves_the_pass_that_it_waited_for(
    window: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(backward_run, "SAVING", -1.0)
    reports: list[PstProgress] = []

    def press(now: PstProgress) -> None:
        if not now.rays_done:  # the estimate before the first pass
            assert now.seconds_left > 0
            return
        reports.append(now)
        if len(reports) == 2:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        mistray.pst(window, [0.0], rays=10_000_000, paths=False, state=tmp_path / "s.npz", progress=press)
    arrays, facts = load_state(tmp_path / "s.npz")
    assert facts["passes"] == len(reports) == 2
    assert round(float(arrays["rays"].sum())) == reports[-1].rays_done

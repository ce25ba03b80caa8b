"""A term that reaches 0 is a fine end of a search, and a point without a merit does not lose what was found."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles.small_scenes import plates_text, scene_text, shape_xml, write

from mistray.analyses.optimize.page import write_optimization
from mistray.analyses.optimize.tables import optimization_record, report_text
from mistray.optimize import Metric, optimize

BEAM, BLOCK, FARTHEST = 5.0, 2.0, 9.0  # radii, mm


@pytest.fixture
def beam(tmp_path: Path) -> Path:
    """A beam with a black disc before a detector: 1 - (r/5)² of the light gets past it, and none from r = 5 on."""
    disc = shape_xml("asphere", "disc", 5.0, semi_diameter=BLOCK)
    detector = shape_xml("asphere", "detector", 10.0, sensor=True, half_width=BEAM, half_height=BEAM)
    return write(tmp_path, scene_text(disc, detector, radius=BEAM))


def study(*terms: dict[str, Any], method: str = "sqp", **optimizer: Any) -> dict[str, Any]:
    return {
        "trace": {"rays": 500},
        "term": [{"goal": "minimise", "selection": "all", **term} for term in terms],
        "variable": [{"parameters": ["disc.semi_diameter"], "low": 0.5, "high": FARTHEST}],
        "optimizer": {"method": method, "step_size": 0.4, **optimizer},
    }


@pytest.mark.parametrize("method", ["sqp", "lbfgsb", "adam"])
@pytest.mark.parametrize("kind", ["path_power", "ghost_rms_irradiance"])
def test_a_closed_gap_is_the_result(beam: Path, tmp_path: Path, kind: str, method: str) -> None:
    result = optimize(beam, study({"kind": kind}, method=method), verification_seeds=2)
    assert result.best.terms == {kind: 0.0}
    assert BEAM < result.after["disc.semi_diameter"] <= FARTHEST
    assert "is 0" in result.ended[0]
    assert result.comparison.total.before > 0
    assert (result.comparison.total.after, np.isnan(result.comparison.total.ratio)) == (0.0, True)
    assert np.isfinite(result.best.merit)
    assert "is 0" in report_text(result)
    assert json.loads(json.dumps(optimization_record(result)))["terms"][0]["after"] == 0
    if (kind, method) == ("path_power", "sqp"):
        names = [file.name for file in write_optimization(result, tmp_path / "out")]
        assert {"scene.xml", "report.html", "search.png"} <= set(names)


def test_zero_does_not_outweigh_a_limit(beam: Path) -> None:
    """A disc that takes all the light breaks the limit on what it may take."""
    limit = {"name": "light", "kind": "path_power", "goal": "at_least", "limit_of_start": 0.9, "tolerance": 0.01}
    result = optimize(beam, study({"kind": "path_power"}, limit), verification_seeds=2)
    assert result.best.terms["path_power"] > 0  # the limit costs 1e4 where all light is lost, ln 1e15 is 35
    assert result.best.broken == ()


def test_zero_reflectance_of_a_coating(tmp_path: Path) -> None:
    """A quarter wave of n = √1.5 on n = 1.5 reflects nothing at its wavelength."""
    index = 1.5**0.5
    coated = {
        "term": [{"kind": "path_power", "goal": "minimise", "wavelength_nm": 550.0, "rays": 32}],
        "coating": [{"name": "AR", "surfaces": "all", "layers": f"{index} 60", "thickness_nm": [20.0, 180.0]}],
        "optimizer": {"starts": 1},
    }
    result = optimize(write(tmp_path, plates_text(1)), coated, verification_seeds=2)
    assert result.thickness_nm("AR") == pytest.approx([550 / 4 / index], abs=0.1)
    assert np.isfinite(result.best.merit)


def test_a_point_without_a_merit_ends_the_search_and_keeps_its_steps(beam: Path) -> None:
    """The RMS radius of no light is no number. Past the disc the ring of light has r_rms² = (5² + r²)/2."""
    found = optimize(beam, study({"kind": beyond_the_disc}), verification_seeds=2)
    assert "no merit" in found.ended[0]
    assert found.best.step == 0
    assert found.best.terms["beyond_the_disc"] == pytest.approx(2 / (BEAM**2 + BLOCK**2), rel=0.05)


def beyond_the_disc(scene: Any, selection: str, **traced: Any) -> Any:
    """1/r_rms², which falls as the disc grows."""
    seen = {key: value for key, value in traced.items() if key not in ("field_deg", "wavelength_nm", "weights")}
    return Metric(scene, lambda observations: 1 / observations[0].moments(selection).variance, settings=seen)

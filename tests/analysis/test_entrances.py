"""By which surfaces the detector sees the outside, against the view factor of two discs."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from oracles.small_scenes import interface_xml, scene_text, shape_xml, write

import mistray
from mistray.analysis.entrances import entrances

RADIUS, SHEET, DISTANCE = 3.0, 5.0, 4.0
PASSES = interface_xml(R=0.0, T=1.0)
SHEET_XML = shape_xml("asphere", "sheet", 0.0, PASSES, semi_diameter=SHEET)
DETECTOR = shape_xml("asphere", "detector", DISTANCE, sensor=True, semi_diameter=RADIUS)


def view_factor() -> float:
    """Of a disc to one that faces it on its axis (Siegel and Howell, Thermal Radiation Heat Transfer)."""
    from_, to = RADIUS / DISTANCE, SHEET / DISTANCE
    s = 1 + (1 + to**2) / from_**2
    return 0.5 * (s - math.sqrt(s**2 - 4 * (to / from_) ** 2))


def test_around_a_sheet(tmp_path: Path) -> None:
    """What does not come through the sheet comes straight; 4.5 standard errors, false alarm 7e-6."""
    found = entrances(mistray.load(write(tmp_path, scene_text(SHEET_XML, DETECTOR))))
    assert found.first == "sheet"
    assert list(found.others) == ["detector"]
    assert found.share == pytest.approx(1 - view_factor(), abs=4.5 * found.share_se)
    assert 0.005 < found.share_se < 0.03
    assert "'sheet' but by detector" in str(found)


def test_the_error_is_that_of_seeds(tmp_path: Path) -> None:
    """χ² of 20 seeds between its quantiles 1e-5 and 1 - 1e-5."""
    scene = mistray.load(write(tmp_path, scene_text(SHEET_XML, DETECTOR)))
    seeds = [entrances(scene, seed=seed) for seed in range(20)]
    chi2 = sum(((one.share - 1 + view_factor()) / one.share_se) ** 2 for one in seeds)
    assert 3.0 < chi2 < 60.0


def test_closed(tmp_path: Path) -> None:
    """A tube from the sheet to behind the detector leaves one way in."""
    tube = shape_xml("frustum", "tube", r0=SHEET, z0=0.0, r1=SHEET, z1=DISTANCE + 1)
    found = entrances(mistray.load(write(tmp_path, scene_text(SHEET_XML, tube, DETECTOR))))
    assert (found.share, found.others) == (0.0, {})
    assert found.rays >= 100
    assert "all that the detector sees" in str(found)


def test_without_optics(tmp_path: Path) -> None:
    found = entrances(mistray.load(write(tmp_path, scene_text(DETECTOR))))
    assert (found.first, found.rays) == ("", 0)
    assert "not known" in str(found)

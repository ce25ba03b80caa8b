"""By which surfaces the detector sees the outside, against the view factor of two discs."""

from __future__ import annotations

import math

from oracles.small_scenes import interface_xml, scene_text, shape_xml

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


def test_around_a_sheet(load_scene) -> None:
    """What does not come through the sheet comes straight; χ² of 20 seeds between its quantiles 1e-5 and 1 - 1e-5."""
    scene = load_scene(scene_text(SHEET_XML, DETECTOR))
    seeds = [entrances(scene, seed=seed) for seed in range(20)]
    assert {(found.first, *found.others) for found in seeds} == {("sheet", "detector")}
    assert 3.0 < sum(((one.share - 1 + view_factor()) / one.share_se) ** 2 for one in seeds) < 60.0
    assert all(0.005 < one.share_se < 0.03 for one in seeds)


def test_closed_and_without_optics(load_scene) -> None:
    """A tube from the sheet to behind the detector leaves one way in."""
    tube = shape_xml("frustum", "tube", r0=SHEET, z0=0.0, r1=SHEET, z1=DISTANCE + 1)
    found = entrances(load_scene(scene_text(SHEET_XML, tube, DETECTOR)))
    assert (found.share, found.others) == (0.0, {})
    assert found.rays >= 100
    found = entrances(load_scene(scene_text(DETECTOR)))
    assert (found.first, found.rays) == ("", 0)

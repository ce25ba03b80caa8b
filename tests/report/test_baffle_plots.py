"""Pictures of baffles: their zones and rays are those of the construction."""

from __future__ import annotations

import importlib
from dataclasses import replace
from io import BytesIO

import pytest
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba

from mistray.prescription.baffles.cassegrain import cassegrain_baffles
from mistray.prescription.baffles.tube import vane_tube
from mistray.prescription.baffles.two_stage import two_stage_baffle
from mistray.prescription.baffles.zones import first_order_zones, lit_zones, seen_zones
from mistray.report.baffle_plots import baffle_figure, cassegrain_figure
from mistray.report.figures.palette import BLUE, ORANGE, VERMILION

TUBE = vane_tube("tube", optic_radius=18, z_rear=102, length=102, wall_radius=30, field_deg=4)


def zones(figure, colour):
    """(z0, z1) of the bands of a colour above the axis, sorted."""
    found = []
    for band in figure.axes[0].findobj(PolyCollection):
        if tuple(band.get_facecolor()[0]) == to_rgba(colour):
            z, r = band.get_paths()[0].vertices.T
            if r.min() > 0:
                found.append((z.min(), z.max()))
    return sorted(found)


def test_zones_are_drawn():
    spoiled = replace(TUBE, vanes=TUBE.vanes[:3] + TUBE.vanes[4:])
    for tube in (TUBE, spoiled):
        figure = baffle_figure(tube, title="a tube")
        drawn = ((ORANGE, lit_zones(tube)), (BLUE, seen_zones(tube)), (VERMILION, first_order_zones(tube)))
        for colour, wanted in drawn:
            assert zones(figure, colour) == [pytest.approx(zone) for zone in wanted]
        assert figure.axes[0].get_title() == "a tube"
    assert zones(baffle_figure(spoiled), VERMILION)
    assert not zones(baffle_figure(TUBE), VERMILION)
    # Rays meet the tips
    lines = [line for line in baffle_figure(TUBE).axes[0].lines if line.get_color() == BLUE]
    assert len(lines) == len(TUBE.vanes)
    for line, vane in zip(lines, TUBE.vanes, strict=True):
        (z0, z1), (r0, r1) = line.get_data()
        assert (z0, r0) == (102, -18)
        assert r0 + (r1 - r0) * (vane.z - z0) / (z1 - z0) == pytest.approx(vane.radius)


def test_two_stages_and_a_cassegrain_are_drawn():
    baffle = two_stage_baffle("b", optic_radius=10, z_rear=0, field_deg=5, exclusion_deg=40, depth=8)
    figure = baffle_figure(baffle, exclusion_deg=40)
    assert len(zones(figure, ORANGE)) == len(lit_zones(baffle.outer, 40.0)) + len(lit_zones(baffle.inner))
    telescope = importlib.import_module("mistray.scenes.cassegrain.prescription").build()
    primary, secondary = telescope.surfaces
    rims = cassegrain_baffles(primary, secondary, telescope.detector, field_deg=0.28, wall_depth=4, wall_rear=26)
    picture = cassegrain_figure(telescope, rims, title="telescope")
    assert [text.get_text() for text in picture.axes[0].texts] == ["A", "B"]
    for one in (figure, picture):
        data = BytesIO()
        one.savefig(data, format="png")
        assert data.tell() > 10_000

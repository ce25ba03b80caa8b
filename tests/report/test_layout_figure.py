"""The layout for papers: the section is that of the scene, the rays are those of the history."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from report.fake_trace import SHARES, trace_in_colours
from report.view_scene import A4, CONIC, RADIUS, RayTrace

from mistray.errors import MistrayError
from mistray.report.figures.layout import CANDIDATES, layout_figure, meridional, section, write_layout


@pytest.fixture(scope="module")
def figure(scene, trace):
    return layout_figure(scene, trace, paths=2, rays=4)


def test_rays_are_those_of_the_history_near_the_section(figure, trace):
    axes = figure.axes[0]
    handles, labels = axes.get_legend_handles_labels()
    assert labels == ["0 direct image, 3 W", "1 detector → window_rear, 0.0002 W"]
    for path_id, handle in enumerate(handles):
        drawn = [line for line in axes.lines if line.get_color() == handle.get_color() and len(line.get_xdata())]
        wanted = meridional(trace.history(path_id, CANDIDATES * 4).rays, 4)
        assert len(drawn) == 4
        for line, ray in zip(drawn, wanted, strict=True):
            np.testing.assert_array_equal(line.get_xydata(), ray[:, [2, 1]])
    assert axes.get_aspect() == 1.0


def test_section_of_a_surface_of_revolution_is_exact(scene):
    """A window on the axis; the lens beside the plane is cut through its triangles, which are chords of it."""
    lines = {surface.name: surface.lines for surface in section(scene)}
    (rear,) = lines["window_rear"]
    np.testing.assert_allclose(rear[:, 0], 1.0 - 20.0 + np.sqrt(20.0**2 - rear[:, 1] ** 2), atol=1e-12)
    lens = np.concatenate(lines["L1_front"])
    r2 = 0.3**2 + lens[:, 1] ** 2
    sag = (r2 / RADIUS) / (1 + np.sqrt(1 - (1 + CONIC) * r2 / RADIUS**2)) + A4 * r2**2
    assert np.abs(lens[:, 0] - 3.0 - sag).max() < 2e-3


def test_path_ids_choose_the_rows(scene, trace):
    """Of nine rows the ninth has the colour of the first, in dashes."""
    labels = layout_figure(scene, trace, path_ids=[3, 0], rays=1).axes[0].get_legend_handles_labels()[1]
    assert [label.split()[0] for label in labels] == ["3", "0"]
    nine = RayTrace(trace_in_colours(10.0).fakes, 10.0, shares=SHARES)
    handles, _ = layout_figure(scene, nine, path_ids=range(9), rays=1).axes[0].get_legend_handles_labels()
    looks = [(handle.get_color(), handle.get_linestyle()) for handle in handles]
    assert len(set(looks)) == 9
    assert looks[8] == (looks[0][0], "--")
    axes = layout_figure(scene).axes[0]
    assert (axes.get_legend_handles_labels(), axes.get_title()) == (([], []), "")
    for given, options, words in (
        (trace, {"path_ids": [99]}, "path_id 99 does not exist"),
        (None, {"path_ids": [1]}, "path_ids without a trace"),
        (trace, {"rays": 0}, "rays is 0"),
        (trace, {"paths": -2}, "paths is -2"),
    ):
        with pytest.raises(MistrayError, match=words):
            layout_figure(scene, given, **options)


def test_svg_has_lines_and_text(scene, trace, figure, tmp_path):
    """Text as text, so that a paper's own font and a search find it; the same file every time."""
    path = write_layout(figure, tmp_path / "layout.svg")
    text = path.read_text(encoding="utf-8")
    assert "".join(ET.fromstring(text).itertext()).count("0 direct image, 3 W") == 1
    assert "<image" not in text
    again = write_layout(layout_figure(scene, trace, paths=2, rays=4), tmp_path / "again.svg")
    assert again.read_text(encoding="utf-8") == text
    for ending, start in (("pdf", b"%PDF"), ("eps", b"%!PS"), ("png", b"\x89PNG")):
        assert write_layout(figure, tmp_path / f"layout.{ending}").read_bytes().startswith(start)

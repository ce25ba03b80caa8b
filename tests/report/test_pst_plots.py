"""Pictures of a PST: what they show, on which scale, with which labels."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from report.fake_pst import fake_pst

from mistray.analysis.pst.causes import cause_frame
from mistray.analysis.pst.result import Pst
from mistray.errors import MistrayError
from mistray.report.figures.plots import as_png
from mistray.report.figures.pst import pst_causes, pst_curve, pst_irradiance, pst_map


@pytest.fixture(scope="module")
def pst() -> Pst:
    return fake_pst(map_pixels=16, relative_error=0.02, error_up_to_deg=60)


def lines(axes):
    return {line.get_label(): line for line in axes.get_lines()}


def test_curve_shows_every_class_on_a_log_scale(pst: Pst) -> None:
    above, below = pst_curve(pst, "camera").axes
    drawn = lines(above)
    names = {"all light": "total", "stray light: all but direct": "stray", "direct image": "direct", "ghosts": "ghost",
             "single scatter": "single_scatter", "multiple scatter": "multiple_scatter",
             "straight shots": "straight_shot"}  # fmt: skip
    for label, group in names.items():
        value = pst.curve(group)[0]
        np.testing.assert_array_equal(drawn[label].get_ydata(), np.where(value > 0, value, np.nan))
    assert above.get_yscale() == "log"
    assert below.get_xlabel() == "field angle θ [deg]"
    assert "normal" in above.get_ylabel()
    assert above.get_title() == "camera: point source transmittance, joined, mean over all azimuths"
    assert "cos θ" in pst_curve(pst.to("projected")).axes[0].get_ylabel()


def test_bands_are_one_standard_error(pst: Pst) -> None:
    above, _ = pst_curve(pst).axes
    value, se = pst.curve("total")
    vertices = above.collections[0].get_paths()[0].vertices
    at_40 = vertices[np.isclose(vertices[:, 0], 40.0)][:, 1]
    np.testing.assert_allclose([at_40.min(), at_40.max()], [value[20] - se[20], value[20] + se[20]], rtol=1e-9)


def test_a_point_without_neighbours_has_its_error_too() -> None:
    pst = fake_pst(field_deg=(0, 10, 45, 60))  # straight shots at 45° only
    value, se = pst.curve("straight_shot")
    segments = [line for item in pst_curve(pst).axes[0].collections for line in getattr(item, "get_segments", list)()]
    (bar,) = [line for line in segments if line[0][0] == 45.0]
    np.testing.assert_allclose(bar[:, 1], [value[2] - se[2], value[2] + se[2]])


def test_errors_and_the_one_asked_for_stand_below(pst: Pst) -> None:
    below = lines(pst_curve(pst).axes[1])
    value, se = pst.curve("total")
    np.testing.assert_allclose(below["standard error, all light"].get_ydata(), 100 * se / value)
    np.testing.assert_allclose(below["requested error"].get_xydata(), [[0, 2], [60, 2]])
    np.testing.assert_allclose(below["largest ray of scatter"].get_ydata()[[0, -1]], [0.2, 31])


def test_edge_of_the_field_is_marked(pst: Pst) -> None:
    above, _ = pst_curve(pst).axes
    assert any(text.get_text() == "edge of the field, 26.1°" for text in above.texts)
    assert not pst_curve(fake_pst(field_deg=(40, 50))).axes[0].texts


def test_angles_without_light_are_marked_at_the_bottom() -> None:
    above = pst_curve(fake_pst(dark_from_deg=55)).axes[0]
    marks = lines(above)["no light found"]
    np.testing.assert_array_equal(marks.get_xdata(), np.arange(56, 81, 2))
    assert np.all(marks.get_ydata() < 10 * above.get_ylim()[0])


def test_deep_curves_stay_on_the_axis() -> None:
    """Ten decades between the field and 80°: all light is within the axis."""
    pst = fake_pst()
    pst.by_batch[:, 20:] *= 1e-6
    low, high = pst_curve(pst).axes[0].get_ylim()
    assert low < pst.value.min()
    assert pst.value.max() < high


def test_a_dark_pst_says_so() -> None:
    above, _ = pst_curve(fake_pst(dark_from_deg=0)).axes
    assert [text.get_text() for text in above.texts] == ["no light was seen"]
    assert as_png(pst_causes(fake_pst(dark_from_deg=0))).startswith(b"\x89PNG")


def test_causes_are_stacked_shares(pst: Pst) -> None:
    axes = pst_causes(pst).axes[0]
    table = cause_frame(pst)
    tops = np.zeros(41)
    for bars, name in zip(axes.containers, table.columns, strict=True):
        assert bars.get_label() == name
        np.testing.assert_allclose([bar.get_y() for bar in bars], tops)
        np.testing.assert_allclose([bar.get_height() for bar in bars], table[name], atol=1e-12)
        tops += table[name]
    np.testing.assert_allclose(tops, 100, rtol=1e-6)
    assert axes.get_ylabel() == "share of the stray light [%]"
    assert {"barrel_1", "barrel_1 (reflects)", "ghosts", "window_front", "straight shots"} <= set(table.columns)


def test_many_causes_end_in_a_rest() -> None:
    pst = fake_pst(field_deg=(0, 20, 40))
    rows = pst.path_rows
    copies = [rows.assign(scatter_1=f"wall_{k}", events=f"wall_{k}:r detector:A") for k in range(12)]
    many = type(pst)(**{**vars(pst), "path_rows": type(rows)(np.vstack(copies), columns=rows.columns).infer_objects()})
    labels = [bars.get_label() for bars in pst_causes(many).axes[0].containers]
    assert len(labels) == 10
    assert labels[-1].endswith(" more")


def test_map_shows_the_cells_where_they_are() -> None:
    pst = fake_pst(field_deg=(10, 20, 40), azimuths_deg=(0, 90, 200))
    panels = [axes for axes in pst_map(pst).axes if axes.name == "polar"]
    assert [axes.get_title() for axes in panels] == ["all light", "stray light: all but direct"]
    for axes, group in zip(panels, ("total", "stray"), strict=True):
        (mesh,) = [item for item in axes.collections if isinstance(item, QuadMesh)]
        corners, shown = mesh.get_coordinates(), mesh.get_array()
        middle = (corners[:-1, :-1] + corners[1:, 1:]) / 2
        value = pst.map(group)[0]
        for i, angle in enumerate(pst.field_deg):
            for j, azimuth in enumerate(pst.grid.azimuths_deg):
                turned = np.degrees(middle[..., 0]) - azimuth
                here = (np.abs((turned + 180) % 360 - 180) < 1.0) & np.isclose(middle[..., 1], angle)
                assert here.any()
                np.testing.assert_allclose(shown[here], np.log10(value[i, j]))
        between = np.isclose(middle[..., 1], 15.0)
        assert between.any()
        assert np.ma.getmaskarray(shown)[between].all()
        assert axes.get_theta_offset() == pytest.approx(np.pi / 2)
        assert axes.get_theta_direction() == 1


def test_map_needs_azimuths(pst: Pst) -> None:
    with pytest.raises(MistrayError, match="two azimuths or more"):
        pst_map(pst)


def test_map_of_a_dark_pst() -> None:
    assert as_png(pst_map(fake_pst(azimuths_deg=(0, 90), dark_from_deg=0))).startswith(b"\x89PNG")


def test_irradiance_is_a_log_map_in_mm(pst: Pst) -> None:
    figure = pst_irradiance(pst, 40.0)
    axes, bar = figure.axes
    (image,) = axes.get_images()
    np.testing.assert_allclose(image.get_array(), np.log10(pst.irradiance(40.0)[0]))
    assert tuple(image.get_extent()) == pst.extent_mm
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [mm]", "y [mm]")
    assert "W/mm²" in bar.get_ylabel()
    assert axes.get_title() == "source at 40°, mean over all azimuths"
    assert "relative error of the others 10 %" in figure.get_supxlabel()


def test_irradiance_names_the_azimuth_and_a_dark_detector() -> None:
    several = fake_pst(field_deg=(0, 60), azimuths_deg=(0, 90), map_pixels=4, dark_from_deg=50)
    assert pst_irradiance(several, 0.0, 90.0).axes[0].get_title() == "source at 0°, azimuth 90°"
    (axes,) = pst_irradiance(several, 60.0, 90.0).axes
    assert [text.get_text() for text in axes.texts] == ["no light"]

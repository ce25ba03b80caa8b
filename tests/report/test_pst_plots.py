"""Pictures of a PST: what they show, on which scale."""

from __future__ import annotations

from typing import Any

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


def lines(axes: Any) -> dict[str, Any]:
    return {line.get_label(): line for line in axes.get_lines()}


def texts(axes: Any) -> list[str]:
    return [text.get_text() for text in axes.texts]


def test_curve_shows_every_class_with_its_error(pst: Pst) -> None:
    above, below = pst_curve(pst, "camera").axes
    names = {"all light": "total", "stray light: all but direct": "stray", "direct image": "direct", "ghosts": "ghost",
             "single scatter": "single_scatter", "multiple scatter": "multiple_scatter",
             "straight shots": "straight_shot"}  # fmt: skip
    for label, group in names.items():
        value = pst.curve(group)[0]
        np.testing.assert_array_equal(lines(above)[label].get_ydata(), np.where(value > 0, value, np.nan))
    assert above.get_yscale() == "log"
    assert "edge of the field, 26.1°" in texts(above)
    assert "cos θ" in pst_curve(pst.to("projected")).axes[0].get_ylabel()
    assert not texts(pst_curve(fake_pst(field_deg=(40, 50))).axes[0])
    # Bands are one standard error, which stands below with the one that was asked for
    value, se = pst.curve("total")
    vertices = above.collections[0].get_paths()[0].vertices
    at_40 = vertices[np.isclose(vertices[:, 0], 40.0)][:, 1]
    np.testing.assert_allclose([at_40.min(), at_40.max()], [value[20] - se[20], value[20] + se[20]], rtol=1e-9)
    errors = lines(below)
    np.testing.assert_allclose(errors["standard error, all light"].get_ydata(), 100 * se / value)
    np.testing.assert_allclose(errors["requested error"].get_xydata(), [[0, 2], [60, 2]])
    np.testing.assert_allclose(errors["largest ray of scatter"].get_ydata()[[0, -1]], [0.2, 31])
    # A point without neighbours has its error, too
    few = fake_pst(field_deg=(0, 10, 45, 60))  # straight shots at 45° only
    value, se = few.curve("straight_shot")
    segments = [line for item in pst_curve(few).axes[0].collections for line in getattr(item, "get_segments", list)()]
    (bar,) = [line for line in segments if line[0][0] == 45.0]
    np.testing.assert_allclose(bar[:, 1], [value[2] - se[2], value[2] + se[2]])


def test_dark_angles_and_deep_curves() -> None:
    """Angles without light are marked at the bottom; ten decades between the field and 80° are within the axis."""
    above = pst_curve(fake_pst(dark_from_deg=55)).axes[0]
    marks = lines(above)["no light found"]
    np.testing.assert_array_equal(marks.get_xdata(), np.arange(56, 81, 2))
    assert np.all(marks.get_ydata() < 10 * above.get_ylim()[0])
    deep = fake_pst()
    deep.by_batch[:, 20:] *= 1e-6
    low, high = pst_curve(deep).axes[0].get_ylim()
    assert low < deep.value.min()
    assert deep.value.max() < high
    dark = fake_pst(azimuths_deg=(0, 90), dark_from_deg=0)
    assert texts(pst_curve(dark).axes[0]) == ["no light was seen"]
    for draw in (pst_causes, pst_map):
        assert as_png(draw(dark)).startswith(b"\x89PNG")


def test_causes_are_stacked_shares_and_irradiance_a_log_map(pst: Pst) -> None:
    axes, table, tops = pst_causes(pst).axes[0], cause_frame(pst), np.zeros(41)
    for bars, name in zip(axes.containers, table.columns, strict=True):
        assert bars.get_label() == name
        np.testing.assert_allclose([bar.get_y() for bar in bars], tops)
        np.testing.assert_allclose([bar.get_height() for bar in bars], table[name], atol=1e-12)
        tops += table[name]
    np.testing.assert_allclose(tops, 100, rtol=1e-6)
    # Many causes end in a rest
    few = fake_pst(field_deg=(0, 20, 40))
    rows = few.path_rows
    copies = [rows.assign(scatter_1=f"wall_{k}", events=f"wall_{k}:r detector:A") for k in range(12)]
    many = type(few)(**{**vars(few), "path_rows": type(rows)(np.vstack(copies), columns=rows.columns).infer_objects()})
    labels = [bars.get_label() for bars in pst_causes(many).axes[0].containers]
    assert len(labels) == 10
    assert labels[-1].endswith(" more")
    # Irradiance
    axes, bar = pst_irradiance(pst, 40.0).axes
    (image,) = axes.get_images()
    np.testing.assert_allclose(image.get_array(), np.log10(pst.irradiance(40.0)[0]))
    assert tuple(image.get_extent()) == pst.extent_mm
    assert "W/mm²" in bar.get_ylabel()
    several = fake_pst(field_deg=(0, 60), azimuths_deg=(0, 90), map_pixels=4, dark_from_deg=50)
    assert pst_irradiance(several, 0.0, 90.0).axes[0].get_title() == "source at 0°, azimuth 90°"
    assert texts(pst_irradiance(several, 60.0, 90.0).axes[0]) == ["no light"]


def test_map_shows_the_cells_where_they_are(pst: Pst) -> None:
    around = fake_pst(field_deg=(10, 20, 40), azimuths_deg=(0, 90, 200))
    panels = [axes for axes in pst_map(around).axes if axes.name == "polar"]
    assert [axes.get_title() for axes in panels] == ["all light", "stray light: all but direct"]
    for axes, group in zip(panels, ("total", "stray"), strict=True):
        (mesh,) = [item for item in axes.collections if isinstance(item, QuadMesh)]
        corners, shown = mesh.get_coordinates(), mesh.get_array()
        middle = (corners[:-1, :-1] + corners[1:, 1:]) / 2
        value = around.map(group)[0]
        for i, angle in enumerate(around.field_deg):
            for j, azimuth in enumerate(around.grid.azimuths_deg):
                turned = np.degrees(middle[..., 0]) - azimuth
                here = (np.abs((turned + 180) % 360 - 180) < 1.0) & np.isclose(middle[..., 1], angle)
                assert here.any()
                np.testing.assert_allclose(shown[here], np.log10(value[i, j]))
        between = np.isclose(middle[..., 1], 15.0)
        assert between.any()
        assert np.ma.getmaskarray(shown)[between].all()
        assert axes.get_theta_offset() == pytest.approx(np.pi / 2)
        assert axes.get_theta_direction() == 1
    with pytest.raises(MistrayError, match="two azimuths or more"):
        pst_map(pst)

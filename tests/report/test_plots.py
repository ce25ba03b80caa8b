"""Pictures: what they show, on which scale, with which labels."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from report.fake_scene import FakeShape, lens_scene
from report.fake_trace import ghosts_of, trace_at

from mistray.analysis.irradiance import averaged, log_range
from mistray.errors import MistrayError
from mistray.report.figures.layout import glass_bodies, layout, meridional, section
from mistray.report.figures.plots import (
    common_range,
    draw_map,
    ghost_image,
    image_colours,
    levels_against_field,
    montage,
)


@pytest.fixture(scope="module")
def report():
    return ghosts_of(*map(trace_at, (0.0, 10.0, 20.0)))


def scene_of(*shapes):
    return SimpleNamespace(shapes=lambda: list(shapes))


def drawn(figure):
    return [image for axes in figure.axes for image in axes.get_images()]


def images(figure):
    """Maps, without the hatches, which have colours of their own."""
    return [image for image in drawn(figure) if image.get_array().ndim == 2]


def test_pixels_of_few_rays_are_hatched(report):
    few, value = report.stray_light(20.0).few_rays, report.stray_map(20.0)[0]
    (image, hatch) = drawn(ghost_image(report, 20.0))
    lines = hatch.get_array()[..., 3] > 0
    size = lines.shape[0] // value.shape[0]
    assert size >= 1
    hatched = lines.reshape(value.shape[0], size, value.shape[1], size).any(axis=(1, 3))
    assert not hatched[~few | (value < 10.0 ** image.get_clim()[0])].any()
    assert hatched.any()


def test_ghost_image_shows_log10_of_the_map(report):
    figure = ghost_image(report, 10.0)
    whole, stray = images(figure)
    t, (map_, _) = report[10.0], report.stray_map(10.0)
    for image, expected in ((whole, t.irradiance), (stray, map_)):
        floor, top = image.get_clim()
        assert (floor, top) == log_range([expected], 8.0)
        lit = expected >= 10**floor
        np.testing.assert_allclose(image.get_array()[lit], np.log10(expected[lit]))
        assert np.ma.masked_invalid(image.get_array()).mask[~lit].all()
        assert tuple(image.get_extent()) == pytest.approx(t.extent)
    assert stray.get_clim()[1] < whole.get_clim()[1]
    assert {image.get_clim() for image in images(ghost_image(report, 10.0, (-7.0, 3.0)))} == {(-7.0, 3.0)}
    # Out of field all light is stray light, and drawn once
    (image,) = images(ghost_image(report, 20.0))
    assert np.nansum(10 ** image.get_array()) == pytest.approx(report[20.0].irradiance.sum(), rel=1e-6)
    # A montage shows stray light on scales of their own, or on one
    own, common = images(montage(report)), images(montage(report, common=True))
    assert [image.get_clim() for image in own] == [log_range([report.stray_map(field)[0]], 8.0) for field in report]
    assert {image.get_clim() for image in common} == {common_range(report, stray=True)}
    brightest = max(float(np.nanmax(image.get_array())) for image in own)
    assert brightest < np.log10(report[0.0].irradiance.max()) - 1  # no direct image


def test_averaged_colours_and_dark_maps():
    """Odd sizes: squares at the far edges reach beyond the map and have the mean of what lies on it."""
    image = np.random.default_rng(4).random((11, 7))
    coarse, extent = averaged(image, (-1.0, 2.5, 0.0, 5.5), 4)
    assert coarse.shape == (4, 3)
    assert extent == (-1.0, 3.5, 0.0, 6.0)
    np.testing.assert_allclose(coarse[1, 0], image[3:6, :3].mean())
    np.testing.assert_allclose(coarse[3, 2], image[9:, 6:].mean())
    np.testing.assert_array_equal(averaged(image, (0.0, 1.0, 0.0, 1.0), 11)[0], image)
    # Lightness of the colour map must rise without a break, or steps appear that are not in the data
    rgb = image_colours()(np.linspace(0, 1, 64))[:, :3]
    luminance = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance) > 0).all()
    # A dark map says so
    axes, extent = Figure().subplots(), (-1.0, 1.0, -1.0, 1.0)
    assert draw_map(axes, np.zeros((4, 4)), extent, None) is None
    assert [text.get_text() for text in axes.texts] == ["no light"]
    with pytest.raises(MistrayError, match="the floor must lie below the top"):
        draw_map(axes, np.ones((2, 2)), extent, (2.0, 1.0))


def test_levels_leave_out_what_a_logarithmic_axis_cannot_show(report):
    left = levels_against_field(report).axes[0]
    labels = left.get_legend_handles_labels()[1]
    assert labels == ["direct image", "ghost", "structure"]
    direct = left.containers[0].lines[0].get_xdata()
    np.testing.assert_array_equal(direct, [0.0, 10.0])


def test_sections_glass_and_rays_of_a_layout():
    mirror = FakeShape("fold", "fold", [[0.0, 0.0], [1.0, 0.0]], 0.0, mirror=True)
    c = np.sqrt(0.5)
    mirror.matrix[:3, :3] = [[1, 0, 0], [0, c, -c], [0, c, c]]
    (surface,) = section(scene_of(mirror))
    assert surface.kind == "mirror"
    np.testing.assert_allclose(surface.lines[0][-1], [c, c], atol=1e-12)
    # L1 of the fake lens has rims at r = 1 and an edge of r = 1 between z = 1.05 and 1.5; here one that is pointed
    window, _ = glass_bodies(lens_scene())
    assert (window[:, 0].min(), window[:, 0].max(), window[:, 1].max()) == (0.0, 0.3, 1.2)
    front, rear, _ = (shape for shape in lens_scene().shapes() if shape.part == "L1")
    sides = [
        FakeShape(name, "L1", [[1.0, z], [1.2, 1.2]], 0.0, "nd=1.6 Vd=30", "air", opaque=True)
        for name, z in (("L1_edge", 1.05), ("L1_bevel", 1.5))
    ]
    (body,) = glass_bodies(scene_of(front, rear, *sides))
    assert (body[:, 1].max(), body[:, 1].min()) == (1.2, -1.2)
    # Meridional rays spread over the pupil and stay near the plane
    rng = np.random.default_rng(0)
    starts = rng.uniform(-1, 1, (64, 2))
    rays = [np.array([[x, y, 0.0], [x, y, 1.0]]) for x, y in starts]
    chosen = meridional(rays, 7)
    heights = [ray[0, 1] for ray in chosen]
    assert len(chosen) == 7
    assert max(heights) - min(heights) > 1.2
    assert np.mean([abs(ray[0, 0]) for ray in chosen]) < 0.5 * np.mean(np.abs(starts[:, 0]))
    assert meridional([], 7) == []
    assert len(meridional(rays[:2], 7)) == 2


def test_layout_says_which_path_is_too_rare():
    t = trace_at(20.0)
    sampled = t.sampled_rays
    (kept,) = [k for k, path in enumerate(t.fakes) if "detector:R L1_rear:R" in path.events]
    t.sampled_rays = lambda ids, n: {i: rays if i == kept else [] for i, rays in sampled(ids, n).items()}
    report = ghosts_of(t, nominal=trace_at(0.0))
    labels = layout(report, 20.0, ghosts=2).axes[0].get_legend_handles_labels()[1]
    assert labels == ["detector → L1_rear (ghost)", "detector → window_rear (ghost), too rare to draw"]


def test_layout_draws_the_worst_ghosts_or_the_paths_asked_for(report):
    """Out of field the worst and the strongest stray path."""
    lens, window = "detector → L1_rear (ghost)", "detector → window_rear (ghost)"
    for field, ghosts, wanted in (
        (10.0, 2, ["direct image", lens, window]),
        (10.0, 0, ["direct image"]),
        (20.0, 1, [lens, window]),
    ):
        assert layout(report, field, ghosts=ghosts).axes[0].get_legend_handles_labels()[1] == wanted
    table = report.table(10.0)
    direct, other = (table.path_id[rows].iloc[0] for rows in (table.kind == "direct", table.ghost_2 == "window_rear"))
    handles, labels = layout(report, 10.0, path_ids=[direct, other]).axes[0].get_legend_handles_labels()
    assert labels == [f"path {direct}: direct image", f"path {other}: detector → window_rear"]
    assert handles[0].get_color() != handles[1].get_color()
    with pytest.raises(MistrayError, match="path 99 is not in the table of field 10 deg"):
        layout(report, 10.0, path_ids=[99])

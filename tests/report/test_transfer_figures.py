"""Pictures of an image with stray light hold its curves, also where there is no stray light or one frequency."""

from __future__ import annotations

import io

import numpy as np
import pytest
from oracles.rough_paraboloid import paraboloid_text
from oracles.scatter_scenes import bsdf_xml
from PIL import Image

import mistray
from mistray.analyses.transfer.figures import image_figure, mtf_figure, spread_figure
from mistray.analyses.transfer.page import transfer_parts
from mistray.report.figures.plots import as_png
from mistray.report.model import FigurePart

HALO = bsdf_xml("abg", A=1e-3, B=1e-6, g=2.0, event="reflection")


@pytest.fixture(scope="module")
def halo(load_scene):
    return mistray.transfer(load_scene(paraboloid_text(HALO, detector=5.0)), rays=3000, pixel_mm=0.004)


def test_curves_are_those_of_the_result(halo):
    """Rings of the spread function keep its flux."""
    (one,) = halo
    left, right = mtf_figure(one, "mirror").axes
    drawn = {line.get_label(): line.get_ydata() for line in left.lines}
    np.testing.assert_allclose(drawn["lens alone, tangential"], one.lens())
    np.testing.assert_allclose(drawn["with stray light and detector, sagittal"], one.composite("sagittal").value)
    lost = {line.get_label(): line.get_ydata() for line in right.lines}
    assert lost["scatter"][-1] == pytest.approx(100 * (1 - one.veiling_floor.value), rel=0.2)
    np.testing.assert_allclose(lost["ghosts"], 0, atol=1e-9)
    irradiance, *rings = spread_figure(one).axes
    assert [line.get_label() for line in irradiance.lines] == ["all light", "direct", "scatter"]
    within, outside = ({line.get_label(): line.get_ydata() for line in axes.lines} for axes in rings)
    np.testing.assert_allclose(within["with stray light"] + outside["with stray light"], 1)


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({}, marks=pytest.mark.long),
        {"frequencies_per_mm": [3.0]},
        pytest.param({"frequencies_per_mm": [0.0]}, marks=pytest.mark.long),
    ],
)
def test_no_stray_light_and_few_frequencies(load_scene, options):
    (one,) = mistray.transfer(load_scene(paraboloid_text()), rays=200, **options)
    for draw in (mtf_figure, spread_figure, image_figure):
        picture = Image.open(io.BytesIO(as_png(draw(one, "a $ mirror"))))
        assert np.asarray(picture.convert("L")).std() > 5


def test_an_image_is_drawn_as_far_as_the_pupil_resolves_it(halo, monkeypatch):
    """An image far beside the image point, or a blurred one, may ask for more."""
    (one,) = halo
    monkeypatch.setattr("mistray.analyses.transfer.figures.WIDTHS", (1e5, 1e6))
    for axes in image_figure(one).axes[:2]:
        left, right, *_ = axes.images[0].get_extent()
        assert right - left == pytest.approx(2e3 * one.image.largest_radius_mm, rel=2e-3)


@pytest.mark.long
def test_an_image_far_out_of_focus_has_words_instead_of_pictures():
    """Of a point 500 mm before a lens for distant objects the wavefront is steeper than any grid of the default."""
    found = mistray.transfer(mistray.load("cooke_triplet", "point:0,0,-500"), rays=1000)
    parts = transfer_parts(found, "triplet")
    assert not any(isinstance(part, FigurePart) for part in parts)
    assert any("wavefront" in str(part) and "focus" in str(part) for part in parts)

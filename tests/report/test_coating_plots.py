"""Pictures of coatings: what is drawn is what the coating says."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import mistray
from mistray.coatings import Bare, Ideal, preset, spectrum
from mistray.errors import MistrayError
from mistray.report.figures.coating import coated_surfaces, coating_figure, surfaces_figure

WAVELENGTHS = np.arange(450.0, 651.0, 50.0)


def curve(axes, label: str) -> np.ndarray:
    return next(item for item in axes.get_lines() if item.get_label() == label).get_ydata()


def test_lines_are_the_spectra() -> None:
    figure = coating_figure(preset("bbar3"), WAVELENGTHS, [0.0, 40.0], back="1.5168")
    left, right = figure.axes
    values = spectrum(preset("bbar3"), WAVELENGTHS, [0.0, 40.0], back="1.5168")
    np.testing.assert_allclose(curve(left, "0°"), 100 * values.mean()[:, 0])
    (colour,) = (item.get_color() for item in left.get_lines() if item.get_label() == "40°")
    drawn = {item.get_linestyle(): item.get_ydata() for item in left.get_lines() if item.get_color() == colour}
    for style, share in (("-", values.mean()[:, 1]), ("--", values.R[:, 1, 0]), (":", values.R[:, 1, 1])):
        np.testing.assert_allclose(drawn[style], 100 * share)
    by_angle = {item.get_label(): item for item in right.get_lines()}
    for nm in (450, 550, 650):
        item = by_angle[f"{nm} nm"]
        at = spectrum(preset("bbar3"), [nm], item.get_xdata(), back="1.5168").mean()[0]
        np.testing.assert_allclose(item.get_ydata(), 100 * at)
    assert (right.get_yscale(), left.get_ylim()[0]) == ("log", 0)
    assert curve(left, "bare, 0°")[0] == pytest.approx(4.21646, abs=1e-4)
    # Scales and axes
    left, right = coating_figure(preset("protected_al"), WAVELENGTHS, [0.0]).axes  # a mirror
    assert right.get_yscale() == left.get_yscale() == "linear"
    assert all(not str(item.get_label()).startswith("bare") for item in left.get_lines())
    left, _ = coating_figure(Bare(), WAVELENGTHS, [0.0, 60.0], from_front=False).axes  # total reflection
    assert left.get_yscale() == "log"
    figure = coating_figure(Ideal(0.1, 0.9, "split"), WAVELENGTHS, [0.0], "air", "N-SF6", from_front=False)
    assert figure.axes[1].get_xlabel() == "angle of incidence in N-SF6 [deg]"
    assert figure.get_suptitle() == "split, N-SF6 | air, light from N-SF6"


def test_one_row_for_each_kind_of_surface() -> None:
    coated = {"back": "1.6", "coating": {"type": "ref", "id": "ar"}}
    bsdfs = {
        "a": coated,
        "b": {"front": "1.6", "back": "air"},
        "c": coated,
        "d": {"front": "1.6", "R": 0.9, "mirror": True},
        "wall": {"R": 0.0},
    }
    shapes = {
        name: {"type": "asphere", "semi_diameter": 5.0, "z": 2.0 * k, "bsdf": {"type": "interface", **bsdf}}
        for k, (name, bsdf) in enumerate(bsdfs.items())
    }
    scene = mistray.load({"type": "scene", "ar": {"type": "thinfilm", "preset": "bbar3"}, **shapes})
    groups = coated_surfaces(scene)
    assert [group.names for group in groups] == [("a", "c"), ("b",), ("d",)]
    assert groups[0].coating.name == "ar"
    assert (groups[1].front, groups[1].back) == ("1.6", "air")
    assert isinstance(groups[1].coating, Bare)
    figure = surfaces_figure(groups, WAVELENGTHS, [0.0, 30.0])
    assert len(figure.axes) == 6
    first = figure.axes[0]
    assert first.get_title(loc="left") == "a, c"
    expected = spectrum(groups[0].coating, WAVELENGTHS, [30.0], "air", "1.6").mean()[:, 0]
    np.testing.assert_allclose(curve(first, "30°"), 100 * expected)
    # the rear of a lens is drawn from the air as well
    behind = spectrum(Bare(), WAVELENGTHS, [30.0], "1.6", "air", from_front=False).mean()[:, 0]
    np.testing.assert_allclose(curve(figure.axes[2], "30°"), 100 * behind)
    with pytest.raises(MistrayError, match="no optical surface"):
        coated_surfaces(SimpleNamespace(shapes=list))

"""Paints: energy and reciprocity at grazing angles, presets, bad numbers."""

from __future__ import annotations

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.physics.paint import gain
from mistray.scatter.evaluate import bsdf
from mistray.scatter.paint import PRESETS, Paint
from mistray.scatter.total import lobe_total

GLOSSY = {"reflectance": 0.045, "b0": 0.05, "l": 0.1, "s": -3.0}


def direction(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    parts = (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def value(paint: Paint, theta_i: float, theta_s: float, phi: float) -> float:
    lobes = paint.lobes(550, 1.0, 1.5, True)
    return float(bsdf(lobes, "reflection", np.cos(theta_i), direction(theta_s, phi), 1.0, 1.5, 0.3))


def total(paint: Paint, angle_deg: float) -> float:
    cosine = np.cos(np.radians([angle_deg]))
    return sum(float(lobe_total(lobe, cosine, 1.0, 1.5)[0]) for lobe in paint.lobes(550, 1, 1.5, True))


def quadrature(paint: Paint, angle_deg: float) -> float:
    """∫ f cos θs dΩ on a grid of its own."""
    edges_t, edges_p = np.linspace(0, np.pi / 2, 401), np.linspace(0, np.pi, 361)
    t, p = 0.5 * (edges_t[1:] + edges_t[:-1]), 0.5 * (edges_p[1:] + edges_p[:-1])
    lobes = paint.lobes(550, 1.0, 1.5, True)
    f = bsdf(lobes, "reflection", np.cos(np.radians(angle_deg)), direction(t[:, None], p), 1.0, 1.5, 0.3)
    cell = np.diff(np.sin(edges_t) ** 2)[:, None] / 2 * np.diff(edges_p)
    return 2 * float(np.sum(f * cell))


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_lambertian(name: str) -> None:
    paint = Paint.preset(name)
    for angle in (0.0, 45.0, 89.0):
        assert value(paint, np.radians(angle), 1.2, 2.0) == pytest.approx(PRESETS[name] / np.pi, rel=1e-12)
        assert total(paint, angle) == pytest.approx(PRESETS[name], rel=1e-5)


def test_flat_black_of_the_phone_camera() -> None:
    assert total(Paint.preset("flat_black"), 0.0) == pytest.approx(0.045, rel=1e-5)


@pytest.mark.parametrize("n", [None, 1.5])
@pytest.mark.parametrize("angle", [0.0, 45.0, 70.0, 85.0])
def test_total_by_quadrature(n: float | None, angle: float) -> None:
    paint = Paint(**GLOSSY, n=n)
    # The quadrature's cells of 0.2° resolve the lobe of 6° to better than this
    assert total(paint, angle) == pytest.approx(quadrature(paint, angle), rel=1e-3)


def test_scatter_by_its_formula() -> None:
    theta_i, theta_s, phi = 0.9, 0.5, 0.7
    plain = Paint(**GLOSSY)
    r = np.hypot(np.sin(theta_s) * np.cos(phi) - np.sin(theta_i), np.sin(theta_s) * np.sin(phi))
    expected = 0.045 / np.pi + 0.05 * (1 + (r / 0.1) ** 2) ** -1.5
    assert value(plain, theta_i, theta_s, phi) == pytest.approx(expected, rel=1e-12)
    grown = Paint(**GLOSSY, n=1.5)
    expected += 0.05 * (1 + (r / 0.1) ** 2) ** -1.5 * (gain(np.cos(theta_i), np.cos(theta_s), 1.5) - 1)
    assert value(grown, theta_i, theta_s, phi) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(("n", "limit_deg", "tolerance"), [(None, 89.9, 1e-12), (1.5, 89.9, 1e-3)])
def test_reciprocal(n: float | None, limit_deg: float, tolerance: float) -> None:
    paint = Paint(**GLOSSY, n=n)
    rng = np.random.default_rng(7)
    for theta_i, theta_s, phi in rng.random((300, 3)) * np.radians([limit_deg, limit_deg, 180]):
        assert value(paint, theta_i, theta_s, phi) == pytest.approx(value(paint, theta_s, theta_i, phi), rel=tolerance)


def test_gloss_grows_towards_grazing_and_keeps_energy() -> None:
    paint = Paint(**GLOSSY, n=1.5)
    totals = [total(paint, angle) - 0.045 for angle in (0.0, 60.0, 80.0)]
    assert totals[1] > 1.5 * totals[0]
    assert totals[2] > totals[1]
    with pytest.raises(MistrayError, match=r"scatters 1\.\d+ of the light at \d+.*°"):
        Paint(0.9, b0=1.0, l=0.1, s=-3, n=1.5)
    assert total(Paint(0.9, b0=1.0, l=0.1, s=-3), 89.0) < 1  # without growth it is less there than at 0°


def test_options() -> None:
    assert [lobe.event for lobe in Paint(0.1).lobes(550, 1, 1.5, True)] == ["reflection"]
    assert Paint(0.1).lobes(550, 1, 1.5, True)[0].shares == (1.0, 0.0, 0.0)
    assert Paint(0.1, side="back").lobes(550, 1, 1.5, True) == ()
    assert Paint.preset("flat_black", relative_to="specular").lobes(550, 1, 1.5, True)[0].shares == (0.0, 1.0, 0.0)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"reflectance": 1.2}, "Paint: reflectance is 1.2; it must lie between 0 and 1"),
        ({"reflectance": float("nan")}, "reflectance is nan"),
        ({"b0": -1.0}, "b0 is -1"),
        ({"b0": 1.0, "l": 0.0}, "l is 0; it must"),
        ({"b0": 1.0, "s": 0.5}, "s is 0.5; it must"),
        ({"b0": 1.0, "n": 1.0}, "n is 1; it must"),
        ({}, "nothing is scattered; leave the model out"),
        ({"reflectance": 0.99, "b0": 1.0}, "of the light at 0°; lower reflectance or b0"),
    ],
)
def test_bad_numbers(given: dict, words: str) -> None:
    with pytest.raises(MistrayError) as error:
        Paint(**given)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_unknown_preset() -> None:
    with pytest.raises(MistrayError, match="'flat_blak' is unknown"):
        Paint.preset("flat_blak")

"""Stacks of layers: which side is which, agreement with `tmm`, shifts, text."""

from __future__ import annotations

import re

import numpy as np
import pytest

from mistray.coatings import Bare, Layer, Stack, layer_text, parse_layers
from mistray.errors import MistrayError

tmm = pytest.importorskip("tmm")
pytestmark = pytest.mark.quick

ABSORBING = (Layer("1.38", 120.0), Layer("2.3+0.4i", 15.0), Layer("1.6", 90.0))
NUMBERS = [(1.38 + 0j, 120.0), (2.3 + 0.4j, 15.0), (1.6 + 0j, 90.0)]
COSINES = np.cos(np.radians([0.0, 20.0, 45.0, 70.0, 89.0]))
AIR, GLASS, METAL = 1 + 0j, 1.5168 + 0j, 0.958 + 6.69j


def compare(
    stack: Stack | Bare, front: complex, back: complex, from_front: bool, layers: list[tuple[complex, float]]
) -> None:
    """With `tmm`; `layers` in the order of incidence."""
    own = stack.response(550.0, front, back, COSINES, from_front)
    ends = (front, back) if from_front else (back, front)
    index, thickness = [ends[0], *(n for n, _ in layers), ends[1]], [np.inf, *(d for _, d in layers), np.inf]
    for k, cosine in enumerate(COSINES):
        s, p = (tmm.coh_tmm(pol, index, thickness, np.arccos(cosine), 550.0) for pol in "sp")
        np.testing.assert_allclose(own.R[k], [s["R"], p["R"]], atol=1e-10)
        np.testing.assert_allclose(own.T[k], [s["T"], p["T"]], atol=1e-10)
        turn = np.angle(s["r"] * np.conj(p["r"]))
        np.testing.assert_allclose(np.exp(1j * own.phase_r[k]), np.exp(1j * turn), atol=1e-8)
        if min(s["T"], p["T"]) > 1e-9:
            turn = np.angle(s["t"] * np.conj(p["t"]))
            np.testing.assert_allclose(np.exp(1j * own.phase_t[k]), np.exp(1j * turn), atol=1e-8)


@pytest.mark.parametrize(
    ("first", "front", "back", "first_is_front"),
    [
        ("outside", AIR, GLASS, True),
        ("outside", GLASS, AIR, False),
        ("outside", AIR, AIR, True),
        ("outside", GLASS, GLASS, True),
        ("outside", GLASS, METAL, True),  # n of the metal is lower: it is the substrate all the same
        ("outside", METAL, GLASS, False),
        ("front", AIR, GLASS, True),
        ("front", GLASS, AIR, True),
        ("back", AIR, GLASS, False),
        ("back", GLASS, AIR, False),
    ],
)
def test_where_the_first_layer_lies(first: str, front: complex, back: complex, first_is_front: bool) -> None:
    stack = Stack(ABSORBING, first)
    indices, thickness, order = stack.front_to_back(550.0, front, back)
    own = NUMBERS if first_is_front else NUMBERS[::-1]
    np.testing.assert_allclose(indices, [n for n, _ in own])
    np.testing.assert_allclose(thickness, [d for _, d in own])
    assert order.tolist() == ([0, 1, 2] if first_is_front else [2, 1, 0])
    if front.imag == 0:
        compare(stack, front, back, True, own)
        compare(Bare(), front, back, True, [])
    if back.imag == 0:
        compare(stack, front, back, False, own[::-1])


def test_the_sides_of_an_absorbing_stack_differ() -> None:
    """The test above would not see a stack taken the wrong way round if these were equal."""
    from_air, from_glass = (Stack(ABSORBING).response(550.0, AIR, GLASS, COSINES[:1], side) for side in (True, False))
    turned = Stack(ABSORBING, "back").response(550.0, AIR, GLASS, COSINES[:1], True)
    for other in (from_glass, turned):
        assert abs(from_air.R - other.R).min() > 0.003
    np.testing.assert_allclose(from_air.T, from_glass.T, atol=1e-12)


def test_opaque_stacks_pass_nothing() -> None:
    layers = (Layer("1.6", 171.875), Layer("0.958+6.69i", 150.0))
    shut, open_ = (Stack(layers, opaque=opaque).response(550.0, AIR, GLASS, COSINES, True) for opaque in (True, False))
    assert np.all(shut.T == 0)
    np.testing.assert_array_equal(shut.R, open_.R)
    assert open_.T.max() < 1e-9, "150 nm of aluminium are dark, so that the statement is true"
    assert [Stack(layers, opaque=opaque).opaque for opaque in (True, False)] == [True, False]


def test_shifts_are_added_at_every_wavelength() -> None:
    layer = Layer("N-BK7", 100.0, n_shift=0.02, k_shift=1e-3)
    for wavelength in (450.0, 650.0):
        plain = Layer("N-BK7", 100.0).index(wavelength)
        assert layer.index(wavelength) == pytest.approx(plain + 0.02 + 1e-3j, abs=1e-15)


def test_what_is_no_stack() -> None:
    for layers, first, nm, words in (
        ([Layer("1.38", -1.0)], "outside", 550.0, "layer 1 (1.38): thickness_nm is "),
        ([Layer("1.38", float("nan"))], "outside", 550.0, "layer 1 (1.38): thickness_nm is "),
        ([], "top", 550.0, "first = 'top'"),
        ([Layer("MgF", 10.0)], "outside", 550.0, "layer 1: material 'MgF' is unknown"),
        ([Layer("N-BK7", 10.0)], "outside", 5000.0, "layer 1: material 'N-BK7': 5000 nm is outside of its 3"),
        ([Layer("nd=1.6 Vd=50", 10.0)], "outside", 550.0, "layer 1: material 'nd=1.6 Vd=50': k is unknown"),
        ([Layer("1.38", 9.0), Layer("1.6+0.4i", 90.0, 0.0, -0.5)], "outside", 550.0, "layer 2 (1.6+0.4i): n = 1.6, k"),
        ([Layer("1.38", 9.0), Layer("1.6+0.4i", 90.0, -1.7, 0.0)], "outside", 550.0, "layer 2 (1.6+0.4i): n = -0.1, k"),
    ):
        with pytest.raises(MistrayError, match=f"^coating 'ar'.*{re.escape(words)}"):
            Stack(tuple(layers), first, "ar").response(nm, AIR, GLASS, COSINES, True)
    for text, design_nm, words in (
        ("MgF2 10, ", 550.0, "layer 2: '' has no material and thickness; write 'material thickness'"),
        ("MgF2 10 nm", 550.0, "layer 1: 'MgF2 10 nm' has no"),
        ("MgF 0.25w", 550.0, "layer 1: material 'MgF' is unknown"),
        ("1.38 10, 0.2 20", 550.0, "layer 2: material '0.2'"),
        ("1.38 0.25w", 0.0, "design_nm = 0"),
    ):
        with pytest.raises(MistrayError, match=f"^coating 'ar'.*{re.escape(words)}"):
            parse_layers(text, design_nm, name="ar")


def test_layers_from_text_and_back() -> None:
    layers = parse_layers("MgF2 99.64, 2.1 0.5w\n 1.63+0.001i   84.4,nd=1.6 Vd=50 k=0 10", 500.0)
    assert [layer.material for layer in layers] == ["MgF2", "2.1", "1.63+0.001i", "nd=1.6 Vd=50 k=0"]
    np.testing.assert_allclose([layer.thickness_nm for layer in layers], [99.64, 0.5 * 500 / 2.1, 84.4, 10.0])
    (layer,) = parse_layers("N-BK7 0.25w", 486.1327)
    assert layer.thickness_nm == pytest.approx(0.25 * 486.1327 / 1.52238, rel=1e-5)
    (layer,) = parse_layers("my glass.csv 20", resolve=lambda path: f"/scenes/{path}")
    assert layer.material == "/scenes/my glass.csv"
    rng = np.random.default_rng(3)
    layers = tuple(Layer(material, 300 * rng.random()) for material in ["MgF2", "1.5+0.1i", "TiO2"] * 4)
    assert parse_layers(layer_text(layers)) == layers
    for layer, words in ((Layer("1.38", 10.0, 0.1), "n_shift = 0.1, k_shift = 0"), (Layer("a,b.csv", 1.0), "a comma")):
        with pytest.raises(MistrayError, match=words):
            layer_text([layer])

"""Stacks of layers: which side is which, agreement with `tmm`, shifts, text."""

from __future__ import annotations

import numpy as np
import pytest
import tmm

from mistray.coatings import Layer, Stack, layer_text, parse_layers
from mistray.errors import MistrayError

pytestmark = pytest.mark.quick

ABSORBING = (Layer("1.38", 120.0), Layer("2.3+0.4i", 15.0), Layer("1.6", 90.0))
NUMBERS = [(1.38 + 0j, 120.0), (2.3 + 0.4j, 15.0), (1.6 + 0j, 90.0)]
COSINES = np.cos(np.radians([0.0, 20.0, 45.0, 70.0, 89.0]))
AIR, GLASS, METAL = 1 + 0j, 1.5168 + 0j, 0.958 + 6.69j


def by_tmm(n_in: complex, layers: list[tuple[complex, float]], n_out: complex, cosine: float, nm: float) -> dict:
    """R, T and phases of s against p."""
    index, thickness = [n_in, *(n for n, _ in layers), n_out], [np.inf, *(d for _, d in layers), np.inf]
    s, p = (tmm.coh_tmm(pol, index, thickness, np.arccos(cosine), nm) for pol in "sp")
    return {
        "R": [s["R"], p["R"]],
        "T": [s["T"], p["T"]],
        "phase_r": np.angle(s["r"] * np.conj(p["r"])),
        "phase_t": np.angle(s["t"] * np.conj(p["t"])),
    }


def compare(stack: Stack, front: complex, back: complex, from_front: bool, layers: list[tuple[complex, float]]) -> None:
    """`layers` in the order of incidence."""
    own = stack.response(550.0, front, back, COSINES, from_front)
    ends = (front, back) if from_front else (back, front)
    for k, cosine in enumerate(COSINES):
        other = by_tmm(ends[0], layers, ends[1], cosine, 550.0)
        np.testing.assert_allclose(own.R[k], other["R"], atol=1e-10)
        np.testing.assert_allclose(own.T[k], other["T"], atol=1e-10)
        np.testing.assert_allclose(np.exp(1j * own.phase_r[k]), np.exp(1j * other["phase_r"]), atol=1e-8)
        if min(other["T"]) > 1e-9:
            np.testing.assert_allclose(np.exp(1j * own.phase_t[k]), np.exp(1j * other["phase_t"]), atol=1e-8)


class TestSides:
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
    def test_where_the_first_layer_lies(self, first: str, front: complex, back: complex, first_is_front: bool) -> None:
        stack = Stack(ABSORBING, first)
        indices, thickness, order = stack.front_to_back(550.0, front, back)
        own = NUMBERS if first_is_front else NUMBERS[::-1]
        np.testing.assert_allclose(indices, [n for n, _ in own])
        np.testing.assert_allclose(thickness, [d for _, d in own])
        assert order.tolist() == ([0, 1, 2] if first_is_front else [2, 1, 0])
        if front.imag == 0:
            compare(stack, front, back, True, own)
        if back.imag == 0:
            compare(stack, front, back, False, own[::-1])

    def test_the_sides_of_an_absorbing_stack_differ(self) -> None:
        """The tests above would not see a stack taken the wrong way round if these were equal."""
        stack = Stack(ABSORBING)
        from_air = stack.response(550.0, AIR, GLASS, COSINES[:1], True)
        from_glass = stack.response(550.0, AIR, GLASS, COSINES[:1], False)
        assert abs(from_air.R - from_glass.R).min() > 0.003
        np.testing.assert_allclose(from_air.T, from_glass.T, atol=1e-12)
        turned = Stack(ABSORBING, "back").response(550.0, AIR, GLASS, COSINES[:1], True)
        assert abs(from_air.R - turned.R).min() > 0.003

    def test_transmission_is_reciprocal_and_nothing_is_gained(self) -> None:
        outside = np.linspace(0.02, 1, 50)
        inside = np.sqrt(1 - (1 - outside**2) / GLASS.real**2)
        stack = Stack(ABSORBING)
        one, other = stack.response(550.0, AIR, GLASS, outside, True), stack.response(550.0, AIR, GLASS, inside, False)
        np.testing.assert_allclose(one.T, other.T, atol=1e-12)
        assert min(one.A.min(), other.A.min()) > 0.01
        clear = Stack((Layer("1.38", 100.0), Layer("2.1", 60.0))).response(550.0, AIR, GLASS, outside, True)
        np.testing.assert_allclose(clear.A, 0.0, atol=1e-12)


def test_frustrated_total_reflection() -> None:
    """100 nm of air between glass: part of the light tunnels; behind 5 µm none does."""
    cosine = np.array([np.cos(np.radians(60.0))])
    thin, thick = (Stack((Layer("air", d),)).response(550.0, GLASS, GLASS, cosine, True) for d in (100.0, 5000.0))
    expected = by_tmm(GLASS, [(1.0, 100.0)], GLASS, cosine[0], 550.0)
    np.testing.assert_allclose(thin.T[0], expected["T"], atol=1e-10)
    assert thin.T.min() > 0.2
    assert thick.T.max() < 1e-12
    np.testing.assert_allclose(thick.R, 1.0, atol=1e-12)


def test_a_stack_of_no_layers_is_a_bare_surface() -> None:
    own = Stack(()).response(550.0, AIR, GLASS, np.array([1.0]), True)
    np.testing.assert_allclose(own.R, (0.5168 / 2.5168) ** 2, rtol=1e-12)


def test_opaque_stacks_pass_nothing() -> None:
    layers = (Layer("1.6", 171.875), Layer("0.958+6.69i", 150.0))
    shut, open_ = (Stack(layers, opaque=opaque).response(550.0, AIR, GLASS, COSINES, True) for opaque in (True, False))
    assert np.all(shut.T == 0)
    np.testing.assert_array_equal(shut.R, open_.R)
    assert open_.T.max() < 1e-9, "150 nm of aluminium are dark, so that the statement is true"
    assert Stack(layers, opaque=True).opaque
    assert not Stack(layers).opaque


class TestShifts:
    def test_added_at_every_wavelength(self) -> None:
        layer = Layer("N-BK7", 100.0, n_shift=0.02, k_shift=1e-3)
        for wavelength in (450.0, 650.0):
            plain = Layer("N-BK7", 100.0).index(wavelength)
            assert layer.index(wavelength) == pytest.approx(plain + 0.02 + 1e-3j, abs=1e-15)

    @pytest.mark.parametrize(("n_shift", "k_shift"), [(0.0, -0.5), (-1.7, 0.0)])
    def test_impossible(self, n_shift: float, k_shift: float) -> None:
        stack = Stack((Layer("1.38", 10.0), Layer("1.6+0.4i", 90.0, n_shift, k_shift)), name="ar")
        with pytest.raises(MistrayError, match=r"coating 'ar', layer 2 \(1.6\+0.4i\): n = .*, k = .* at 550 nm"):
            stack.response(550.0, AIR, GLASS, COSINES, True)


class TestErrors:
    @pytest.mark.parametrize("thickness", [-1.0, float("nan"), float("inf")])
    def test_thickness(self, thickness: float) -> None:
        with pytest.raises(MistrayError, match=r"coating 'ar', layer 1 \(1.38\): thickness_nm is .*"):
            Stack((Layer("1.38", thickness),), name="ar")

    def test_first(self) -> None:
        with pytest.raises(MistrayError, match="coating 'ar': first = 'top'"):
            Stack((), "top", "ar")

    def test_material(self) -> None:
        with pytest.raises(MistrayError, match=r"coating 'ar', layer 1: material 'MgF' is unknown"):
            Stack((Layer("MgF", 10.0),), name="ar").response(550.0, AIR, GLASS, COSINES, True)

    def test_wavelength(self) -> None:
        with pytest.raises(MistrayError, match=r"coating 'ar', layer 1: material 'N-BK7': 5000 nm is outside of its 3"):
            Stack((Layer("N-BK7", 10.0),), name="ar").response(5000.0, AIR, GLASS, COSINES, True)

    def test_unknown_absorption(self) -> None:
        with pytest.raises(MistrayError, match=r"layer 1: material 'nd=1.6 Vd=50': k is unknown"):
            Stack((Layer("nd=1.6 Vd=50", 10.0),)).response(550.0, AIR, GLASS, COSINES, True)


class TestText:
    def test_nanometres_and_waves(self) -> None:
        layers = parse_layers("MgF2 99.64, 2.1 0.5w\n 1.63+0.001i   84.4,nd=1.6 Vd=50 k=0 10", 500.0)
        assert [layer.material for layer in layers] == ["MgF2", "2.1", "1.63+0.001i", "nd=1.6 Vd=50 k=0"]
        np.testing.assert_allclose([layer.thickness_nm for layer in layers], [99.64, 0.5 * 500 / 2.1, 84.4, 10.0])

    def test_waves_of_a_dispersive_material(self) -> None:
        (layer,) = parse_layers("N-BK7 0.25w", 486.1327)
        assert layer.thickness_nm == pytest.approx(0.25 * 486.1327 / 1.52238, rel=1e-5)

    def test_round_trip(self) -> None:
        rng = np.random.default_rng(3)
        layers = tuple(Layer(material, 300 * rng.random()) for material in ["MgF2", "1.5+0.1i", "TiO2"] * 4)
        assert parse_layers(layer_text(layers)) == layers
        assert layer_text((Layer("MgF2", 100.0), Layer("2.1", 0.5))) == "MgF2 100, 2.1 0.5"

    def test_files_are_looked_up_beside_the_scene(self) -> None:
        (layer,) = parse_layers("my glass.csv 20", resolve=lambda path: f"/scenes/{path}")
        assert layer.material == "/scenes/my glass.csv"

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("", "layer 1: '' has no material and thickness; write 'material thickness'"),
            ("MgF2", "layer 1: 'MgF2' has no material and thickness"),
            ("MgF2 10, ", "layer 2: '' has no"),
            ("MgF2 ten", "layer 1: 'MgF2 ten' has no"),
            ("MgF2 10 nm", "layer 1: 'MgF2 10 nm' has no"),
            ("MgF 0.25w", "layer 1: material 'MgF' is unknown"),
            ("1.38 10, 0.2 20", "layer 2: material '0.2'"),
        ],
    )
    def test_bad(self, text: str, words: str) -> None:
        with pytest.raises(MistrayError) as caught:
            parse_layers(text, name="ar")
        assert str(caught.value).startswith("coating 'ar', ")
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)

    def test_bad_design_wavelength(self) -> None:
        with pytest.raises(MistrayError, match="design_nm = 0"):
            parse_layers("1.38 0.25w", 0.0)

    def test_shifts_have_no_text(self) -> None:
        with pytest.raises(MistrayError, match=r"layer 1 \(1.38\): n_shift = 0.1, k_shift = 0 have no place"):
            layer_text([Layer("1.38", 10.0, 0.1)])
        with pytest.raises(MistrayError, match="has a comma"):
            layer_text([Layer("a,b.csv", 10.0)])

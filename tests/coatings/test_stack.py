"""Coatings: bare surfaces, shares, stacks beside `tmm`, presets beside vectors, tables of both sides."""

import re
from pathlib import Path

import numpy as np
import pytest
import vectors
from oracles.small_scenes import write
from refusals import each_refused, refused

from mistray.coatings import PRESETS, Bare, CoatingTable, Ideal, Layer, Stack, layer_text, parse_layers, preset
from mistray.coatings.response import total_reflection
from mistray.coatings.spectrum import spectrum
from mistray.errors import MistrayError

pytestmark = pytest.mark.quick

tmm = pytest.importorskip("tmm")

ABSORBING = (Layer("1.38", 120.0), Layer("2.3+0.4i", 15.0), Layer("1.6", 90.0))
NUMBERS = [(1.38 + 0j, 120.0), (2.3 + 0.4j, 15.0), (1.6 + 0j, 90.0)]
COSINES = np.cos(np.radians([0.0, 20.0, 45.0, 70.0, 89.0]))
AIR, GLASS, METAL = 1 + 0j, 1.5168 + 0j, 0.958 + 6.69j


def compare(stack: Stack | Bare, front: complex, back: complex, from_front: bool, layers: list) -> None:
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


def test_a_mirror_turns_its_layers_to_the_light() -> None:
    """Both media of a mirror are those of the light; silver under an overcoat that absorbs is duller than by itself."""
    layers = (Layer("1.6+0.05i", 171.875), Layer("0.06+3.6i", 300.0))
    front, back = (Stack(layers, opaque=True).response(550.0, AIR, AIR, COSINES, side) for side in (True, False))
    np.testing.assert_array_equal(front.R, back.R)
    assert 0.7 < front.R[0, 0] < 0.8
    assert Stack(layers, "front", opaque=True).response(550.0, AIR, AIR, COSINES, False).R[0, 0] > 0.98
    assert Stack(layers, opaque=True).response(550.0, GLASS, AIR, COSINES, True).R[0, 0] > 0.95  # seen through a body


def test_stacks_and_their_text() -> None:
    """The test above would not see a stack taken the wrong way round if these were equal."""
    from_air, from_glass = (Stack(ABSORBING).response(550.0, AIR, GLASS, COSINES[:1], side) for side in (True, False))
    for other in (from_glass, Stack(ABSORBING, "back").response(550.0, AIR, GLASS, COSINES[:1], True)):
        assert abs(from_air.R - other.R).min() > 0.003
    np.testing.assert_allclose(from_air.T, from_glass.T, atol=1e-12)
    layers = (Layer("1.6", 171.875), Layer("0.958+6.69i", 150.0))
    shut, open_ = (Stack(layers, opaque=opaque).response(550.0, AIR, GLASS, COSINES, True) for opaque in (True, False))
    assert np.all(shut.T == 0)
    np.testing.assert_array_equal(shut.R, open_.R)
    assert open_.T.max() < 1e-9, "150 nm of aluminium are dark, so that the statement is true"
    assert [Stack(layers, opaque=opaque).opaque for opaque in (True, False)] == [True, False]
    layer = Layer("N-BK7", 100.0, n_shift=0.02, k_shift=1e-3)
    for wavelength in (450.0, 650.0):
        plain = Layer("N-BK7", 100.0).index(wavelength)
        assert layer.index(wavelength) == pytest.approx(plain + 0.02 + 1e-3j, abs=1e-15)
    for layers, first, nm, words in (
        ([Layer("1.38", -1.0)], "outside", 550.0, "layer 1 (1.38): thickness_nm is "),
        ([Layer("1.38", float("nan"))], "outside", 550.0, "layer 1 (1.38): thickness_nm is "),
        ([], "top", 550.0, "first = 'top'"),
        ([Layer("MgF", 10.0)], "outside", 550.0, "layer 1: material 'MgF' is unknown"),
        ([Layer("N-BK7", 10.0)], "outside", 5000.0, "layer 1: material 'N-BK7': 5000 nm is outside its 3"),
        ([Layer("nd=1.6 Vd=50", 10.0)], "outside", 550.0, "layer 1: material 'nd=1.6 Vd=50': k is unknown"),
        ([Layer("1.38", 9.0), Layer("1.6+0.4i", 90.0, 0.0, -0.5)], "outside", 550.0, "layer 2 (1.6+0.4i): n = 1.6, k"),
        ([Layer("1.38", 9.0), Layer("1.6+0.4i", 90.0, -1.7, 0.0)], "outside", 550.0, "layer 2 (1.6+0.4i): n = -0.1, k"),
    ):
        with pytest.raises(MistrayError, match=f"^coating 'ar'.*{re.escape(words)}"):
            Stack(tuple(layers), first, "ar").response(nm, AIR, GLASS, COSINES, True)
    for text, design_nm, words in vectors.toml("refusals.toml")["layers"]:
        with pytest.raises(MistrayError, match=f"^coating 'ar'.*{re.escape(words)}"):
            parse_layers(text, design_nm, name="ar")
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
    shifted, named = [Layer("1.38", 10.0, 0.1)], [Layer("a,b.csv", 1.0)]
    each_refused((shifted, "n_shift = 0.1, k_shift = 0"), (named, "a comma"), by=layer_text)


MANY = np.cos(np.radians(np.concatenate([np.linspace(0, 89.9, 60), [90.0]])))
CROWN, ALUMINIUM = 1.5168 + 0j, 0.958 + 6.69j


def test_grazing_light_absorbing_media_and_ideal_shares() -> None:
    """What bare surfaces reflect is compared with `tmm` above, in test_thinfilm.py with vectors."""
    for front, back in ((1 + 0j, CROWN), (CROWN, 1 + 0j), (1.2 + 0j, ALUMINIUM), (1 + 0j, 1 + 0j)):
        grazing = Bare().response(550.0, front, back, np.array([0.0, 1e-12, 0.5]), True)
        np.testing.assert_allclose(grazing.R + grazing.T, 1.0, atol=1e-12)
        rounded = Bare().response(550.0, front, back, [np.nextafter(1.0, 2.0), -1e-17], True)  # of unit vectors
        np.testing.assert_array_equal(rounded.R, Bare().response(550.0, front, back, [1.0, 0.0], True).R)
    # R + T > 1 is possible for waves that decay along their way; only the real part of their index counts
    grey = Bare().response(550.0, 1.5 + 0.01j, 1 + 0j, MANY, True)
    clear = Bare().response(550.0, 1.5 + 0j, 1 + 0j, MANY, True)
    np.testing.assert_array_equal(grey.R, clear.R)
    np.testing.assert_array_equal(grey.T, clear.T)
    assert grey.A.min() > -1e-12
    # The same everywhere; beyond the critical angle what would be transmitted is reflected too
    front, back = (Ideal(0.3, 0.5).response(550.0, 1 + 0j, CROWN, MANY, side) for side in (True, False))
    for found, expected in ((front.R, 0.3), (front.T, 0.5), (front.A, 0.2), (front.phase_r, np.pi), (front.phase_t, 0)):
        np.testing.assert_allclose(found, expected)
    beyond = total_reflection(1 + 0j, CROWN, MANY, False)
    assert beyond.sum() > 20
    assert not total_reflection(1 + 0j, CROWN, MANY, True).any()
    np.testing.assert_allclose(back.R[beyond], 0.8)
    np.testing.assert_allclose(back.T[beyond], 0.0)
    np.testing.assert_allclose(back.T[~beyond], 0.5)
    assert (Ideal(0.3, 0.0).opaque, Ideal(0.3, 0.1).opaque) == (True, False)
    words = r"coating 'x': R = .* and T = .*R \+ T must not exceed 1"
    wrong = (0.6, 0.5), (-0.1, 0.5), (0.1, -0.2), (float("nan"), 0.0)
    each_refused(*((*shares, "x", words) for shares in wrong), by=Ideal)


SUBSTRATE = "1.5168"
BAND = np.arange(450.0, 650.1, 2.5)
# The vectors' aluminium has no end, the preset's 150 nm pass exp(-4πkd/λ) < 2e-8 of the light to and fro
FILM, LAST = preset("protected_al").layers
MIRROR = Stack((FILM, Layer("0.958+6.69i", LAST.thickness_nm)), opaque=True)


@pytest.mark.parametrize(
    ("stack", "design"),
    [
        (preset("mgf2_quarter_wave"), "MgF2_QW"),
        (preset("v_coat"), "V_138_210"),
        (preset("bbar3"), "QHQ_138_210_163"),
        (preset("bbar4"), "BBAR4_LHLH"),
        (MIRROR, "Al_SiO_HW"),
    ],
)
def test_against_vectors(stack: Stack, design: str) -> None:
    """7 wavelengths, 4 angles, s and p; the vectors come from an independent program, checked with `tmm`."""
    rows = [row for row in vectors.rows("thinfilm.csv") if row["design"] == design]
    assert len(rows) == 56
    for row in rows:
        cosine = np.cos(np.radians([float(row["aoi_deg"])]))
        own = stack.response(float(row["lambda_nm"]), 1 + 0j, 1.5168 + 0j, cosine, True)
        pol = "sp".index(row["pol"])
        assert own.R[0, pol] == pytest.approx(float(row["R"]), abs=3e-8 if stack is MIRROR else 1e-12)
        if stack is not MIRROR:
            assert own.T[0, pol] == pytest.approx(float(row["T"]), abs=1e-12)


def test_figures_of_the_antireflection_coatings() -> None:
    """What the docstring says, at normal incidence on n = 1.5168."""

    def reflectance(name: str, wavelengths_nm: np.ndarray | list[float]) -> np.ndarray:
        return spectrum(preset(name), wavelengths_nm, [0.0], back=SUBSTRATE).mean()[:, 0]

    assert reflectance("mgf2_quarter_wave", [550.0])[0] == pytest.approx(0.012835, abs=5e-7)
    below, at, above = reflectance("v_coat", [500.0, 550.0, 600.0])
    assert at < 1e-9
    assert min(below, above) > 1e-3, "a V: narrow"
    assert reflectance("bbar3", BAND).max() <= 0.0026
    assert reflectance("bbar4", np.arange(420.0, 681.0, 10.0)).mean() == pytest.approx(9.36e-4, abs=5e-7)
    fine = reflectance("bbar4", np.linspace(420.0, 680.0, 2001))
    assert fine.mean() == pytest.approx(8.5e-4, abs=1e-5)
    assert fine.max() <= 0.0033


@pytest.mark.parametrize(("name", "low", "high"), [("protected_al", 0.90, 0.925), ("protected_ag", 0.965, 0.99)])
def test_metals(name: str, low: float, high: float) -> None:
    """Freshly evaporated aluminium and silver in the green; so thick that less than 1e-6 passes from 400 nm on."""
    mirror = spectrum(preset(name), [550.0], [0.0, 45.0])
    assert low < mirror.mean()[0, 0] < high
    assert np.all(mirror.T == 0)
    assert preset(name).opaque
    assert spectrum(Stack(preset(name).layers), np.arange(400.0, 1001.0, 25.0), [0.0]).T.max() < 1e-6


def test_design_wavelength_and_what_is_no_preset() -> None:
    """The curves of a design without dispersion scale with the wavelength; a metal keeps its thickness."""
    short = spectrum(preset("bbar3", 550.0), [500.0, 550.0], [0.0, 30.0], back=SUBSTRATE)
    long = spectrum(preset("bbar3", 1100.0), [1000.0, 1100.0], [0.0, 30.0], back=SUBSTRATE)
    np.testing.assert_allclose(short.R, long.R, atol=1e-12)
    assert preset("protected_al", 1100.0).layers[1] == LAST
    for name, design in PRESETS.items():
        stack = preset(name)
        assert (stack.first, stack.name, stack.layers[0].material) == ("outside", name, design.films[0][0])
    for name, words in (("bbar5", "did you mean 'bbar4'?"), ("xyz", f"choose one of {', '.join(PRESETS)}")):
        with refused(f"coating preset '{name}' is unknown", words):
            preset(name)
    with refused("coating preset 'bbar3': design_nm = -1"):
        preset("bbar3", -1.0)


RARE, DENSE = 1 + 0j, 1.5 + 0j
PLAIN = """# measured
wavelength_nm,angle_deg,R,T
500,0,.10,.80
500,60,.20,.70
600,0,.30,.60
600,60,.40,.50
"""
POLARISED = """wavelength_nm,angle_deg,R_s,R_p,T_s,T_p,R_back_s,R_back_p,phase_r_deg,phase_t_deg,phase_r_back_deg
550,0,.1,.1,.8,.8,.15,.15,180,0,180
550,60,.3,.1,.6,.85,.35,.12,150,-10,170
"""
HALF = np.degrees(np.arccos(0.75))  # in the middle between 0° and 60° in the cosine


@pytest.fixture
def read(tmp_path: Path):
    def from_text(text: str) -> CoatingTable:
        return CoatingTable.read(write(tmp_path, text, "ar.csv"))

    return from_text


def at(table: CoatingTable, nm: float, degrees: float, from_front: bool = True):
    """Response at one angle in the air in front."""
    cosine = np.cos(np.radians([degrees]))
    if not from_front:
        cosine = np.sqrt(1 - (1 - cosine**2) / DENSE.real**2)
    return table.response(nm, RARE, DENSE, cosine, from_front)


def test_the_phase_from_the_back_of_a_coating_that_absorbs_nothing(read) -> None:
    """Stokes' relation, held against the layers that the table is made of."""
    layers, cosine = Stack((Layer("MgF2", 120.0), Layer("TiO2", 60.0))), np.cos(np.radians([60.0]))
    inside = np.sqrt(1 - (1 - cosine**2) / DENSE.real**2)
    front, behind = (layers.response(550.0, RARE, DENSE, c, c is cosine) for c in (cosine, inside))
    numbers = *front.R[0], *front.T[0] - 1e-6, *np.degrees([front.phase_r[0], front.phase_t[0]])
    columns = ["wavelength_nm", "angle_deg", "R_s", "R_p", "T_s", "T_p", "phase_r_deg", "phase_t_deg"]
    values = (np.array([v]) for v in (550, 60, *numbers))
    found = CoatingTable.from_columns("ar", dict(zip(columns, values, strict=True)))
    turned = at(found, 550.0, 60.0, from_front=False).phase_r[0] - behind.phase_r[0]
    assert np.angle(np.exp(1j * turned)) == pytest.approx(0, abs=1e-5)


def test_shares_of_polarisations_and_sides_and_phases(read) -> None:
    """At the nodes, linear between them in wavelength and cosine; beyond the steepest angle the last value holds."""
    table = read(PLAIN)
    np.testing.assert_allclose(at(table, 500.0, 60.0).R, [[0.2, 0.2]], atol=1e-15)
    np.testing.assert_allclose(at(table, 600.0, 0.0).T, [[0.6, 0.6]], atol=1e-15)
    np.testing.assert_allclose(at(table, 600.0, 0.0).A, [[0.1, 0.1]], atol=1e-15)
    assert at(table, 525.0, HALF).R[0, 0] == pytest.approx(0.25 * 0.35 + 0.75 * 0.15, abs=1e-15)
    np.testing.assert_allclose(at(table, 500.0, 80.0).R, 0.2)
    head, *rows = PLAIN.splitlines()[1:]
    np.testing.assert_array_equal(read("\n".join([head, rows[2], rows[1], rows[3], rows[0]])).shares, table.shares)
    with refused(r"ar.csv': 450 nm is outside its 500 … 600 nm"):
        at(table, 450.0, 0.0)
    # The angle is that in the rarer material; a table of one wavelength holds for all
    table = read(POLARISED)
    front, behind = at(table, 550.0, 60.0), at(table, 550.0, 60.0, from_front=False)
    np.testing.assert_allclose(front.R, [[0.3, 0.1]], atol=1e-15)
    np.testing.assert_allclose(front.T, [[0.6, 0.85]], atol=1e-15)
    np.testing.assert_allclose(behind.R, [[0.35, 0.12]], atol=1e-12)
    np.testing.assert_allclose(behind.T, front.T, atol=1e-12)
    np.testing.assert_array_equal(at(table, 400.0, 60.0).R, front.R)
    beyond = read(PLAIN).response(500.0, RARE, DENSE, np.array([0.2]), False)
    np.testing.assert_allclose(beyond.R, 0.9)
    np.testing.assert_allclose(beyond.T, 0.0)
    # An opaque table has the angle of the side of incidence
    table = read("wavelength_nm,angle_deg,R,T\n550,0,.1,0\n550,60,.3,0\n")
    assert (table.opaque, read(PLAIN).opaque) == (True, False)
    for from_front in (True, False):
        np.testing.assert_allclose(table.response(550.0, RARE, DENSE, np.array([0.5]), from_front).R, 0.3)
    plain, table = at(read(PLAIN), 550.0, 30.0), read(POLARISED)
    np.testing.assert_allclose(np.exp(1j * plain.phase_r), -1, atol=1e-12)
    np.testing.assert_allclose(plain.phase_t, 0, atol=1e-12)
    assert np.degrees(at(table, 550.0, 60.0).phase_r[0]) == pytest.approx(150)
    assert np.degrees(at(table, 550.0, 60.0).phase_t[0]) == pytest.approx(-10)
    assert np.degrees(at(table, 550.0, 60.0, from_front=False).phase_r[0]) == pytest.approx(170)
    # between 180 and 150 degrees lies 165, not a value on the far side of the circle
    assert np.degrees(at(table, 550.0, HALF).phase_r[0]) == pytest.approx(165)


def test_metal_has_no_critical_angle() -> None:
    """The index n of silver is less than 1, which is no total reflection; a table has the angles in air."""
    columns = {"wavelength_nm": [550.0, 550.0], "angle_deg": [0.0, 60.0], "R": [0.6, 0.8], "T": [0.3, 0.1]}
    table = CoatingTable.from_columns("columns", {key: np.array(values) for key, values in columns.items()})
    for coating, oblique in ((Ideal(R=0.6, T=0.3), (0.6, 0.3)), (table, (0.8, 0.1))):
        for sides, from_front in (((1.0 + 0j, 0.06 + 3.6j), True), ((0.06 + 3.6j, 1.0 + 0j), False)):
            found = coating.response(550.0, *sides, np.array([1.0, 0.5]), from_front)
            assert np.allclose(found.R, np.array([0.6, oblique[0]])[:, None])
            assert np.allclose(found.T, np.array([0.3, oblique[1]])[:, None])

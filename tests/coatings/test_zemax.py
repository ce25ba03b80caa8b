"""Coating files of Zemax and coatings by strings; presets on bodies that they were not made for, against `tmm`."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import vectors
from command_line import run, succeeds
from oracles.small_scenes import interface_xml, scene_text, shape_xml, write
from refusals import each_refused, refused
from singlet_files import plano_convex

import mistray
from mistray.coatings import PRESETS, Bare, CoatingTable, Ideal, Layer, Stack, layer_text, preset, spectrum
from mistray.coatings.files import coating_from_text, read_coating, write_table
from mistray.coatings.fitted_to_substrate import fitted_preset
from mistray.coatings.zemax_coating_dat import read_coating_file
from mistray.materials import complex_index, nearest_known_nm, refractive_index, source
from mistray.prescription import Coating, Detector, Prescription, Source, Surface
from mistray.prescription.by_text import coating_of

SAMPLE = Path(__file__).parents[1] / "data" / "coating_sample.dat"
ONE = np.array([1.0])
AIR, GLASS = 1 + 0j, 1.5168 + 0j


@pytest.fixture
def file():
    return read_coating_file(SAMPLE)


def layers(stack) -> list[tuple[str, float]]:
    return [(layer.material.rpartition(":")[2], round(layer.thickness_nm, 4)) for layer in stack.layers]


def test_the_ends_of_tables_are_within(tmp_path: Path) -> None:
    """0.6328 · 1000 is a little more than 632.8, and 0.6342 · 1000 a little less than 634.2."""
    table = "TABLE T\nANGL 0\nWAVE 0.6328 .1 .1 .9 .9\nWAVE 0.6342 0 0 1 1\n"
    path = write(tmp_path, f"MATE HENE\n0.6328 1.5 0\n0.6342 1.4 0\n{table}", "COATING.DAT")
    coating = read_coating_file(path)["T"]
    for nm, n, r in ((632.8, 1.5, 0.1), (634.2, 1.4, 0.0)):
        assert (complex_index(f"{path}:HENE", nm), coating.response(nm, AIR, GLASS, ONE, True).R[0, 0]) == (n, r)


def test_materials(tmp_path: Path) -> None:
    """By their strings: k changes its sign, tables are interpolated, one row holds everywhere."""
    assert complex_index(f"{SAMPLE}:AL", 550.0) == 0.958 + 6.69j
    assert complex_index(f"{SAMPLE}:zro2", 475.0) == pytest.approx(2.085 + 0.00015j, abs=1e-12)
    rows = "MATE MGF2\n0.40 1.385 0.0\n0.60 1.375 -0.001\nMATE FLAT\n0.55 2.1 -0.02\n"
    path = write(tmp_path, f"! coating materials\n{rows}", "COATING.DAT")
    assert complex_index(f"{path}:mgf2", 500.0) == pytest.approx(1.38 + 0.0005j, abs=1e-14)
    assert complex_index(f"{path}:MGF2 k=0", 500.0).imag == 0
    assert source(f"{path}:MGF2").k_range_nm == pytest.approx((400.0, 600.0))
    assert complex_index(f"{path}:Flat", 300.0) == complex_index(f"{path}:Flat", 3000.0) == 2.1 + 0.02j
    each_refused(
        ("MGF2", 700.0, "400 … 600 nm"),
        ("MGF", 500.0, "material 'MGF'"),
        ("z", 5.0, "'z'"),
        by=lambda name, nm: refractive_index(f"{path}:{name}", nm),
    )


class TestLayers:
    def test_waves_and_micrometres(self, file) -> None:
        assert layers(file["AR"]) == [("MGF2", round(0.25 * 550 / 1.378, 4))]
        assert layers(file["AR2"]) == [("MGF2", 99.8185), ("ZRO2", round(0.5 * 550 / 2.05, 4)), ("air", 10.0)]
        # Waves are those of the primary wavelength. OpticStudio's own example: T = 0.25, n = 1.4 at 0.55 µm gives
        # 0.0982 µm; here by its formula.
        (layer,) = read_coating_file(SAMPLE, 600.0)["AR"].layers
        assert layer.thickness_nm == pytest.approx(0.25 * 600 / (1.378 + (1.3761 - 1.378) / 3), rel=1e-12)
        # The first is the outermost from either side
        assert file["AR2"].first == "outside"
        sides = ((AIR, GLASS, True), (GLASS, AIR, False))
        seen, turned = (file["AR2"].response(550.0, *ends, ONE, side).R for *ends, side in sides)
        np.testing.assert_allclose(seen, turned, atol=1e-12)

    def test_groups_repeat(self, file) -> None:
        """The quarter-wave mirror (HL)^7 H on glass: R = ((1 - y)/(1 + y))² with y = (H/L)^14 H²/n."""
        quarter = {name: round(0.25 * 550 / n, 4) for name, n in (("H", 2.3), ("L", 1.38))}
        assert layers(file["HR"]) == [("H", quarter["H"]), ("L", quarter["L"])] * 7 + [("H", quarter["H"])]
        group = [("H", quarter["H"]), ("L", quarter["L"]), ("H", quarter["H"])]
        assert layers(file["HL2"]) == [("L", round(0.5 * 550 / 1.38, 4)), *group, *group, ("L", 100.0)]
        y = (2.3 / 1.38) ** 14 * 2.3**2 / 1.5168
        own = file["HR"].response(550.0, AIR, GLASS, ONE, True)
        np.testing.assert_allclose(own.R, ((1 - y) / (1 + y)) ** 2, atol=1e-10)

    def test_mirrors_end_in_their_substrate(self, file) -> None:
        """Aluminium 0.958 + 6.69i at 550 nm: 92.1136 %; half a wave changes nothing."""
        stack = file.mirror("ALUM")
        assert stack.opaque
        np.testing.assert_allclose(stack.response(550.0, AIR, AIR, ONE, True).R, 0.921136, atol=5e-7)
        assert file["ALUM"].response(550.0, AIR, AIR, ONE, True).R.max() < 0.05, "0.1 nm of aluminium is no mirror"

    def test_a_clear_substrate_of_a_mirror_has_no_rear(self, tmp_path: Path) -> None:
        """4 % of n = 1.5, whatever the wavelength and the thickness in the file; under a quarter wave as on a lens."""
        text = "MATE G\n0.5 1.5 0\n12 1.5 0\nMATE H\n0.5 2.3 0\n12 2.3 0\nCOAT G\nG 1\nCOAT H\nH 0.25\nG 1\n"
        path = write(tmp_path, text, "COATING.DAT")
        file, layer = read_coating_file(path), Stack((Layer("2.3", 0.25 * 550 / 2.3),))
        for nm in (500.0, 633.0, 10600.0):
            np.testing.assert_allclose(file.mirror("G").response(nm, AIR, AIR, ONE, True).R, 0.04, atol=1e-6)
            on_lens = layer.response(nm, AIR, 1.5 + 0j, ONE, True).R
            np.testing.assert_allclose(file.mirror("H").response(nm, AIR, AIR, ONE, False).R, on_lens, atol=1e-4)

    def test_mirrors_without_layers_transmit_nothing(self, file) -> None:
        assert file.mirror("SPLIT") == Ideal(0.5, 0.0, "SPLIT")
        table = file.mirror("MEASURED")
        assert table.opaque
        at_45 = np.cos(np.radians([45.0]))
        np.testing.assert_allclose(table.response(500.0, AIR, AIR, at_45, False).R, [[0.05, 0.02]], atol=1e-12)


def test_names_ideal_coatings_tables_and_what_is_not_known(file) -> None:
    """Of the retarder s is real, p has a quarter wave in both: in mistray's exp(-iωt) the sign is turned."""
    names = "AR AR2 HR HL2 ALUM SLOPED I.98 SPLIT CLEAR RETARDER MEASURED VENDOR.ZEC"
    assert (list(file), file["ar"]) == (names.split(), file["AR"])
    assert file["SPLIT"] == Ideal(0.5, 0.4, "SPLIT")
    np.testing.assert_allclose([file["CLEAR"].R, file["I.98"].T, file["I.98"].R], [0.01, 0.98, 0.02])
    retarder = file["RETARDER"]
    assert isinstance(retarder, CoatingTable)
    own = retarder.response(633.0, AIR, GLASS, ONE, True)
    np.testing.assert_allclose(own.R, 0.36)
    np.testing.assert_allclose(own.T, 0.64)
    np.testing.assert_allclose(np.exp(1j * own.phase_r), np.exp(1j * np.radians(180 + 90)), atol=1e-12)
    np.testing.assert_allclose(own.phase_t, np.radians(90), atol=1e-12)
    table = file["MEASURED"]
    own = table.response(500.0, AIR, GLASS, np.cos(np.radians([45.0])), True)
    np.testing.assert_allclose(own.R, [[0.05, 0.02]], atol=1e-12)
    np.testing.assert_allclose(own.T, [[0.94, 0.97]], atol=1e-12)
    np.testing.assert_allclose(np.degrees(own.phase_r), 170, atol=1e-9)
    np.testing.assert_allclose(np.degrees(own.phase_t), 5, atol=1e-9)
    np.testing.assert_allclose(table.response(550.0, AIR, GLASS, ONE, True).R, 0.015)
    each_refused(
        (lambda: file["SLOPED"], "line 51: taper RADIAL"),
        (lambda: file["VENDOR.ZEC"], "line 68: coating VENDOR.ZEC is encrypted"),
        (lambda: file["measure"], "no coating 'measure'"),
        (lambda: file["AR"].response(800.0, AIR, GLASS, ONE, True), "'AR', layer 1: .*800 nm is outside its 400"),
        (lambda: file["MEASURED"].response(700.0, AIR, GLASS, ONE, True), "MEASURED': 700 nm is outside its 500"),
        (lambda: read_coating_file(SAMPLE, 0.0), "design_nm = 0"),
    )


GOOD = "MATE L\n0.55 1.38 0\n"


def test_an_edited_file_in_every_encoding_is_read_anew(tmp_path: Path) -> None:
    """OpticStudio writes ANSI or UTF-16."""
    path = tmp_path / "c.dat"
    for number, encoding in enumerate(("utf-16", "utf-8-sig", "latin-1")):
        text = f"! Schichten für außen\n{GOOD.replace('1.38', f'1.{38 + number}')}COAT A\nL .25\n"
        path.write_bytes(text.encode(encoding))
        os.utime(path, ns=(number, number))  # the clock of a file system may be coarser than this test is fast
        assert layers(read_coating_file(path)["A"]) == [("L", round(0.25 * 550 / (1.38 + 0.01 * number), 4))]


WAVELENGTHS, ANGLES = [450.0, 550.0, 650.0], [0.0, 30.0, 60.0, 85.0]
GREY = Stack((Layer("1.38", 95.0), Layer("2.2+0.2i", 20.0)), name="grey")


def test_names_of_coatings(tmp_path: Path) -> None:
    assert (coating_from_text("bare"), coating_from_text(" bbar3 ", 600.0)) == (Bare(), preset("bbar3", 600.0))
    assert coating_from_text("1.38 0.25w", 600.0) == Stack((Layer("1.38", 0.25 * 600 / 1.38),), name="1.38 0.25w")
    table = write(tmp_path, "wavelength_nm,angle_deg,R,T\n550,0,.1,.9\n", "ar.csv")
    assert isinstance(coating_from_text(str(table)), CoatingTable)
    assert coating_from_text(f"{SAMPLE}:SPLIT") == Ideal(0.5, 0.4, "SPLIT")
    (tmp_path / "c.dat").write_text("COAT I.²\n", encoding="utf-8")
    assert coating_from_text(f"{tmp_path / 'c.dat'}:I.²") == Stack((), name="I.²")  # no transmittance: ² is no decimal
    assert read_coating(f"{SAMPLE.name}:ALUM", mirror=True, resolve=lambda path: str(SAMPLE.parent / path)).opaque
    # Waves are those of the light that the caller names, as of layers; a stated wavelength goes first
    for text, nm in ((f"{SAMPLE}:AR", 600.0), (f"{SAMPLE}:AR design_nm=650", 650.0), (f"{SAMPLE}:SPLIT", 600.0)):
        assert coating_of(text, design_nm=600.0).design_nm == nm


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("bbar5", "did you mean 'bbar4'? There are mgf2_quarter_wave"),
        ("nowhere.csv", "coating table 'nowhere.csv': No such file"),
        ("nowhere.dat:AR", "coating file 'nowhere.dat': No such file"),
        (str(SAMPLE), f"which coating? Write '{SAMPLE}:NAME' with one of AR, AR2, HR"),
        (f"{SAMPLE}:AR9", "no coating 'AR9'; did you mean 'AR'?"),
        ("MgF 100", "coating 'MgF 100', layer 1: material 'MgF' is unknown"),
    ],
)
def test_what_names_no_coating(text: str, words: str) -> None:
    with refused("", words):
        spectrum(coating_from_text(text), [550.0], [0.0])
    with refused(r"coating 'ar\.xlsx' is not a file that mistray knows"):
        read_coating("ar.xlsx")


@pytest.mark.parametrize(("front", "back"), [("air", "1.5168"), ("1.5168", "air"), ("1.33", "1.33")])
@pytest.mark.parametrize("coating", [GREY, preset("bbar3"), Bare(), Ideal(0.3, 0.6, "split")])
def test_a_table_that_is_written_and_read_back(tmp_path: Path, coating, front: str, back: str) -> None:
    """At its nodes the table answers as the coating does, from both sides, phases included."""
    write_table(coating, tmp_path / "out.csv", WAVELENGTHS, ANGLES, front, back)
    table = CoatingTable.read(tmp_path / "out.csv")
    assert [file.name for file in tmp_path.iterdir()] == ["out.csv"]
    for from_front in (True, False):
        one, other = (spectrum(c, WAVELENGTHS, ANGLES, front, back, from_front, rarer=True) for c in (coating, table))
        np.testing.assert_allclose(other.R, one.R, atol=1e-9)
        np.testing.assert_allclose(other.T, one.T, atol=1e-9)
        strong = one.R.min(axis=2) > 1e-10
        np.testing.assert_allclose(np.exp(1j * other.phase_r)[strong], np.exp(1j * one.phase_r)[strong], atol=1e-6)
        np.testing.assert_allclose(np.exp(1j * other.phase_t), np.exp(1j * one.phase_t), atol=1e-6)


def test_mirrors_and_what_is_no_table(tmp_path: Path) -> None:
    file = tmp_path / "al.csv"
    for front, back in (("air", "Al"), ("Al", "air")):
        write_table(Bare(), file, WAVELENGTHS, ANGLES, front, back)
        table = CoatingTable.read(file)
        assert table.opaque
        one, other = (spectrum(c, WAVELENGTHS, ANGLES, front, back, front == "air") for c in (Bare(), table))
        np.testing.assert_allclose(other.R, one.R, atol=1e-12)
        assert file.read_text().startswith(f"# bare between {front} (front) and {back} (back)")
    # Angles of an opaque stack, and of one too thick for any light, are those on the side of incidence
    for coating in (preset("protected_al"), Stack((Layer("Al", 9000.0),))):
        write_table(coating, file, WAVELENGTHS, ANGLES, "air", "1.5168")
        for from_front in (True, False):
            both = coating, CoatingTable.read(file)
            one, other = (spectrum(c, WAVELENGTHS, ANGLES, back="1.5168", from_front=from_front) for c in both)
            np.testing.assert_allclose(other.R, one.R, atol=1e-12)
    each_refused(
        (550.0, 0.0, ("Al", "Ag"), "both are metals; no light gets there"),
        (550.0, -1.0, ("air", "air"), "angles_deg is -1.*between 0 and 90"),
        (30000.0, 0.0, ("air", "N-BK7"), "30000 nm is outside"),
        by=lambda nm, angle, sides: write_table(GREY, tmp_path / "out.csv", [nm], [angle], *sides),
    )
    assert list(tmp_path.iterdir()) == [file]


def test_spectrum() -> None:
    """Shares add up; light that enters a metal is absorbed, and none comes from it."""
    values = spectrum(GREY, WAVELENGTHS, ANGLES, back="1.5168")
    assert values.R.shape == (3, 4, 2)
    np.testing.assert_allclose(values.R + values.T + values.A, 1.0)
    np.testing.assert_allclose(values.mean("A"), values.A.mean(axis=2))
    single = GREY.response(550.0, 1 + 0j, 1.5168 + 0j, np.cos(np.radians([60.0])), True)
    np.testing.assert_array_equal(values.R[1, 2], single.R[0])
    metal = spectrum(Bare(), [550.0], [0.0], back="Al")
    assert metal.T.max() == 0
    np.testing.assert_allclose(metal.R + metal.A, 1.0)
    with refused(r"light from 'Al' \(k = 6.* at 550 nm\), in which nothing travels"):
        spectrum(Bare(), [550.0], [0.0], back="Al", from_front=False)
    inside, outside = (spectrum(Bare(), [550.0], [60.0], "1.5168", "air", rarer=rarer) for rarer in (False, True))
    assert inside.T.max() < 1e-12, "60° in glass is beyond the critical angle"
    np.testing.assert_allclose(outside.R, spectrum(Bare(), [550.0], [60.0], "air", "1.5168").R, atol=1e-12)


def by_tmm(stack: Stack, body: str, low_nm: float, high_nm: float) -> float:
    """Mean R over a band at normal incidence, by the program of S. J. Byrnes."""
    tmm = pytest.importorskip("tmm")
    thickness = [np.inf, *(layer.thickness_nm for layer in stack.layers), np.inf]
    found = []
    for nm in np.linspace(low_nm, high_nm, 41):
        n = refractive_index(body, nearest_known_nm(body, nm))
        found.append(tmm.coh_tmm("s", [1.0, *stack.indices(nm), n], thickness, 0.0, nm)["R"])
    return float(np.mean(found))


@pytest.mark.parametrize("name", ["v_coat", "bbar3", "bbar4"])
@pytest.mark.parametrize("body", ["1.45", "1.62", "1.7847", "N-SF6", "1.95"])
def test_on_flints(name: str, body: str) -> None:
    """What is said to be reached is what `tmm` computes, and no more than a quarter wave of MgF2 leaves."""
    found = fitted_preset(name, body)
    assert found.reached == pytest.approx(by_tmm(found.stack, body, found.low_nm, found.high_nm), rel=2e-3)
    assert found.designed == pytest.approx(by_tmm(preset(name), body, found.low_nm, found.high_nm), rel=2e-3)
    assert found.reached <= found.designed
    assert found.reached <= by_tmm(preset("mgf2_quarter_wave"), body, found.low_nm, found.high_nm) + 2e-6


@pytest.mark.parametrize(("name", "body", "most"), vectors.toml("infrared_presets.toml")["rows"])
def test_in_the_infrared(name: str, body: str, most: float) -> None:
    """Residual reflectance by `tmm`, in the mean over 3 to 5 or 8 to 12 µm; bare, these bodies have 17 to 36 %."""
    found = fitted_preset(name, body)
    band = (3000.0, 5000.0) if "mwir" in name else (8000.0, 12000.0)
    assert (found.low_nm, found.high_nm) == pytest.approx(band)
    reached = by_tmm(found.stack, body, *band)
    assert reached <= most
    # k of silicon changes R by less than this
    assert found.reached == pytest.approx(reached, rel=1e-2, abs=1e-6)


def test_a_body_like_that_of_the_design_keeps_it_and_others_are_refused() -> None:
    for name, design in PRESETS.items():
        if design.metal is None:
            found = fitted_preset(name, repr(design.substrate))
            assert not found.changed
            assert found.stack == preset(name)
    each_refused(
        ("zns_lwir", "ZnSe", r"does not suit 'ZnSe': mean R = 1\d.* %"),
        ("bbar3", "Ge", "passes no light from 450 to 650 nm"),
        by=fitted_preset,
    )


def test_a_body_of_a_file_that_changes_is_fitted_again(tmp_path: Path) -> None:
    body = tmp_path / "body.csv"
    for index in ("4.0", "3.2"):
        body.write_text(f"wavelength_nm,n,k\n2000,{index},0\n6000,{index:<06},0\n")
        assert fitted_preset("zns_mwir", str(body)).bare == fitted_preset("zns_mwir", index).bare


def test_coat_fits_each_glass_and_says_what_it_reached(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The scene has explicit layers, one coating for each glass; as designed, R would be two to four times as large."""
    file = tmp_path / "coated.xml"
    printed = succeeds(capsys, "coat", "cooke_triplet", "L?_*=bbar3", "-o", file)
    found = {body: fitted_preset("bbar3", body) for body in ("N-LAK9", "N-SF5")}
    for body, one in found.items():
        assert f"note: bbar3 on {body}: {one}" in printed
        assert one.reached < 0.5 * one.designed
    shapes = {shape.id(): shape.bsdf() for shape in mistray.load(file).shapes()}
    for surface, body in (("L1_front", "N-LAK9"), ("L2_rear", "N-SF5")):
        own, wanted = shapes[surface].coating.layers, found[body].stack.layers
        assert [layer.material for layer in own] == [layer.material for layer in wanted]
        assert [layer.thickness_nm for layer in own] == pytest.approx([x.thickness_nm for x in wanted], rel=1e-6)
    assert shapes["L1_front"].coating is shapes["L3_rear"].coating


def test_waves_are_those_of_invisible_light(tmp_path: Path) -> None:
    """A quarter wave of ZnS on a scene of 8 to 12 µm is one at 10 µm, as the file says."""
    front = shape_xml("asphere", "front", bsdf=interface_xml(back="Ge"), semi_diameter=5.0)
    scene = write(tmp_path, scene_text(front, radius=3.0, wavelength_nm="8000, 9000, 12000"))
    (layer,) = mistray.coat(scene, {"front": "ZnS 0.25w"}).shapes()[0].bsdf().coating.layers
    assert layer.thickness_nm == pytest.approx(2500.0 / refractive_index("ZnS", 10000.0), rel=1e-6)
    (layer,) = mistray.coat(scene, {"front": "ZnS 0.25w design_nm=9000"}).shapes()[0].bsdf().coating.layers
    assert layer.thickness_nm == pytest.approx(2250.0 / refractive_index("ZnS", 9000.0), rel=1e-6)
    zns = mistray.coat(scene, {"front": "zns_lwir"}).shapes()[0].bsdf().coating
    coated = spectrum(zns, [10000.0], [0.0], "air", "Ge")
    # R = ((n₀ nₛ - n²)/(n₀ nₛ + n²))² of a quarter wave
    n = refractive_index("Ge", 10000.0)
    assert coated.mean()[0, 0] == pytest.approx(((n - 4.84) / (n + 4.84)) ** 2, abs=1e-6)


def test_presets_as_designed_are_named_on_other_bodies() -> None:
    """A crown's preset that a scene has on a flint reflects twelve times as much as on a crown; the notes say so."""

    def notes(glass: str, **recipe: Any) -> list[str]:
        lens = Prescription(
            name="lens",
            surfaces=(
                Surface("front", semi_diameter=5.0, back=glass, coating=Coating(**recipe)),
                Surface("rear", z=4.0, semi_diameter=5.0, front=glass),
            ),
            detector=Detector(z=30.0, semi_diameter=9.0),
            source=Source(radius=3.0, wavelength_nm=(550.0,)),
        )
        return [note for note in mistray.trace(lens.to_scene(), rays=16).notes if "as designed" in note]

    (note,) = notes("N-SF6", preset="bbar3")
    assert "bbar3 as designed, for n = 1.517, leaves a mean R of 1.2 % on N-SF6 from 450 to 650 nm" in note
    assert f"{100 * fitted_preset('bbar3', 'N-SF6').designed:.2g} % on N-SF6" in note
    assert notes("N-BK7", preset="bbar3") == notes("N-SF6", preset="mgf2_quarter_wave") == []
    assert notes("N-SF6", layers=layer_text(fitted_preset("bbar3", "N-SF6").stack.layers)) == []
    assert notes("N-SF6", preset="bbar3", design_nm=600.0)[0].count("490.909 to 709.091 nm") == 1


def test_commands_with_a_coating_say_what_it_reached(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An import prints it and keeps it in the file; other commands print it on stderr, unless they are to be quiet."""
    note = str(fitted_preset("bbar3", "N-SF6"))
    lens = write(tmp_path, plano_convex("N-SF6 0 0 1.8 25", "SCHOTT", 0.55), "lens.zmx")
    scene = tmp_path / "lens.xml"
    assert succeeds(capsys, "import", lens, "--coating", "S1=bbar3", "-o", scene).count(note) == 1
    assert note in scene.read_text()
    command = ["ghosts", scene, "--coating", "S2=bbar3", "--rays", "200"]
    for more, times in (((), 1), (("--quiet",), 0)):
        code, _, err = run(capsys, *command, *more)
        assert (code, err.count(note)) == (0, times)

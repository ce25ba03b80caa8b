"""CODE V files made by hand, command by command; those of other programs: tests/validation/test_lens_files.py."""

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
import vectors
from oracles.small_scenes import write
from refusals import refused

from mistray import MistrayError
from mistray.io.codev.commands import commands
from mistray.io.codev.glasses import table_material
from mistray.materials import refractive_index
from mistray.physics.geometry.outline import ALL, Outline, OutlineFigure, circle, rectangle
from mistray.physics.sags.terms import sag
from mistray.prescription import Sequential, read_codev
from mistray.prescription.sequential.first_order import first_order, paraxial_system
from mistray.prescription.sequential.rays import motion, to_world, trace

pytestmark = pytest.mark.quick
DOUBLET, ZOOM = vectors.text("doublet.seq"), vectors.text("zoom.seq")


@pytest.fixture
def lens(tmp_path):
    def read(text: str, **options) -> Sequential:
        return read_codev(write(tmp_path, text, "lens.seq"), **options)

    return read


def system(surfaces: str, **changes: str) -> str:
    """A file with these surfaces."""
    lines = {"RDM": "Y", "DIM": "M", "EPD": "10", "WL": "550", "SO": "0 1e13"} | changes
    return "\n".join([*(f"{key} {value}" for key, value in lines.items()), surfaces, "SI 0 0"])


def test_a_doublet(lens):
    found = lens(DOUBLET)
    assert (found.name, found.source) == ('A doublet, 3.5" ! of two glasses; air spaced', "CODE V file lens.seq")
    assert [row.radius for row in found.rows] == [60, -45, -44, -130, math.inf]
    assert [row.thickness for row in found.rows] == [6, 0.5, 2.5, 92.75, 0]
    assert [row.material for row in found.rows] == ["schott/N-BK7", "air", "schott/N-SF5", "air", "air"]
    assert [(row.number, row.kind) for row in found.rows] == [*((k, "surface") for k in range(1, 5)), (5, "image")]
    assert ([row.number for row in found.rows if row.stop], found.rows[0].label) == ([2], "front")
    assert [(row.semi_diameter, row.semi_diameter_fixed) for row in found.rows[:3:2]] == [(12.5, True), (12.6, False)]
    assert (found.rows[3].conic, found.rows[3].coefficients) == (-0.5, (1e-6, -2e-9))
    assert (found.aperture_kind, found.aperture, found.object_distance) == ("entrance_pupil_diameter", 25, math.inf)
    assert (found.field_kind, found.fields) == ("angle_deg", ((0.5, 0), (0, 2)))
    assert found.vignetting == ((0, 0, 0, 0), (0, pytest.approx(0.05), 0, 0.25))
    assert (found.wavelengths_nm, found.weights, found.primary) == ((656.3, 587.6, 486.1), (1, 2, 1), 2)
    assert (found.unread, found.notes, [row.line for row in found.rows]) == ((), (), [10, 14, 16, 18, 22])


def test_every_command_has_an_effect_or_is_listed(lens):
    text = DOUBLET.replace("GO\n", "THC 0; PIM\nTEM 20.0\nINI 'XYZ'\nABC 1 2\nDER VAL I1 -0.6\nGO\nVIE\n")
    whole = lens(text)
    listed = {entry.text: entry for entry in whole.unread}
    assert set(listed) == {"THC 0", "PIM", "TEM 20.0", "INI 'XYZ'", "ABC 1 2", "DER VAL I1 -0.6", "VIE"}
    assert "unknown" in listed["ABC 1 2"].reason

    def bare(found: Sequential) -> Sequential:
        """A lens without what tells where things stood."""
        return replace(found.with_rows([replace(row, line=0) for row in found.rows]), unread=(), notes=())

    restates = ("LEN", "DIM", "ASP", "GO", "SO", "RDM")  # what they say is so without them, RDM see below
    changing = [command for command in commands(text) if command.name not in restates]
    assert len(changing) == 28
    for command in changing:
        place = sum(len(line) + 1 for line in text.splitlines()[: command.line - 1])
        words = "S 60.0 6.0 &\nNBK7_SCHOTT\n" if command.line == 10 else command.text
        assert words in text[place:]
        same = False
        with suppress(MistrayError):
            same = bare(lens(text[:place] + text[place:].replace(words, "", 1))) == bare(whole)
        assert same == (command.text in listed), command


@pytest.mark.parametrize("unit", ["I", "C", "in", "CM"])
def test_units(lens, unit):
    mm = {"I": 25.4, "C": 10.0}[unit[0].upper()]
    text = "S 2 0.5 NBK7_SCHOTT\nCIR 0.4\nASP\nA 0.01;J 0.5\nS 0 3\nXDE 0.1"
    found = lens(system(text, DIM=unit, EPD="0.5", YOB="1", SO="0 8"))
    row = found.rows[0]
    assert (row.radius, row.thickness, row.semi_diameter) == pytest.approx((2 * mm, 0.5 * mm, 0.4 * mm))
    assert row.coefficients == pytest.approx((0.01 / mm**3, *[0] * 7, 0.5 / mm**19))
    assert found.rows[1].decentre.x == pytest.approx(0.1 * mm)
    assert (found.aperture, found.object_distance, found.fields[0][1]) == pytest.approx((0.5 * mm, 8 * mm, mm))


def test_without_rdm_both_readings_are_named(lens):
    text = system("S 0 1 NBK7_SCHOTT\nSTO\nS -0.05 15").replace("RDM Y\n", "")
    default = "read as curvature -0.05 /mm (radius -20 mm), the default of CODE V; radius_mode=True reads it as radius"
    found, as_radius = lens(text), lens(text, radius_mode=True)
    assert found.notes[0] == f"no RDM: -0.05 of surface 2 is {default} -0.05 mm"
    assert as_radius.notes[0] == "no RDM: -0.05 of surface 2 is read as radius -0.05 mm"
    assert [each.rows[1].radius for each in (found, as_radius, lens(text, radius_mode=False))] == [-20, -0.05, -20]
    for mode in ("RDM N", "RDM"):
        assert not any("RDM" in note for note in lens(f"{mode}\n{text}").notes)
        with refused(r"against radius_mode=.*leave radius_mode out"):
            lens(f"{mode}\n{text}", radius_mode=mode == "RDM N")
    # A number in radius mode holds as it was given, RDY is always a radius and CUY a curvature
    found = lens(f"RDM N\n{text}\nRDY S1 30\nCUY S2 -0.01\nTHI S1 2;GLA S1 1.5168:64.17")
    assert (found.rows[0].radius, found.rows[1].radius, found.rows[0].thickness) == (30, -100, 2)
    assert found.rows[0].material == "nd=1.5168 Vd=64.17 k=0"


@pytest.mark.parametrize("angles", [(30, 0, 0), (0, -20, 0), (25, 15, 0), (-10, 35, 50), (0, 0, 20)])
def test_ben_follows_the_reflected_axis(lens, angles):
    """A ray along the axis goes on along the axis behind a mirror that bends it, whatever its angles."""
    found = lens(system("S 0 40\nS 0 -30 REFL\nBEN;ADE {};BDE {};CDE {}\nS 0 -20\nS 0 0".format(*angles)))
    hits, onward = trace(found, [(0, 0, -5)], [(0, 0, 1)])
    assert hits[-1, 0] == pytest.approx([0, 0, 0], abs=1e-12)
    assert onward[-1, 0] == pytest.approx([0, 0, -1], abs=1e-12)


def test_signs_of_the_angles(lens):
    """ADE tilts the axis to +y, BDE to -x (left-handed both), CDE turns x to y."""
    for name, normal in {"ADE": (0, math.sin(0.1), math.cos(0.1)), "BDE": (-math.sin(0.1), 0, math.cos(0.1))}.items():
        found = lens(system(f"S 0 40\nS 0 -40 REFL\n{name} {math.degrees(0.1)};DAR\n"))
        _, onward = trace(found, [(0, 0, -5)], [(0, 0, 1)])
        expected = np.array([0, 0, 1]) - 2 * normal[2] * np.array(normal)
        assert onward[1, 0] @ [0, 0, 1] == pytest.approx(expected @ normal, abs=1e-12)
        assert onward[-1, 0] == pytest.approx(expected, abs=1e-12)
    found = lens(system("S 0 10\nCDE 90\nS 0 10\n"))
    hits, _ = trace(found, [(1, 0, 0)], [(0, 0, 1)])
    assert hits[-1, 0] == pytest.approx([0, -1, 0], abs=1e-12)
    # A shift comes before the turn and stays; DAR returns, REV undoes
    move = "XDE 1;YDE 2;ZDE 3;ADE 10;BDE 20;CDE 30"
    for text, expected in (
        ("YDE 2;ADE 90\nS 0 0\nS 0 0", [[0, 2, 0], [0, 12, 0], [0, 12, 0], [0, 12, 0]]),
        (f"{move};DAR\nS 0 10\nS 0 0", [[1, 2, 3], [0, 0, 10], [0, 0, 20], [0, 0, 20]]),
    ):
        origins = to_world(lens(system(f"S 0 10\n{text}\n")), np.zeros((4, 1, 3)))[:, 0]
        assert origins == pytest.approx(np.array(expected), abs=1e-12)
    found = lens(system(f"S 0 10\n{move}\nS 0 -10\n{move};REV\nS 0 0\n"))
    assert [row.kind for row in found.rows] == ["surface", "surface", "coordinate_break", "surface", "image"]
    assert [row.number for row in found.rows] == [1, 2, 2, 3, 4]
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], dtype=float)
    placed = to_world(found, np.tile(points, (5, 1, 1)))
    # 10 along the turned axis, the inverse of the move, 10 back: only the shift along the two axes is left
    assert placed[3] == pytest.approx(points + placed[1][0] - placed[0][0] - [0, 0, 10], abs=1e-12)


def test_apertures_glasses_and_private_catalogues(lens):
    both = Outline((*circle(3).figures, OutlineFigure("rectangle", "&", sizes=(2, 9))))
    for text, radius, fixed, clear, opaque, unread in (
        ("CIR CLR 3; CIR EDG 4", 3, True, None, None, 1),
        ("CIR EDG 4", 4, False, None, None, 0),
        ("CIR 3; CIR 4", 4, True, None, None, 1),
        ("CIR 3; ADY 1", None, False, circle(3, y=1), None, 0),
        ("REX 2; REY 1; ADX -1", None, False, rectangle(2, 1, x=-1), None, 0),
        ("REY 1; ARO 10", None, False, rectangle(ALL, 1, angle_deg=10), None, 0),
        ("CIR 3; REX 2; REY 9", None, False, both, None, 0),
        ("CIR 3; CIR OBS 1; ADY OBS 2", 3, True, None, circle(1, y=2), 0),
        ("ELX 2; ELY 2", 2, True, None, None, 0),
        ("ELX 2; ELY 1", None, False, Outline((OutlineFigure("ellipse", sizes=(2, 1)),)), None, 0),
        ("CIR 3; CIR HOL 1", 3, True, circle(3, 1), None, 0),
        ("CIR 3; CIR OBS L'A' 1", 3, True, None, circle(1), 0),
        ("CIR HOL 1; CIR OBS 2", None, False, Outline((OutlineFigure("circle", "-", sizes=(1,)),)), circle(2), 0),
        ("REX EDG 3; REY EDG 2", None, False, None, None, 2),
    ):
        found = lens(system(f"S 10 2\n{text}\nS 0 5"))
        row = found.rows[0]
        assert (row.semi_diameter, row.semi_diameter_fixed) == (radius, fixed)
        assert (row.aperture, row.obscuration, len(found.unread)) == (clear, opaque, unread)
    named = ("NBK7_SCHOTT", "SLAL8_OHARA", "N-SF5", "BK7", "SILICA", "'MINE'")
    crystals = ("BAF2_SPECIAL", "BAF2", "BAF2_CDGM")
    numbers = ("517642", "517000.520000", "569.631", "1.7:30")
    text = "".join(f"S 10 2 {word}\n" for word in (*named, *numbers, *crystals))
    found = [row.material for row in lens(system(f"{text}S 0 5"), glasses={"mine": "1.5"}).rows]
    assert found[:6] == ["schott/N-BK7", "ohara/S-LAL8", "schott/N-SF5", "schott/N-BK7", "fused silica", "1.5"]
    assert found[6:10] == [f"nd={nd} Vd={vd} k=0" for nd, vd in ((1.517, 64.2), (1.517, 52), (1.569, 63.1), (1.7, 30))]
    assert [material.removesuffix(" k=0") for material in found[10:13]] == ["BaF2", "BaF2", "cdgm/BAF2"]

    def index(wavelength):
        return 1.5 + 6e3 / wavelength**2

    nodes = [700.0, 650.0, 587.6, 546.1, 486.1, 435.8, 404.7]
    falling, indices = [str(nm) for nm in nodes], " ".join(repr(index(nm)) for nm in nodes)
    table = f"PRV\nPWL {' '.join(falling[:4])}&\n{' '.join(falling[4:])}\n'E 48' {indices}"
    found = lens(system(f"{table}\nEND\nS 10 2 'E 48'\nS 0 5", WL="656.27 587.56 486.13", REF="2"))
    material = found.rows[0].material
    for wavelength in (*nodes, 656.27, 587.56, 486.13):
        assert refractive_index(material, wavelength) == pytest.approx(index(wavelength), abs=2e-7)
    assert abs(refractive_index(material, 519.0) - index(519.0)) > 2e-5  # linear there, see `table_material`
    assert table_material([500.0], [1.5], [600.0]) == "n(500.0)=1.5"


def test_finite_distances_and_what_is_left_out(lens):
    surfaces = "S 10 1 NBK7_SCHOTT\nS -20 15"

    def without_pupil(**changes: str) -> Sequential:
        return lens(system(surfaces, **changes).replace("EPD 10\n", ""))

    for key, value in (("FNO", "5"), ("NA", "0.1")):
        found = without_pupil(**{key: value}, SO="0 100")
        assert found.aperture_kind == "object_na"
        start = math.tan(math.asin(found.aperture))
        assert abs(paraxial_system(found)[0].trace(start * 100, start)[-1, 1]) == pytest.approx(0.1, rel=1e-12)
        assert any(key in note for note in found.notes)
        found = without_pupil(**{key: value}, SO="0 100 NBK7_SCHOTT")  # the beam itself, from a medium
        data = first_order(found)
        start = data.epd / 2 / (100 + data.entrance_pupil_z)
        assert abs(paraxial_system(found)[0].trace(start * 100, start)[-1, 1]) == pytest.approx(0.1, rel=1e-12)
    found = without_pupil(FNO="5")
    assert (found.aperture_kind, found.aperture) == ("f_number", 5)
    assert first_order(found).epd == pytest.approx(first_order(found).efl / 5)
    assert (without_pupil(NA="0.1").aperture, without_pupil(NAO="0.02", SO="0 100").aperture) == (5, 0.02)
    for words, telecentric in (("Y", True), ("N", False), ("", True)):
        found = lens(system(surfaces, SO="0 100", TEL=words))
        assert (found.telecentric, found.unread) == (telecentric, ())
    found = lens(system(surfaces, TEL="Y"))
    assert (found.telecentric, [(entry.line, entry.text) for entry in found.unread]) == (False, [(6, "TEL Y")])
    found = lens("RDM Y\nEPD 5\nWL 650 550 450\nS 10 1 NBK7_SCHOTT\nS -20 15")
    assert [note.split(":")[0] for note in found.notes] == ["no STO", "no SI", "no REF", "no field"]
    assert (found.wavelength_nm, found.rows[0].stop, found.rows[-2].thickness) == (550, True, 15)


X, Y = np.random.default_rng(4).uniform(-3, 3, (2, 40))


def conic(r2, c, k):
    return c * r2 / (1 + np.sqrt(1 - (1 + k) * c * c * r2))


def swept(profile, across, c):
    """A profile turned about a line at 1/c."""
    return (1 - np.sqrt((1 - c * profile) ** 2 - (c * across) ** 2)) / c


def aspheric(r2):
    return conic(r2, 1 / 80, -0.3)


@pytest.mark.parametrize(
    ("text", "height"),
    [
        ("YTO\nRDX 60\nK -.5\nA 1e-5", lambda x, y, r2: swept(conic(y * y, 1 / 80, -0.5) + 1e-5 * y**4, x, 1 / 60)),
        ("XTO\nRDX 60\nK -.5\nA 1e-5", lambda x, y, r2: swept(conic(x * x, 1 / 60, -0.5) + 1e-5 * x**4, y, 1 / 80)),
        ("CYL\nCUX 0", lambda x, y, r2: conic(y * y, 1 / 80, 0.0)),
        (
            "AAS\nCUX .01\nK -.2\nKX .3\nAR 1e-5\nAP .2\nBR 1e-7\nBP -.1",
            lambda x, y, r2: (
                (0.01 * x * x + y * y / 80) / (1 + np.sqrt(1 - 1.3 * (0.01 * x) ** 2 - 0.8 * (y / 80) ** 2))
                + 1e-5 * (0.8 * x * x + 1.2 * y * y) ** 2
                + 1e-7 * (1.1 * x * x + 0.9 * y * y) ** 3
            ),
        ),
        (
            "SPS XYP 12\nSCO NRADIUS 12\nSCO K -.3\nSCO C3 .01\nSCO C4 .02\nSCO C8 -.01\nSCO C10 .03",
            lambda x, y, r2: (
                aspheric(r2) + 0.01 * y / 12 + 0.02 * (x / 12) ** 2 - 0.01 * x * x * y / 12**3 + 0.03 * (y / 12) ** 3
            ),
        ),
        (
            "SPS ZRN 12\nSCO K -.3\nSCO NRADIUS 12\nSCO C2 .2; SCO C3 .1; SCO C6 .01; SCO C7 .02\nSCO C10 .03\n"
            "SCO C13 -.02",
            lambda x, y, r2: (
                aspheric(r2) + 0.2 + 0.1 * x / 12
                + 0.01 * (2 * r2 / 144 - 1)
                + 0.02 * 2 * x * y / 144
                + 0.03 * (3 * r2 / 144 - 2) * y / 12
                - 0.02 * (4 * r2 / 144 - 3) * (x * x - y * y) / 144
            ),
        ),
        (
            "SPS ZFR\nSCO C1 -.3\nSCO C2 12\nSCO C3 37\nSCO C7 .01\nSCO C9 .02\nSCO Z12 .03",
            lambda x, y, r2: (
                aspheric(r2) + 0.01 * (2 * r2 / 144 - 1) + 0.02 * 2 * x * y / 144
                + 0.03 * (4 * r2 / 144 - 3) * (x * x - y * y) / 144
            ),
        ),
        (
            "SPS ODD 0.0\nSCO K -.3\nSCO AR3 1e-4\nSCO AR4 -1e-5\nSCO C6 1e-6",
            lambda x, y, r2: aspheric(r2) + 1e-4 * r2**1.5 - 1e-5 * r2**2 + 1e-6 * r2**2.5,
        ),
        ("SPS ODD 12\nSCO AR5 1e-2", lambda x, y, r2: conic(r2, 1 / 80, 0.0) + 1e-2 * r2**2.5 / 12**5),
    ],
    ids=lambda value: value.split("\n")[0] if isinstance(value, str) else "",
)  # fmt: skip
@pytest.mark.parametrize(("unit", "mm"), [("M", 1.0), ("I", 25.4)])
def test_freeforms(lens, text, height, unit, mm):
    """Formulas written out; in the frame before the row's own turn, which an XTO has."""
    row = lens(system(f"S 80 2\n{text}\nS 0 5").replace("DIM M", f"DIM {unit}")).rows[0]
    turn = np.eye(4) if row.decentre is None else motion(row.decentre)
    assert row.decentre is None or row.decentre.returns
    x, y, _ = turn[:3, :3].T @ [mm * X, mm * Y, 0 * X]
    assert sag(x, y, row.sag_numbers) == pytest.approx(mm * height(X, Y, X * X + Y * Y), abs=1e-12 * mm)
    if text.startswith("XTO"):  # whose aperture turns back
        row = lens(system("S 80 2\nXTO\nRDX 60\nREX 4; REY 1; ADX 2\nS 0 5")).rows[0]
        for place in ((5.5, 0.5), (-1.9, 0.0), (-2.1, 0.0), (2.0, 1.1)):
            u, v, _ = turn[:3, :3].T @ [*place, 0.0]
            assert bool(row.aperture.contains(u, v)) == (place[0] in (5.5, -1.9))


def test_zoom_positions(lens):
    for names, gap, radius, distance, pupil, field, last in (
        ((None, "wide"), 20, 40, math.inf, 10, 5, 30),
        ((2, "in the middle"), 12.5, -42, math.inf, 11, 4, 30),
        (("3",), 5, 40, 800, 12, 3, 33),
    ):
        for found in (lens(ZOOM, configuration=wanted) for wanted in names):
            assert [row.thickness for row in found.rows] == [3, gap, 2, last, 0]
            assert found.rows[2].radius == pytest.approx(radius)
            assert (found.object_distance, found.aperture, found.fields) == (distance, pupil, ((0, 0), (0, field)))
            assert any("'in the middle'" in note for note in found.notes)
            assert [entry.text for entry in found.unread] == ["ZOO THC S2 0"]
    for absent in (0, 4, "Wide", "²"):
        with refused("zoom position"):
            lens(ZOOM, configuration=absent)
    solved = ZOOM.replace("S 0 30\n", "S 0 30\nPIM\n")
    first, second = (" ".join(lens(solved, configuration=wanted).notes) for wanted in (1, 2))
    assert "not solved anew" not in first
    assert "; not solved anew, but as in zoom position 1: PIM (line 8)" in second
    named = ZOOM.replace("ZOO EPD", "SLB S3 'Z1'; TIT 'Z3'\nZOO EPD")  # texts that look like positions
    found = lens(named, configuration=2)
    assert (found.name, found.rows[2].label) == ("Z3", "Z1")


def test_labels_that_look_like_surfaces_and_surface_0(lens):
    found = lens(system("S 10 1 NBK7_SCHOTT\nSLB 'first'\nS -20 15\nSLB 'S1'\nS 0 5\nSLB S3 'S2'", SO="0 50"))
    assert [row.label for row in found.rows[:3]] == ["first", "S1", "S2"]
    assert lens(system("S 10 1", SO="0 50").replace("SO ", "S0 ")).object_distance == 50

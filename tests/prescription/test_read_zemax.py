import math
from dataclasses import replace

import numpy as np
import pytest
import vectors
from oracles.small_scenes import write
from refusals import each_refused, refused

from mistray.materials import refractive_index
from mistray.physics.sags.terms import sag
from mistray.prescription import Decentre, Outline, OutlineFigure, Sequential, circle, read_zemax, rectangle
from mistray.prescription.sequential.first_order import first_order
from mistray.prescription.sequential.rays import frames, to_world, trace

pytestmark = pytest.mark.quick
COATINGS = vectors.DATA / "coating_sample.dat"
SYSTEM = vectors.text("zemax_system.txt").rstrip()
FIELD = "FTYP 0 0 1 1 0 0 0\nXFLN 0\nYFLN 0"
OBJECT = "SURF 0\n  TYPE STANDARD\n  DISZ INFINITY"
FRONT = "SURF 1\n  STOP\n  TYPE STANDARD\n  CURV 0.02\n  DISZ 5\n  GLAS N-BK7 0 0 1.5 40"
REAR = 'SURF 2\n  TYPE STANDARD\n  CURV -0.02 0 0 0 0 ""\n  DISZ 45'
IMAGE = "SURF 3\n  TYPE STANDARD\n  DISZ 0"
SINGLET = "\n".join([SYSTEM, OBJECT, FRONT, REAR, IMAGE])


@pytest.fixture
def read(tmp_path):
    def reader(text: str | bytes, **options) -> Sequential:
        return read_zemax(write(tmp_path, text, "lens.zmx"), **options)

    return reader


def surface(*lines: str, after: str = "") -> str:
    """The singlet with one more surface, of these lines, in front of it."""
    body = "\n".join(["SURF 1", *(f"  {line}" for line in lines)])
    moved = [part.replace(f"SURF {k}", f"SURF {k + 1}") for k, part in ((1, FRONT), (2, REAR), (3, IMAGE))]
    return "\n".join([SYSTEM, OBJECT, body, *moved, after])


@pytest.mark.parametrize(("encoding", "end"), [("utf-8", "\n"), ("utf-16", "\r\n"), ("latin-1", "\n")])
def test_singlet(encoding, end, read):
    text = SINGLET.replace("Singlet", "Ø = 8 mm")
    lens = read(text.replace("\n", end).encode(encoding))
    front, rear, image = lens.rows
    assert (lens.name, lens.source) == ("Ø = 8 mm", "Zemax file lens.zmx")
    assert (front.radius, front.thickness, front.material, front.stop) == (50.0, 5.0, "schott/N-BK7", True)
    assert (rear.radius, rear.thickness, rear.material, rear.stop) == (-50.0, 45.0, "air", False)
    assert (image.kind, image.radius, image.semi_diameter) == ("image", math.inf, None)
    assert (lens.object_distance, lens.object_material) == (math.inf, "air")
    assert (lens.aperture_kind, lens.aperture) == ("entrance_pupil_diameter", 8.0)
    assert (lens.wavelengths_nm, lens.weights, lens.primary) == ((587.5618,), (1.0,), 0)
    assert [row.number for row in lens.rows] == [1, 2, 3]
    assert [text.splitlines()[row.line - 1] for row in lens.rows] == ["SURF 1", "SURF 2", "SURF 3"]
    assert lens.unread == ()
    assert "glass N-BK7: the file does not decide whose it is; taken to be schott/N-BK7" in lens.notes  # no GCAT


@pytest.mark.parametrize(("unit", "mm"), [("MM", 1.0), ("CM", 10.0), ("IN", 25.4), ("METER", 1000.0)])
def test_units(unit, mm, read):
    asphere = surface("TYPE EVENASPH", "CURV 0.05", "CONI -2", "PARM 2 3e-4", "PARM 4 -2e-7", "DISZ 2", "DIAM 3 0")
    text = asphere.replace("UNIT MM", f"UNIT {unit}").replace("DISZ INFINITY", "DISZ 7")
    lens = read(text.replace("FTYP 0 0 1 1", "FTYP 1 0 1 1").replace("YFLN 0", "YFLN 0.5"))
    row = lens.rows[0]
    assert (row.radius, row.conic, row.thickness, row.semi_diameter) == pytest.approx((20 * mm, -2, 2 * mm, 3 * mm))
    # The sag at 1 lens unit is that many lens units, whatever the unit
    heights = [a * mm ** (2 * place) for place, a in enumerate(row.coefficients, 2)]
    assert heights == pytest.approx([3e-4 * mm, 0.0, -2e-7 * mm], rel=1e-12)
    assert (lens.object_distance, lens.aperture, lens.fields) == (7 * mm, 8 * mm, ((0.0, 0.5 * mm),))


def turned(*tilts: float, order: int = 0, x: float = 0.0, thickness: float = 0.0) -> str:
    values = enumerate((x, 0.0, *tilts, order), 1)
    return surface("TYPE COORDBRK", *(f"PARM {place} {value}" for place, value in values), f"DISZ {thickness}")


def test_tilts_folds_and_terms_in_r2_by_hand(read):
    """Right-handed rotations about the frame's own axes; the thickness runs along the last z axis."""
    for text, x_axis, z_axis, origin in (
        (turned(90, 0, 0), (1, 0, 0), (0, -1, 0), (0, 0, 0)),
        (turned(0, 90, 0), (0, 0, -1), (1, 0, 0), (0, 0, 0)),
        (turned(0, 0, 90), (0, 1, 0), (0, 0, 1), (0, 0, 0)),
        # About x first, then about the new y, which is the old z: z goes to -y, then x
        (turned(90, 90, 0), (0, 1, 0), (1, 0, 0), (0, 0, 0)),
        # The other order: about y first, then about the new x, which is the old -z: z goes to x, then -y … of the world
        (turned(90, 90, 0, order=1), (0, 0, -1), (0, -1, 0), (0, 0, 0)),
        (turned(0, 90, 0, x=2, thickness=5), (0, 0, -1), (1, 0, 0), (7, 0, 0)),
        (turned(0, 90, 0, order=1, x=2, thickness=5), (0, 0, -1), (1, 0, 0), (5, 0, -2)),
    ):
        frame = frames(read(text))[1]
        np.testing.assert_allclose(frame[:3, [0, 2]].T, [x_axis, z_axis], atol=1e-15)
        np.testing.assert_allclose(frame[:3, 3], origin, atol=1e-14)
    # A mirror turned by 45° about x sends +z to +y, and a second break by 45° with a negative thickness follows it
    lines = ["SURF 1", "  TYPE COORDBRK", "  PARM 3 45", "  DISZ 0", "SURF 2", "  GLAS MIRROR 0 0 1.5 40", "  DISZ 0"]
    lines += ["SURF 3", "  TYPE COORDBRK", "  PARM 3 45", "  DISZ -30", "SURF 4", "  DISZ 0"]
    lens = read("\n".join([SYSTEM, OBJECT, *lines]))
    assert [row.kind for row in lens.rows] == ["coordinate_break", "surface", "coordinate_break", "image"]
    assert lens.rows[1].mirror
    points, _ = trace(lens, [[0, 0, -5], [1, 0, -5], [0, 1, -5]], [0.0, 0.0, 1.0] * np.ones((3, 1)))
    np.testing.assert_allclose(to_world(lens, points)[-1], [[0, 30, 0], [1, 30, 0], [0, 30, 1]], atol=1e-12)
    lines = ["SURF 1", "  DISZ 5", "  GLAS N-BK7 0 0", "SURF 2", "  TYPE COORDBRK", "  PARM 1 1", "  DISZ 3", "SURF 3"]
    lines += ["  GLAS MIRROR 0 0", "  DISZ -8", "SURF 4", "  DISZ -9", "SURF 5", "  DISZ 0"]
    rows = read("\n".join([SYSTEM, OBJECT, *lines])).rows
    assert ([row.material for row in rows], rows[1].decentre) == (["schott/N-BK7"] * 3 + ["air"] * 2, Decentre(x=1.0))
    row = read(surface("SCBD 1 1 0 0.5 -0.25 10 20 30", "SCBD 2 0 0 0 0 0 0 0", "DISZ 2")).rows[0]
    assert row.decentre == Decentre(x=0.5, y=-0.25, tilt_deg=(10.0, 20.0, 30.0), tilt_first=True)
    text = surface("GLAS ___BLANK 1 0 1.6 40", "DISZ 1").replace("GLAS N-BK7 0 0 1.5 40", "GLAS ___BLANK 2 1 1.5 30")
    assert [row.material for row in read(text).rows[:2]] == ["nd=1.6 Vd=40 k=0"] * 2
    r = np.array([1.0, 5.0])
    for curvature, conic in ((0.0, 3), (0.02, -1)):
        terms = (f"CURV {curvature}", f"CONI {conic}", "PARM 1 0.01", "PARM 2 1e-6")
        row = read(surface("TYPE EVENASPH", *terms)).rows[0]
        assert row.conic == -1
        expected = (curvature / 2 + 0.01) * r**2 + 1e-6 * r**4
        np.testing.assert_allclose(r**2 / (2 * row.radius) + row.coefficients[0] * r**4, expected, rtol=1e-14)


def glass(line: str, system: str = "") -> str:
    return SINGLET.replace("GLAS N-BK7 0 0 1.5 40", line).replace(OBJECT, f"{system}\n{OBJECT}")


def test_glasses(read):
    for line, catalogues, material, note in (
        ("GLAS N-BK7 0 0 1.5 40", "SCHOTT", "schott/N-BK7", None),
        ("GLAS SF5 0 0 1.7 20", "HIKARI SCHOTT", "hikari/SF5", None),
        ("GLAS SF5 0 0 1.7 20", "MISC SCHOTT HIKARI", "schott/SF5", None),
        ("GLAS K-FK5 0 0", "SUMITA_AUG2011", "sumita/K-FK5", None),
        ("GLAS S-LAL10", "SCHOTT", "ohara/S-LAL10", "catalogues SCHOTT do not decide"),
        ("GLAS BK7 0 0 1.5 40", "SCHOTT", "schott/N-BK7", "BK7: taken to be schott/N-BK7"),
        ("GLAS BAF2 0 0", "CDGM INFRARED", "cdgm/BAF2", None),
        ("GLAS BAF2 0 0", "INFRARED CDGM", "BaF2 k=0", "BAF2: taken to be BaF2"),
        ("GLAS SILICA 0 0 1.5 40", "MISC", "fused silica", "SILICA: taken to be fused silica"),
        ("GLAS N-BK7 3 0 1.5 40", "SCHOTT", "schott/N-BK7", None),
        ("GLAS B270 0 0", "SCHOTT", "schott/B270 k=0", "glass B270: absorption unknown, taken to be 0"),
        ("GLAS ___BLANK 1 0 1.6 38.5 0 0 0 0", "", "nd=1.6 Vd=38.5 k=0", "two-term Cauchy"),
        ("GLAS ___BLANK 1 0 1,6 38,5 0,01", "", "nd=1.6 Vd=38.5 k=0", "dPgF = 0.01 is not used"),
        ("GLAS ___BLANK 1 0 1.6 0", "", "1.6", None),
        ("GLAS AIR 0 0 1 0", "", "air", None),
    ):
        lens = read(glass(line, f"GCAT {catalogues}"))
        assert lens.rows[0].material == material
        found = [(note or "absorption") in each for each in lens.notes]
        assert any(found) if note else all(found)


def test_agf_file_and_replacements_go_first(read, tmp_path):
    agf = tmp_path / "own.agf"
    agf.write_text("NM N-BK7 1 0 1.6 40\nCD 2.56 0 0 0 0 0\nLD 0.3 2.5\nIT 0.3 0.9 10\nIT 2.5 0.9 10\n")
    material = read(glass("GLAS n-bk7 0 0", "GCAT SCHOTT"), glass_catalogues=[agf]).rows[0].material
    assert (material, refractive_index(material, 587.56)) == (f"{agf}:n-bk7", pytest.approx(1.6))
    lens = read(glass("GLAS SECRET 0 0"), glass_catalogues=[agf], glasses={"secret": "1.75"})
    assert lens.rows[0].material == "1.75"
    assert "glass SECRET: replaced by 1.75, as asked" in lens.notes
    with refused(r"glass catalogue .*No such file"):
        read(SINGLET, glass_catalogues=[tmp_path / "none.agf"])


@pytest.mark.parametrize(
    ("lines", "semi_diameter", "fixed", "aperture"),
    [
        (["DIAM 0 0"], None, False, None),
        (["DIAM 4 1 0 0 1"], 4.0, False, None),
        (["DIAM 4 1", "FLAP 0 4 0"], 4.0, True, None),
        (["DIAM 4 0", "CLAP 0 3 0"], 3.0, True, circle(3.0)),
        (["CLAP 1 3 0"], 3.0, False, circle(3.0, 1.0)),
        (["DIAM 9 0", "CLAP 0 3 0", "OBDC 6 8"], 13.0, False, circle(3.0, x=6.0, y=8.0)),
        (["DIAM 4 0", "OBSC 0 1 0"], 4.0, False, (None, circle(1.0))),
        (["SQAP 3 4 0"], 5.0, False, rectangle(3.0, 4.0)),
        (["DIAM 4 0", "SQOB 1 2 0", "OBDC 0 1"], 4.0, False, (None, rectangle(1.0, 2.0, y=1.0))),
        (["ELAP 3 3"], 3.0, True, circle(3.0)),
        (["ELAP 3 4", "OBDC 1 0"], math.hypot(4.0, 4.0), False,
         Outline((OutlineFigure("ellipse", "+", 1.0, 0.0, sizes=(3.0, 4.0)),))),
        (["DIAM 4 0", "ELOB 1 2"], 4.0, False, (None, Outline((OutlineFigure("ellipse", sizes=(1.0, 2.0)),)))),
        (["DIAM 4 0", "SPID 0.5 2 0", "OBDC 0 1"], 4.0, False,
         (None, Outline((OutlineFigure("rectangle", "+", 8.0, 1.0, 0.0, (8.0, 0.25)),
                         OutlineFigure("rectangle", "+", -8.0, 1.0 + 8.0 * math.sin(math.pi), 180.0, (8.0, 0.25)))))),
    ],
)  # fmt: skip
def test_apertures(lines, semi_diameter, fixed, aperture, read):
    lens = read(surface(*lines, "DISZ 1"))
    row = lens.rows[0]
    clear, opaque = aperture if isinstance(aperture, tuple) else (aperture, None)
    assert (row.semi_diameter, row.semi_diameter_fixed) == (semi_diameter, fixed)
    assert (row.aperture, row.obscuration, lens.unread) == (clear, opaque, ())


FIELDS = "FTYP {} 0 2 1\nXFLN 1 2 9 9\nYFLN 3 4 9 9\nVDXN 0 0.1 9\nVDYN 0 0.2 9\nVCXN 0 0.3 9\nVCYN 0 0.4 9\nVANN 0 0 0"
VIGNETTED = {"fields": ((1.0, 3.0), (2.0, 4.0)), "vignetting": ((0.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3, 0.4))}
WAVES = "WAVM 1 0.5875618 1\nPWAV 1"
LIGHT = f"{FIELD}\n{WAVES}"


def waves(first: float, second: float, weight: float, primary: int) -> dict[str, object]:
    return {"wavelengths_nm": (first, second), "weights": (1.0, weight), "primary": primary}


def test_system_lines_finite_objects_angles_and_coatings(read):
    for old, new, expected in (
        ("ENPD 8", "FNUM 2.8 0", {"aperture_kind": "f_number", "aperture": 2.8}),
        ("ENPD 8", "OBNA 0.25 0", {"aperture_kind": "object_na", "aperture": 0.25}),
        ("ENPD 8", "OBNA 30 1", {"aperture_kind": "object_na", "aperture": pytest.approx(0.5)}),
        ("ENPD 8", "FLOA", {"aperture_kind": "stop_diameter", "aperture": 7.0}),
        ("DISZ INFINITY", "DISZ 1E+10", {"object_distance": math.inf}),
        (FIELD, FIELDS.format(0), VIGNETTED | {"field_kind": "angle_deg"}),
        (FIELD, FIELDS.format(1), VIGNETTED | {"field_kind": "object_height"}),
        (FIELD, FIELDS.format(2), VIGNETTED | {"field_kind": "image_height"}),
        (LIGHT, "FTYP 0 0 1 2\nWAVM 1 0.4861 1\nWAVM 2 0.6563 0.5\nWAVM 3 0.55 1\nPWAV 2", waves(486.1, 656.3, 0.5, 1)),
        # Old files without the number fill the list up with one value
        (LIGHT, "WAVM 1 0.4861 1\nWAVM 2 0.55 1\nWAVM 3 0.55 1\nWAVM 4 0.55 1\nPWAV 2", waves(486.1, 550.0, 1.0, 1)),
        (LIGHT, "WAVL 0.4861 0.5876\nWWGT 1 0.25\nPWAV 1", waves(486.1, 587.6, 0.25, 0)),
        (WAVES, "", {"wavelengths_nm": (587.56,), "weights": (1.0,), "primary": 0}),
    ):
        text = SINGLET.replace("  STOP", "  STOP\n  DIAM 3.5 0")
        assert old in text
        lens = read(text.replace(old, new))
        assert {key: getattr(lens, key) for key in expected} == expected
    # A thin lens, f = 60 mm, from 90 to 180 mm: F/5 at the image is a slope of 0.1 there and of 0.2 at the object
    rows = f"SURF 1\n  STOP\n  CURV {1 / 60}\n  GLAS ___BLANK 1 0 1.5 0\nSURF 2\n  CURV {-1 / 60}\n  DISZ 180"
    text = "\n".join([SYSTEM, OBJECT.replace("INFINITY", "90"), rows, "SURF 3", "  DISZ 0"])
    lens = read(text.replace("ENPD 8", "FNUM 5 1"))
    assert (lens.aperture_kind, math.tan(math.asin(lens.aperture))) == ("object_na", pytest.approx(0.2, rel=1e-12))
    assert any("working F-number 5 " in note for note in lens.notes)
    oil = text.replace("  DISZ 90", "  DISZ 90\n  GLAS ___BLANK 1 0 1.5 0")
    assert read(oil.replace("ENPD 8", "OBNA 30 1")).aperture == pytest.approx(0.75)  # NA = n sin θ
    lens = read(text.replace("ENPD 8", "FNUM 5 0"))  # of infinite conjugates, wherever the object is
    assert first_order(lens).epd == pytest.approx(60 / 5)
    floating = SINGLET.replace("ENPD 8", "FLOA").replace("  STOP", "  STOP\n  DIAM 3.5 0\n  CLAP 0 6 0")
    assert read(floating).aperture == 7.0  # of the semi-diameter, whatever aperture the surface has
    lens = read(text.replace("ENPD 8", "OBNA 0.1 0").replace("FTYP 0 0", "FTYP 1 1"))
    assert (lens.telecentric, lens.unread) == (True, ())
    # Azimuth 30°, elevation 40°: the direction (cos 40° sin 30°, sin 40°, cos 40° cos 30°) has the same tangents
    text = SINGLET.replace("FTYP 0", "FTYP 4").replace("XFLN 0", "XFLN 30").replace("YFLN 0", "YFLN 40")
    ((x, y),) = read(text).fields
    azimuth, elevation = math.radians(30), math.radians(40)
    z = math.cos(elevation) * math.cos(azimuth)
    assert math.tan(math.radians(x)) == pytest.approx(math.cos(elevation) * math.sin(azimuth) / z)
    assert math.tan(math.radians(y)) == pytest.approx(math.sin(elevation) / z)
    text = SINGLET.replace("  STOP", "  STOP\n  COAT HR")
    lens = read(text)
    assert lens.rows[0].coating == "HR"
    assert [(line.text, line.line) for line in lens.unread] == [("COAT HR", text.splitlines().index("  COAT HR") + 1)]
    lens = read(text, coatings=COATINGS)
    assert (lens.rows[0].coating, lens.unread) == (f"{COATINGS}:HR", ())
    with refused(r"line 15: coating file .*no coating 'HRX'"):
        read(text.replace("HR", "HRX"), coatings=COATINGS)


def test_lines_are_listed_or_refused(read):
    for text, lines in (
        (surface("TYPE SZERNSAG", "XDAT 1 2", "XDAT 2 10", "XDAT 9 3", "XDAT 8 0"), ["XDAT 9 3"]),
        (surface("UDAD mask", "DIAM 5 0"), ["UDAD mask"]),
        (surface("OBDC 1 2", "DIAM 5 0"), ["OBDC 1 2"]),
        (surface("TYPE COORDBRK", "PARM 7 1"), ["PARM 7 1"]),
        (SINGLET.replace("DISZ 0", "DISZ 0\n  GLAS N-BK7 0 0"), ["GLAS N-BK7 0 0"]),
        (glass("GLAS N-BK7 4 0 0.001 0.2", "GCAT SCHOTT"), ["GLAS N-BK7 4 0 0.001 0.2"]),
        (SINGLET.replace("DISZ INFINITY", "DISZ 9\n  CURV 0.1"), ["CURV 0.1"]),
        (surface("TYPE STANDARD", "PARM 1 0", "PARM 2 3"), ["PARM 2 3"]),
        (SINGLET.replace("FTYP 0 0 1 1", "FTYP 1 1 1 1").replace("ENPD 8", "OBNA 0.1 0"), ["FTYP 1 1 1 1 0 0 0"]),
        (SINGLET.replace("PWAV", "VANN 5\nPWAV"), ["VANN 5"]),
        (SINGLET.replace("PWAV", "ENVD 35 1 0\nPWAV"), ["ENVD 35 1 0"]),
        (SINGLET.replace("PWAV", "GFAC 1 2\nPWAV"), ["GFAC 1 2"]),
        (SINGLET.replace("PWAV", "GFAC 0 0\nNOTE 0 hello\nPOLS 1 0 1\nGLRS 1 0\nPWAV"), []),
        (SINGLET.replace("PWAV", "ENVD 20 1 0\nRAIM 0 1\nCOFN COATING.DAT\nPWAV"), []),
        (SINGLET.replace("  STOP", "  STOP\n  HIDE 0\n  MIRR 2 0\n  POPS 0\n  MEMA 9\n  VPAR 2"), []),
        (SINGLET + "\nEFFL 1 2 0\nTOL TOFF\nMNUM 3 1\nTHIC 2 1 5.0", []),
        (SINGLET + "\nEFFL 1 2 0\nTOL TOFF\nMNUM 1 1\nMOFF 0", []),
        (SINGLET.replace("\n  ", "\n") + "\nEFFL 1 2 0", ["EFFL 1 2 0"]),  # could belong to the surface
    ):
        lens = read(text)
        assert [line.text for line in lens.unread] == lines
        for line in lens.unread:
            assert (text.splitlines()[line.line - 1].strip(), bool(line.reason)) == (line.text, True)
        if not lines:  # those that are known to have no effect
            assert [replace(row, line=0) for row in lens.rows] == [replace(row, line=0) for row in read(SINGLET).rows]
    # An unknown keyword is listed wherever it stands, and so is one between two surfaces
    lines = SINGLET.splitlines()
    for place in range(len(lines) + 1):
        for stray in ("QQQQ 1 2", "  QQQQ 1 2"):
            if place == len(lines) and stray[0] == "Q":
                continue  # the merit function of an indented file
            lens = read("\n".join([*lines[:place], stray, *lines[place:]]))
            assert [(line.line, line.text) for line in lens.unread] == [(place + 1, "QQQQ 1 2")], place
    for change, message in (
        ((SINGLET, bytes(range(256)).decode("latin-1")), "no line 'SURF 0'"),
        (("CURV -0.02", "STOP\n  CURV -0.02"), "surfaces 1, 2 are all stops"),
        ((f"{FRONT}\n{REAR}\n{IMAGE}", IMAGE.replace("3", "1")), "it needs one at least, and an image"),
    ):
        with refused(message) as error:
            read(SINGLET.replace(*change, 1))
        assert len(str(error.value)) < 400


CONFIGURATIONS = SINGLET + "\n" + vectors.text("zemax_configurations.txt")


@pytest.mark.parametrize("wanted", [2, "2", "near"])
def test_configurations(wanted, read):
    saved, other = read(CONFIGURATIONS), read(CONFIGURATIONS, configuration=wanted)
    assert saved.rows == read(SINGLET).rows == read(SINGLET, configuration=1).rows
    assert (saved.object_distance, other.object_distance) == (math.inf, 800)
    assert (other.rows[1].thickness, other.rows[0].radius, other.aperture) == (97.5, -100, 7.25)
    assert (other.fields[0], other.vignetting[0]) == ((saved.fields[0][0], 3.5), (0, 0.125, 0, 0))
    for lens in (saved, other):
        assert any("'other glass'" in note for note in lens.notes)
        assert lens.unread == ()
    old = CONFIGURATIONS.replace("FTYP 0 0 1 1", "FTYP 0 0 3 1").replace("FLN 0", "FLD 0 7 10")
    assert read(old.replace("YFIE 1 2", "YFIE 3 2"), configuration=2).fields == ((0, 0), (7, 7), (10, 3.5))
    # A solve has set the back focus for the saved configuration alone
    solved = CONFIGURATIONS.replace("DISZ 45", "DISZ 45\n  MAZH 0 0")
    first, second = (" ".join(read(solved, configuration=wanted).notes) for wanted in (1, 2))
    assert "not solved anew" not in first
    assert "; not solved anew, but as in configuration 1: MAZH of surface 2" in second


def test_configurations_that_cannot_be_read(read):
    each_refused(
        (3, "line .*: 'GLSS 1 3 N-SF11.*' *: GLSS is not read"),
        (4, "configuration 4 of 3"),
        ("²", "configuration '²' is not there"),
        ("far", "configuration 'far' is not there; the file has 'at infinity', 'near', 'other glass'"),
        by=lambda wanted: read(CONFIGURATIONS, configuration=wanted),
    )


def test_an_irregular_surface_and_an_odd_asphere_over_a_radius(read):
    """Formulas of OpticStudio's manual; the second is the one that OpticStudio itself gives 1e-5 mm for."""
    lens = read(surface("TYPE IRREGULA", "PARM 5 0.01", "PARM 6 -0.02", "PARM 7 0.03", "DIAM 8 0", "CURV 0.02"))
    x, y = np.array([0.0, 3.0, -2.0, 8.0]), np.array([8.0, 4.0, 1.0, 0.0])
    base = read(surface("DIAM 8 0", "CURV 0.02")).rows[0].sag_numbers
    r2, v = (x * x + y * y) / 64, y / 8
    expected = 0.01 * r2**2 - 0.02 * v**2 + 0.03 * r2 * v
    assert sag(x, y, lens.rows[0].sag_numbers) - sag(x, y, base) == pytest.approx(expected, abs=1e-14)
    lens = read(surface("TYPE XOSPHERE", "XDAT 1 4", "XDAT 2 2", "XDAT 5 8e-5"))
    assert sag(np.array(1.0), np.array(0.0), lens.rows[0].sag_numbers) == pytest.approx(1e-5, abs=1e-18)

"""`mistray import` of lens files: what it writes, prints and refuses; and a lens file in the place of a scene."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import json_units
import pytest
import vectors
from command_line import fails, run, succeeds
from singlet_files import SEQ, ZMX

import mistray
import mistray.scenes

pytestmark = pytest.mark.quick

CAMERA = Path(mistray.scenes.__file__).parent / "phone_camera" / "prescription.json"
INDEX = 1.5168


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("singlet.zmx").write_text(ZMX)


def imported(capsys, text: str, *options: object, name: str = "singlet.zmx") -> list[str]:
    """Lines that the import of a file prints, which writes a.xml."""
    Path(name).write_text(text)
    return succeeds(capsys, "import", name, "-o", "a.xml", "--force", *options).splitlines()


def shapes(path: str = "a.xml") -> dict[str, ElementTree.Element]:
    return {node.get("id", ""): node for node in ElementTree.parse(path).getroot().iter("shape")}


def test_zemax_file(capsys):
    lines = imported(capsys, ZMX)
    assert lines[0] == f"a.xml: {len(shapes())} surfaces; next: mistray ghosts a.xml --field-deg 0 3"
    # By hand: 1/f = (n-1)(1/R1 - 1/R2 + (n-1) t/(n R1 R2)), n = 1.5168 → 49.0 mm, back focus f (1 - (n-1) t/(n R1))
    assert "at 587.562 nm: focal length 49.2" in lines[1]
    assert ", F/6.1" in lines[1]
    assert lines[1].endswith("entrance pupil 8 mm")
    assert "1 line of singlet.zmx had no effect:" in lines
    assert any(line.startswith("  line 11: XYZZY 1 2 3  (") for line in lines)
    assert {"S1", "S2", "L1_edge", "barrel_1_wall", "detector"} <= set(shapes())
    assert "XYZZY" in Path("a.xml").read_text(encoding="utf-8")
    # A CODE V file gives the same surfaces
    trees = {name: ElementTree.tostring(tree) for name, tree in shapes().items()}
    imported(capsys, SEQ, name="singlet.seq")
    assert {name: ElementTree.tostring(tree) for name, tree in shapes().items()} == trees


def test_json(capsys):
    record = json_units.read("\n".join(imported(capsys, ZMX, "--json", "--beam", "exact")))
    r, t = 50.0, 5.0
    power = (INDEX - 1) * (2 / r - (INDEX - 1) * t / (INDEX * r * r))
    assert record["efl_mm"] == pytest.approx(1 / power, rel=1e-5)
    assert record["bfl_mm"] == pytest.approx((1 - (INDEX - 1) * t / (INDEX * r)) / power, rel=1e-5)
    assert record["fields_deg"] == [[0.0, 0.0], [0.0, 3.0]]
    assert [(item["line"], item["text"]) for item in record["unread"]] == [(11, "XYZZY 1 2 3")]
    assert record["files"] == ["a.xml"]
    # Two bare faces of N-BK7 at the d line, the detector absorbs all
    bare = (1 - ((INDEX - 1) / (INDEX + 1)) ** 2) ** 2
    assert record["arriving_share"] == pytest.approx(bare, rel=2e-3)
    # The stop cuts a wider beam, of whose 4000 rays 0.9 count: 5 standard errors, once in 1e6
    record = json_units.read("\n".join(imported(capsys, ZMX, "--json")))
    assert record["arriving_share"] == pytest.approx(bare, rel=5 * (0.1 / 0.9 / 4000) ** 0.5)
    assert any("wider than the pupil" in note for note in record["notes"])
    assert "it has R13=5.272" in fails(capsys, "import", CAMERA, "-o", "camera.xml", "--variant", "nope")
    line = ("import", CAMERA, "-o", "camera.xml", "--wavelength-nm", 600, "--json")
    record = json_units.read(succeeds(capsys, *line))
    assert list(mistray.load("camera.xml").emitters()[0].wavelengths_nm) == [600.0]
    assert (record["surfaces"], record["unread"]) == (len(shapes("camera.xml")), [])


def test_fields_of_a_tilted_lens_keep_their_sign(capsys):
    """About one axis -3° is the same as 3°; behind a tilt it is not."""
    three = ZMX.replace("FTYP 0 0 2", "FTYP 0 0 3").replace("XFLN 0 0", "XFLN 0 0 0").replace("0 3\n", "0 3 -3\n")
    assert imported(capsys, three)[0].endswith("--field-deg 0 3")
    tilt = "SURF 1\n  TYPE COORDBRK\n  PARM 3 5\n  DISZ 0\nSURF 2\n  STOP"
    renumbered = three.replace("SURF 3", "SURF 4").replace("SURF 2", "SURF 3").replace("SURF 1\n  STOP", tilt)
    assert imported(capsys, renumbered)[0].endswith("--field-deg -3 0 3")


def test_a_telecentric_lens(capsys):
    text = ZMX.replace("ENPD 8", "OBNA 0.05 0").replace("FTYP 0 0 2", "FTYP 1 1 2").replace("DISZ INFINITY", "DISZ 60")
    next_command, numbers, *_ = imported(capsys, text)
    assert next_command.endswith("mistray ghosts a.xml --field-mm 0 3")
    assert numbers.endswith(", telecentric in object space")
    source = ElementTree.parse("a.xml").find("emitter[@type='point_source']")
    assert float(source.find("float[@name='z']").get("value")) == -60
    assert json_units.read("\n".join(imported(capsys, text, "--json")))["f_number"] is None


def test_options_reach_the_scene(capsys):
    """The path of a coating file in a scene is relative to it, that on the command line to the current folder."""
    for folder in ("lib", "out"):
        Path(folder).mkdir()
    Path("lib/COATING.DAT").write_bytes((vectors.DATA / "coating_sample.dat").read_bytes())
    Path("singlet.zmx").write_text(ZMX.replace("  CURV 0.02\n", "  CURV 0.02\n  COAT AR\n"))
    succeeds(capsys, "import", "singlet.zmx", "-o", "out/a.xml", "--edges", "ground", "--margin", 0.1, "--beam",
             "front", "--detector-half-mm", 3, 2, "--wavelength-nm", 600, "--glass", "N-BK7=1.7",
             "--coatings", "lib/COATING.DAT")  # fmt: skip
    text = Path("out/a.xml").read_text(encoding="utf-8")
    for part in ("ground_edge", 'name="half_height" value="2"', 'value="1.7"', 'name="wavelength_nm" value="600"'):
        assert part in text
    assert "../lib/COATING.DAT:AR" in text


@pytest.mark.parametrize(("name", "options", "message"), vectors.toml("refusals.toml")["imports"])
def test_what_makes_no_sense_is_refused(capsys, name, options, message):
    Path(name).write_text(ZMX)
    assert message in fails(capsys, "import", name, *options)
    assert {path.name for path in Path().iterdir()} == {name, "singlet.zmx"}


def test_the_detector_absorbs_all_unless_it_is_coated(capsys):
    """As the note says: here, or with mistray coat. A name of the lens file is answered."""
    (note,) = [line for line in imported(capsys, ZMX) if "the detector absorbs" in line]
    assert "--coating 'detector=R=0.1'" in note
    assert "the detector absorbs" in Path("a.xml").read_text(encoding="utf-8")
    succeeds(capsys, "coat", "a.xml", "detector=R=0.1", "-o", "b.xml")
    named = ZMX.replace("SURF 1\n", "SURF 1\n  COMM L1 front\n").replace("SURF 3\n", "SURF 3\n  COMM FPA\n")
    out = "\n".join(imported(capsys, named, "--coating", "detector=R=0.1"))
    assert "the detector absorbs" not in out + Path("a.xml").read_text(encoding="utf-8")
    assert "'L1 front' is 'L1_front', 'FPA' is 'detector'" in out
    assert "L1_front" in shapes()
    for name in ("a.xml", "b.xml"):
        floats = shapes(name)["detector"].iter("float")
        assert [item.get("value") for item in floats if item.get("name") == "R"] == ["0.1"]
    assert "did you mean 'detector'" in fails(capsys, "import", "singlet.zmx", "-o", "c.xml", "--coating", "FPA=R=0.05")
    assert "did you mean 'detector'" in fails(capsys, "coat", "a.xml", "FPA=R=0.05", "-o", "c.xml")


def test_the_beam_and_the_stop(capsys):
    """A stop of 4 mm in radius at the first surface, then at the second one behind 3 mm of clear radius."""
    for beam, said in (("pupil", "overfills the stop"), ("exact", "just fills the stop")):
        out = "\n".join(imported(capsys, ZMX, "--beam", beam))
        assert f"note: the beam {said}, surface 1, of radius 4 mm" in out
    inner = ZMX.replace("  STOP\n", "").replace("SURF 2\n", "SURF 2\n  STOP\n")
    out = "\n".join(imported(capsys, inner.replace("DISZ 5\n", "DISZ 5\n  CLAP 0 3 0\n")))
    # In first order the heights at the stop go with those at the first surface: 3 mm of 4 mm
    found = re.search(r"the beam fills the stop, surface 2, .* only to ([\d.]+) % of its radius: 'S1' takes", out)
    assert float(found[1]) == pytest.approx(75, abs=1.5)


def test_no_light_arrives(capsys):
    """A plate in the beam: batoid drops what it obscures, and here everything is obscured."""
    pytest.importorskip("batoid")
    Path("dark.yaml").write_text(vectors.text("dark.yaml"))
    code, out, err = run(capsys, "import", "dark.yaml", "-o", "dark.xml", "--wavelength-nm", 500)
    assert (code, err.count("\n")) == (2, 1)
    assert "'lid' takes 100 %" in err
    assert "dark.xml" in err
    assert "dark.xml" in out
    assert "lid" in shapes("dark.xml")


def test_many_lines_with_the_same_keyword_are_told_once(capsys):
    """As in a file whose surfaces all have a keyword that is new."""
    text = ZMX.replace("  TYPE STANDARD\n", "  TYPE STANDARD\n  ABCD 7\n")
    told = [line for line in imported(capsys, text) if "ABCD" in line]
    assert len(told) == 1
    assert f"and {text.count('ABCD') - 1} more" in told[0]


def test_ghosts_of_a_lens_file(capsys):
    """Numbers on stdout, what was assumed on stderr, nothing left behind; one that cannot be read is told."""
    code, out, notes = run(capsys, "ghosts", "singlet.zmx", "--rays", 500, "--json")
    assert code == 0, notes
    assert json.loads(out)["fields"][0]["worst_paths"]
    for part in ("line 11: XYZZY 1 2 3", "--coating 'detector=R=0.1'", "mistray import"):
        assert part in notes
    assert [path.name for path in Path().iterdir()] == ["singlet.zmx"]
    Path("telescope.yaml").write_text("opticalSystem: {}", encoding="utf-8")
    for name, message in (("none.seq", "none.seq"), ("telescope.yaml", "give --wavelength-nm")):
        assert message in fails(capsys, "ghosts", name)


def test_coating_a_lens_file_writes_a_scene(capsys):
    """Without a trace; the same scene as with an import before it. The lens file is never written on."""
    code, out, notes = run(capsys, "coat", "singlet.zmx", "S?=bbar3", "-o", "coated.xml")
    assert code == 0
    assert "bbar3: S1, S2" in out
    assert "imported as it stands" in notes
    assert mistray.load("coated.xml").shapes()
    succeeds(capsys, "import", "singlet.zmx")
    succeeds(capsys, "coat", "singlet.xml", "S?=bbar3", "-o", "twice.xml")
    assert Path("twice.xml").read_text() == Path("coated.xml").read_text()
    assert "singlet.zmx" in run(capsys, "coat", "singlet.zmx", "S?=bbar3", "-o", "singlet.zmx", "--force")[2]
    assert Path("singlet.zmx").read_text() == ZMX

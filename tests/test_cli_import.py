"""`mistray import` of sequential lens files: what it writes, prints and refuses."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import json_units
import pytest

from mistray import cli

pytestmark = pytest.mark.quick

SHARED = Path(__file__).parent / "data"
# f = 50 · 50 / 100 / (n - 1) about, n of N-BK7 at the d line
ZMX = """MODE SEQ
NAME Singlet
UNIT MM X W X CM MR CPMM
ENPD 8
GCAT SCHOTT
FTYP 0 0 2 1 0 0 0
XFLN 0 0
YFLN 0 3
WAVM 1 0.5875618 1
PWAV 1
XYZZY 1 2 3
SURF 0
  TYPE STANDARD
  DISZ INFINITY
SURF 1
  STOP
  TYPE STANDARD
  CURV 0.02
  DISZ 5
  GLAS N-BK7 0 0 1.5168 64.17
SURF 2
  TYPE STANDARD
  CURV -0.02
  DISZ 46
SURF 3
  TYPE STANDARD
  DISZ 0
"""
SEQ = """RDM Y
LEN
TITLE 'Singlet'
EPD 8
DIM M
WL 587.5618
REF 1
XAN 0 0
YAN 0 3
SO 0 1E20
S 50 5 NBK7_SCHOTT
  STO
S -50 46
SI 0 0
GO
"""


@pytest.fixture
def zmx(tmp_path):
    path = tmp_path / "singlet.zmx"
    path.write_text(ZMX)
    return path


def run(capsys, *arguments) -> tuple[int, str, str]:
    code = cli.main(["import", *map(str, arguments)])
    out, err = capsys.readouterr()
    return code, out, err


def fails(capsys, *arguments) -> str:
    code, out, err = run(capsys, *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    return err


def shapes(path: Path) -> dict[str, ElementTree.Element]:
    return {node.get("id", ""): node for node in ElementTree.parse(path).getroot().iter("shape")}


def test_zemax_file(capsys, zmx, tmp_path):
    output = tmp_path / "a.xml"
    code, out, _ = run(capsys, zmx, "-o", output)
    assert code == 0
    lines = out.splitlines()
    assert lines[0] == f"{output}: {len(shapes(output))} surfaces; next: mistray ghosts {output} --field-deg 0 3"
    # By hand: 1/f = (n-1)(1/R1 - 1/R2 + (n-1) t/(n R1 R2)), n = 1.5168 → 49.0 mm, back focus f (1 - (n-1) t/(n R1))
    assert "at 587.562 nm: focal length 49.2" in lines[1]
    assert ", F/6.1" in lines[1]
    assert lines[1].endswith("entrance pupil 8 mm")
    assert "1 line of singlet.zmx had no effect:" in lines
    assert any(line.startswith("  line 11: XYZZY 1 2 3  (") for line in lines)
    assert {"S1", "S2", "L1_edge", "barrel_1_wall", "detector"} <= set(shapes(output))
    assert "XYZZY" in output.read_text(encoding="utf-8")


def test_code_v_file_gives_the_same_surfaces(capsys, zmx, tmp_path):
    seq = tmp_path / "singlet.seq"
    seq.write_text(SEQ)
    assert run(capsys, seq, "-o", tmp_path / "seq.xml")[0] == 0
    assert run(capsys, zmx, "-o", tmp_path / "zmx.xml")[0] == 0
    both = [shapes(tmp_path / name) for name in ("seq.xml", "zmx.xml")]
    assert list(both[0]) == list(both[1])
    for name in both[0]:
        texts = [ElementTree.tostring(tree[name]) for tree in both]
        assert texts[0] == texts[1], name


def test_fields_of_a_tilted_lens_keep_their_sign(capsys, zmx, tmp_path):
    """About one axis -3° is the same as 3°; behind a tilt it is not."""
    zmx.write_text(
        ZMX.replace("FTYP 0 0 2", "FTYP 0 0 3").replace("XFLN 0 0", "XFLN 0 0 0").replace("0 3\n", "0 3 -3\n")
    )
    assert run(capsys, zmx, "-o", tmp_path / "a.xml")[1].splitlines()[0].endswith("--field-deg 0 3")
    tilt = "SURF 1\n  TYPE COORDBRK\n  PARM 3 5\n  DISZ 0\nSURF 2\n  STOP"
    renumbered = zmx.read_text().replace("SURF 3", "SURF 4").replace("SURF 2", "SURF 3")
    zmx.write_text(renumbered.replace("SURF 1\n  STOP", tilt))
    code, out, err = run(capsys, zmx, "-o", tmp_path / "b.xml")
    assert code == 0, err
    assert out.splitlines()[0].endswith("--field-deg -3 0 3")


def test_a_telecentric_lens(capsys, zmx, tmp_path):
    text = ZMX.replace("ENPD 8", "OBNA 0.05 0").replace("FTYP 0 0 2", "FTYP 1 1 2").replace("DISZ INFINITY", "DISZ 60")
    zmx.write_text(text)
    code, out, err = run(capsys, zmx, "-o", tmp_path / "a.xml")
    assert code == 0, err
    assert out.splitlines()[1].endswith(", telecentric in object space")
    source = ElementTree.parse(tmp_path / "a.xml").find("emitter[@type='point_source']")
    assert float(source.find("float[@name='z']").get("value")) == -60
    assert json_units.read(run(capsys, zmx, "-o", tmp_path / "b.xml", "--json")[1])["f_number"] is None


def test_json(capsys, zmx, tmp_path):
    code, out, _ = run(capsys, zmx, "-o", tmp_path / "a.xml", "--json")
    assert code == 0
    record = json_units.read(out)
    n, r, t = 1.5168, 50.0, 5.0
    power = (n - 1) * (2 / r - (n - 1) * t / (n * r * r))
    assert record["efl_mm"] == pytest.approx(1 / power, rel=1e-5)
    assert record["bfl_mm"] == pytest.approx((1 - (n - 1) * t / (n * r)) / power, rel=1e-5)
    assert record["fields_deg"] == [[0.0, 0.0], [0.0, 3.0]]
    assert [(item["line"], item["text"]) for item in record["unread"]] == [(11, "XYZZY 1 2 3")]
    assert record["files"] == [str(tmp_path / "a.xml")]


def test_json_of_a_camera_lens(capsys, tmp_path):
    import mistray.scenes

    lens = Path(mistray.scenes.__file__).parent / "phone_camera" / "prescription.json"
    code, out, _ = run(capsys, lens, "-o", tmp_path / "a.xml", "--json")
    record = json_units.read(out)
    assert code == 0
    assert record["surfaces"] == len(shapes(tmp_path / "a.xml"))
    assert record["unread"] == []


def test_options_reach_the_scene(capsys, zmx, tmp_path):
    output = tmp_path / "a.xml"
    code, _, _ = run(capsys, zmx, "-o", output, "--edges", "ground", "--margin", "0.1", "--beam", "front",
                     "--detector-half-mm", "3", "2", "--wavelength-nm", "600",
                     "--glass", "N-BK7=1.7")  # fmt: skip
    text = output.read_text(encoding="utf-8")
    assert code == 0
    assert "ground_edge" in text
    assert 'name="half_height" value="2"' in text
    assert 'value="1.7"' in text
    assert 'name="wavelength_nm" value="600"' in text


def test_coating_file_is_found_from_the_scene(capsys, zmx, tmp_path, monkeypatch):
    """A path in a scene is relative to it, that on the command line to the current folder."""
    zmx.write_text(ZMX.replace("  CURV 0.02\n", "  CURV 0.02\n  COAT AR\n"))
    (tmp_path / "lib").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "lib" / "COATING.DAT").write_bytes((SHARED / "coating_sample.dat").read_bytes())
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, zmx, "-o", "out/a.xml", "--coatings", "lib/COATING.DAT")
    assert code == 0, err
    assert "../lib/COATING.DAT:AR" in Path("out/a.xml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("a.zmx", ("--variant", "b"), "--variant b: Zemax files hold no variants; leave it out"),
        ("a.json", ("--edges", "open"), "--edges open: JSON files hold no edges to choose; leave it out"),
        ("a.zmx", ("--radius-mode", "yes"), "Zemax files hold no radius mode; leave it out"),
        ("a.seq", ("--coatings", "C.DAT"), "CODE V files hold no coatings by name; leave it out"),
        ("a.stl", ("--wavelength-nm", "500"), "mechanical files hold no wavelength of a source; leave it out"),
        ("a.zmx", ("--space", "x=2"), "--space: Zemax files hold no mechanics; leave it out"),
        ("a.zmx", ("--glass", "BK7"), "--glass: 'BK7' is no glass; write NAME=MATERIAL"),
        ("a.zmx", ("--edges", "shiny"), "edges = 'shiny'; they are blackened, ground or open"),
        ("a.zmx", ("--margin", "-1"), "--margin: -1 must lie between 0 and 10"),
        (
            "a.osl",
            (),
            "files of type '.osl' cannot be read; give one of .json, .yaml, .yml, .zmx, .seq, .len, .lens, .roa, .step",
        ),
        ("a.igs", (), "files of type '.igs' cannot be read; export it as STEP, one of "),
        ("a.fbx", (), "files of type '.fbx' cannot be read; export it as STL, OBJ, PLY or GLB, one of "),
        ("a.lens", ("--glass", "A=N-BK7"), "--glass ('A', 'N-BK7'): FlareSim files hold no glass names; leave it out"),
        ("a.zmx", ("-o", "nowhere/a.xml"), "the folder 'nowhere' does not exist; make it first"),
    ],
)
def test_what_makes_no_sense_is_refused(capsys, tmp_path, monkeypatch, name, options, message):
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(ZMX)
    assert message in fails(capsys, name, *options)
    assert [path.name for path in tmp_path.iterdir()] == [name]


class TestAssumptions:
    """What the import says of what it has assumed."""

    def test_the_detector_absorbs_all(self, capsys, zmx, tmp_path):
        output = tmp_path / "a.xml"
        (note,) = [line for line in run(capsys, zmx, "-o", output)[1].splitlines() if "the detector absorbs" in line]
        assert "--coating 'detector=R=0.1'" in note
        assert "the detector absorbs" in output.read_text(encoding="utf-8")
        # As the note says: here, or with mistray coat
        code, out, _ = run(capsys, zmx, "-o", tmp_path / "b.xml", "--coating", "detector=R=0.1")
        assert code == 0
        assert "the detector absorbs" not in out + (tmp_path / "b.xml").read_text(encoding="utf-8")
        assert cli.main(["coat", str(output), "detector=R=0.1", "-o", str(tmp_path / "c.xml")]) == 0
        for name in ("b.xml", "c.xml"):
            detector = shapes(tmp_path / name)["detector"]
            assert [item.get("value") for item in detector.iter("float") if item.get("name") == "R"] == ["0.1"]

    def test_the_beam_and_the_stop(self, capsys, zmx, tmp_path):
        """A stop of 4 mm in radius at the first surface, then at the second one behind 3 mm of clear radius."""
        for beam, said in (("pupil", "overfills the stop"), ("exact", "just fills the stop")):
            out = run(capsys, zmx, "-o", tmp_path / f"{beam}.xml", "--beam", beam)[1]
            assert f"note: the beam {said}, surface 1, of radius 4 mm" in out
        inner = ZMX.replace("  STOP\n", "").replace("SURF 2\n", "SURF 2\n  STOP\n")
        zmx.write_text(inner.replace("DISZ 5\n", "DISZ 5\n  CLAP 0 3 0\n"))
        out = run(capsys, zmx, "-o", tmp_path / "vignetted.xml")[1]
        # In first order the heights at the stop go with those at the first surface: 3 mm of 4 mm
        found = re.search(r"the beam fills the stop, surface 2, .* only to ([\d.]+) % of its radius: 'S1' takes", out)
        assert float(found[1]) == pytest.approx(75, abs=1.5)

    def test_a_name_of_the_file_is_answered(self, capsys, zmx, tmp_path):
        named = ZMX.replace("SURF 1\n", "SURF 1\n  COMM L1 front\n").replace("SURF 3\n", "SURF 3\n  COMM FPA\n")
        zmx.write_text(named)
        output = tmp_path / "a.xml"
        out = run(capsys, zmx, "-o", output)[1]
        assert "'L1 front' is 'L1_front', 'FPA' is 'detector'" in out
        assert "L1_front" in shapes(output)
        assert "did you mean 'detector'" in fails(capsys, zmx, "-o", tmp_path / "b.xml", "--coating", "FPA=R=0.05")
        assert cli.main(["coat", str(output), "FPA=R=0.05", "-o", str(tmp_path / "c.xml")]) == 2
        assert "did you mean 'detector'" in capsys.readouterr().err


class TestLight:
    """Whether the light of the source arrives."""

    def test_share(self, capsys, zmx, tmp_path):
        code, out, _ = run(capsys, zmx, "-o", tmp_path / "lens.xml", "--json", "--beam", "exact")
        assert code == 0
        # Two bare faces of N-BK7 at the d line, the detector absorbs all
        bare = (1 - (0.5168 / 2.5168) ** 2) ** 2
        assert json.loads(out)["arriving_share"] == pytest.approx(bare, rel=2e-3)
        # The stop cuts a wider beam, of whose 4000 rays 0.9 count: 5 standard errors, once in 1e6
        code, out, _ = run(capsys, zmx, "-o", tmp_path / "wide.xml", "--json")
        assert json.loads(out)["arriving_share"] == pytest.approx(bare, rel=5 * (0.1 / 0.9 / 4000) ** 0.5)
        assert any("wider than the pupil" in note for note in json.loads(out)["notes"])

    def test_none(self, capsys, tmp_path):
        """A plate in the beam: batoid drops what it obscures, and here everything is obscured."""
        pytest.importorskip("batoid")
        path = tmp_path / "dark.yaml"
        path.write_text(
            """
            opticalSystem:
              type: CompoundOptic
              name: dark
              pupilSize: 0.1
              items:
                - {type: Baffle, name: lid, surface: {type: Plane}, coordSys: {z: 2.0},
                   obscuration: {type: ObscCircle, radius: 0.2}}
                - {type: Detector, name: D, surface: {type: Plane}, obscuration: {type: ClearCircle, radius: 0.1}}
            """
        )
        output = tmp_path / "dark.xml"
        code, out, err = run(capsys, path, "-o", output, "--wavelength-nm", "500")
        assert code == 2
        assert err.count("\n") == 1
        assert "'lid' takes 100 %" in err
        assert str(output) in err
        assert "lid" in shapes(output)
        assert str(output) in out

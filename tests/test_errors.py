"""Bad input: one line on stderr that names the object, the value and the remedy; exit code 2; nothing written."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest

import mistray
from mistray import cli
from mistray.errors import MistrayError
from mistray.prescription import from_json

SCENE = """\
<scene version="3.0.0">
    <integrator type="straylight"/>
    <emitter type="collimated" id="source">
        <float name="radius" value="2"/>
    </emitter>
    <shape type="asphere" id="L1_front">
        <float name="radius" value="20"/>
        <float name="semi_diameter" value="5"/>
        <bsdf type="interface"><string name="back" value="1.5"/></bsdf>
    </shape>
    <shape type="asphere" id="L1_rear">
        <float name="radius" value="-20"/>
        <float name="semi_diameter" value="5"/>
        <transform name="to_world"><translate z="3"/></transform>
        <bsdf type="interface"><string name="front" value="1.5"/></bsdf>
    </shape>
    <shape type="asphere" id="detector">
        <float name="half_width" value="5"/>
        <float name="half_height" value="5"/>
        <transform name="to_world"><translate z="20"/></transform>
        <bsdf type="interface"><float name="R" value="0"/></bsdf>
        <sensor type="irradiancemeter"><film type="hdrfilm"><rfilter type="box"/></film></sensor>
    </shape>
</scene>
"""
EMITTER = re.search(r"    <emitter.*</emitter>\n", SCENE, re.DOTALL)[0]
SENSOR = re.search(r"        <sensor.*</sensor>\n", SCENE)[0]
FIRST_BSDF = '<bsdf type="interface"><string name="back" value="1.5"/></bsdf>'
SOURCE_RADIUS = '<float name="radius" value="2"/>'


@dataclass(frozen=True)
class Case:
    """Damage done to the scene, as (old, new), options of the command, and the words of the line that must come."""

    name: str
    damage: tuple[str, str] = ("", "")
    options: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    scene: str = "scene.xml"
    times: int = 1  # how often the damage is done

    def text(self) -> str:
        old, new = self.damage
        assert old in SCENE, f"{self.name}: '{old}' is not in the scene"
        return SCENE.replace(old, new, self.times)


def bsdf(inside: str) -> tuple[str, str]:
    """Damage: the interface of L1_front with other contents."""
    return FIRST_BSDF, f'<bsdf type="interface"><string name="back" value="1.5"/>{inside}</bsdf>'


def source(inside: str) -> tuple[str, str]:
    """Damage: the source with one more parameter."""
    return SOURCE_RADIUS, f"{SOURCE_RADIUS}{inside}"


# What the project promises to catch, each through the command line as a user runs it
PROMISED = [
    Case("missing file", words=("scene 'phone_camra': no such file", "phone_camera"), scene="phone_camra"),
    Case("broken XML", ("</emitter>", "</emiter>"), words=("line 5", "broken XML", "close or correct the tag")),
    Case(
        "unknown parameter",
        ('name="semi_diameter"', 'name="semidiameter"'),
        words=("line 6", "unknown parameter 'semidiameter' = 5 of shape 'L1_front'", "did you mean 'semi_diameter'?"),
    ),
    Case(
        "missing material",
        ('value="1.5"', 'value="N-BK77"'),
        words=("line 9", "interface of shape 'L1_front': material 'N-BK77' is unknown", "did you mean N-BK7"),
    ),
    Case(
        "negative semi-diameter",
        ('name="semi_diameter" value="5"', 'name="semi_diameter" value="-5"'),
        words=("line 6", "shape 'L1_front': semi_diameter is -5", "must lie between 1e-15 and 1e12 mm"),
    ),
    Case(
        "overlapping surfaces",
        ('<translate z="3"/>', '<translate z="1"/>'),
        words=("surfaces 'L1_front' and 'L1_rear' cross at r = 4.4", "move them apart"),
    ),
    Case("no detector", (SENSOR, ""), words=("no detector", "nest an 'irradiancemeter' sensor")),
    Case("no source", (EMITTER, ""), words=("no source", "add an emitter")),
    Case("zero rays", options=("--rays", "0"), words=("--rays: 0 must", "between 1 and 4294967295")),
    Case(
        "field that misses the lens",
        source('<transform name="to_world"><translate z="-50"/></transform>'),
        options=("--field-deg", "0", "45"),
        words=("source 'source': no ray of its light along (0, 0.7071, 0.7071) hits", "check field_deg"),
    ),
    Case("field of 90 degrees", options=("--field-deg", "90"), words=("--field-deg: 90 must lie between -90 and 90",)),
]

OTHERS = [
    Case("empty file", (SCENE, ""), words=("line 1", "broken XML, no document element found")),
    Case("no version", (' version="3.0.0"', ""), words=('write <scene version="3.0.0">',)),
    Case("unknown tag", ("<integrator", "<lamp/><integrator"), words=("line 2", "<lamp> is no element of a scene")),
    Case("unknown plugin", ('"asphere"', '"aspheer"'), words=("no plugin 'aspheer'", "did you mean 'asphere'?")),
    Case("unknown bsdf parameter", bsdf('<float name="r" value="0.1"/>'), words=("'r' = 0.1", "did you mean 'R'?")),
    Case("unknown source parameter", source('<float name="field" value="2"/>'), words=("mean 'field_deg'?",)),
    Case(
        "unknown integrator parameter",
        ('type="straylight"/>', 'type="straylight"><integer name="ray" value="3"/></integrator>'),
        words=("line 2", "unknown parameter 'ray' = 3 of straylight", "did you mean 'rays'?"),
    ),
    Case("no semi-diameter", ('<float name="semi_diameter" value="5"/>', ""), words=("'L1_front': give either semi_",)),
    Case("not a number", ('name="semi_diameter" value="5"', 'name="semi_diameter" value="five"'),
         words=("line 8", "shape 'L1_front': semi_diameter is 'five'; it must be a number")),
    Case("a string", ('<float name="semi_diameter" value="5"/>', '<string name="semi_diameter" value="5"/>'),
         words=("shape 'L1_front': semi_diameter is '5'; it must be a number",)),
    Case("nan", ('name="semi_diameter" value="5"', 'name="semi_diameter" value="nan"'),
         words=("semi_diameter is nan; it must be a number",)),
    Case("given twice", ('<float name="radius" value="20"/>',
         '<float name="radius" value="20"/><float name="radius" value="21"/>'),
         words=("shape 'L1_front': radius is given twice; keep one",)),
    Case("conic that ends", ('name="radius" value="20"', 'name="radius" value="4"'),
         words=("'L1_front': the conic ends at r = 4 mm", "5 mm", "reduce the aperture")),
    Case("scaled", ('<translate z="3"/>', '<scale value="2"/>'), words=("'L1_rear': to_world scales", "rigid motion")),
    Case("duplicate id", ('id="L1_rear"', 'id="L1_front"'), words=("'L1_front' is taken by line 6", "its own")),
    Case("undefined default", (SOURCE_RADIUS, '<float name="radius" value="$r"/>'), words=("'$r' is not defined",)),
    Case("reference to nothing", (FIRST_BSDF, '<ref id="coating"/>'), words=("refers to 'coating'", "correct the id")),
    Case("missing include", ("<integrator", '<include filename="other.xml"/><integrator'), words=("'other.xml'",)),
    Case("missing mesh", ("<integrator",
         '<shape type="ply" id="tube"><string name="filename" value="tube.ply"/></shape><integrator'),
         words=("shape 'tube': no file 'tube.ply'; check the path",)),
    Case("index below 1", ('value="1.5"', 'value="0.5"'), words=("material '0.5': index 0.5", "at least 1")),
    Case("materials that do not fit", ('name="front" value="1.5"', 'name="front" value="1.6"'),
         words=("'L1_front' at z = 0 mm and 'L1_rear' at z = 3 mm", "'1.5' for one and '1.6'", "correct their front")),
    Case("coating sums to 1.1", bsdf('<float name="R" value="0.5"/><float name="T" value="0.6"/>'),
         words=("interface of shape 'L1_front': R = 0.5 and T = 0.6", "must not exceed 1")),
    Case("T without R", bsdf('<float name="T" value="0.6"/>'), words=("'L1_front': T is given without R; give both",)),
    Case("coating and table", bsdf('<float name="R" value="0.5"/><string name="table" value="c.csv"/>'),
         words=("give R and T or table, not both",)),
    Case("table file missing", bsdf('<string name="table" value="coating.csv"/>'),
         words=("interface of shape 'L1_front': coating table 'coating.csv': No such file", "relative to the scene")),
    Case("shape without interface", (FIRST_BSDF, ""), words=("shape 'L1_front'", "nest an 'interface'")),
    Case("stock bsdf", (FIRST_BSDF, '<bsdf type="diffuse"/>'), words=("SmoothDiffuse", "nest an 'interface'")),
    Case("source radius", (SOURCE_RADIUS, '<float name="radius" value="0"/>'),
         words=("source 'source': radius is 0; it must lie",)),
    Case("source field", source('<float name="field_deg" value="95"/>'), words=("field_deg is 95; it must lie",)),
    Case("source wavelength", source('<string name="wavelength_nm" value="green"/>'),
         words=("wavelength_nm is 'green'; give one number",)),
    Case("wavelength no glass has", ('value="1.5"', 'value="N-BK7"'), ("--wavelength-nm", "100"),
         ("material 'N-BK7': 100 nm is outside of its 300 … 2500 nm",), times=2),
    Case("rays in the scene",
         ('type="straylight"/>', 'type="straylight"><integer name="rays" value="0"/></integrator>'),
         words=("integrator 'straylight': rays is 0; it must",)),
    Case("splitting in the scene",
         ('type="straylight"/>', 'type="straylight"><string name="splitting" value="both"/></integrator>'),
         words=("splitting is 'both'",)),
    Case("reflections", options=("--max-reflections", "-1"), words=("--max-reflections: -1 must be a whole number",)),
    Case("threshold", options=("--flux-threshold", "2"), words=("--flux-threshold: 2 must", "between 0 and 1")),
    Case("events", options=("--max-events", "2000"), words=("--max-events: 2000 must", "between 1 and")),
    Case("wavelength", options=("--wavelength-nm", "-550"), words=("--wavelength-nm: -550 must lie between 10 and",)),
]  # fmt: skip


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working directory with an output directory that holds a file; fails if a command leaves anything behind."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.html").write_text("old")
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    left = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")} - {"scene.xml"}
    assert left == {"out", os.path.join("out", "report.html")}
    assert (tmp_path / "out" / "report.html").read_text() == "old"


def check_line(err: str, words: tuple[str, ...]) -> None:
    assert err.count("\n") == 1, err
    assert err.startswith("mistray: error: "), err
    for word in words:
        assert word in err, f"'{word}' is not in: {err}"
    for noise in ("Traceback", ".cpp", "MistrayError", "RuntimeError", "\x1b"):
        assert noise not in err, err
    assert len(err) < 330, err


def ghosts(case: Case) -> list[str]:
    return ["ghosts", case.scene, "--rays", "200", *case.options, "--out", "out", "--force"]


@pytest.mark.long
def test_the_scene_is_good(capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("scene.xml").write_text(SCENE)
    assert cli.main(["ghosts", "scene.xml", "--rays", "200", "--quiet", "--out", "out"]) == 0
    assert capfd.readouterr().err == ""
    assert Path("out", "report.html").is_file()


@pytest.mark.parametrize("case", [*PROMISED, *OTHERS], ids=lambda case: case.name)
def test_one_line_and_nothing_written(capfd, folder, case):
    Path("scene.xml").write_text(case.text())
    assert cli.main(ghosts(case)) == 2
    out, err = capfd.readouterr()
    assert out == ""
    check_line(err, case.words)


@pytest.mark.long
def test_the_command_itself(tmp_path):
    """The same through the real command, as processes of their own; every third case, as each starts Python anew."""

    def run(case):
        place = tmp_path / case.name.replace(" ", "_")
        (place / "out").mkdir(parents=True)
        (place / "scene.xml").write_text(case.text())
        command = [sys.executable, "-m", "mistray", *ghosts(case)]
        done = subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=300)
        return case, done, sorted(path.name for path in place.rglob("*"))

    with ThreadPoolExecutor(2) as pool:
        for case, done, left in pool.map(run, PROMISED[::3]):
            assert (done.returncode, done.stdout) == (2, ""), case.name
            check_line(done.stderr, case.words)
            assert left == ["out", "scene.xml"], case.name


# Cases that are a matter of the command line alone have no counterpart in Python
IN_PYTHON = [case for case in (*PROMISED, *OTHERS) if not case.options]


@pytest.mark.parametrize("case", IN_PYTHON, ids=lambda case: case.name)
def test_python_says_the_same(folder, case):
    Path("scene.xml").write_text(case.text())
    with pytest.raises(MistrayError) as caught:
        mistray.trace(mistray.load(case.scene), rays=200)
    assert isinstance(caught.value, ValueError)
    check_line(f"mistray: error: {caught.value}\n", case.words)


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"rays": 0}, "rays is 0; it must be a whole number between 1 and 4294967295"),
        ({"rays": 2.5}, "rays is 2.5; it must be a whole number"),
        ({"rays": math.nan}, "rays is nan; it must be a whole number"),
        ({"rays": 1e10}, "use several seeds"),
        ({"field_deg": 90}, "field_deg is 90; it must lie between -90 and 90 degrees"),
        ({"field_deg": math.inf}, "field_deg is inf; it must lie between -90 and 90"),
        ({"azimuth_deg": math.nan}, "azimuth_deg is nan; it must lie between -360 and 360"),
        ({"wavelength_nm": 0}, "wavelength_nm is 0; it must lie between 10 and 1e7 nm"),
        ({"wavelength_nm": [550, -1]}, "wavelength_nm is -1; it must lie between 10 and 1e7 nm"),
        ({"max_reflections": -1}, "max_reflections is -1; it must be a whole number between 0 and"),
        ({"max_events": 1001}, "max_events is 1001; it must be a whole number between 1 and"),
        ({"flux_threshold": 1}, "flux_threshold is 1"),
        ({"splitting": "both"}, "splitting is 'both'"),
        ({"below_threshold": "stop"}, "below_threshold is 'stop'"),
        ({"seed": -1}, "seed is -1; it must be a whole number between"),
        ({"detector": "L1_front"}, "'L1_front' is no detector of this scene; choose from detector"),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_arguments_of_trace(tmp_path, keywords, words):
    (tmp_path / "scene.xml").write_text(SCENE)
    scene = mistray.load(tmp_path / "scene.xml")
    with pytest.raises(MistrayError, match=re.escape(words)) as caught:
        mistray.trace(scene, **({"rays": 100} | keywords))
    assert "\n" not in str(caught.value)


def test_trace_of_a_path_is_explained():
    with pytest.raises(MistrayError, match=r"got str; load the scene first: mistray\.load\(path\)"):
        mistray.trace("phone_camera", rays=100)


@pytest.mark.parametrize(
    ("out", "words"),
    [
        ("scene.xml", "is a file; name a directory"),
        ("sealed", "cannot be written"),
    ],
)
def test_output_that_cannot_be_written(capfd, folder, out, words):
    """Found before the trace. File modes do not bind root, /proc does."""
    Path("scene.xml").write_text(SCENE)
    if out == "sealed":
        if not Path("/proc").is_dir():
            pytest.skip("no folder here that refuses everybody")
        out = "/proc/sealed"
    assert cli.main(["ghosts", "scene.xml", "--rays", "200", "--out", out]) == 2
    stdout, err = capfd.readouterr()
    assert stdout == ""
    check_line(err, (words,))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text[: len(text) // 2], "it must be a JSON file"),
        (lambda text: text.replace('"detector"', '"sensor"', 1), "key 'detector' is missing; compare with scenes/"),
        (lambda text: text.replace('"radius": 1.25171162', '"radius": 9'),
         "stop 'stop': radius = 9 mm; it must lie between 0 and its outer radii"),
    ],
    ids=["half a file", "missing key", "stop wider than its plate"],
)  # fmt: skip
def test_prescriptions(capfd, tmp_path, change, words):
    shipped = Path(__file__).parents[1] / "scenes" / "phone_camera" / "prescription.json"
    lens = tmp_path / "lens.json"
    lens.write_text(change(shipped.read_text(encoding="utf-8")), encoding="utf-8")
    assert cli.main(["import", str(lens), "-o", str(tmp_path / "scene.xml")]) == 2
    check_line(capfd.readouterr().err, (words,))
    assert [path.name for path in tmp_path.iterdir()] == ["lens.json"]
    with pytest.raises(MistrayError, match=re.escape(words)):
        from_json(lens)

"""Ids with blanks, quotation marks, arrows: the same numbers as with plain ones, in every table and on every page."""

import contextlib
import csv
import json
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import pytest
import vectors
from command_line import Patch, fails
from oracles.small_scenes import plates_text, write
from test_cli_import import ZMX

import mistray
from mistray import MistrayError, cli
from mistray.analyses.optimize.toml.read_study import read_study
from mistray.analyses.sweep.configurations import as_configurations
from mistray.ids import check_id, event_words, fits
from mistray.prescription.coating import check_name

PLAIN = ("p0_front", "p0_rear", "detector")
STRANGE = (
    ('lens 1 → "front", <b>&</b>', "L 'rear' ; (2) : é", "image µ</script><svg/onload=x()>"),
    ("a b c", "a  b", "b"),
    ("x" * 300, "Größe, 透镜", "a:T"),
)
FEW = {"rays": 200, "max_reflections": 2, "max_scatters": 0}


def scene(folder: Path, names: tuple[str, ...]) -> Path:
    text = plates_text(1)
    for plain, name in zip(PLAIN, names, strict=True):
        text = text.replace(f'"{plain}"', quoteattr(name))
    return write(folder, text)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> mistray.Trace:
    return mistray.trace(mistray.load(write(tmp_path_factory.mktemp("plain"), plates_text(1))), **FEW)


@pytest.mark.parametrize("names", STRANGE)
def test_paths_are_the_same(tmp_path: Path, plain: mistray.Trace, names: tuple[str, ...]) -> None:
    strange = mistray.trace(mistray.load(scene(tmp_path, names)), **FEW)
    called = dict(zip(PLAIN, names, strict=True))
    assert len(plain.paths) == len(strange.paths) > 1
    for one, other in zip(plain.paths, strange.paths, strict=True):
        assert (other.power_W, other.path) == (one.power_W, one.path)
        assert other.event_list == [(called[name], what) for name, what in one.event_list]
        assert event_words(other.events) == [f"{called[word[:-2]]}{word[-2:]}" for word in event_words(one.events)]
    assert len({row.label for row in strange.paths}) == len({row.label for row in plain.paths})
    assert [row.path_id for row in plain.paths.select("G(p0_rear)")]
    for given, other in vectors.toml("tables.toml")["filters"].items() if names is STRANGE[0] else ():
        ids = [row.path_id for row in strange.paths.select(other)]
        assert ids == [row.path_id for row in plain.paths.select(given)], given


def test_commands(tmp_path: Path, monkeypatch: Patch, capsys: Any) -> None:
    names = STRANGE[0]
    monkeypatch.chdir(tmp_path)
    scene(tmp_path, names)
    more = ("--filter", "G(lens*)", "--alias", "lens*=the lens", "--levels", "--path-analysis", "power_W")
    few = ("--rays", "200", "--max-scatters", "0")
    assert cli.main(["ghosts", "scene.xml", *few, *more, "--out", "out", "--json"]) == 0
    assert json.dumps(names[0]) in json.dumps(json.loads(capsys.readouterr().out))
    with open("out/paths.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {name for row in rows for name in (word[:-2] for word in event_words(row["events"]))} == set(names)
    page = Path("out/report.html").read_text(encoding="utf-8")
    assert "<b>&</b>" not in page
    assert "lens 1 → " in page
    events = rows[0]["events"]
    for command in (
        ("study", "--quick", "--pst-field-deg", "0", "20", "--field-deg", "0", "--rays", "2000", "--out", "study"),
        ("view", *few, "--out", "view.html", "--layout", "layout.svg", "--save-rays", "rays.json"),
        ("sensitivity", "--rays", "100", "--kind", "curvature", "--paths", events, "--no-check", "--out", "s"),
    ):
        assert cli.main([command[0], "scene.xml", *command[1:]]) == 0, capsys.readouterr().err
        capsys.readouterr()
    for file in tmp_path.rglob("*.html"):
        text = file.read_text(encoding="utf-8")
        assert not [word for word in ("<b>&</b>", "µ</script>", "<svg/onload") if word in text], file


TITLES = (
    "+a", "=1+1", " a ", "a\tb", "$x_1$", "x" * 300, "透" * 200, 'lens 1 → "front", <b>&</b>', "../../x", "--",
    "a\u202eb\u202c", "\u200b\ufeffa\u2066", "a\x9b31mb",
)  # fmt: skip
BOX = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + "f 1 2 4\nf 5 8 6\n"


@pytest.mark.parametrize("title", TITLES)
def test_imported_titles_become_ids(tmp_path: Path, monkeypatch: Patch, capsys: Any, title: str) -> None:
    """What a CAD or lens program calls its parts cannot be changed by who imports them; nor what a scene is called."""
    monkeypatch.chdir(tmp_path)
    Path("m.obj").write_text(f"o {title}\n{BOX}", encoding="utf-8")
    Path("l.zmx").write_text(ZMX.replace("Singlet", title).replace("STOP", f"STOP\n  COMM {title}"), encoding="utf-8")
    files = {"m.obj": "$x$ %s {0} 'a' \"b\" → é\n<c>&.xml", "l.zmx": "l.xml"}  # beside the first stand meshes
    for source, target in files.items():
        assert cli.main(["import", source, "-o", target]) == 0, capsys.readouterr().err
    assert {path.parent for path in tmp_path.rglob("*")} == {tmp_path}
    loaded = [shape.id() for target in files.values() for shape in mistray.load(target).shapes()]
    assert loaded
    for name in loaded:
        check_id(name)


HIDDEN = (
    "a\x1bb", "a\x9bb", "a\u202eb", "a\u2069b", "a\u200bb", "\ufeffa", "a\u200d", "a \u200c b", "a\u00adb", "a\u2028b",
)  # fmt: skip
FORMULAS = ("=cmd|' /C calc'!A0", "+1", "-1", "@SUM(1)")


@pytest.mark.parametrize("name", [*HIDDEN, *FORMULAS, "a\n[trace]\nrays = 7", " a", "a ", "a\tb", "a:T b"])
def test_what_no_id_can_be(name: str) -> None:
    """One rule, for names stand in tables, studies and on terminals; brackets are letters and a pattern."""
    for one, pattern, agrees in (("[2]", "[2]", True), ("2", "[2]", True), ("[2]", "*", True), ("[22]", "[2]", False)):
        assert fits(f"Body{one}", f"Body{pattern}") is agrees
    with pytest.raises(MistrayError) as caught:
        check_id(name)
    said = str(caught.value)
    assert said.isprintable()
    assert "rename it" in said
    assert ascii(name)[1:-1].split("\\")[0] in said
    # Joiners change the meaning of words of Persian and Indian languages; elsewhere they are hidden
    for good in ("\u0646\u0645\u06cc\u200c\u062e\u0648", "\u0915\u094d\u200d\u0937", "lens \u2192 \u00e9"):
        check_id(good)


@pytest.mark.parametrize("what", ["shape", "part", "source", "bsdf", "probe"])
@pytest.mark.parametrize("name", ["=x", "a\u202eb"])
def test_names_of_all_kinds_obey_it(what: str, name: str) -> None:
    keys = {key: name if key == what else key for key in ("shape", "source", "bsdf", "probe")}
    scene = {
        "type": "scene",
        keys["bsdf"]: {"type": "interface", "R": 0.0},
        keys["shape"]: {
            "type": "asphere", "semi_diameter": 5.0, "part": name if what == "part" else "part",
            "nested": {"type": "ref", "id": keys["bsdf"]},
        },
        keys["source"]: {"type": "collimated", "radius": 1.0},
        keys["probe"]: {"type": "probe", "half_width": 5.0},
    }  # fmt: skip
    with pytest.raises(MistrayError, match="rename it"):
        mistray.load(scene)


def test_names_in_files_and_arguments(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """XML 1.0 allows hidden characters; as the name of a part, and in other texts."""
    text = plates_text(1)
    part = f'id="p0_front"><string name="part" value={quoteattr(HIDDEN[2])}/>'
    with pytest.raises(MistrayError, match="rename it"):
        mistray.load(write(tmp_path, text.replace('id="p0_front">', part, 1)))
    with pytest.raises(MistrayError, match="which is not seen; take it out"):
        mistray.load(write(tmp_path, text.replace('name="back" value="', f'name="back" value="{HIDDEN[4]} ', 1)))
    assert "rename it" in fails(capsys, "ghosts", write(tmp_path, text.replace('"p0_front"', '"a&#10;b"')))
    path = write(tmp_path, text)
    for more in ({"sources": {"type": "collimated", "radius": 1.0}}, {"sensors": {"type": "probe", "half_width": 5.0}}):
        ((key, thing),) = more.items()
        with pytest.raises(MistrayError, match="rename it"):
            mistray.load(path, **{key: thing | {"id": "=x"}})


def test_no_cell_of_a_report_is_a_formula(tmp_path: Path, monkeypatch: Patch) -> None:
    """Nor does the name of the scene's own file become one."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path, plates_text(1)).rename("=x.xml")
    for command in ("ghosts", "objects"):
        assert cli.main([command, "=x.xml", "--rays", "200", "--out", command]) == 0
    tables = list(tmp_path.rglob("*.csv"))
    assert len(tables) > 5
    for table in tables:
        for cell in (cell for row in csv.reader(table.read_text(encoding="utf-8").splitlines()) for cell in row):
            with contextlib.suppress(ValueError):
                float(cell)
                continue
            assert cell == "-" or not cell.startswith(("=", "+", "-", "@", "\t")), (table, cell)


@pytest.mark.parametrize("name", ["=1+1", "a\nb", "$x"])
def test_names_in_studies_and_prescriptions(tmp_path: Path, name: str) -> None:
    head = "[[term]]\nkind = 'path_power'\ngoal = 'minimise'\n[[coating]]\n"
    (tmp_path / "a.toml").write_text(f"{head}name = {json.dumps(name)}\nsurfaces = 'all'\nlayers = '1.4 60'\n")
    with pytest.raises(MistrayError, match="coating"):
        read_study(tmp_path / "a.toml")
    with pytest.raises(MistrayError):
        check_name(name)
    if "$" not in name:
        with pytest.raises(MistrayError, match="configuration"):
            as_configurations({name: {"p0_front.z": 1.0}})
    for names in STRANGE:
        for good in names:
            check_name(good)

"""What README.md and docs/ show works: Python, commands in their order, ten tasks, names; links lead somewhere."""

import ast
import contextlib
import importlib
import importlib.util
import inspect
import io
import json
import re
import shlex
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import peers
import pytest
from command_line import Captured, Patch, run
from example_scripts import script
from oracles.layers import stack_powers
from test_cli_import import SEQ, ZMX

import mistray
from mistray import GhostReport, MistrayError, Pst, cli
from mistray.cli import program
from mistray.prescription import Prescription, from_zemax
from mistray.trace import PathTable, RayHistory, Settings, Trace

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
COMMANDS = ROOT / "docs" / "commands.md"
PAGES = [README, *sorted([*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "questions").glob("*.md")])]
ALL_PAGES = sorted((ROOT / "docs").rglob("*.md"))
AROUND = [ROOT / name for name in ("CONTRIBUTING.md", "CODE_OF_CONDUCT.md", "SECURITY.md")]
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
SHELL = re.compile(r"^```sh\n(.*?)^```", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"^ {4}(mistray .*)", re.MULTILINE)


def command_lines(page: Path) -> list[str]:
    """Commands of a page: lines of shell blocks, and indented lines that begin with the name of the program."""
    text = page.read_text(encoding="utf-8")
    return [line for block in SHELL.findall(text) for line in block.splitlines() if line] + INDENTED.findall(text)


def parse(line: str) -> None:
    """Raises `MistrayError` where a line is no command of the program, as far as the shell hands it over."""
    words = list(takewhile(lambda word: word not in ("|", ">"), shlex.split(line, comments=True)))
    if words[0] == "mistray" and "--help" not in words:
        program._parser().parse_args(words[1:])
    else:
        assert words[0] in ("mistray", "make", "pip", "python", "dask"), line


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_run(page: Path, tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.chdir(tmp_path)
    text = page.read_text(encoding="utf-8")
    namespace: dict = {"__name__": "__main__"}
    for match in BLOCK.finditer(text):
        line = text[: match.start()].count("\n") + 2
        code = compile("\n" * (line - 1) + match[1], str(page), "exec", dont_inherit=True)  # a page has no __future__
        exec(code, namespace)
        assert page != README or len([text for text in match[1].splitlines() if text.strip()]) <= 15
    if page == README:
        assert (tmp_path / "paths.csv").read_text().startswith("path_id,")


def blocks(file: Path) -> list[str]:
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".ipynb":
        cells = [cell["source"] for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
        return ["".join(line for line in cell if not line.startswith("%")) for cell in cells]
    return BLOCK.findall(text) if file.suffix == ".md" else [text]


def test_imported_names_exist() -> None:
    """Of pages, notebooks and examples, most of which run in the long tier alone."""
    files = [*PAGES, *sorted((ROOT / "notebooks").glob("*.ipynb")), *sorted((ROOT / "examples").glob("*.py"))]
    nodes = [node for file in files for block in blocks(file) for node in ast.walk(ast.parse(block))]
    named = {
        (node.module, alias.name)
        for node in nodes
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("mistray")
        for alias in node.names
    }
    assert len(named) > 100
    assert [
        f"from {module} import {name}"
        for module, name in sorted(named)
        if not hasattr(importlib.import_module(module), name) and importlib.util.find_spec(f"{module}.{name}") is None
    ] == []


def test_commands_exist() -> None:
    """With their options; `test_the_commands_of_a_page_run` runs them, which takes most of an hour."""
    lines = [line for page in (README, *ALL_PAGES) for line in command_lines(page)]
    assert len(lines) > 40
    for line in lines:
        parse(line)
    for wrong in ("mistray ghost scene.xml", "mistray ghosts scene.xml --flux-treshold 1", "mistary"):
        with pytest.raises((MistrayError, AssertionError)):
            parse(wrong)


@pytest.mark.parametrize("page", [README, *ALL_PAGES], ids=lambda page: page.stem)
def test_commands_of_a_page_do_not_stop_each_other(page: Path) -> None:
    """Typed one after the other: none stops at the files of one before, and no file of TOML is missing."""
    lines = [shlex.split(line, comments=True) for line in command_lines(page)]
    folders = [words[words.index("--out") + 1] for words in lines if "--out" in words and "--resume" not in words]
    assert sorted(set(folders)) == sorted(folders)
    prose = SHELL.sub("", page.read_text(encoding="utf-8"))
    tomls = {word for words in lines for word in words if word.endswith(".toml") and not (ROOT / word).is_file()}
    assert [name for name in tomls if f"`{name}`" not in prose] == []


@pytest.mark.parametrize("page", [*ALL_PAGES, *AROUND, README], ids=lambda page: page.stem)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:|#)([^)]+)", page.read_text(encoding="utf-8")):
        name, _, part = target.partition("#")
        assert (page.parent / name).exists(), target
        if part and page == README:
            headings = re.findall(r"(?m)^#+ (.+)$", (ROOT / name).read_text(encoding="utf-8"))
            assert part in [re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings], target


def test_every_picture_is_shown_and_every_drawn_one_is_there(monkeypatch: Patch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "site"))
    there = {file.name for file in (ROOT / "docs" / "images").glob("*.[ps][nv]g")}
    assert {f"{name}.png" for name in script("page_pictures", ROOT / "docs" / "site").PICTURES} <= there
    text = "".join(page.read_text(encoding="utf-8") for page in (README, *ALL_PAGES))
    assert [name for name in sorted(there) if f"images/{name})" not in text] == []


@pytest.mark.parametrize(
    "line",
    [line for line in dict.fromkeys(command_lines(README) + command_lines(COMMANDS)) if line.startswith("mistray")],
)
def test_a_command_of_the_readme_and_of_the_list(line: str, monkeypatch: Patch, capsys: Captured) -> None:
    monkeypatch.chdir(ROOT)
    Path("out").mkdir(exist_ok=True)
    force = ["--force"] if " out/" in line else []  # which may hold the results of an earlier run of this test
    code, out, err = run(capsys, *shlex.split(line)[1:], *force)
    assert code == 0, err
    assert out


def test_make_demo_writes_the_report() -> None:
    if shutil.which("make") is None or Path(sys.prefix) != ROOT / ".venv":
        pytest.skip("not run by make in its own environment")
    demo = ROOT / "out" / "demo"
    shutil.rmtree(demo, ignore_errors=True)
    done = subprocess.run(["make", "demo"], cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    assert {"report.html", "paths.csv", "overview.png", "path_sort_27deg.txt"} <= {path.name for path in demo.iterdir()}
    assert not re.search(r"(src|href)=[\"']https?:", (demo / "report.html").read_text(encoding="utf-8"))


def test_the_readme_is_short_and_has_two_commands_to_set_up() -> None:
    text = README.read_text(encoding="utf-8")
    assert [line for line in command_lines(README) if not line.startswith("mistray ")] == ["make demo", "make test"]
    assert len(text.splitlines()) <= 130
    assert len(text.split()) <= 1300
    assert all(f"]({name})" in text for name in ("docs/tasks.md", "docs/support.md", "CONTRIBUTING.md"))


def test_pages_list_all_scenes_notebooks_and_commands() -> None:
    text = (ROOT / "docs" / "scenes_and_notebooks.md").read_text(encoding="utf-8")
    assert all(f"`{path.parent.name}`" in text for path in (ROOT / "scenes").glob("*/scene.xml"))
    notebooks = [path.relative_to(ROOT).as_posix() for path in (ROOT / "notebooks").glob("*.ipynb")]
    assert notebooks
    assert all(f"](../{name})" in text for name in notebooks)
    # But for completion, which a shell reads, the cache, and budget, whose file docs/sensitivity.md shows
    listed = {shlex.split(line)[1] for line in command_lines(COMMANDS)}
    assert {module.COMMAND.name for module in program.COMMANDS} - listed <= {"budget", "cache", "completion"}


@pytest.mark.core
def test_docstrings_of_functions_have_the_sections_of_numpydoc(caplog: pytest.LogCaptureFixture) -> None:
    """What stands after the parameters is another section: the site takes free text there for parameters."""
    griffe = pytest.importorskip("griffe")
    pending, parsed = [griffe.load("mistray", search_paths=[ROOT], docstring_parser="numpy")], 0
    caplog.clear()
    while pending:
        for member in pending.pop().members.values():
            if member.is_alias:
                continue
            pending += [member] if member.is_module or member.is_class else []
            if member.is_function and member.docstring:
                assert member.docstring.parsed
                parsed += 1
    assert parsed > 1000
    assert not [message for message in caplog.messages if "mistray/" in message]


TOML = re.compile(r"^```toml\n(.*?)^```", re.MULTILINE | re.DOTALL)
TITLED = re.compile(r"^```(?:json|toml) title=\"([\w.]+)\"\n(.*?)^```", re.MULTILINE | re.DOTALL)
TRIPLET = ROOT / "scenes" / "cooke_triplet" / "scene.xml"
# Last ones count: few rays, little time
FEW = {"rays": ("--rays", "500"), "seconds": ("--seconds", "20"), "monte_carlo": ("--monte-carlo", "2")}
TRACES_NOTHING = {"--write-scene", "--no-trace"}
OTHERS = {
    "mistray app": "waits for a browser; tests/analyses/explorer",
    "--scheduler": "needs the workers of a cluster; tests/cluster",
    "cuda_ad_rgb": "needs a GPU; tests/test_gpu.py",
    "cache clear": "would clear the cache of whoever runs this",
    "explored_scene.xml": "needs what the explorer saves; tests/analyses/explorer/test_server.py",
}
WRITTEN_BY_OTHERS = {"imported_files.md": "tests/test_plugin_pages.py runs them"}


def make(name: str) -> bool:
    """Write a file that a reader has, where the page does not make it; whether the name is that of one."""
    path = Path(name)
    match name:
        case "lens.zmx" | "triplet.zmx":
            path.write_text(ZMX)
        case "triplet.seq":
            path.write_text(SEQ.replace("RDM Y\n", ""))
        case "lens.xml" | "singlet.xml" | "better.xml" | "both.xml" | "telescope.xml":
            path.with_name("own.zmx").write_text(ZMX)
            from_zemax("own.zmx").to_xml(path)
        case "scene.xml" | "triplet.xml":
            shutil.copy(TRIPLET, path)
        case "camera.xml":  # mirrors, which have no glass to know in the infrared, a detector and a part shield_1
            text = (ROOT / "scenes" / "newtonian_scatter" / "scene.xml").read_text(encoding="utf-8")
            text = text.replace('"mirror_cell"', '"shield_1"').replace('id="image"', 'id="detector"')
            path.write_text(text, encoding="utf-8")
        case "camera.roa":
            peers.need("rayoptics")
            package = Path(str(importlib.util.find_spec("rayoptics").origin)).parent
            shutil.copy(package / "models" / "Sasian Triplet.roa", path)
        case "tube.step":  # two parts, a vane and a tube
            text = (Path(__file__).parent / "data" / "assembly_inch.step").read_text(encoding="utf-8")
            text = text.replace("'ring','ring'", "'vane','vane'").replace("'bracket','bracket'", "'tube','tube'")
            path.write_text(text)
        case "bracket.stl":  # a small body as binary STL, in inches far from the lenses
            corners = [(9.0, 0.0, 0.0), (9.5, 0.0, 0.0), (9.0, 0.5, 0.0), (9.0, 0.0, 0.5)]
            faces = [[corners[k] for k in face] for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))]
            facets = [struct.pack("<12fH", 0, 0, 0, *(x for corner in face for x in corner), 0) for face in faces]
            path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + b"".join(facets))
        case "lamp.ies":
            text = "IESNA:LM-63-2002\nTILT=NONE\n1 1000 1 3 1 1 2 0 0 0\n1 1 10\n0 45 90\n0\n100 100 100\n"
            path.write_text(text)
        case _:
            return False
    return True


def steps(page: Path) -> list[tuple[str, str]]:
    """Python blocks, TOML blocks and commands of a page in their order, each with its kind."""
    text = page.read_text(encoding="utf-8")
    found = [(match.start(), "python", match[1]) for match in BLOCK.finditer(text)]
    found += [(match.start(), "toml", match[1]) for match in TOML.finditer(text)]
    for match in SHELL.finditer(text):
        found += [(match.start() + k, "command", line) for k, line in enumerate(match[1].splitlines())]
    found += [(match.start(), "command", match[1]) for match in INDENTED.finditer(text)]
    return [(kind, content) for _, kind, content in sorted(found) if content.startswith("mistray") or kind != "command"]


SHOWING = [page for page in ALL_PAGES if any(kind == "command" for kind, _ in steps(page))]


def run_line(line: str, tomls: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    words = shlex.split(re.split(r" [|>] ", line)[0], comments=True)[1:]
    for name in re.split("[=,\\s]", " ".join(words)):  # also filename=lamp.ies among the facts of a source
        if name and not Path(name).exists() and not make(name) and name.endswith(".toml") and tomls:
            Path(name).write_text(tomls[-1], encoding="utf-8")
    if "--help" not in words:
        options = vars(program._parser().parse_args(words))
        for name, few in FEW.items() if TRACES_NOTHING.isdisjoint(words) else ():
            given = name in options and (name == "rays" or options[name] not in (None, 0))
            given &= words[0] != "export" or "--paths" in words
            given &= name != "rays" or words[0] != "sensitivity" or "pst_band" not in words  # 0 with few rays
            words += few if given else ()
        words += ["--force"] if "force" in options and not options.get("resume") else []
    code = cli.main(words)
    printed = capsys.readouterr()
    # 2 with a line on stdout: an import whose light does not arrive writes its scene and says so
    assert code == 0, (line, printed.err)
    assert printed.out or "--quiet" in words, line


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", SHOWING, ids=lambda page: page.stem)
def test_the_commands_of_a_page_run(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if page.name in WRITTEN_BY_OTHERS:
        pytest.skip(WRITTEN_BY_OTHERS[page.name])
    monkeypatch.chdir(tmp_path)
    for name in ("examples", "scenes"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "out").mkdir()
    for name, content in TITLED.findall(page.read_text(encoding="utf-8")):
        (tmp_path / name).write_text(content, encoding="utf-8")
    namespace: dict = {"__name__": "__main__"}
    tomls: list[str] = []
    coming = [content for kind, content in steps(page) if kind == "toml"]  # a page may show its file after the command
    for kind, content in steps(page):
        if kind == "python":
            exec(compile(content, str(page), "exec"), namespace)
        elif kind == "toml":
            tomls.append(content)
        elif not any(part in content for part in OTHERS):
            capsys.readouterr()
            run_line(content, tomls or coming[:1], capsys)


PAGE = (ROOT / "docs" / "tasks.md").read_text(encoding="utf-8")
TITLES = re.findall(r"(?m)^## \d+\. (.+)$", PAGE)
TEXTS = re.split(r"(?m)^## .+$", PAGE)[1:]
OUT = ROOT / "out"


def lines(text: str, language: str) -> list[str]:
    blocks = re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if line.strip()]


def numbers(printed: str, start: str) -> list[float]:
    """The numbers of the line of a table that begins so and goes on with a number and its error."""
    found = re.findall(rf"(?m)^ *{re.escape(start)} +(\d.* ± .*)$", printed)
    assert len(found) == 1, (start, printed)
    return [float(word) for word in found[0].split() if re.fullmatch(r"\d[\d.]*(e-?\d+)?", word)]


def check_facts(task: int, printed: str) -> None:
    """What the commands of a task have printed and written."""
    match task:
        case 1:  # a phone camera is imported with coatings
            lens = mistray.load(OUT / "phone.xml")
            coated = [shape.id() for shape in lens.shapes() if getattr(shape.bsdf(), "coating", None) is not None]
            assert {"L1_front", "L1_rear", "L5_front", "L5_rear"} <= set(coated)
            assert "next: mistray ghosts out/phone.xml" in printed
        case 2:  # its worst ghosts
            assert len(re.findall(r"L\d_\w+ → L\d_\w+", printed)) >= 3
            page = (OUT / "ghosts" / "report.html").read_text(encoding="utf-8")
            assert page.index("Most stray light arrives at") < page.index("<table")
        case 3:  # a part is moved
            _, before, _, after, _, ratio, error = numbers(printed, "hood.z = -8")
            assert ratio == pytest.approx(after / before, rel=0.01)
            assert 1 - 3 * error < ratio < 1.5
        case 4:  # the PST at 30°
            total, error, stray, _ = numbers(printed, "30")[:4]
            assert total == stray
            assert error < 0.15 * total
        case 5:  # by polish
            told = printed[printed.index("first scattered by") :]
            starts = [line.split()[0] for line in told.splitlines() if line[:1].isspace() and line.strip()]
            assert {"10", "20", "30"} <= set(starts)
            assert re.search(r"L\d_\w+ \d+ %", told)
        case 6:  # exported to CAD
            assert "3 solids" in printed
            assert "2 beams, 6 paths" in printed
            text = (OUT / "triplet.step").read_text(encoding="ascii")
            assert text.startswith("ISO-10303-21;")
            assert all(f"PRODUCT('{lens}'" in text for lens in ("L1", "L2", "L3"))
        case 7:  # the table of a coating reflects what the layers do that it was made of
            assert "own: L1_front" in printed
            shapes = mistray.load(OUT / "own.xml").shapes()
            coatings = {shape.id(): type(getattr(shape.bsdf(), "coating", None)).__name__ for shape in shapes}
            assert (coatings["L1_front"], coatings["L1_rear"]) == ("CoatingTable", "Stack")
            table = pd.read_csv(OUT / "own.csv", comment="#").set_index(["wavelength_nm", "angle_deg"])
            (expected,), _ = stack_powers(1.0, [1.3837, 1.6561], [99.64, 80.0], 1.6938, 550.0, np.ones(1))  # N-LAK9
            assert table.loc[(550, 0)].R_s == pytest.approx(expected, abs=1e-4)
        case 8:  # the table of a Lambertian paint scatters as the paint does
            paint = mistray.coat("plate_and_wall", {}, scatter={"screen": "paint reflectance=0.05"})
            stray, error = (float(curve[0]) for curve in mistray.pst(paint, [30.0], rays=20_000).curve("stray"))
            _, _, found, found_error = numbers(printed, "30")[:4]
            assert abs(found - stray) < 4 * (error**2 + found_error**2) ** 0.5
        case 9:  # two designs are compared
            assert float(*re.findall(r"makes ghosts ([\d.]+) ± [\d.]+ times weaker", printed)) > 2
        case 10:  # a report is handed over
            page = (OUT / "study" / "report.html").read_text(encoding="utf-8")
            assert not re.search(r"(src|href)=[\"']https?:", page)
            assert (OUT / "study" / "report.pdf").read_bytes().startswith(b"%PDF")
        case _:
            pytest.fail(f"task {task} has no facts here")


def test_there_are_ten_and_each_is_short() -> None:
    assert len(TITLES) == len(TEXTS) == 10
    for text in TEXTS:
        commands, code = lines(text, "sh"), lines(text, "python")
        assert bool(commands) != bool(code)
        assert len(commands) <= 3
        assert len(code) <= 10


@pytest.mark.parametrize(("task", "text"), list(enumerate(TEXTS, start=1)), ids=TITLES)
def test_a_task(task: int, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The example in Python is run by tests/test_docs.py too; here its number is looked at."""
    monkeypatch.chdir(ROOT)
    OUT.mkdir(exist_ok=True)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        for line in lines(text, "sh"):
            words = shlex.split(line)
            force = ["--force"] if any("out/" in word for word in words) and words[1] != "pst" else []
            assert cli.main([*words[1:], *force]) == 0, line
        exec("\n".join(lines(text, "python")), {})
    check_facts(task, printed.getvalue())


COMING_FROM = (Path(__file__).parents[1] / "docs" / "coming_from.md").read_text(encoding="utf-8")
# What the names of the page stand for
ROOTS: dict[str, Any] = {"mistray": mistray, "t": Trace, "report": GhostReport, "p": Pst, "system": Prescription}
# What properties and calls on the page give, of which something is asked
PROPERTIES = {"t.paths": PathTable}
RESULTS = {"t.history": RayHistory}
# Names that are only assigned when an object is made
ATTRIBUTES = {"t.energy", "t.surfaces", "t.irradiance"}
FREE = {"scene", "params", "metric", "t", "optic", "model"}  # arguments that the page explains
SETTINGS = {setting.name for setting in fields(Settings)}


def rows(heading: str) -> Iterator[list[str]]:
    """Cells of the tables whose first column has a heading."""
    table = ""
    for line in COMING_FROM.splitlines():
        cells = [cell.strip("| ") for cell in line.strip("|").split(" | ")] if line.startswith("| ") else []
        if cells and cells[0] in ("task", "word"):
            table = cells[0]
        elif cells and table == heading:
            yield cells


TASKS, WORDS = list(rows("task")), list(rows("word"))
ROWS = TASKS + WORDS
SPANS = [span for row in ROWS for span in re.findall(r"`([^`]+)`", re.sub(r"\[`\w+`\]\([^)]*\)", "", row[-1]))]
NAMED = [span for span in SPANS if re.match(r"mistray \w", span)]
CALLS = [span for span in SPANS if re.match(r"(mistray|t|report|p|system)\.", span)]


def test_the_tables_are_whole_and_every_task_has_something_here() -> None:
    assert len(TASKS) > 30
    assert len(WORDS) > 70
    assert all(len(row) == 5 and all(row) for row in TASKS)
    assert all(len(row) == 3 and all(row) for row in WORDS)
    assert len({row[0] for row in TASKS}) == len(TASKS)
    for row in TASKS:
        assert "`" in row[-1] or "](" in row[-1], row[0]
    assert set(SPANS) - set(NAMED) - set(CALLS) <= {"front", "back", "Prescription"}, "neither a command nor a call"


def test_every_program_of_the_title_has_its_words() -> None:
    for program_ in re.findall(r"ASAP|FRED|TracePro|OpticStudio", COMING_FROM.partition("\n")[0]):
        assert f"## The words of {program_}\n" in COMING_FROM


@pytest.mark.parametrize("line", NAMED)
def test_command_exists(line: str) -> None:
    program._parser().parse_args(shlex.split(line)[1:])


def resolve(node: ast.expr) -> tuple[str, Any]:
    """Dotted name of an expression, and the class, function or module it is."""
    if isinstance(node, ast.Call):
        name, _ = resolve(node.func)
        check_arguments(name, resolve(node.func)[1], node)
        return name, RESULTS.get(name)
    if isinstance(node, ast.Attribute):
        above, owner = resolve(node.value)
        name = f"{above}.{node.attr}"
        if name in ATTRIBUTES:
            assert node.attr in (inspect.getdoc(owner) or ""), f"{name} is not documented"
            return name, None
        assert hasattr(owner, node.attr), f"there is no {name}"
        return name, PROPERTIES.get(name, getattr(owner, node.attr))
    assert isinstance(node, ast.Name)
    return node.id, ROOTS[node.id]


def check_arguments(name: str, function: Any, call: ast.Call) -> None:
    signature = inspect.signature(function)
    bound = name.split(".")[0] != "mistray"
    places = [None] * (len(call.args) + bound)
    keywords = {str(word.arg): None for word in call.keywords}
    signature.bind(*places, **keywords)
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in signature.parameters.values()):
        assert set(keywords) <= set(signature.parameters) | SETTINGS, f"{name}: {sorted(keywords)}"
    for argument in call.args:
        assert not isinstance(argument, ast.Name) or argument.id in FREE


@pytest.mark.parametrize("text", CALLS)
def test_call_exists(text: str) -> None:
    resolve(ast.parse(text, mode="eval").body)

"""What README.md and docs/ show works: Python runs, a page in one namespace; commands exist; links lead somewhere."""

import ast
import importlib
import importlib.util
import json
import re
import shlex
import shutil
import subprocess
import sys
from itertools import takewhile
from pathlib import Path

import pytest
from command_line import Patch, run
from example_scripts import script

from mistray.cli import program
from mistray.errors import MistrayError

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
    """With their options; `test_docs_commands` runs them, which takes most of an hour."""
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
    drawn = script("page_pictures", ROOT / "docs" / "site").PICTURES
    there = {file.name for file in (ROOT / "docs" / "images").glob("*.[ps][nv]g")}
    assert {f"{name}.png" for name in drawn} <= there
    text = "".join(page.read_text(encoding="utf-8") for page in (README, *ALL_PAGES))
    assert [name for name in sorted(there) if f"images/{name})" not in text] == []


@pytest.mark.parametrize(
    "line",
    [line for line in dict.fromkeys(command_lines(README) + command_lines(COMMANDS)) if line.startswith("mistray")],
)
def test_a_command_of_the_readme_and_of_the_list(
    line: str, monkeypatch: Patch, capsys: pytest.CaptureFixture[str]
) -> None:
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


def test_a_page_lists_all_scenes_and_notebooks() -> None:
    text = (ROOT / "docs" / "scenes_and_notebooks.md").read_text(encoding="utf-8")
    assert all(f"`{path.parent.name}`" in text for path in (ROOT / "scenes").glob("*/scene.xml"))
    notebooks = [path.relative_to(ROOT).as_posix() for path in (ROOT / "notebooks").glob("*.ipynb")]
    assert notebooks
    assert all(f"](../{name})" in text for name in notebooks)


def test_the_list_of_commands_has_all() -> None:
    """But for completion, which a shell reads, the cache, and budget, whose file docs/sensitivity.md shows."""
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

"""The README's commands and its example do what it says."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mistray import cli

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """Contents of the README's code blocks in a language."""
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


COMMANDS = [line for block in blocks("sh") for line in block.splitlines() if line]


def test_the_commands_of_the_readme_are_known():
    assert {line.split()[0] for line in COMMANDS} == {"make", "mistray"}
    assert [line for line in COMMANDS if line.startswith("make")] == ["make demo", "make test"]


@pytest.mark.long
@pytest.mark.parametrize("line", [line for line in COMMANDS if line.startswith("mistray")])
def test_command(line, monkeypatch, capsys):
    """In this process: to start Python and Mitsuba for each takes longer than most of them."""
    monkeypatch.chdir(ROOT)
    Path("out").mkdir(exist_ok=True)
    arguments = shlex.split(line)[1:]
    if any(word.startswith("out/") for word in arguments):
        arguments.append("--force")  # out/ may hold the results of an earlier run of this test
    code = cli.main(arguments)
    printed = capsys.readouterr()
    assert code == 0, printed.err
    assert printed.out


@pytest.mark.long
def test_make_demo_writes_the_report():
    if shutil.which("make") is None or Path(sys.prefix) != ROOT / ".venv":
        pytest.skip("not run by make in its own environment")
    shutil.rmtree(ROOT / "out" / "demo", ignore_errors=True)
    done = subprocess.run(["make", "demo"], cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    written = {path.name for path in (ROOT / "out" / "demo").iterdir()}
    assert {"report.html", "paths.csv", "overview.png", "path_sort_27deg.txt"} <= written
    html = (ROOT / "out" / "demo" / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"(src|href)=[\"']https?:", html), "the report must not need a network"


@pytest.mark.long
def test_python_examples(tmp_path):
    """The blocks follow each other, as a reader would run them; each is short."""
    examples = blocks("python")
    assert all(len([line for line in code.splitlines() if line.strip()]) <= 15 for code in examples)
    code = "\n".join(examples)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=600, env=dict(os.environ)
    )
    assert done.returncode == 0, done.stderr
    assert "closure" in done.stdout
    assert (tmp_path / "paths.csv").read_text().startswith("path_id,")


def test_links_lead_somewhere():
    for target in re.findall(r"\]\((?!https?:)([^)]+)\)", README):
        page, _, part = target.partition("#")
        assert (ROOT / page).exists(), target
        if part:
            headings = re.findall(r"(?m)^#+ (.+)$", (ROOT / page).read_text(encoding="utf-8"))
            assert part in [re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings], target


def test_scenes_and_notebooks_are_all_named():
    shipped = {path.parent.name for path in (ROOT / "scenes").glob("*/scene.xml")}
    assert all(f"`{name}`" in README for name in shipped)
    notebooks = [path.relative_to(ROOT).as_posix() for path in (ROOT / "notebooks").glob("*.ipynb")]
    assert notebooks
    assert all(f"]({name})" in README for name in notebooks)

"""Every Python example in docs/ runs, the blocks of a page in one namespace; commands exist; links lead somewhere."""

from __future__ import annotations

import re
import shlex
from itertools import takewhile
from pathlib import Path

import pytest

from mistray.cli import program
from mistray.errors import MistrayError

ROOT = Path(__file__).parents[1]
PAGES = sorted([*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "questions").glob("*.md")])
ALL_PAGES = sorted((ROOT / "docs").rglob("*.md"))
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
SHELL = re.compile(r"^```sh\n(.*?)^```", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"^ {4}(mistray .*)", re.MULTILINE)


def command_lines(text: str) -> list[str]:
    """Commands of a page: lines of shell blocks, and indented lines that begin with the name of the program."""
    lines = [line for block in SHELL.findall(text) for line in block.splitlines() if line]
    return lines + INDENTED.findall(text)


def parse(line: str) -> None:
    """Raises `MistrayError` where a line is no command of the program, as far as the shell hands it over."""
    words = list(takewhile(lambda word: word not in ("|", ">"), shlex.split(line, comments=True)))
    if words[0] == "mistray" and "--help" not in words:
        program._parser().parse_args(words[1:])
    else:
        assert words[0] in ("mistray", "make", "pip", "python", "dask"), line


def test_there_are_pages() -> None:
    assert any(BLOCK.search(page.read_text(encoding="utf-8")) for page in PAGES)


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = page.read_text(encoding="utf-8")
    namespace: dict = {"__name__": "__main__"}
    for match in BLOCK.finditer(text):
        line = text[: match.start()].count("\n") + 2
        code = compile("\n" * (line - 1) + match[1], str(page), "exec")
        exec(code, namespace)


def test_commands_exist() -> None:
    """With their options; `test_docs_commands` runs them, which takes most of an hour."""
    lines = [line for page in ALL_PAGES for line in command_lines(page.read_text(encoding="utf-8"))]
    assert len(lines) > 40
    for line in lines:
        parse(line)


@pytest.mark.parametrize("line", ["mistray ghost scene.xml", "mistray ghosts scene.xml --flux-treshold 1", "mistary"])
def test_a_wrong_command_would_be_noticed(line: str) -> None:
    with pytest.raises((MistrayError, AssertionError)):
        parse(line)


@pytest.mark.parametrize("page", [*ALL_PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: page.stem)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!http|#)([^)#]+)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target

"""The tiers of the tests: what is quick holds every room, what is long is left to those who ask for it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.quick


def test_quick_tests_know_every_room() -> None:
    """Each room of the package, and each room of the tests, has tests that `make quick` runs."""
    files = {
        file: text
        for file in (ROOT / "tests").rglob("test_*.py")
        if re.search(r"mark\.quick\b", text := file.read_text(encoding="utf-8"))
    }
    rooms = {folder.name for folder in (ROOT / "mistray").iterdir() if (folder / "__init__.py").exists()}
    named = {room for text in files.values() for room in re.findall(r"mistray\.([a-z_]+)", text)}
    assert rooms <= named
    tests = {file.relative_to(ROOT / "tests").parts[0] for file in files}
    folders = {file.parent.name for file in (ROOT / "tests").glob("*/test_*.py")}
    assert folders - tests == {"attack", "validation"}  # attacks, and numbers of papers and other programs, take longer


def test_the_continuous_integration_calls_the_command_of_the_readme() -> None:
    lines = (ROOT / ".ci/run").read_text(encoding="utf-8").splitlines()
    assert "make test" in lines
    assert "make test\n" in (ROOT / "README.md").read_text(encoding="utf-8")

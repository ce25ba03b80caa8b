"""The tiers of the tests: what is quick knows every room, make test all that a user has, the parts hold the rest."""

import ast
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest
import stubs
import tiers
from command_line import fails
from mutations import FAULTS

import mistray

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.quick


def test_quick_tests_know_every_room() -> None:
    """Each room of the package, and each room of the tests, has tests that `make quick` runs."""
    files = {
        file: text
        for file in (ROOT / "tests").rglob("test_*.py")
        if re.search(r"mark\.quick\b", text := file.read_text(encoding="utf-8"))
    }
    inits = (ROOT / "mistray").glob("*/__init__.py")  # a folder with nothing else re-exports names of others
    rooms = {init.parent.name for init in inits if len(list(init.parent.rglob("*.py"))) > 1}
    named = {room for text in files.values() for room in re.findall(r"mistray\.([a-z_]+)", text)}
    assert rooms <= named
    tests = {file.relative_to(ROOT / "tests").parts[0] for file in files}
    folders = {file.parent.name for file in (ROOT / "tests").glob("*/test_*.py")}
    assert folders - tests == {"attack", "validation"}  # attacks, and numbers of papers and other programs, take longer


def test_the_continuous_integration_calls_the_command_of_the_readme() -> None:
    assert "make test" in (ROOT / ".ci/run").read_text(encoding="utf-8").splitlines()
    assert "make test\n" in (ROOT / "README.md").read_text(encoding="utf-8")


class TestParts:
    def test_together_they_are_the_tier_and_files_stay_together(self) -> None:
        tier = {file: {n: s for n, s in of.items() if s > tiers.AT_ONCE_S} for file, of in tiers.recorded().items()}
        cut = tiers.parts(tier)
        every = [place for part in cut for place in part]
        assert sorted(every) == sorted((file, name) for file, names in tier.items() for name in names)
        assert all(sum(tier[file][name] for file, name in part) <= tiers.MOST_S for part in cut)
        half = tiers.MOST_S / 2
        cut = tiers.parts({"a": {"x": half - 20, "y": 10.0}, "b": {"x": half, "y": half, "z": half}, "c": {"x": 1.0}})
        assert len(cut) == 2
        assert sum({("a", "x"), ("a", "y")} <= part for part in cut) == 1
        assert max(len([place for place in part if place[0] == "b"]) for part in cut) < 3

    def test_chosen_by_a_number_and_nonsense_is_refused(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for text, index in (("0", 0), ("4", 0), ("20421", 1)):
            monkeypatch.setenv(tiers.PART, text)
            assert tiers.chosen_part(4) == index
        for text in ("", "-1", "1.5", "today"):
            monkeypatch.setenv(tiers.PART, text)
            with pytest.raises(pytest.UsageError, match=f"{tiers.PART} is '{text}'"):
                tiers.chosen_part(4)

    def test_a_test_newer_than_the_record_is_in_every_part(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(tiers, "recorded", lambda: {"a.py": {"test_x": tiers.MOST_S, "test_y": tiers.MOST_S}})
        items: list[Any] = [Item("a.py", name) for name in ("test_x", "test_y", "test_new")]
        names = []
        for part in ("0", "1"):
            monkeypatch.setenv(tiers.PART, part)
            names.append({item.name for item in tiers.in_part(items)})
        assert names[0] & names[1] == {"test_new"}
        assert names[0] | names[1] == {"test_x", "test_y", "test_new"}


class Item:
    """What the tiers look at of a test that is marked long."""

    def __init__(self, file: str, name: str) -> None:
        self.path, self.name, self.nodeid = ROOT / "tests" / file, name, f"tests/{file}::{name}[case]"

    def get_closest_marker(self, mark: str) -> str | None:
        return mark if mark == "long" else None


def marks(node: ast.AST) -> set[str]:
    """Names of the marks of a function or class."""
    return {m for d in getattr(node, "decorator_list", ()) for m in re.findall(r"mark\.(\w+)", ast.unparse(d))}


def pieces(path: Path) -> Iterator[str]:
    """Source of a test file without the tests that `make test` leaves out."""
    text = path.read_text(encoding="utf-8")
    tree, lines = ast.parse(text), text.splitlines()
    file = path.relative_to(ROOT / "tests").as_posix()
    whole = {
        mark
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark"
        for mark in re.findall(r"mark\.(\w+)", ast.unparse(node.value))
    }
    for node in tree.body:
        members = node.body if isinstance(node, ast.ClassDef) else [node]
        owner = f"{node.name}." if isinstance(node, ast.ClassDef) else ""
        for member in members:
            if isinstance(member, ast.FunctionDef | ast.AsyncFunctionDef) and member.name.startswith("test"):
                found = whole | marks(member) | (marks(node) if owner else set())
                if found & {"long", "slow", "gpu"} or tiers.takes_long(file, owner + member.name, "core" in found):
                    continue
            first = min([member.lineno, *(each.lineno for each in getattr(member, "decorator_list", ()))])
            yield "\n".join(lines[first - 1 : member.end_lineno])


@lru_cache(maxsize=1)
def sources() -> str:
    """Source of all tests that `make test` runs, but for this file, and of what they share."""
    files = [path for path in (ROOT / "tests").rglob("*.py") if path != Path(__file__)]
    return "\n".join(piece for path in sorted(files) for piece in pieces(path))


class TestEverythingIsTested:
    """What the program has, by its own lists, is named in tests that `make test` runs."""

    def test_plugins(self) -> None:
        names = {
            name
            for path in (ROOT / "plugins").rglob("*.py")
            for name in re.findall(r'^mi\.register_\w+\("(\w+)"', path.read_text(encoding="utf-8"), re.MULTILINE)
        }
        assert len(names) > 30
        assert {name for name in names if not re.search(rf"""["']{name}["']""", sources())} == set()

    def test_readers(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """The message about an unknown type lists the types of all files that are read."""
        (tmp_path / "lens.unknown").write_text("")
        suffixes = set(re.findall(r"\.[a-z]\w*", fails(capsys, "import", tmp_path / "lens.unknown")))
        suffixes -= {".unknown"}
        assert len(suffixes) > 12
        assert {suffix for suffix in suffixes if suffix not in sources()} == set()

    def test_functions(self) -> None:
        packages = {f"mistray.{each.name}" for each in pkgutil.iter_modules(mistray.__path__) if each.ispkg}
        modules = map(importlib.import_module, packages.union(stubs.packages()))
        names = {n for m in modules for n in getattr(m, "__all__", ()) if inspect.isfunction(getattr(m, n))}
        assert len(names) > 100
        assert names - set(re.findall(r"\w+", sources())) == set()

    def test_faults_are_of_lines_that_are_there(self) -> None:
        """`python tests/mutations.py` can put each of them into the program."""
        found = {
            name: (ROOT / fault.file).read_text(encoding="utf-8").count(fault.right) for name, fault in FAULTS.items()
        }
        assert found == dict.fromkeys(FAULTS, 1)

"""What docs/support_matrix.md and README say about packages is so: their versions, and how much they take on a disk."""

import importlib.metadata
import re
import tomllib

import pytest
from example_scripts import DOCS, ROOT, script
from packaging.requirements import Requirement

MATRIX = script("make_support_matrix", DOCS)
README = ROOT / "README.md"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def size_bytes(name: str, seen: dict[str, int]) -> None:
    """Adds what the files of a distribution, and of those that it needs, take on the disk."""
    if name.lower() in seen:
        return
    found = importlib.metadata.distribution(name)
    paths = [found.locate_file(file) for file in found.files or ()]
    seen[name.lower()] = sum(512 * path.stat().st_blocks for path in paths if path.is_file())
    for needed in map(Requirement, found.requires or ()):
        if needed.marker is None or needed.marker.evaluate({"extra": ""}):
            size_bytes(needed.name, seen)


def test_the_table_of_packages_is_current() -> None:
    """After a change of a version: PYTHONPATH=tests python docs/make_support_matrix.py."""
    assert MATRIX.PAGE.read_text(encoding="utf-8") == MATRIX.page()
    assert MATRIX.table().count("\n") > 20


def test_lowest_versions_are_allowed_by_what_the_tests_ran_with() -> None:
    tested = MATRIX.tested()
    for text in PROJECT["dependencies"]:
        needed = Requirement(text)
        assert needed.specifier.contains(tested[needed.name.lower()]), text


@pytest.mark.parametrize("page", [README, MATRIX.PAGE], ids=lambda page: page.stem)
def test_the_environment_is_as_large_as_the_page_says(page) -> None:
    """Of what pip installs without extras; another file system or Python changes it by some per cent."""
    seen: dict[str, int] = {}
    for text in PROJECT["dependencies"]:
        size_bytes(Requirement(text).name, seen)
    (stated,) = re.findall(r"about (\d+) MB", page.read_text(encoding="utf-8"))
    assert sum(seen.values()) / 1e6 == pytest.approx(int(stated), rel=0.1)


def test_pythons_of_the_page_are_those_of_the_classifiers() -> None:
    named = [text.rpartition(" ")[2] for text in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d+$", text)]
    tested = re.findall(r"(?m)^\| (3\.\d+) \| tested", MATRIX.PAGE.read_text(encoding="utf-8"))
    assert named == tested
    assert f">={named[0]}" == PROJECT["requires-python"]

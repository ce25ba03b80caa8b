"""The attack, some of its cases or all: nothing that a user or an enemy gives ends in a traceback, a hang or a lie."""

from pathlib import Path

import pytest

from attack.__main__ import PARTS, run_part

# One of so many cases in the long tests; in how many tests all of them are split
SOME = {"options": 151, "scenes": 71, "files": 13, "surroundings": 15}
SPLIT = {"options": 12, "scenes": 6, "files": 4}


@pytest.mark.timeout(900)
@pytest.mark.parametrize("part", SOME)
def test_some_cases(part: str, tmp_path: Path) -> None:
    assert run_part(part, tmp_path, every=SOME[part])[1] == {}


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("part", "first"), [(part, k) for part in PARTS for k in range(SPLIT.get(part, 1))])
def test_all_cases(part: str, first: int, tmp_path: Path) -> None:
    assert run_part(part, tmp_path, every=SPLIT.get(part, 1), first=first)[1] == {}

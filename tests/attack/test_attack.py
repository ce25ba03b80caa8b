"""The attack, some of its cases or all: nothing that a user or an enemy gives ends in a traceback, a hang or a lie."""

from __future__ import annotations

from pathlib import Path

import pytest

from attack.parts import BEFORE
from attack.run import run_part

SOME = {
    "options": 60,
    "xml": 40,
    "files": 8,
    "bombs": 5,
    "kills": 16,
    "interrupts": 23,
    "surroundings": 15,
    "entries": 6,
}
PLAIN = ("options", "numbers", "files", "entries", "requests")


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("part", PLAIN)
def test_some_cases(part: str, tmp_path: Path) -> None:
    assert run_part(part, tmp_path, every=SOME.get(part, 10)).failures == {}


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("part", BEFORE)
def test_all_cases(part: str, tmp_path: Path) -> None:
    assert run_part(part, tmp_path).failures == {}

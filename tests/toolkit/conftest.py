"""A scene for calls that end before they trace, and a folder with the inputs of calls."""

from pathlib import Path
from typing import Any

import pytest
from command_line import Patch
from test_every_command import INPUTS

import mistray


@pytest.fixture(scope="session")
def scene() -> Any:
    return mistray.load("plate")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: Patch) -> Path:
    """The working folder, with the scenes and files of the calls."""
    monkeypatch.chdir(tmp_path)
    for name, text in INPUTS.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path

"""A scene for calls that end before they trace, and a folder with the inputs of calls."""

from typing import Any

import pytest
from test_every_command import folder

import mistray

__all__ = ["folder"]


@pytest.fixture(scope="session")
def scene() -> Any:
    return mistray.load("plate")

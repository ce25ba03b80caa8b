"""A scene for calls that end before they trace."""

from __future__ import annotations

from typing import Any

import pytest

import mistray


@pytest.fixture(scope="session")
def scene() -> Any:
    return mistray.load("plate")

"""The STEP files of tests/data, by the script that writes them."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

DATA = Path(__file__).parents[1] / "data"


@pytest.fixture(scope="session")
def make_step() -> ModuleType:
    """The module tests/data/make_step.py."""
    spec = importlib.util.spec_from_file_location("make_step", DATA / "make_step.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module

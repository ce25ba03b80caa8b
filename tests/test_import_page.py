"""The page of imported files says what the command says."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import peers
import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.long
def test_the_page_is_current() -> None:
    """After a change of a reader: python docs/make_import_page.py."""
    peers.need("rayoptics")
    pytest.importorskip("batoid")
    spec = importlib.util.spec_from_file_location("make_import_page", ROOT / "docs" / "make_import_page.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.PAGE.read_text(encoding="utf-8") == module.page()

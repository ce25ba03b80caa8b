"""The page of imported files says what the command says."""

from __future__ import annotations

import peers
import pytest
from example_scripts import DOCS, script


@pytest.mark.long
def test_the_page_is_current() -> None:
    """After a change of a reader: python docs/make_import_page.py."""
    peers.need("rayoptics")
    pytest.importorskip("batoid")
    module = script("make_import_page", DOCS)
    assert module.PAGE.read_text(encoding="utf-8") == module.page()

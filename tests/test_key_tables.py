"""The tables of keys of TOML files say what the fields say."""

import pytest
from example_scripts import DOCS, script

TABLES = script("make_key_tables", DOCS)


@pytest.mark.parametrize("name", TABLES.PAGES)
def test_a_page_is_current(name: str) -> None:
    """After a change of a field: python docs/make_key_tables.py."""
    assert (TABLES.DOCS / name).read_text(encoding="utf-8") == TABLES.page(name)


def test_every_section_has_its_table() -> None:
    text = "".join(TABLES.page(name) for name in TABLES.PAGES)
    shown = [section for found in TABLES.TABLE.finditer(text) for section in found[2].split(", ")]
    assert shown == list(TABLES.SECTIONS)

"""Reads configurations from TOML; every message is one line with the file, the key and the remedy."""

from __future__ import annotations

from pathlib import Path

from mistray.optimize.section import Section
from mistray.sweeps.configurations import Configuration


def read_configurations(source: str | Path) -> list[Configuration]:
    """
    Read configurations.

    Parameters
    ----------
    source : str or Path
        A TOML file with sections ``[[configuration]]``, each with a ``name`` and a table ``values``; see
        docs/sweeps.md.

    Raises
    ------
    MistrayError
        If the file is missing or no TOML, a key is unknown or missing, a value is no number, or two configurations have
        one name.
    """
    whole = Section.of_file(source, "configurations")
    whole.known(("configuration",))
    found = [_configuration(section) for section in whole.tables("configuration")]
    if not found:
        raise whole.fail("configuration", "is missing; add at least one section [[configuration]]")
    return found


def _configuration(section: Section) -> Configuration:
    section.known(("name", "values"))
    values = section.table("values")
    return Configuration(section.text("name"), {key: values.numbers(key) for key in values.content})

"""Report parts that several commands share: definitions of terms, and settings."""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from mistray.toolkit.pages.model import Items, NotePart, PagePart, Section, Terms
from mistray.toolkit.tables.text import ABSENT
from mistray.trace.forward import versions


def settings_section(
    facts: Mapping[str, Any],
    command: str,
    definitions: Mapping[str, str] | None = None,
    assumptions: Sequence[str] = (),
    before: Sequence[PagePart] = (),
    after: Sequence[PagePart] = (),
    link: str = "",
    folded: str = "",
) -> Section:
    """
    Return the last section of a report: assumptions, definitions, settings and command line.

    Parameters
    ----------
    facts : mapping
        Settings by name; values of any kind.
    command : str
        Command line; empty: none.
    definitions : mapping of str to str, optional
        Meanings of words, see `terms`.
    assumptions : sequence of str
        Assumptions of the computation, one sentence each.
    before, after : sequence of PagePart
        Parts at the top of the section, and parts between the settings and the command.
    link, folded : str
        Link name and folding, see `Section`.
    """
    parts: list[PagePart] = list(before)
    if assumptions:
        parts += [NotePart("Assumptions", "h3"), Items(assumptions)]
    if definitions:
        parts += [NotePart("Definitions", "h3"), Terms(list(definitions.items())), NotePart("Settings", "h3")]
    parts += [Terms([(str(key), setting_text(value)) for key, value in facts.items()]), *after]
    if command:
        parts += [NotePart("Command", "h3"), NotePart(command, "pre")]
    words = [word for word, there in (("Assumptions", assumptions), ("definitions", definitions)) if there]
    title = f"{', '.join([*words, '']).removesuffix(', ')} and settings".capitalize() if words else "Settings"
    return Section("settings", title, parts, link, folded)


@functools.cache
def terms(report: str) -> dict[str, str]:
    """Return the definitions of the words that a report uses, in order; `report` is its table in assets/terms.toml."""
    text = files("mistray.toolkit.pages").joinpath("assets", "terms.toml").read_text(encoding="utf-8")
    return dict(tomllib.loads(text)[report])


def version_settings() -> dict[str, str]:
    """Return the versions of the packages that computed a result, by label, for the settings of a report."""
    return {f"version of {name}": version for name, version in versions().items()}


def setting_text(value: Any) -> str:
    """Return the value of a setting as a report shows it; None as "–"."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return ", ".join(setting_text(item) for item in value)
    return ABSENT if value is None else str(value)


def thousands(value: Any) -> str:
    """Return a whole number in digits with a space before every three of them; None as "–"."""
    return f"{int(value):,}".replace(",", " ") if value is not None else ABSENT

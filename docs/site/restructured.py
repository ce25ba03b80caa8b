"""Docstrings as Markdown: tables of reStructuredText, and links to public names in single backticks."""

from __future__ import annotations

import re
from typing import Any

import griffe
from reference import PACKAGES, definition, homes

RULE = re.compile(r"=+(?: +=+)+ *")
NAME = re.compile(r"(?<![`\w\[])`([A-Za-z_]\w*)`(?!`)")


def public_names() -> dict[str, str]:
    """Public names that stand for one thing, and where it is defined."""
    found: dict[str, set[str]] = {}
    for package in PACKAGES:
        for name, home in homes(package).items():
            found.setdefault(name, set()).add(definition(home))
    return {name: next(iter(places)) for name, places in found.items() if len(places) == 1}


class Restructured(griffe.Extension):
    """Changes each docstring before it is parsed."""

    def __init__(self) -> None:
        self.names = {name: home for name, home in public_names().items() if name[0].isupper() or "_" in name}

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Change the docstring of an object."""
        if obj.docstring is not None:
            text = with_tables(obj.docstring.value)
            text = re.sub(r"::$", ":", text, flags=re.MULTILINE)
            obj.docstring.value = NAME.sub(lambda match: self._link(match[1], obj.path), text)

    def _link(self, name: str, here: str) -> str:
        home = self.names.get(name)
        return f"`{name}`" if home is None or here.startswith(home) else f"[`{name}`][{home}]"


def with_tables(text: str) -> str:
    """Text with its simple tables as those of Markdown."""
    return "\n\n".join(markdown_table(block) for block in re.split(r"\n{2,}", text))


def markdown_table(block: str) -> str:
    """A simple table of reStructuredText as one of Markdown, and any other block as it is."""
    lines = block.splitlines()
    if not (len(lines) > 2 and RULE.fullmatch(lines[0]) and RULE.fullmatch(lines[-1])):
        return block
    starts = [match.start() for match in re.finditer("=+", lines[0])]
    ends = [*starts[1:], None]
    rows: list[list[str]] = []
    for line in lines:
        if RULE.fullmatch(line):
            continue
        cells = [line[a:b].strip().replace("|", r"\|") for a, b in zip(starts, ends, strict=True)]
        if cells[0] or not rows:
            rows.append(cells)
        else:  # it goes on the row before
            rows[-1] = [f"{above} {below}".strip() for above, below in zip(rows[-1], cells, strict=True)]
    head = rows.pop(0) if sum(bool(RULE.fullmatch(line)) for line in lines) == 3 else [" "] * len(starts)
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(starts), *rows))

"""The frame of an HTML report: style and script inside, nothing from the network."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib.resources import files


def page(title: str, sections: Sequence[str]) -> str:
    """A whole HTML document from its title, which is escaped, and finished sections."""
    resources = files("mistray.report")
    css, script = (resources.joinpath(f"report.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>\n{css}</style></head>\n<body>\n"
        + "\n".join(sections)
        + f"\n<script>\n{script}</script></body></html>\n"
    )

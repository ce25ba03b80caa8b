"""The frame of an HTML report: style and scripts inside, nothing from the network."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib.resources import files


def page(title: str, sections: Sequence[str], scripts: Sequence[str] = ("report",)) -> str:
    """
    A whole HTML document.

    Parameters
    ----------
    title : str
        It is escaped.
    sections : sequence of str
        Finished HTML.
    scripts : sequence of {"report", "hover", "explorer"}
        What the page can do: sort and filter tables, show the values of plots, explore the paths of a field.
    """
    code = "\n".join(_resource(f"{name}.js") for name in scripts)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>\n{_resource('report.css')}</style></head>\n<body>\n"
        + "\n".join(sections)
        + f'\n<script>\n"use strict";\n{code}</script></body></html>\n'
    )


def _resource(name: str) -> str:
    return files("mistray.report.html").joinpath("assets", name).read_text(encoding="utf-8")

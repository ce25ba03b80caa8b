"""Formulas of LaTeX as MathML, which browsers draw without a script."""

from __future__ import annotations

import html
import re

from latex2mathml.converter import convert

BLOCK = re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', re.DOTALL)
INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)


def with_formulas(page: str) -> str:
    """HTML of a page with its formulas as MathML."""
    page = BLOCK.sub(lambda match: convert(html.unescape(match[1]).strip(), display="block"), page)
    return INLINE.sub(lambda match: convert(html.unescape(match[1]).strip()), page)

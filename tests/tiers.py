"""Tiers of parametrised tests."""

from __future__ import annotations

import pytest


def slow_unless(quick: bool) -> pytest.MarkDecorator | tuple[()]:
    """Marks of a case that shows again, unless it is one of the quick ones, what these show."""
    return () if quick else pytest.mark.slow

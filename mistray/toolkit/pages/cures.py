"""Options that cure what a warning says: the settings that it names, as the command line writes them."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

from mistray.settings import Settings

_NAMES = sorted((one.name for one in dataclasses.fields(Settings) if "_" in one.name), key=len, reverse=True)
_NAMED = re.compile(
    rf"(?P<option>--[a-z][\w-]*)|\b(?P<setting>{'|'.join(_NAMES)})\b|\b(?:raise|more|fewer|lower) (?P<rays>rays)\b"
)


def cures(texts: Sequence[str]) -> list[str]:
    """Return the options that warnings name, each once: "lower flux_threshold" is cured by "--flux-threshold"."""
    found = (match for text in texts for match in _NAMED.finditer(text))
    options = (one["option"] or f"--{(one['setting'] or one['rays']).replace('_', '-')}" for one in found)
    return list(dict.fromkeys(options))

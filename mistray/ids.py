"""Rules for ids of objects, and splitting of a string into events."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection
from fnmatch import fnmatchcase

from mistray.errors import MistrayError
from mistray.events import EVENT_LETTERS

FORMULA_SIGNS = "=+-@"  # a spreadsheet that reads a table takes what begins so for a formula
JOINERS = "\u200c\u200d"  # between the letters of scripts that need them
CONTROLS = {"Cc", "Cf", "Cs", "Zl", "Zp"}  # categories of what steers a line or a terminal, or cannot be seen
_BETWEEN = re.compile(rf"(?<=:[{EVENT_LETTERS}])\s+")


def event_words(text: str) -> list[str]:
    """
    Split a list of events such as ``L1 front:T window:R detector:A``, each an id, a colon and a letter.

    Ids may contain spaces, because an event ends with its letter. An empty string has no events.
    """
    return _BETWEEN.split(text.strip()) if text.strip() else []


def fits(name: str, pattern: str) -> bool:
    """True if a name equals a pattern literally, brackets included, or matches it with the wildcards of `fnmatch`."""
    return name == pattern or fnmatchcase(name, pattern)


def hidden(text: str, breaks: str = "") -> str:
    """
    Return the first character of a string that is invisible, or that controls or reverses its line; "" if none.

    Parameters
    ----------
    text : str
        Text to search.
    breaks : str
        Control characters that are allowed.

    Returns
    -------
    str
        Character; empty if there is none. A joiner between two letters, marks or symbols is allowed.
    """
    for place, letter in enumerate(text):
        if unicodedata.category(letter) not in CONTROLS or letter in breaks:
            continue
        beside = text[place - 1 : place] + text[place + 1 : place + 2]
        if letter not in JOINERS or len(beside) < 2 or not all(unicodedata.category(c)[0] in "LMS" for c in beside):
            return letter
    return ""


def check_id(name: str, what: str = "object") -> None:
    """
    Raise `MistrayError` if a string cannot be an id.

    Spaces, quotation marks, arrows, commas and letters of any script are allowed. Line breaks and other `hidden`
    characters, spaces at the ends, a sign at the start that marks a formula in a spreadsheet, and text like the end of
    an event, as in ``a:T b``, are not allowed.

    Parameters
    ----------
    name : str
        Text to check.
    what : str
        Kind of object, for the message.

    Raises
    ------
    MistrayError
        If the text breaks one of these rules.
    """
    if letter := hidden(name):
        why = f"holds U+{ord(letter):04X}, a line break or another character that is not seen"
    elif name[:1] in tuple(FORMULA_SIGNS):
        why = f"begins with {name[0]}, which a spreadsheet takes for a formula"
    elif name != name.strip():
        why = "begins or ends with a blank"
    elif _BETWEEN.search(name):
        why = "holds a colon, a letter and a blank, as at the end of an event"
    else:
        return
    raise MistrayError(f"{what} {name!a}: its name {why}; rename it")


def check_written_id(name: str, what: str = "object") -> None:
    """Raise as `check_id` does, or if an id for a scene file contains ``$``, which marks a parameter in such files."""
    check_id(name, what)
    if "$" in name:
        raise MistrayError(f"{what} {name!a}: its name holds $, by which scene files know parameters; rename it")


def plain_name(text: str) -> str:
    """
    Return a string as a name of a file or part: runs of characters other than letters, digits, _ and - become _.

    Underscores at the ends are removed, so the name may be empty.
    """
    return re.sub(r"[^\w-]+", "_", text).strip("_")


def free_name(base: str, end: str, taken: Collection[str]) -> str:
    """Return ``base`` + ``end``, or if that is taken, with the first number from 2 between them that makes it new."""
    name, number = f"{base}{end}", 2
    while name in taken:
        name, number = f"{base}_{number}{end}", number + 1
    return name

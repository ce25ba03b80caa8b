"""Rules for ids of objects, and how the events at them are told apart in a line of text."""

from __future__ import annotations

import re
import unicodedata
from fnmatch import fnmatchcase

from mistray.errors import MistrayError
from mistray.events import EVENT_LETTERS

FORMULA_SIGNS = "=+-@"  # a spreadsheet that reads a table takes what begins so for a formula
JOINERS = "\u200c\u200d"  # between the letters of scripts that need them
CONTROLS = {"Cc", "Cf", "Cs", "Zl", "Zp"}  # categories of what steers a line or a terminal, or cannot be seen
_BETWEEN = re.compile(rf"(?<=:[{EVENT_LETTERS}])\s+")


def event_words(text: str) -> list[str]:
    """
    The events of a list such as ``L1 front:T window:R detector:A``, each an id, a colon and a letter.

    Ids may hold blanks: an event ends with its letter.
    """
    return _BETWEEN.split(text.strip()) if text.strip() else []


def fits(name: str, pattern: str) -> bool:
    """Whether a name is what is meant: the same text, which may hold brackets, or one that `fnmatch` takes for it."""
    return name == pattern or fnmatchcase(name, pattern)


def hidden(text: str, breaks: str = "") -> str:
    """
    The first character of a text that nobody sees, or that turns, breaks or steers the line that it stands in.

    Parameters
    ----------
    text : str
    breaks : str
        Control characters that are allowed.

    Returns
    -------
    str
        Empty if there is none. A joiner between two letters or marks is none.
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
    Raise if a text cannot be an id.

    Blanks, quotation marks, arrows, commas and letters of any script are allowed. Not allowed are line breaks and other
    `hidden` characters, blanks at the ends, a sign at the start by which a spreadsheet knows a formula, and what looks
    like the end of an event, as in ``a:T b``.

    Parameters
    ----------
    name : str
    what : str
        Kind of object, for the message.

    Raises
    ------
    MistrayError
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
    """As `check_id`, of what is written into a scene file, where ``$`` begins the name of a parameter."""
    check_id(name, what)
    if "$" in name:
        raise MistrayError(f"{what} {name!a}: its name holds $, by which scene files know parameters; rename it")


def plain_name(text: str) -> str:
    """A text as the name of a file or a part: letters, digits, _ and -, others as one underscore."""
    return re.sub(r"[^\w-]+", "_", text).strip("_")

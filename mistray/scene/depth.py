"""
Checks of a scene file for content that would crash Mitsuba's reader, or that it would misread silently.

Elements nested thousands of levels deep crash the process, and reading an included pipe would block. A few files that
include each other, or parameters of parameters, grow without end. Mitsuba reads a missing number as 0, and it ignores
the last row of a matrix.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from xml.parsers import expat

from mistray.errors import MistrayError, printable
from mistray.read_file import read_file, require_file
from mistray.scene.check import LAST_ROW
from mistray.scene.messages import FILE, VALUE_TAGS, SceneElement
from mistray.scene.xml_file import DEEPEST, MOST_TEXT, behind_path, filled, too_deep

DEEPEST_FILE = 15  # files within each other, the scene's own counted, as Mitsuba has it
MOST_INCLUDES = 1000  # each counted as often as it is read
LONGEST_SHOWN = 60  # characters of a value that a message repeats

AXES = ("x", "y", "z")
# Attributes that are numbers, and where one holds several: how many there may be
NUMBERS: Mapping[str, tuple[str, ...]] = {
    "float": ("value",),
    "point": AXES,
    "vector": AXES,
    "translate": AXES,
    "scale": AXES,
    "rotate": ("angle", *AXES),
}
LISTS: Mapping[str, Mapping[str, tuple[int, ...]]] = {
    **{tag: {"value": (1, 3)} for tag in ("point", "vector", "translate", "scale", "rotate", "rgb")},
    "matrix": {"value": (9, 16)},
    "lookat": {"origin": (3,), "target": (3,), "up": (3,)},
}
MAY_BE_EMPTY = {("lookat", "up")}

_NUMBER = re.compile(
    r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|(?P<word>inf(?:inity)?|nan(?:\(\w*\))?))",
    re.IGNORECASE | re.ASCII,
)


def check_source(path: Path, text: str | None = None) -> None:
    """
    Refuse a scene file that would crash Mitsuba, or that Mitsuba would misread.

    Parameters
    ----------
    path : Path
        Scene file. Other faults in it are left to its reader.
    text : str, optional
        Text to check instead of the content of the file.

    Raises
    ------
    MistrayError
        If elements are nested deeper than `DEEPEST` levels or includes deeper than `DEEPEST_FILE` files, or the scene
        exceeds `MOST_INCLUDES` or `MOST_TEXT`. It is also raised if a file cannot be read or is a pipe or a device, a
        value is given twice, or a number is missing or malformed.
    """
    _Look(path).read(path, [path.parent, Path()], (), text)


class _Look:
    """
    Check of elements and numbers of a scene before Mitsuba reads them, file by file through its includes.

    Attributes
    ----------
    path : Path
        Scene file, for messages.
    defaults : dict of str to str
        Values of the parameters ``$name`` seen so far.
    contents : dict of Path to bytes
        Contents of the files read so far.
    includes, text : int
        Number of includes so far, and length of their text and of all values with parameters in place.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.defaults: dict[str, str] = {}
        self.contents: dict[Path, bytes] = {}
        self.includes = self.text = 0

    def read(self, path: Path, folders: list[Path], within: tuple[Path, ...], text: str | None = None) -> None:
        """
        Check a file, or `text` in its place, and the files that it includes; `folders` are searched for these in order.

        `within` are the files that include this one, the outermost first. Raise `MistrayError` as `check_source` does;
        broken XML is left to Mitsuba.
        """
        data = self._content(path) if text is None else text.encode()
        self._grow(len(data), f"scene '{self.path}'")
        folders = [path.parent, *folders]
        stack: list[SceneElement] = []
        parser = expat.ParserCreate()

        def start(tag: str, given: dict[str, str]) -> None:
            if len(stack) >= DEEPEST:
                raise too_deep(path, parser.CurrentLineNumber, tag)
            element = SceneElement(tag, given.get("type", ""), given.get("id", ""), given.get("name", ""))
            element.parent = stack[-1] if len(stack) > 1 else None
            stack.append(element)
            line = f"scene '{path}', line {parser.CurrentLineNumber}"
            values = {key: self._filled(value, f"{line}: {_where(element)}{key}") for key, value in given.items()}
            if mistake := _twice(element) or _mistake(element, values):
                raise MistrayError(f"{line}: {_where(element)}{mistake}")
            if tag == "default":
                self.defaults.setdefault(element.name, values.get("value", ""))
            elif tag == "path":
                folders[:] = behind_path(folders, values.get("value", ""))
            if name := values.get(FILE):
                for folder in folders:
                    if os.path.exists(folder / name) and not os.path.isdir(folder / name):
                        require_file(folder / name, f"{line}: <{tag}> file")
                if tag == "include":
                    self._include(name, folders, (*within, path), f"{line}: <include> '{printable(name)}'")

        parser.StartElementHandler = start
        parser.EndElementHandler = lambda tag: stack.pop()
        try:
            parser.Parse(data, True)
        except MistrayError:
            raise
        except (ValueError, LookupError, expat.ExpatError):  # Mitsuba will say what is wrong
            return

    def _include(self, name: str, folders: list[Path], within: tuple[Path, ...], where: str) -> None:
        file = next((folder / name for folder in folders if os.path.isfile(folder / name)), None)
        if file is None:
            return
        self.includes += 1
        if any(os.path.exists(one) and os.path.samefile(file, one) for one in within):  # not yet, if its text is given
            raise MistrayError(f"{where} lies within itself; take one of the two out")
        if len(within) >= DEEPEST_FILE:
            raise MistrayError(f"{where} lies within {DEEPEST_FILE} files; put some of them together")
        if self.includes > MOST_INCLUDES:
            raise MistrayError(
                f"scene '{self.path}': it includes more than {MOST_INCLUDES} files, the last '{printable(name)}'; "
                "put some of them together"
            )
        self.read(file, folders, within)

    def _content(self, path: Path) -> bytes:
        if path not in self.contents:
            if os.path.isfile(path):  # large ones are not read
                self._grow(0 if os.path.getsize(path) <= MOST_TEXT else MOST_TEXT + 1, f"scene '{path}'")
            self.contents[path] = read_file(path, "scene")
        return self.contents[path]

    def _filled(self, text: str, where: str) -> str:
        """
        Return an attribute with its ``$name`` parameters substituted.

        Raise `MistrayError`, naming the place `where`, if it or the whole scene grows too long.
        """
        if "$" not in text:
            return text
        try:
            whole = filled(text, self.defaults)
        except MistrayError as error:
            raise MistrayError(f"{where} {error}") from None
        self._grow(len(whole), where)
        return whole

    def _grow(self, size: int, where: str) -> None:
        self.text += size
        if self.text > MOST_TEXT:
            raise MistrayError(
                f"{where}: the scene has more than {MOST_TEXT >> 20} MiB of text, includes and parameters in place; "
                "make it smaller"
            )


def _where(element: SceneElement) -> str:
    """Return the start of a message, ``owner: ``: the object that an element belongs to, or the element itself."""
    operation = element.parent is not None and element.parent.tag == "transform"
    owner = element.parent.parent if operation and element.parent is not None else element.owner
    if owner is None or owner.tag in ("default", "scene", "include", "path"):
        return f"<{element.tag}> '{printable(element.name)}': " if element.name else f"<{element.tag}>: "
    if operation and element.parent is not None:
        return f"{printable(str(owner))}: {printable(element.parent.name)}: "
    return f"{printable(str(owner))}: "


def _twice(element: SceneElement) -> str:
    """Return a message if an object's value is given for the second time, else "" after the name is noted."""
    if element.tag not in VALUE_TAGS or element.parent is None or not element.name:
        return ""
    if element.name in element.parent.values:
        return f"{printable(element.name)} is given twice; keep one of them"
    element.parent.values[element.name] = ""
    return ""


def _mistake(element: SceneElement, values: Mapping[str, str]) -> str:
    """
    Return a message on the first invalid number of a scene element; "" if there is none.

    `values` are its attributes with parameters in place. One that still holds a ``$`` is not checked.
    """
    tag = element.tag
    for key in NUMBERS.get(tag, ()):
        name = printable(element.name) if tag == "float" else f"{key} of {_named(element)}"
        if key in values and "$" not in values[key] and (reason := _no_number(values[key])):
            return f"{name} is {_shown(values[key])}; {reason}"
    for key, counts in LISTS.get(tag, {}).items():
        if key not in values or "$" in values[key] or (not values[key] and (tag, key) in MAY_BE_EMPTY):
            continue
        words = values[key].replace(",", " ").split()
        name = f"{key} of {_named(element)}"
        if len(words) not in counts:
            several = " or ".join(str(count) for count in counts)
            return f"{name} is {_shown(values[key])}; give {several} numbers, not {len(words)}"
        for word in words:
            if reason := _no_number(word):
                return f"{name} holds {_shown(word)}; {reason}"
        if len(words) == 16 and [float(word) for word in words[12:]] != LAST_ROW:
            return f"{name} has '{' '.join(words[12:])}' as its last row; it must be '0 0 0 1'"
    return ""


def _named(element: SceneElement) -> str:
    return f"<{element.tag}> '{printable(element.name)}'" if element.name else f"<{element.tag}>"


def _no_number(text: str) -> str:
    """Return the reason why Mitsuba would not read a string as the number it states; empty if it would."""
    match = _NUMBER.fullmatch(text.strip())
    if match is None:
        return "it must be a number"
    value = float(match[0]) if match["word"] is None else math.nan
    if math.isinf(value) or (value == 0 and re.match(r"[^e]*[1-9]", match[0], re.IGNORECASE)):
        return "it is beyond the range of numbers; write inf or 0 if that is meant"
    return ""


def _shown(text: str) -> str:
    return f"'{printable(text if len(text) <= LONGEST_SHOWN else text[:LONGEST_SHOWN] + '…')}'"

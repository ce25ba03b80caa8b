"""Coatings put on surfaces of a scene file; everything else in the file, comments and layout included, stays as it is.

The text is edited in place: a coating becomes one ``<bsdf type="thinfilm" id="…">``, and each surface that it covers
refers to it from its ``interface``. What it had before goes: R, T, table, a coating of its own or a shared one.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from mistray.coatings import Stack, layer_text
from mistray.errors import MistrayError
from mistray.prescription.scene_file import comment_text
from mistray.replace_file import replace_file

# What says which coating an interface or a thinfilm has
COATING_VALUES = {"R", "T", "table", "layers", "preset", "first", "design_nm", "n_shift", "k_shift", "opaque"}
COATED = ("interface", "thinfilm")
INDENT = "    "
NOTE = "Coatings put on by mistray"
DESIGN_NM = 550.0  # of the plugin


@dataclass(frozen=True)
class SharedCoating:
    """
    One design on some surfaces.

    Attributes
    ----------
    id : str
        Id that the coating gets in the file; a number is added if the file has it already.
    stack : Stack
    surfaces : tuple of str
        Ids of shapes.
    design_nm : float
        A wavelength at which the materials of the layers are known, nm.
    """

    id: str
    stack: Stack
    surfaces: tuple[str, ...]
    design_nm: float = DESIGN_NM


@dataclass
class _Element:
    """An element of the file and its place: ``<tag …>`` is start … inside, ``</tag>`` is close … end; byte offsets."""

    tag: str
    values: dict[str, str]
    start: int
    inside: int
    close: int = 0
    end: int = 0
    parent: _Element | None = None
    children: list[_Element] = field(default_factory=list)

    def walk(self) -> Iterator[_Element]:
        yield self
        for child in self.children:
            yield from child.walk()


class _File:
    """A scene file: its bytes and its elements."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.data = path.read_bytes()
        except OSError as error:
            raise MistrayError(f"scene '{path}': {error.strerror}; check the path") from None
        declared = re.match(rb"\s*<\?xml[^>]*encoding\s*=\s*[\"']([\w.-]+)", self.data)
        if declared and declared[1].lower() not in (b"utf-8", b"us-ascii", b"ascii"):
            raise MistrayError(f"scene '{path}': its encoding is {declared[1].decode()}; save it as UTF-8")
        self.comments: list[tuple[int, int]] = []
        self.root = self._parse()
        self.ids = {e.values["id"]: e for e in self.root.walk() if "id" in e.values and e.tag != "ref"}

    def _parse(self) -> _Element:
        parser = expat.ParserCreate()
        stack: list[_Element] = []
        roots: list[_Element] = []

        def start(tag: str, values: dict[str, str]) -> None:
            index = parser.CurrentByteIndex
            parent = stack[-1] if stack else None
            element = _Element(tag, values, index, self._end_of_tag(index), parent=parent)
            (parent.children if parent else roots).append(element)
            stack.append(element)

        def end(tag: str) -> None:
            element = stack.pop()
            if self.data[element.inside - 2 : element.inside] == b"/>":
                element.close = element.end = element.inside
            else:
                element.close = parser.CurrentByteIndex
                element.end = self.data.index(b">", element.close) + 1

        def comment(text: str) -> None:
            index = parser.CurrentByteIndex
            self.comments.append((index, self.data.index(b"-->", index) + 3))

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.CommentHandler = comment
        try:
            parser.Parse(self.data, True)
        except expat.ExpatError as error:
            raise MistrayError(
                f"scene '{self.path}', line {error.lineno}: broken XML, {expat.ErrorString(error.code)}; correct it"
            ) from None
        return roots[0]

    def _end_of_tag(self, index: int) -> int:
        """Offset behind the ``>`` of the tag that starts at an offset; one within quotes does not count."""
        match = re.compile(rb"<(?:[^\"'>]|\"[^\"]*\"|'[^']*')*>").match(self.data, index)
        assert match is not None  # expat has read it
        return match.end()

    def text(self, element: _Element) -> bytes:
        return self.data[element.start : element.end]

    def indent(self, element: _Element) -> str:
        """The blanks before an element that begins its line; empty otherwise."""
        line = self.data[self.data.rfind(b"\n", 0, element.start) + 1 : element.start]
        return line.decode() if not line.strip() else ""

    def with_blanks(self, element: _Element) -> tuple[int, int]:
        """Place of an element with the line break and the blanks before it."""
        before = len(self.data[: element.start].rstrip())
        return (before if b"\n" in self.data[before : element.start] else element.start), element.end

    def head(self, element: _Element) -> int:
        """Where an element begins, a comment right before it included."""
        for start, end in self.comments:
            if end <= element.start and not self.data[end : element.start].strip():
                return start
        return element.start

    def removals(self, coatings: Sequence[_Element]) -> Iterator[tuple[int, int, bytes]]:
        """Edits that remove shared coatings; with those of `recoated` go their note and the empty line behind them."""
        end_of_ours = -1
        for coating in coatings:
            start, end = self.with_blanks(coating)
            head = self.head(coating)
            noted = self.data[head : coating.start].startswith(f"<!-- {NOTE}".encode())
            if noted:
                start = len(self.data[:head].rstrip())
            if noted or start == end_of_ours:
                end_of_ours = coating.end
                empty = re.compile(rb"\n[ \t]*(?=\n)").match(self.data, end)
                end = empty.end() if empty else end
            yield start, end, b""

    def interface(self, surface: str) -> tuple[_Element, _Element]:
        """The child of a shape that is its surface, and the ``interface`` or ``thinfilm`` that it is or refers to."""
        shape = self.ids.get(surface)
        if shape is None or shape.tag != "shape":
            raise MistrayError(
                f"scene '{self.path}': it has no shape '{surface}'; coatings can be put on shapes that stand in the "
                "file with their id, not on included ones"
            )
        for child in shape.children:
            meant = self.ids.get(child.values.get("id", "")) if child.tag == "ref" else child
            if meant is not None and meant.tag == "bsdf":
                if meant.values.get("type") not in COATED:
                    raise MistrayError(
                        f"scene '{self.path}', shape '{surface}': its BSDF is '{meant.values.get('type')}'; "
                        "a coating needs an 'interface'"
                    )
                return child, meant
        raise MistrayError(f"scene '{self.path}', shape '{surface}': it has no BSDF; nest an 'interface' in it")


def recoated(source: str | Path, coatings: Sequence[SharedCoating], folder: str | Path, note: str = "") -> str:
    """
    Text of a scene with coatings put on surfaces.

    Parameters
    ----------
    source : str or Path
        Scene XML file.
    coatings : sequence of SharedCoating
    folder : str or Path
        Where the text will be stored. If the scene names files relative to its own folder and that is another one, the
        text says where to look for them.
    note : str
        Comment before the coatings.

    Raises
    ------
    MistrayError
        If the file cannot be read, a shape is missing or given twice, or a shape has no ``interface``.
    """
    file = _File(Path(source))
    edits: list[tuple[int, int, bytes]] = []
    names = _names(file, coatings)
    done: set[str] = set()
    for coating, name in zip(coatings, names, strict=True):
        for surface in coating.surfaces:
            if surface in done:
                raise MistrayError(f"shape '{surface}' gets two coatings; put it into one group")
            done.add(surface)
            place, interface = file.interface(surface)
            text = _coated(file, interface, name, copied=place is not interface)
            deeper = file.indent(place)[len(file.indent(interface)) :]
            edits.append((place.start, place.end, text.replace(b"\n", b"\n" + deeper.encode())))
    shapes = [child for child in file.root.children if child.tag == "shape"]
    at = file.head(shapes[0])
    lines = [f"<!-- {NOTE}{f': {comment_text(note)}' if note else ''} -->"]
    for coating, name in zip(coatings, names, strict=True):
        lines += _coating_lines(name, coating)
    pad = file.indent(shapes[0])
    edits.append((at, at, "".join(f"{line}\n{pad}" for line in [*lines, ""]).replace(f"\n{pad}\n", "\n\n").encode()))
    edits += file.removals(_forsaken(file, done))
    if _names_files(file) and Path(folder).resolve() != file.path.resolve().parent:
        way = os.path.relpath(file.path.resolve().parent, Path(folder).resolve())
        edits.append((file.root.inside, file.root.inside, f"\n{pad}<path value={quoteattr(way)}/>".encode()))
    data = file.data
    for start, end, new in sorted(edits, reverse=True):
        data = data[:start] + new + data[end:]
    return data.decode("utf-8")


def write_recoated(source: str | Path, coatings: Sequence[SharedCoating], target: str | Path, note: str = "") -> Path:
    """
    Write `recoated` text to a file, atomically: on an error an old file stays.

    Returns
    -------
    Path
        The file.
    """
    target = Path(target)
    return replace_file(target, recoated(source, coatings, target.parent, note), "scene file")


def _coated(file: _File, interface: _Element, name: str, copied: bool) -> bytes:
    """Text of an interface with a reference to a coating instead of what it had."""
    shift = interface.start
    text = file.text(interface)
    tag = text[: interface.inside - shift]
    if copied:  # a shared interface may have other users, so the surface gets one of its own
        tag = re.sub(rb"\s+id\s*=\s*(\"[^\"]*\"|'[^']*')", b"", tag, count=1)
    tag = re.sub(rb"(\stype\s*=\s*[\"'])thinfilm([\"'])", rb"\1interface\2", tag, count=1)
    if interface.end == interface.inside:  # <bsdf …/>
        tag = tag[:-2].rstrip() + b">"
    body = b""
    position = interface.inside
    for child in interface.children:
        if _is_coating(file, child):
            start, end = file.with_blanks(child)
            body += file.data[position:start]
            position = end
    body += file.data[position : interface.close]
    pad = file.indent(interface)
    inner = f"\n{pad}{INDENT}" if pad or b"\n" in text else ""
    reference = f"{inner}<ref id={quoteattr(name)}/>" + (f"\n{pad}" if inner else "")
    return tag + body.rstrip() + reference.encode() + b"</bsdf>"


def _is_coating(file: _File, child: _Element) -> bool:
    """Whether a child of an interface says which coating it has."""
    if child.tag == "ref":
        child = file.ids.get(child.values.get("id", ""), child)
    if child.tag == "bsdf":
        return child.values.get("type") == "thinfilm"
    return child.values.get("name") in COATING_VALUES


def _coating_lines(name: str, coating: SharedCoating) -> list[str]:
    lines = [
        f'<bsdf type="thinfilm" id={quoteattr(name)}>',
        f'{INDENT}<string name="layers" value={quoteattr(layer_text(coating.stack.layers))}/>',
    ]
    if coating.stack.first != "outside":
        lines.append(f'{INDENT}<string name="first" value={quoteattr(coating.stack.first)}/>')
    if coating.design_nm != DESIGN_NM:
        lines.append(f'{INDENT}<float name="design_nm" value="{coating.design_nm!r}"/>')
    return [*lines, "</bsdf>"]


def _names(file: _File, coatings: Sequence[SharedCoating]) -> list[str]:
    """Ids for the coatings that the file does not have yet, but for coatings that nobody will refer to any more."""
    recoated_shapes = {surface for coating in coatings for surface in coating.surfaces}
    taken = set(file.ids) - {element.values["id"] for element in _forsaken(file, recoated_shapes)}
    names = []
    for coating in coatings:
        name, number = coating.id, 2
        while name in taken:
            name, number = f"{coating.id}_{number}", number + 1
        taken.add(name)
        names.append(name)
    return names


def _forsaken(file: _File, surfaces: set[str]) -> list[_Element]:
    """Shared coatings that only these surfaces refer to."""
    found = []
    for child in file.root.children:
        if child.tag != "bsdf" or child.values.get("type") != "thinfilm" or "id" not in child.values:
            continue
        users = [e for e in file.root.walk() if e.tag == "ref" and e.values.get("id") == child.values["id"]]
        if users and all(_shape_of(user) in surfaces for user in users):
            found.append(child)
    return found


def _shape_of(element: _Element | None) -> str | None:
    """Id of the shape that an element belongs to."""
    while element is not None and element.tag != "shape":
        element = element.parent
    return None if element is None else element.values.get("id")


def _names_files(file: _File) -> bool:
    """Whether a value of the scene is, or contains, the name of a file relative to the scene's folder."""
    folder = file.path.parent
    for element in file.root.walk():
        for text in (element.values.get("value", ""), element.values.get("filename", "")):
            words = {text, *re.split(r"[\s,:]+", text)} - {"", "."}
            if any(not Path(word).is_absolute() and (folder / word).is_file() for word in words):
                return True
    return False

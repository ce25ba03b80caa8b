"""
Scene files as text that is edited in place: comments and layout stay as they are.

All changes of values, coatings and scatter models in a file go through `SceneFile`. Callers find the elements with it
and pass it the byte ranges to replace.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from mistray.errors import MistrayError
from mistray.materials.mate import shown
from mistray.physics.sags.terms import RADII
from mistray.read_file import read_file

LONGEST_NAME = 6  # words of a file name with blanks, within a longer text such as a list of layers
DEEPEST = 100  # levels of elements within each other; scenes need about six
INDENT = "    "
MOST_TEXT = 32 << 20  # characters of a scene, each file counted as often as it is read, parameters in place
Edit = tuple[int, int, bytes]  # replaces the bytes from start to end
VALUE_TAGS = ("float", "integer", "boolean", "string")
# What a value may stand as instead of by its own name
INSTEAD = {
    **{curvature: (radius,) for radius, curvature in RADII.items()},
    "thickness_nm": ("layers", "preset", "table"),
    "reflectance": ("preset",),
    "A": ("file",),  # of `abg`
}
_ID = re.compile(rb"\s+id\s*=\s*(\"[^\"]*\"|'[^']*')")


@dataclass
class Element:
    """
    XML element with its byte offsets in the file.

    ``<tag …>`` spans start … inside, and ``</tag>`` spans close … end. `values` are the attributes of the tag.
    """

    tag: str
    values: dict[str, str]
    start: int
    inside: int
    close: int = 0
    end: int = 0
    parent: Element | None = None
    children: list[Element] = field(default_factory=list)

    def walk(self) -> Iterator[Element]:
        """Yield the element and then all elements within it, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.walk()


class SceneFile:
    """
    Scene file, as bytes to edit and as a tree of elements.

    Parameters
    ----------
    path : Path
        Scene XML file.
    data : bytes, optional
        Content to use instead of that of the file.

    Attributes
    ----------
    path : Path
        As given.
    data : bytes
        Content.
    comments : list of (int, int)
        Byte offsets at which each comment begins and ends.
    root : Element
        Element ``scene``.
    ids : dict of str to Element
        Elements that have an id and are no references, by id.

    Raises
    ------
    MistrayError
        If the file cannot be read, is not XML in UTF-8, or is nested deeper than `DEEPEST`.
    """

    def __init__(self, path: Path, data: bytes | None = None) -> None:
        self.path = path
        self.data = read_file(path, "scene") if data is None else data
        declared = re.match(rb"\s*<\?xml[^>]*encoding\s*=\s*[\"']([\w.-]+)", self.data)
        if declared and declared[1].lower() not in (b"utf-8", b"us-ascii", b"ascii"):
            raise MistrayError(f"scene '{path}': its encoding is {declared[1].decode()}; save it as UTF-8")
        self.comments: list[tuple[int, int]] = []
        self.root = self._parse()
        self.ids = {e.values["id"]: e for e in self.root.walk() if "id" in e.values and e.tag != "ref"}

    def _parse(self) -> Element:
        parser = expat.ParserCreate()
        stack: list[Element] = []
        roots: list[Element] = []

        def start(tag: str, values: dict[str, str]) -> None:
            index = parser.CurrentByteIndex
            parent = stack[-1] if stack else None
            if len(stack) >= DEEPEST:
                raise too_deep(self.path, parser.CurrentLineNumber, tag)
            element = Element(tag, values, index, self._end_of_tag(index), parent=parent)
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
        """Return the byte offset after the ``>`` that ends the tag at `index`, ignoring any in quotes."""
        match = re.compile(rb"<(?:[^\"'>]|\"[^\"]*\"|'[^']*')*>").match(self.data, index)
        assert match is not None  # expat has read it
        return match.end()

    def text(self, element: Element) -> bytes:
        """Return the bytes of an element as written in the file."""
        return self.data[element.start : element.end]

    def indent(self, element: Element) -> str:
        """Return the white space before an element that is first on its line; "" otherwise."""
        line = self.data[self.data.rfind(b"\n", 0, element.start) + 1 : element.start]
        return line.decode() if not line.strip() else ""

    def with_blanks(self, element: Element) -> tuple[int, int]:
        """
        Return byte offsets of the start and end of an element, with the line break and white space before it.

        An element that is not first on its line begins where it stands.
        """
        before = len(self.data[: element.start].rstrip())
        return (before if b"\n" in self.data[before : element.start] else element.start), element.end

    def head(self, element: Element) -> int:
        """Return the byte offset at which an element begins, including a comment right before it."""
        for start, end in self.comments:
            if end <= element.start and not self.data[end : element.start].strip():
                return start
        return element.start

    def tail(self, element: Element) -> int:
        """Return the byte offset at which an element ends, including a comment that follows it on the same line."""
        for start, end in self.comments:
            between = self.data[element.end : start] if start >= element.end else b"\n"
            if not between.strip() and b"\n" not in between:
                return end
        return element.end

    @cached_property
    def defaults(self) -> dict[str, str]:
        """Default values of the file's parameters ``$name``, by name; the first of several counts, as in Mitsuba."""
        found: dict[str, str] = {}
        for element in self.root.walk():
            if element.tag == "default":
                found.setdefault(element.values.get("name", ""), element.values.get("value", ""))
        return found

    @cached_property
    def _folders(self) -> list[Path]:
        """Folders in which files named by the scene are searched: its own, those of its ``<path>``, the current one."""
        found = [self.path.parent, Path()]
        for element in self.root.walk():
            if element.tag == "path":
                found = behind_path(found, filled(element.values.get("value", ""), self.defaults))
        return found

    def beside(self, name: str) -> str:
        """Return the path from the current folder of a file that the scene names; the name itself if there is none."""
        # os.path.isfile, because that of Path raises for a long name
        return next((str(folder / name) for folder in self._folders if os.path.isfile(folder / name)), name)

    def values(self, element: Element) -> dict[str, str]:
        """
        Return the values of an element's properties, keyed by name; ``$name`` is replaced by its default.

        Raise `MistrayError` as `filled` does.
        """
        return {
            child.values["name"]: filled(child.values["value"], self.defaults)
            for child in element.children
            if "name" in child.values and "value" in child.values
        }

    def meant(self, element: Element) -> Element | None:
        """Return the element itself, or the object that a reference points to; None if that is not in the file."""
        return self.ids.get(element.values.get("id", "")) if element.tag == "ref" else element

    def surface(self, shape: Element) -> tuple[Element, Element] | None:
        """Return the BSDF element within a shape and the BSDF that it is or refers to; None without a BSDF."""
        for child in shape.children:
            meant = self.meant(child)
            if meant is not None and meant.tag == "bsdf":
                return child, meant
        return None

    def named(self, place: str) -> Element | None:
        """
        Return the object whose values ``mi.traverse`` names by a place, such as ``L1_front.bsdf.particulate``.

        It is None if the file has no such object.
        """
        first, *path = place.split(".")
        element = self.ids.get(first)
        for part in path:
            element = None if element is None else self._child(element, part)
        return element

    def _child(self, element: Element, part: str) -> Element | None:
        """Return the object that ``mi.traverse`` names `part` within an element; None if there is none."""
        if element.tag == "shape":
            found = self.surface(element)
            return found[1] if found is not None and part == "bsdf" else None
        counts: dict[str, int] = {}
        for child in element.children:
            meant = self.meant(child)
            if meant is None or meant.tag != "bsdf":
                continue
            kind = meant.values.get("type", "")
            counts[kind] = counts.get(kind, 0) + 1
            name = "coating" if kind == "thinfilm" else kind if counts[kind] == 1 else f"{kind}_{counts[kind]}"
            if name == part:
                return meant
        return None

    def with_values(self, values: Iterable[tuple[Element, str, str]]) -> list[Edit]:
        """
        Return edits that set values of elements: in place of the old one, or after the last value.

        Parameters
        ----------
        values : iterable of (Element, str, str)
            Element, name of the value, and its XML; of several with one name, the last counts.
        """
        by_element: dict[int, tuple[Element, dict[str, str]]] = {}
        for element, name, text in values:
            by_element.setdefault(element.start, (element, {}))[1][name] = text
        return [edit for element, new in by_element.values() for edit in self._put(element, new)]

    def _put(self, element: Element, new: Mapping[str, str]) -> list[Edit]:
        edits: list[Edit] = []
        more = []
        values = [child for child in element.children if child.tag in VALUE_TAGS]
        for name, text in new.items():
            names = (name, *INSTEAD.get(name, ()))
            old = next((child for child in values if child.values.get("name") in names), None)
            if old is None:
                more.append(text)
            else:
                edits.append((old.start, old.end, text.encode()))
        if not more:
            return edits
        if element.end == element.inside:  # <bsdf …/>
            tag = re.sub(rb"\s*/>$", b">", self.text(element))
            return [(element.start, element.end, tag + "".join(more).encode() + f"</{element.tag}>".encode())]
        if values:
            pad = self.indent(values[-1])
            added = "".join(f"\n{pad}{text}" if pad else text for text in more)
            at = self.tail(values[-1]) if pad else values[-1].end
            return [*edits, (at, at, added.encode())]
        pad = self.indent(element.children[0]) if element.children else ""
        added = "".join(f"\n{pad}{text}" if pad else text for text in more)
        return [*edits, (element.inside, element.inside, added.encode())]

    def with_copies(self, references: Iterable[Element]) -> SceneFile:
        """Return the file with given references replaced by copies of the objects they refer to, without ids."""
        return self.changed(
            [(place.start, place.end, self._copy(place, self.ids[place.values["id"]])) for place in references]
        )

    def _copy(self, place: Element, shared: Element) -> bytes:
        deeper = self.indent(place)[len(self.indent(shared)) :].encode()
        copied, at = b"", shared.start
        for element in shared.walk():
            if "id" in element.values and element.tag != "ref":  # those of objects within it are taken, too
                tag = self.data[element.start : element.inside]
                copied += self.data[at : element.start] + _ID.sub(b"", tag, count=1)
                at = element.inside
        return (copied + self.data[at : shared.end]).replace(b"\n", b"\n" + deeper)

    def changed(self, edits: Iterable[Edit]) -> SceneFile:
        """
        Return the file after edits, each a byte range and its new content; ranges must not overlap.

        Raise `MistrayError` if the result is not XML.
        """
        data = self.data
        for start, end, new in sorted(edits, key=lambda edit: edit[:2], reverse=True):
            data = data[:start] + new + data[end:]
        return SceneFile(self.path, data)

    def edited(self, edits: Iterable[Edit], folder: Path) -> str:
        """
        Return the text of the file after some edits.

        Parameters
        ----------
        edits : iterable of Edit
            Byte ranges, which must not overlap, and their new contents.
        folder : Path
            Folder in which the text will be stored. If the scene names files relative to its own folder and that is a
            different one, the text gets a search path to it.

        Raises
        ------
        MistrayError
            If the result is not XML.
        """
        edits = list(edits)
        if folder.resolve() != self.path.resolve().parent and self._names_files():
            way = os.path.relpath(self.path.resolve().parent, folder.resolve())
            pad = next((self.indent(child) for child in self.root.children), INDENT)
            edits.append((self.root.inside, self.root.inside, f"\n{pad}<path value={quoteattr(way)}/>".encode()))
        return self.changed(edits).data.decode("utf-8")

    def _names_files(self) -> bool:
        """True if a value names a file, see `names_a_file`, or a ``<path>`` a folder, relative to that of the scene."""
        return any(
            names_a_file(text := filled(element.values.get(key, ""), self.defaults), self.path.parent)
            or (element.tag == "path" and not os.path.isabs(text) and os.path.isdir(self.path.parent / text))
            for element in self.root.walk()
            for key in ("value", "filename")
        )


def too_deep(path: Path, line: int, tag: str) -> MistrayError:
    """Return the error for a scene file whose elements are nested more than `DEEPEST` levels deep."""
    return MistrayError(f"scene '{path}', line {line}: <{tag}> lies within {DEEPEST} other elements; close them first")


def is_true(text: str) -> bool:
    """True if the value of a ``<boolean>`` is true; Mitsuba takes capitals, too."""
    return text.lower() == "true"


def names_a_file(text: str, folder: Path) -> bool:
    """True if a string, or some of its words, is the name of an existing file relative to a folder."""
    # os.path.isfile, because that of Path raises for a text that is too long for a name, such as a list of layers
    return any(not os.path.isabs(name) and os.path.isfile(folder / name) for name in possible_names(text))


def possible_names(text: str) -> list[str]:
    """
    Return what may be names of files in a string, sorted: the whole text, and runs of its words.

    A run also counts without ``:entry`` at its end, and without ``key=`` before it.
    """
    found = {text}
    for part in re.split(r"[,;\n]", text):
        words = part.split()
        for length in range(1, min(LONGEST_NAME, len(words)) + 1):
            for start in range(len(words) - length + 1):
                whole = " ".join(words[start : start + length])
                found |= {whole, whole.rpartition(":")[0], whole.partition("=")[2]}
    return sorted(found - {"", "."})


def with_whole_paths(name: str, text: str) -> str:
    """
    Return the text of a scene in which each ``<path>`` to a folder beside the scene, or in another path, is absolute.

    Mitsuba looks for such folders first if it reads a file, but in the current folder if it reads a string.

    Parameters
    ----------
    name : str
        Path of the scene file whose content the text replaces.
    text : str
        Scene XML.

    Raises
    ------
    MistrayError
        If the text is not XML in UTF-8.
    """
    file = SceneFile(Path(name), text.encode())
    edits: list[Edit] = []
    folders = [Path(os.path.abspath(name)).parent]
    for element in file.root.walk():
        if element.tag != "path":
            continue
        known, folders = folders, behind_path(folders, filled(element.values.get("value", ""), file.defaults))
        if len(folders) > len(known):
            whole = quoteattr(str(folders[1]).replace("$", "\\$"))
            edits.append((element.start, element.end, f"<path value={whole}/>".encode()))
    return file.changed(edits).data.decode() if edits else text


def behind_path(folders: Sequence[Path], way: str) -> list[Path]:
    """
    Return the folders in which Mitsuba searches files behind a ``<path>`` with this value, the first one first.

    `folders` are those before it; the first of them, that of the scene file itself, stays the first.
    """
    # os.path.isdir, because that of Path raises for a text that is too long for a name
    found = next((folder / way for folder in folders if os.path.isdir(folder / way)), None)
    return [folders[0], *([] if found is None else [found]), *folders[1:]]


def filled(text: str, defaults: Mapping[str, str]) -> str:
    """
    Return a value with the parameters ``$name`` substituted; longest names first, as they may begin alike.

    A dollar after a backslash becomes a plain dollar, as in Mitsuba.

    Raises
    ------
    MistrayError
        If the result would have more than `MOST_TEXT` characters; it is not built then.
    """
    whole = text
    for name in sorted(filter(None, defaults), key=len, reverse=True) if "$" in text else ():
        if f"${name}" not in whole:
            continue
        parts = re.split(rf"(?<!\\)\${re.escape(name)}", whole)
        if len(whole) + (len(parts) - 1) * (len(defaults[name]) - len(name) - 1) > MOST_TEXT:
            raise MistrayError(
                f"'{shown([text])}' has more than {MOST_TEXT >> 20} MiB with its parameters in place; shorten it"
            )
        whole = defaults[name].join(parts)
    return whole.replace("\\$", "$")

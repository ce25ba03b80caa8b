"""Change of coatings and scatter in a scene file; everything else, comments and layout included, stays as it is.

The text is edited in place: a coating becomes one ``<bsdf type="thinfilm" id="…">``, and each surface that it covers
refers to it from its ``interface``. Its old coating is removed: R, T, table, a coating of its own or a reference to a
shared one.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

from mistray.coatings import Stack, layer_text
from mistray.errors import MistrayError
from mistray.prescription.coating import Coating
from mistray.prescription.scene_file import comment_text, shared_lines
from mistray.replace_file import replace_file
from mistray.scene.files import with_includes
from mistray.scene.xml_file import INDENT, Edit, Element, SceneFile

# What says which coating an interface or a thinfilm has
COATING_VALUES = {"R", "T", "table", "layers", "preset", "first", "design_nm", "n_shift", "k_shift", "opaque"}
COATED = ("interface", "thinfilm")
NOTE = "Coatings put on by mistray"
DESIGN_NM = 550.0  # of the plugin


@dataclass(frozen=True)
class SharedCoating:
    """
    Coating design for one or several surfaces of a scene file.

    Attributes
    ----------
    id : str
        Id of the coating in the file; a number is appended if the scene has it already.
    stack : Stack
        Layers of the coating.
    surfaces : tuple of str
        Ids of the shapes that get the coating.
    design_nm : float
        Wavelength at which the materials of the layers are known, nm.
    """

    id: str
    stack: Stack
    surfaces: tuple[str, ...]
    design_nm: float = DESIGN_NM

    def as_shared(self, name: str) -> Coating:
        """Return the coating under a name, with its layers as the string that scene files state."""
        first, design_nm, layers = self.stack.first, self.design_nm, layer_text(self.stack.layers)
        return Coating(layers=layers, first=first, design_nm=design_nm, mirror=self.stack.opaque, name=name)


@dataclass(frozen=True)
class Refit:
    """
    Changes to make to the interface of one surface: elements to add, coating and scatter models to remove.

    Attributes
    ----------
    lines : tuple of str
        XML elements that are added to the interface.
    coating : bool
        Whether the old coating is removed.
    scatter : frozenset of str
        Kinds of scatter models that are removed.
    """

    lines: tuple[str, ...]
    coating: bool = True
    scatter: frozenset[str] = frozenset()

    def drops(self, file: SceneFile, child: Element) -> bool:
        """True if these changes remove the given child element of the interface."""
        if _is_coating(file, child):
            return self.coating
        return (file.meant(child) or child).values.get("type") in self.scatter


def refitted(
    file: SceneFile,
    refits: Mapping[str, Refit],
    shared: Sequence[str],
    folder: Path,
    note: str = "",
    kept: Container[str] = (),
) -> str:
    """
    Return the text of a scene whose surfaces have other coatings or scatter models.

    Shared coatings of these surfaces that nothing refers to any more are removed.

    Parameters
    ----------
    file : SceneFile
        Scene file to change.
    refits : mapping of str to Refit
        Changes, keyed by the id of the shape.
    shared : sequence of str
        Lines of the shared objects that the new interfaces refer to. They stand before the first shape, under a
        comment.
    folder : Path
        Folder in which the text will be stored.
    note : str
        End of the comment.
    kept : container of str
        Ids of shared coatings of the file that are never removed.

    Raises
    ------
    MistrayError
        If a shape is missing or has no ``interface`` or ``thinfilm``.
    """
    places = [_interface(file, surface)[0] for surface in refits]
    # A shared interface may have other users, so each surface gets one of its own
    file = file.with_copies(place for place in places if place.tag == "ref")
    edits = [_refit(file, _interface(file, surface)[1], refit) for surface, refit in refits.items()]
    if shared:
        first = next(child for child in file.root.children if child.tag == "shape")
        at, pad = file.head(first), file.indent(first)
        lines = [f"<!-- {NOTE}{f': {comment_text(note)}' if note else ''} -->", *shared, ""]
        edits.append((at, at, "".join(f"{line}\n{pad}" for line in lines).replace(f"\n{pad}\n", "\n\n").encode()))
    forsaken = _forsaken(file, {name for name, refit in refits.items() if refit.coating})
    edits += _removals(file, [element for element in forsaken if element.values["id"] not in kept])
    return file.edited(edits, folder)


def recoated(source: str | Path, coatings: Sequence[SharedCoating], folder: str | Path, note: str = "") -> str:
    """
    Return the text of a scene with coatings put on surfaces.

    Parameters
    ----------
    source : str or Path
        Scene XML file.
    coatings : sequence of SharedCoating
        Coatings and the surfaces that get them.
    folder : str or Path
        Folder in which the text will be stored. If the scene names files relative to its own folder and that is a
        different one, the text gets a search path to it.
    note : str
        Comment before the coatings.

    Raises
    ------
    MistrayError
        If the file cannot be read, a shape is missing or given twice, or has no ``interface`` or ``thinfilm``.
    """
    file = SceneFile(Path(source))
    refits: dict[str, Refit] = {}
    names = _names(file, coatings)
    for coating, name in zip(coatings, names, strict=True):
        for surface in coating.surfaces:
            if surface in refits:
                raise MistrayError(f"shape '{surface}' gets two coatings; put it into one group")
            refits[surface] = Refit((f"<ref id={quoteattr(name)}/>",))
    lines = [
        line for coating, name in zip(coatings, names, strict=True) for line in shared_lines(coating.as_shared(name))
    ]
    return refitted(file, refits, lines, Path(folder), note)


def write_recoated(source: str | Path, coatings: Sequence[SharedCoating], target: str | Path, note: str = "") -> Path:
    """
    Write the text that `recoated` returns to a file, atomically: on an error an old file stays.

    Raise `MistrayError` as `recoated` does, or if the file cannot be written.

    Returns
    -------
    Path
        Written scene file.
    """
    target = Path(target)
    return replace_file(target, recoated(source, coatings, target.parent, note), "scene file")


def _interface(file: SceneFile, surface: str) -> tuple[Element, Element]:
    """
    Return the BSDF child of a shape, and the ``interface`` or ``thinfilm`` that the child is or refers to.

    Raise `MistrayError` if the file has no such shape, or the shape has no such BSDF.
    """
    shape = file.ids.get(surface)
    if shape is None or shape.tag != "shape":
        raise MistrayError(
            f"scene '{file.path}': it has no shape '{surface}'; coatings can be put on shapes that stand in the "
            "file with their id, not on included ones"
        )
    found = file.surface(shape)
    if found is None:
        raise MistrayError(f"scene '{file.path}', shape '{surface}': it has no BSDF; nest an 'interface' in it")
    if found[1].values.get("type") not in COATED:
        raise MistrayError(
            f"scene '{file.path}', shape '{surface}': its BSDF is '{found[1].values.get('type')}'; "
            "a coating needs an 'interface'"
        )
    return found


def _removals(file: SceneFile, coatings: Sequence[Element]) -> Iterator[Edit]:
    """
    Yield the edits that remove shared coatings, which nothing uses any more, from the text of a scene.

    If `recoated` wrote a coating, its comment and the empty line are removed, too.
    """
    end_of_ours = -1
    for coating in coatings:
        start, end = file.with_blanks(coating)
        head = file.head(coating)
        noted = file.data[head : coating.start].startswith(f"<!-- {NOTE}".encode())
        if noted:
            start = len(file.data[:head].rstrip())
        if noted or start == end_of_ours:
            end_of_ours = coating.end
            empty = re.compile(rb"\n[ \t]*(?=\n)").match(file.data, end)
            end = empty.end() if empty else end
        yield start, end, b""


def _refit(file: SceneFile, interface: Element, refit: Refit) -> Edit:
    """Return the text edit that changes the interface of one shape as `refit` says; a ``thinfilm`` becomes one."""
    text = file.text(interface)
    tag = re.sub(
        rb"(\stype\s*=\s*[\"'])thinfilm([\"'])", rb"\1interface\2", text[: interface.inside - interface.start], count=1
    )
    if interface.end == interface.inside:  # <bsdf …/>
        tag = tag[:-2].rstrip() + b">"
    body = b""
    position = interface.inside
    for child in interface.children:
        if refit.drops(file, child):
            start, end = file.with_blanks(child)
            body += file.data[position:start]
            position = end
    body += file.data[position : interface.close]
    pad = file.indent(interface)
    inner = f"\n{pad}{INDENT}" if pad or b"\n" in text else ""
    added = "".join(f"{inner}{line}" for line in refit.lines) + (f"\n{pad}" if inner else "")
    return interface.start, interface.end, tag + body.rstrip() + added.encode() + b"</bsdf>"


def _is_coating(file: SceneFile, child: Element) -> bool:
    """True if a child of an interface defines its coating."""
    child = file.meant(child) or child
    if child.tag == "bsdf":
        return child.values.get("type") == "thinfilm"
    return child.values.get("name") in COATING_VALUES


def _names(file: SceneFile, coatings: Sequence[SharedCoating]) -> list[str]:
    """Return one new id for each coating, not used in the scene except by shared coatings that will be removed."""
    recoated_shapes = {surface for coating in coatings for surface in coating.surfaces}
    taken = set(with_includes(file.path).ids) - {element.values["id"] for element in _forsaken(file, recoated_shapes)}
    names = []
    for coating in coatings:
        name, number = coating.id, 2
        while name in taken:
            name, number = f"{coating.id}_{number}", number + 1
        taken.add(name)
        names.append(name)
    return names


def _forsaken(file: SceneFile, surfaces: set[str]) -> list[Element]:
    """Return the shared coatings to which only the given surfaces refer, so that they can be removed."""
    found = []
    for child in file.root.children:
        if child.tag != "bsdf" or child.values.get("type") != "thinfilm" or "id" not in child.values:
            continue
        users = [e for e in file.root.walk() if e.tag == "ref" and e.values.get("id") == child.values["id"]]
        if users and all(_shape_of(user) in surfaces for user in users):
            found.append(child)
    return found


def _shape_of(element: Element | None) -> str | None:
    """Return the id of the shape that an element belongs to; None if there is none."""
    while element is not None and element.tag != "shape":
        element = element.parent
    return None if element is None else element.values.get("id")

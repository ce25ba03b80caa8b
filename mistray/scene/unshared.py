"""Scene files rewritten so that each surface has scatter models of its own, which can be changed one by one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from mistray.errors import MistrayError
from mistray.scatter.kinds import KINDS
from mistray.scene.xml_file import Element, SceneFile


class SceneText:
    """
    A scene file with a copy of every shared scatter model at each surface that refers to it.

    The copies have no id, so that `mi.traverse` names their values by surface and kind, as in
    ``L1_front.bsdf.particulate.level``. Models that nothing refers to any more are removed; coatings stay shared.
    Surfaces of included files stay as they are.

    Parameters
    ----------
    source : str or Path
        Scene XML file.
    own : bool
        Whether to make the copies; otherwise the scene stays as it is.

    Raises
    ------
    MistrayError
        If the file cannot be read or is not XML.
    """

    def __init__(self, source: str | Path, own: bool = True) -> None:
        self.file = SceneFile(Path(source))
        self._values: list[tuple[Element, str, str]] = []
        if own:
            for within in ("shape", "bsdf"):  # first surfaces, then models of a surface
                self.file = self.file.with_copies(_references(self.file, within))
            gone = [self.file.with_blanks(element) for element in _unused(self.file)]
            self.file = self.file.changed([(*place, b"") for place in gone])

    def set(self, key: str, value: float) -> None:
        """
        Set a value of a scatter model.

        Parameters
        ----------
        key : str
            Key of the value as in `mi.traverse`: ``L1_front.bsdf.particulate.level``, ``wall.bsdf.reflectance`` for a
            model that is the surface itself, or ``polish.rms_nm`` for a model with an id.
        value : float
            New number, in the unit of the parameter.

        Raises
        ------
        MistrayError
            If the model does not stand in the file.
        """
        place, _, name = key.rpartition(".")
        model = self.file.named(place)
        if model is None:
            raise MistrayError(
                f"scene '{self.file.path}': the model of '{key}' does not stand in the file; it may be in an included "
                "one"
            )
        self._values.append((model, name, f'<float name="{name}" value="{float(value)!r}"/>'))

    def text(self, folder: str | Path) -> str:
        """Return the changed scene as XML text, to be stored in `folder`; see `SceneFile.edited`."""
        return self.file.edited(self.file.with_values(self._values), Path(folder))


def _shared(file: SceneFile) -> Mapping[str, Element]:
    """Return the top-level scatter models of a file, and interfaces that have one, by id."""
    return {
        element.values["id"]: element
        for element in file.root.children
        if element.tag == "bsdf" and "id" in element.values and _scatters(file, element)
    }


def _scatters(file: SceneFile, element: Element) -> bool:
    """True if a BSDF is a scatter model, or an interface that has one."""
    found = (element, *(file.meant(child) for child in element.children))
    return any(one is not None and one.values.get("type") in KINDS for one in found)


def _references(file: SceneFile, within: str) -> Iterator[Element]:
    """
    Yield references to the objects of `_shared` that stand directly in a shape, or in a BSDF of a shape.

    `within` is the tag of that element, "shape" or "bsdf".
    """
    shared = _shared(file)
    for element in file.root.walk():
        if element.tag == "ref" and element.values.get("id") in shared and element.parent is not None:
            parent = element.parent
            if parent.tag == within and "shape" in (parent.tag, parent.parent.tag if parent.parent else ""):
                yield element


def _unused(file: SceneFile) -> list[Element]:
    """Return shared scatter models and interfaces of a scene file to which nothing refers any more."""
    gone: list[Element] = []
    shared = _shared(file)
    for name, element in sorted(shared.items(), key=lambda item: item[1].values.get("type") in KINDS):
        inside = {id(one) for other in gone for one in other.walk()}
        users = (one for one in file.root.walk() if one.tag == "ref" and one.values.get("id") == name)
        if all(id(user) in inside for user in users):
            gone.append(element)
    return gone

"""Scene files in which every surface has its own scatter models, so that each can be made rougher or cleaner."""

from __future__ import annotations

import copy
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path

from mistray.errors import MistrayError
from mistray.read_file import read_file
from mistray.scatter.kinds import KINDS
from mistray.scene.depth import check_source
from mistray.scene.xml_file import names_a_file

# What else says a value in a file; a new value takes its place
SYNONYMS = {"reflectance": ("preset",)}
HEAD = re.compile(rb"\s*(?:<\?xml.*?\?>\s*)?((?:<!--.*?-->\s*)*)", re.DOTALL)  # comments before the first element


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
        If the file cannot be read or is no XML.
    """

    def __init__(self, source: str | Path, own: bool = True) -> None:
        self.path = Path(source)
        builder = ElementTree.TreeBuilder(insert_comments=True)
        check_source(self.path)
        data = read_file(source, "scene")
        try:
            self._root = ElementTree.fromstring(data, ElementTree.XMLParser(target=builder))
        except ElementTree.ParseError as error:
            raise MistrayError(f"scene '{source}': broken XML, {error}; correct it") from None
        head = HEAD.match(data)
        self._head = head[1].decode() if head else ""
        self._shapes = {shape.get("id", ""): shape for shape in self._root.iter("shape")}
        if own:
            self._give_copies()

    def _give_copies(self) -> None:
        shared = {node.get("id", ""): node for node in self._root.findall("bsdf") if "id" in node.attrib}
        for shape in self._shapes.values():
            _replace(shape, {name: node for name, node in shared.items() if _scatters(node, shared)})
            for surface in shape.findall("bsdf"):
                _replace(surface, {name: node for name, node in shared.items() if node.get("type") in KINDS})
        interfaces = [name for name, node in shared.items() if node.get("type") not in KINDS]
        for name in [*interfaces, *(name for name in shared if name not in interfaces)]:  # these refer to the others
            used = any(node.get("id") == name for node in self._root.iter("ref"))
            if not used and _scatters(shared[name], shared):
                self._root.remove(shared[name])

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
        head, _, name = key.rpartition(".")
        node = self._model(head)
        if node is None:
            raise MistrayError(
                f"scene '{self.path}': the model of '{key}' does not stand in the file; it may be in an included one"
            )
        for item in list(node):
            if item.get("name") in (name, *SYNONYMS.get(name, ())):
                node.remove(item)
        ElementTree.SubElement(node, "float", {"name": name, "value": repr(float(value))})

    def _model(self, head: str) -> ElementTree.Element | None:
        """Return the scatter model or BSDF whose keys in `mi.traverse` begin with `head`."""
        for node in self._root.iter("bsdf"):
            if node.get("id") == head:
                return node
        surface, _, inner = head.partition(".bsdf")
        shape = self._shapes.get(surface)
        bsdf = None if shape is None else shape.find("bsdf")
        if bsdf is None or not inner:
            return bsdf
        models: dict[str, ElementTree.Element] = {}
        for node in bsdf.findall("bsdf"):  # named as `interface` names them
            kind = node.get("type", "")
            count = sum(other.get("type") == kind for other in models.values())
            models[f"{kind}_{count + 1}" if count else kind] = node
        return models.get(inner.removeprefix("."))

    def text(self, folder: str | Path) -> str:
        """
        Return the scene as XML text.

        Parameters
        ----------
        folder : str or Path
            Folder in which the text will be stored. If the scene names files relative to its own folder and that is a
            different one, the text gets a search path to it.
        """
        root = copy.deepcopy(self._root)
        home = self.path.resolve().parent
        if home != Path(folder).resolve() and _names_files(root, home):
            way = os.path.relpath(home, Path(folder).resolve())
            root.insert(0, ElementTree.Element("path", {"value": way}))
        ElementTree.indent(root, "    ")
        whole = ElementTree.tostring(root, encoding="unicode")
        return f"<?xml version='1.0' encoding='utf-8'?>\n{self._head}{whole}\n"


def _scatters(node: ElementTree.Element, shared: Mapping[str, ElementTree.Element]) -> bool:
    """Whether a shared BSDF is a scatter model, or an interface that has one."""
    if node.get("type") in KINDS:
        return True
    referred = (shared.get(ref.get("id", "")) for ref in node.findall("ref"))
    return any(item is not None and item.get("type") in KINDS for item in (*node.findall("bsdf"), *referred))


def _replace(parent: ElementTree.Element, shared: Mapping[str, ElementTree.Element]) -> None:
    """Replace references to shared objects by copies of them."""
    for place, child in enumerate(list(parent)):
        if child.tag == "ref" and child.get("id") in shared:
            own = copy.deepcopy(shared[child.get("id", "")])
            del own.attrib["id"]
            own.tail = child.tail
            parent[place] = own


def _names_files(root: ElementTree.Element, folder: Path) -> bool:
    """Whether a value of the scene is, or contains, the name of a file relative to a folder."""
    return any(names_a_file(node.get(key, ""), folder) for node in root.iter() for key in ("value", "filename"))

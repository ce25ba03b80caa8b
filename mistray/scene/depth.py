"""
What Mitsuba's reader of scene files does not survive, looked for before it.

Elements that lie within each other some thousand levels deep end the process, and an included pipe would be waited for.
"""

from __future__ import annotations

import os
from pathlib import Path
from xml.parsers import expat

from mistray.errors import MistrayError
from mistray.read_file import read_file, require_file
from mistray.scene.files import filled
from mistray.scene.xml_file import DEEPEST, too_deep

FILE = "filename"  # by which elements, and all of Mitsuba's plugins, name a file


def check_depth(path: Path) -> None:
    """
    Refuse a scene file that would end or hold the process.

    Parameters
    ----------
    path : Path
        What is wrong with it otherwise is left to its reader; included files are looked at by themselves.

    Raises
    ------
    MistrayError
        An element lies deeper than `DEEPEST` levels, or an attribute ``filename`` names a pipe or a device.
    """
    _Look(path).run()


class _Look:
    def __init__(self, path: Path) -> None:
        self.waiting, self.looked_at = [path], set[Path]()
        self.folders = [path.parent, Path()]
        self.defaults: dict[str, str] = {}

    def run(self) -> None:
        while self.waiting:
            file = self.waiting.pop()
            if file.resolve() not in self.looked_at:
                self.looked_at.add(file.resolve())
                self.folders.append(file.parent)
                self._look(file)

    def _look(self, path: Path) -> None:
        depth = 0
        parser = expat.ParserCreate()

        def start(tag: str, attributes: dict[str, str]) -> None:
            nonlocal depth
            depth += 1
            if depth > DEEPEST:
                raise too_deep(path, parser.CurrentLineNumber, tag)
            where = f"scene '{path}', line {parser.CurrentLineNumber}: <{tag}>"
            value, name = (filled(attributes.get(key, ""), self.defaults) for key in ("value", FILE))
            if tag == "default":
                self.defaults.setdefault(attributes.get("name", ""), value)
            elif tag == "path":
                self.folders += [folder / value for folder in self.folders]
            for folder in self.folders if name else ():
                self._check(folder / name, where, tag)

        def end(tag: str) -> None:
            nonlocal depth
            depth -= 1

        parser.StartElementHandler, parser.EndElementHandler = start, end
        try:
            parser.Parse(read_file(path, "scene"), True)
        except MistrayError:
            raise
        except (ValueError, LookupError, expat.ExpatError):  # Mitsuba will say what is wrong
            return

    def _check(self, file: Path, where: str, tag: str) -> None:
        if os.path.exists(file) and not os.path.isdir(file):
            require_file(file, f"{where} file")
            if tag == "include":
                self.waiting.append(file)

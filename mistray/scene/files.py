"""Finding all files that a scene depends on: its own, included ones, and files named in its values."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from mistray.errors import errors_of
from mistray.scene.xml_file import SceneFile, filled

LONGEST_NAME = 6  # words of a file name with blanks, within a longer text such as a list of layers


def scene_files(path: Path, text: bytes | None = None) -> list[Path]:
    """
    Return the files whose content a scene depends on.

    A value counts as the name of a file where a file of that name exists: better one too many than one too few.

    Parameters
    ----------
    path : Path
        Scene XML file.
    text : bytes, optional
        Content to use instead of that of the file.

    Returns
    -------
    list of Path
        The scene file first, then the scenes that it includes, then all others, each once; absolute.

    Raises
    ------
    MistrayError
        If the scene, or a scene that it includes, cannot be read or is not XML in UTF-8.
    """
    first = path.resolve()
    scenes = {first: None}
    folders = {first.parent: None, Path.cwd(): None}
    defaults: dict[str, str] = {}  # as in Mitsuba: of all scenes together, the first of a name holds
    texts: list[str] = []

    def read(scene: Path) -> None:
        for element in SceneFile(scene, text if scene == first else None).root.walk():
            with errors_of(f"scene '{scene}'"):
                value, name = (filled(element.values.get(key, ""), defaults) for key in ("value", "filename"))
            texts.extend((value, name))
            if element.tag == "default":
                defaults.setdefault(element.values.get("name", ""), value)
            elif element.tag == "path":
                folders.update({(folder / value).resolve(): None for folder in list(folders)})
            elif element.tag == "include":
                for found in named_files(name, folders):
                    if found not in scenes:
                        scenes[found] = folders[found.parent] = None
                        read(found)

    read(first)
    return list(scenes | {file: None for text in texts for file in named_files(text, folders)})


def named_files(text: str, folders: Iterable[Path]) -> Iterator[Path]:
    """Yield existing files that a string may name, whole or by some of its words, relative to any of the folders."""
    for name in _names(text):
        for folder in tuple(folders):
            # os.path.isfile, because that of Path raises for a text that is too long for a name
            if os.path.isfile(folder / name):
                yield (folder / name).resolve()


def _names(text: str) -> Iterator[str]:
    """Yield possible file names in a string: the whole text, and runs of words, also without ``:entry`` or ``key=``."""
    found = {text}
    for part in re.split(r"[,;\n]", text):
        words = part.split()
        for length in range(1, min(LONGEST_NAME, len(words)) + 1):
            for start in range(len(words) - length + 1):
                whole = " ".join(words[start : start + length])
                found |= {whole, whole.rpartition(":")[0], whole.partition("=")[2]}
    yield from sorted(found - {"", "."})

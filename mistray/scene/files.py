"""Finding all files that a scene depends on: its own, included ones, and files named in its values."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from mistray.errors import errors_of
from mistray.scene.xml_file import SceneFile, filled, possible_names


def scene_files(path: Path, text: bytes | None = None) -> list[Path]:
    """Return the files whose content a scene depends on; raise as `files_and_homes` does, which finds them."""
    return list(files_and_homes(path, text))


def files_and_homes(path: Path, text: bytes | None = None) -> dict[Path, set[Path]]:
    """
    Return the files whose content a scene depends on, and the folders that its names for them are relative to.

    A value counts as the name of a file where a file of that name exists: better one too many than one too few.

    Parameters
    ----------
    path : Path
        Scene XML file.
    text : bytes, optional
        Content to use instead of that of the file.

    Returns
    -------
    dict of Path to set of Path
        File → folders: that of the scene, the current folder, or both. The scene file comes first, then the scenes that
        it includes, then all others. All paths are absolute.

    Raises
    ------
    MistrayError
        If the scene, or a scene that it includes, cannot be read or is not XML in UTF-8.
    """
    first = path.resolve()
    files = {first: {first.parent}}
    folders = {first.parent: first.parent, Path.cwd(): Path.cwd()}  # the folders searched → where they are named from
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
                for folder, home in list(folders.items()):
                    folders.setdefault((folder / value).resolve(), home)
            elif element.tag == "include":
                for found, home in named_files(name, folders):
                    if found not in files:
                        files[found] = {home}
                        folders.setdefault(found.parent, home)
                        read(found)

    read(first)
    for value in texts:
        for file, home in named_files(value, folders):
            files.setdefault(file, set()).add(home)
    return files


def named_files(text: str, folders: Mapping[Path, Path]) -> Iterator[tuple[Path, Path]]:
    """
    Yield existing files that a string may name, whole or by some of its words, relative to any of the folders.

    With each file comes the value of its folder in the mapping.
    """
    for name in possible_names(text):
        for folder, home in tuple(folders.items()):
            # os.path.isfile, because that of Path raises for a text that is too long for a name
            if os.path.isfile(folder / name):
                yield (folder / name).resolve(), home

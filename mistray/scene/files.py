"""Finding all files that a scene depends on: its own, included ones, and files named in its values; joining scenes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from mistray.errors import MistrayError, errors_of
from mistray.scene.depth import check_source
from mistray.scene.xml_file import SceneFile, behind_path, filled, possible_names


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


def with_includes(path: Path) -> SceneFile:
    """
    Return a scene file in which the scenes that it includes stand in place of their ``<include>``.

    Raise `MistrayError` if one is missing, or `check_source` refuses the files.
    """
    file = SceneFile(path)
    if not any(element.tag == "include" for element in file.root.walk()):
        return file
    check_source(path)  # or the files might have no end
    return _whole(path, [])


def _whole(path: Path, folders: list[Path]) -> SceneFile:
    """
    Return a scene file in which the scenes that it includes stand in place of their ``<include>``.

    They are searched beside the file that includes them, then in its ``<path>``, the last one first, and in `folders`,
    as in Mitsuba. Raise `MistrayError` if one is missing.
    """
    file = SceneFile(path)
    folders = [path.parent, *folders]
    edits = []
    for element in file.root.walk():
        if element.tag == "path":
            folders = behind_path(folders, filled(element.values.get("value", ""), file.defaults))
        if element.tag != "include":
            continue
        name = filled(element.values.get("filename", ""), file.defaults)
        found = next((folder / name for folder in (*folders, Path()) if (folder / name).is_file()), None)
        if found is None:
            raise MistrayError(f"scene '{path}': there is no file '{name}' for its <include>; correct the name")
        inner = _whole(found, folders)
        edits.append((element.start, element.end, inner.data[inner.root.inside : inner.root.close]))
    return file.changed(edits)

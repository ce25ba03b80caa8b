"""Where a scene came from, so that another process can load the same one: its text and the files that it names."""

from __future__ import annotations

import hashlib
import os.path
import shutil
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mitsuba as mi

from mistray.cache.fingerprint import file_fingerprint
from mistray.errors import MistrayError
from mistray.read_file import read_file, require_file
from mistray.scene.files import scene_files

OURS = "mistray.plugins."
ATTRIBUTE = "mistray_source"  # of a plugin of the scene: a scene itself, of C++, takes no attribute
SCENE_NAME = "scene-that-travels.xml"


@dataclass(frozen=True)
class PackedScene:
    """
    A scene from a file, as another machine can have it.

    Attributes
    ----------
    name : str
        Path of the file, for messages.
    files : dict of str to bytes
        The file, under `scene`, and the files that it names relative to its folder, by their paths in a folder of their
        own.
    scene : str
    checked : dict of str to str
        Absolute paths that the scene names, which do not travel, and the hashes of their contents.
    sources : tuple
        Its light, where that is not what the file says, see `mistray.scene.load`.
    sensors : tuple
        Those that the file does not have.
    """

    name: str
    files: Mapping[str, bytes]
    scene: str
    checked: Mapping[str, str] = field(default_factory=dict)
    sources: tuple[Any, ...] = ()
    sensors: tuple[Any, ...] = ()

    def load(self) -> mi.Scene:
        """
        Load the scene from its contents.

        Raises
        ------
        MistrayError
            If a file that does not travel is not here or is another one, or the scene cannot be read.
        """
        from mistray.scene.load import load

        folder = _Folder()
        scene = load(self.unpack(folder.path), self.sources, self.sensors)
        for owner in _owners(scene):  # some files are read later, and the folder goes with the scene
            setattr(owner, f"{ATTRIBUTE}_folder", folder)
            break
        return scene

    def unpack(self, folder: Path) -> Path:
        """Write the files into a folder; returns that of the scene, and raises as `load` does."""
        for path, digest in self.checked.items():
            found = file_fingerprint(Path(path)) if os.path.isfile(path) else None
            if found != digest:
                what = "is not there" if found is None else "is another file there"
                raise MistrayError(
                    f"scene '{self.name}': '{path}' {what}; name it relative to the scene's folder, so that it travels"
                )
        for path, content in self.files.items():
            file = folder / path
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
        return folder / self.scene


@dataclass(frozen=True)
class SceneDict:
    """A scene that is a dict, and its light and further sensors, where that is not what the dict says."""

    given: Mapping[str, Any]
    sources: tuple[Any, ...] = ()
    sensors: tuple[Any, ...] = ()

    def load(self) -> mi.Scene:
        """Load the scene; raises as `mistray.scene.load` does."""
        from mistray.scene.load import load

        return load(dict(self.given), self.sources, self.sensors)


class _Folder:
    """A temporary folder that is removed with this object, or with the process."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="mistray-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


@dataclass(frozen=True)
class _Origin:
    """Arguments of `load`: a file, absolute, with its text at that time, or a dict; further sources and sensors."""

    path: Path | None
    text: bytes
    given: Mapping[str, Any]
    sources: tuple[Any, ...] = ()
    sensors: tuple[Any, ...] = ()


def remember(
    scene: mi.Scene,
    given: Path | Mapping[str, Any],
    sources: Iterable[Any] = (),
    sensors: Iterable[Any] = (),
    text: str | None = None,
) -> None:
    """
    Keep what a scene was loaded from, and with which other sources and sensors, with one of its plugins.

    `text` is what stood for the content of the file, where that was another one.
    """
    for owner in _owners(scene):
        if isinstance(given, Path):
            content = read_file(given, "scene") if text is None else text.encode()
            origin = _Origin(given.resolve(), content, {}, tuple(sources), tuple(sensors))
        else:
            origin = _Origin(None, b"", given, tuple(sources), tuple(sensors))
        setattr(owner, ATTRIBUTE, origin)
        return


def source_of(scene: mi.Scene) -> PackedScene | SceneDict:
    """
    Return the source of a scene, for another process: a file with its contents, or a dict.

    Raises
    ------
    MistrayError
        If it was not loaded by `mistray.load`, or its files are gone.
    """
    for owner in _owners(scene):
        origin = getattr(owner, ATTRIBUTE, None)
        if isinstance(origin, _Origin):
            if origin.path is None:
                return SceneDict(dict(origin.given), origin.sources, origin.sensors)
            return replace(_packed(origin.path, origin.text), sources=origin.sources, sensors=origin.sensors)
    raise MistrayError("the scene's source is not known, so that it cannot travel; load it with mistray.load(path)")


def _owners(scene: mi.Scene) -> Iterator[Any]:
    """Plugins of mistray in a scene, which are objects of Python."""
    for item in (*scene.emitters(), scene.integrator(), *scene.shapes()):
        for plugin in (item, item.bsdf()) if isinstance(item, mi.Shape) else (item,):
            if type(plugin).__module__.startswith(OURS):
                yield plugin


def _packed(path: Path, text: bytes) -> PackedScene:
    """A scene file with all that it names."""
    require_file(path, "scene")
    first, *others = scene_files(path, text)
    contents = {file: read_file(file) for file in others}
    texts = [text, *(content for file, content in contents.items() if file.suffix == ".xml")]
    absolute = {file for file in others if any(str(file).encode() in content for content in texts)}
    ways = {file: Path(os.path.relpath(file, first.parent)) for file in others if file not in absolute}
    # A folder that lies as deep as the files lie upwards
    inside = Path(*("in",) * max((way.parts.count("..") for way in ways.values()), default=0))
    files = {os.path.normpath(inside / way): contents[file] for file, way in ways.items()}
    scene = os.path.normpath(inside / SCENE_NAME)
    checked = {str(file): hashlib.sha256(contents[file]).hexdigest() for file in absolute}
    return PackedScene(str(path), {**files, scene: text}, scene, checked)

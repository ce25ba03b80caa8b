"""Description of where a scene came from, from which another process can load it: its text and files named there."""

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
from mistray.scene.files import files_and_homes

OURS = "mistray.plugins."
ATTRIBUTE = "mistray_source"  # of a plugin of the scene: a scene itself, of C++, takes no attribute
SCENE_NAME = "scene-that-travels.xml"


@dataclass(frozen=True)
class PackedScene:
    """
    Scene file with its content and the files it names, for loading on another machine.

    Attributes
    ----------
    name : str
        Path of the file, for messages.
    files : dict of str to bytes
        Contents of the scene file, keyed by `scene`, and of files named relative to its folder, keyed by their path in
        the unpacked folder.
    scene : str
        Key of the scene file in `files`.
    checked : dict of str to str
        SHA-256 hashes of files that the scene names by an absolute path, keyed by path. They do not travel.
    sources : tuple
        Sources that replace those of the file, see `mistray.scene.load`; empty if none do.
    sensors : tuple
        Sensors that are added to those of the file.
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
            If a file of `checked` is missing here or has other contents, or the scene cannot be read.
        """
        from mistray.scene.load import load

        folder = _Folder()
        scene = load(self.unpack(folder.path), self.sources, self.sensors)
        for owner in _owners(scene):  # some files are read later, and the folder goes with the scene
            setattr(owner, f"{ATTRIBUTE}_folder", folder)
            break
        return scene

    def unpack(self, folder: Path) -> Path:
        """
        Write the files into a folder and return the path of the scene file.

        Raise `MistrayError` if a file of `checked` is missing here or has other contents, or a path leads outside.
        """
        for path, digest in self.checked.items():
            found = file_fingerprint(Path(path)) if os.path.isfile(path) else None
            if found != digest:
                what = "is not there" if found is None else "is another file there"
                raise MistrayError(
                    f"scene '{self.name}': '{path}' {what}; name it relative to the scene's folder, so that it travels"
                )
        for path, content in self.files.items():
            file = folder / path
            if not file.resolve().is_relative_to(folder.resolve()):
                raise MistrayError(f"scene '{self.name}': '{path}' lies outside its folder; save the result again")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
        return folder / self.scene


@dataclass(frozen=True)
class SceneDict:
    """Scene given as a dict, with sources that replace its own, if there are any, and sensors that are added."""

    given: Mapping[str, Any]
    sources: tuple[Any, ...] = ()
    sensors: tuple[Any, ...] = ()

    def load(self) -> mi.Scene:
        """Load the scene; raise as `mistray.scene.load` does."""
        from mistray.scene.load import load

        return load(dict(self.given), self.sources, self.sensors)


class _Folder:
    """
    Temporary folder that is deleted together with this object, or at the end of the process.

    Attributes
    ----------
    path : Path
        The folder.
    """

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="mistray-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


@dataclass(frozen=True)
class _Origin:
    """
    Arguments with which a scene was loaded.

    Attributes
    ----------
    path : Path or None
        Absolute path of its file; None: it was loaded from a dict.
    text : bytes
        Content of the file; empty for a dict.
    given : mapping
        Scene dict; empty for a file.
    sources : tuple
        Sources that replaced those of the scene; empty if none did.
    sensors : tuple
        Sensors that were added to those of the scene.
    """

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
    Attach the arguments with which a scene was loaded to one of its plugins.

    `text` is the text that replaced the content of the file, if any. In a scene without a plugin of mistray nothing is
    kept. A file that cannot be read raises `MistrayError`.
    """
    others = tuple(map(_copy, sources)), tuple(map(_copy, sensors))
    for owner in _owners(scene):
        if isinstance(given, Path):
            content = read_file(given, "scene") if text is None else text.encode()
            origin = _Origin(given.resolve(), content, {}, *others)
        else:
            origin = _Origin(None, b"", _copy(given), *others)
        setattr(owner, ATTRIBUTE, origin)
        return


def _copy(value: Any) -> Any:
    """Return a copy of a dict and of all dicts within it, which its owner may change; other values as they are."""
    return {key: _copy(item) for key, item in value.items()} if isinstance(value, Mapping) else value


def file_of(scene: mi.Scene) -> Path | None:
    """Return the absolute path of the file that a scene was loaded from; None if it was a dict, or is not known."""
    origin = _origin_of(scene)
    return None if origin is None else origin.path


def source_of(scene: mi.Scene) -> PackedScene | SceneDict:
    """
    Return the source of a scene, for another process: a file with its contents, or a dict.

    Raises
    ------
    MistrayError
        If the scene was not loaded by `mistray.load`, has no plugin of mistray, or its files are gone.
    """
    origin = _origin_of(scene)
    if origin is not None:
        if origin.path is None:
            return SceneDict(dict(origin.given), origin.sources, origin.sensors)
        return replace(_packed(origin.path, origin.text), sources=origin.sources, sensors=origin.sensors)
    raise MistrayError("the scene's source is not known, so that it cannot travel; load it with mistray.load(path)")


def _origin_of(scene: mi.Scene) -> _Origin | None:
    """Return the arguments that a scene was loaded with; None if they are not known."""
    origins = (getattr(owner, ATTRIBUTE, None) for owner in _owners(scene))
    return next((one for one in origins if isinstance(one, _Origin)), None)


def _owners(scene: mi.Scene) -> Iterator[Any]:
    """Yield the emitters, integrator, shapes and BSDFs of a scene that are plugins of mistray."""
    for item in (*scene.emitters(), scene.integrator(), *scene.shapes()):
        for plugin in (item, item.bsdf()) if isinstance(item, mi.Shape) else (item,):
            if type(plugin).__module__.startswith(OURS):
                yield plugin


def _packed(path: Path, text: bytes) -> PackedScene:
    """
    Return a scene file, with `text` as its content, packed together with all files that it names.

    Files named by an absolute path are not packed, only their hashes. Raise `MistrayError` if one cannot be read.
    """
    require_file(path, "scene")
    named = files_and_homes(path, text)
    first, *others = named
    contents = {file: read_file(file) for file in others}
    texts = [text, *(content for file, content in contents.items() if file.suffix == ".xml")]
    absolute = {file for file in others if any(str(file).encode() in content for content in texts)}
    # Files found in the current folder are packed beside the scene, whose own of the same name come first
    ways = {
        Path(os.path.relpath(file, home)): file
        for beside in (False, True)
        for file in others
        for home in named[file]
        if file not in absolute and (home == first.parent) == beside
    }
    # A folder that lies as deep as the files lie upwards
    inside = Path(*("in",) * max((way.parts.count("..") for way in ways), default=0))
    files = {os.path.normpath(inside / way): contents[file] for way, file in ways.items()}
    scene = os.path.normpath(inside / SCENE_NAME)
    checked = {str(file): hashlib.sha256(contents[file]).hexdigest() for file in absolute}
    return PackedScene(str(path), {**files, scene: text}, scene, checked)

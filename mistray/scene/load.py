"""Scenes from files, dicts and names of shipped scenes."""

from __future__ import annotations

import difflib
import os
import os.path
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mitsuba as mi

from mistray._mitsuba_compat import own_folder_first
from mistray._variant import ensure_variant
from mistray.errors import MistrayError, MistrayWarning
from mistray.ids import check_id
from mistray.materials.mate import shown
from mistray.scene.allowed_plugins import RESOURCES, check_dict, check_file
from mistray.scene.check import check_overlaps
from mistray.scene.depth import check_depth
from mistray.scene.improbable import improbable
from mistray.scene.messages import explain, is_interrupt
from mistray.scene.source import remember

LONGEST_NAME = 400  # characters of a path that a message repeats
NAMES_OFFERED = 5  # shipped scenes that are nearest to one that does not exist


def load(source: str | Path | dict[str, Any]) -> mi.Scene:
    """
    Load an optical system as a Mitsuba scene.

    Parameters
    ----------
    source : str, Path or dict
        A scene XML file, the name of a shipped scene such as ``"phone_camera"``, or a Mitsuba scene dict.

    Returns
    -------
    mi.Scene

    Raises
    ------
    MistrayError
        If the file is missing or nested too deeply, Mitsuba cannot read it or surfaces overlap; the message is one
        line.

    Warns
    -----
    MistrayWarning
        For each scatter model with improbable numbers, see `mistray.scene.improbable`.
    """
    ensure_variant()
    given = source if isinstance(source, dict) else find(source)
    if isinstance(given, Path):
        check_depth(given)
        name = _utf8(given)
    try:
        scene = _from_dict(given) if isinstance(given, dict) else _from_file(name)
    except Exception as error:  # Mitsuba raises RuntimeError and TypeError with text of many lines
        if is_interrupt(error):
            raise KeyboardInterrupt from None
        raise MistrayError(explain(error, given)) from None
    if not isinstance(scene, mi.Scene):
        raise MistrayError(f'scene: the dict describes a {type(scene).__name__}; add "type": "scene" at its top')
    for shape in scene.shapes():
        check_id(shape.id(), "shape")
    check_overlaps(scene)
    for text in improbable(scene):
        warnings.warn(text, MistrayWarning, stacklevel=2)
    remember(scene, given)
    return scene


def _from_file(name: str) -> Any:
    """What a scene file describes; what it includes is looked for in its folder first."""
    with _search(os.path.dirname(name)):
        state = mi.parser.parse_file(_config(), name)
        check_file(state)
        return _built(state)


def _from_dict(given: dict[str, Any]) -> Any:
    """What a scene dict describes; Mitsuba looks for a plugin of each type while it reads it."""
    folders = {
        key: str(item.get("path", ""))
        for key, item in given.items()
        if isinstance(item, dict) and item.get("type") == RESOURCES
    }
    for key, folder in folders.items():
        if not os.path.isdir(folder):
            raise MistrayError(f"scene: '{key}': no folder '{folder}'; correct the path")
    with _search(*folders.values()):
        described = {key: item for key, item in given.items() if key not in folders}
        check_dict(described)
        return _built(mi.parser.parse_dict(_config(), described))


def _config() -> Any:
    """
    How Mitsuba reads a scene.

    Not optimised, because merged shapes lose their names. Not in parallel: a thread that waits for Dr.Jit while it
    makes one of our shapes would begin the next one inside of that wait, which has crashed the process.
    """
    config = mi.parser.ParserConfig(mi.variant())
    config.parallel = config.merge_equivalent = config.merge_meshes = False
    return config


@contextmanager
def _search(*folders: str) -> Iterator[None]:
    """Look for files in some folders too, for a while; the last comes first, but for that of Mitsuba."""
    usual = mi.file_resolver()
    mi.set_file_resolver(resolver := mi.FileResolver(usual))
    for folder in folders:
        resolver.prepend(folder)
    own_folder_first(resolver)
    try:
        yield
    finally:
        mi.set_file_resolver(usual)


def _built(state: Any) -> Any:
    """The objects of a scene that has been read and checked."""
    config = _config()
    mi.parser.transform_all(config, state)
    own_folder_first(mi.file_resolver())  # elements <path> came before
    return mi.parser.instantiate(config, state)


def _utf8(path: Path) -> str:
    """The name of a file as Mitsuba takes it, whatever the encoding of the locale is."""
    try:
        return os.fsencode(path).decode("utf-8")
    except UnicodeDecodeError:
        raise MistrayError(f"scene '{shown([str(path)])}': its name is no UTF-8; rename it, or its folder") from None


def shipped_scenes() -> dict[str, Path]:
    """The files of the scenes that come with mistray, by their names."""
    import mistray.scenes

    return {path.parent.name: path for path in sorted(Path(mistray.scenes.__file__).parent.glob("*/scene.xml"))}


def find(source: str | Path) -> Path:
    """
    File of a scene.

    Parameters
    ----------
    source : str or Path
        An existing file, a folder with a scene.xml, or the name of a shipped scene.

    Raises
    ------
    MistrayError
        If it is none of these.
    """
    path, text = Path(source), str(source)
    # os.path.exists, because that of Path raises for text that is too long for a name; its reader refuses a pipe
    if os.path.exists(path) and not os.path.isdir(path):
        return path
    shipped = shipped_scenes()
    if text in shipped:
        return shipped[text]
    if os.path.isfile(path / "scene.xml"):
        return path / "scene.xml"
    if text.lstrip("\ufeff \t\r\n").startswith("<"):
        raise MistrayError(f"scene '{shown(text.split())}': this is XML text; write it to a file and give its path")
    name = text if text.isprintable() and len(text) <= LONGEST_NAME else shown([text])
    nearest = ", ".join(difflib.get_close_matches(text, shipped, n=NAMES_OFFERED, cutoff=0.0))
    raise MistrayError(f"scene '{name}': no such file; give a scene XML file or a shipped scene, such as {nearest}")

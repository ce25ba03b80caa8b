"""Original scene of a sweep, a file or a loaded scene, from which the configurations are made."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any, ClassVar

import mitsuba as mi
import numpy as np

from mistray.analyses.sweep.configurations import Configuration, Resolved, resolve
from mistray.errors import MistrayError
from mistray.execute.scene_numbers import StoredScene, read_numbers
from mistray.metrics.scene_values import assign
from mistray.scene import coat, find, load
from mistray.scene.add_structures import add_structures
from mistray.scene.check import check_overlaps
from mistray.scene.source import PackedScene


class Original:
    """
    Scene before any edit, from which configurations are made.

    Parameters
    ----------
    given : str, Path or mi.Scene
        A scene file or its name, or a loaded scene, which is not changed.
    folder : Path
        Folder for files of edited scenes; it must exist as long as these are traced.
    """

    def __init__(self, given: str | Path | mi.Scene, folder: Path) -> None:
        self._folder = folder
        self._given = _Loaded(given) if isinstance(given, mi.Scene) else _File(find(given))

    def edited(self, one: Configuration) -> mi.Scene:
        """
        Return the scene with a configuration's edits: structures, coatings and paint in the file, values in the scene.

        Raises
        ------
        MistrayError
            If an edit is impossible or surfaces overlap.
        """
        scene = self._rebuilt(one) if one.rebuilds else self._given.copy()
        if one.values:
            move(scene, one)
        return scene

    def _rebuilt(self, one: Configuration) -> mi.Scene:
        file, parts = self._given.file(self._folder), self._given.parts
        if one.block:
            file = add_structures(file, one.block, Path(tempfile.mkdtemp(dir=self._folder)) / "scene.xml")
        return coat(file, one.coat, paint=one.paint, **parts) if one.coat or one.paint else load(file, **parts)


def move(scene: mi.Scene, one: Configuration) -> Resolved:
    """
    Set the values of a configuration in a loaded scene; return it with names resolved to parameter keys.

    Raises
    ------
    MistrayError
        If a value is impossible, or surfaces overlap then.
    """
    params = mi.traverse(scene)
    (resolved,) = resolve(scene, params, [Configuration(one.name, one.values)])
    assign(params, resolved.values)
    check_overlaps(scene)
    return resolved


class _File:
    """Original given as a scene file."""

    parts: ClassVar[dict[str, Any]] = {}

    def __init__(self, path: Path) -> None:
        self._path = path

    def copy(self) -> mi.Scene:
        """Return a fresh copy of the scene, loaded from its file."""
        return load(self._path)

    def file(self, _: Path) -> Path:
        """Return the path of the scene file; the argument, a folder, is not needed."""
        return self._path


class _Loaded:
    """Original given as a loaded scene, together with the source that it was loaded from."""

    def __init__(self, scene: mi.Scene) -> None:
        self._stored = StoredScene.of(scene)
        self.parts = {"sources": self._stored.source.sources, "sensors": self._stored.source.sensors}

    def copy(self) -> mi.Scene:
        """Return a copy of the scene with its present values."""
        return self._stored.load()

    def file(self, folder: Path) -> Path:
        """
        Return the scene's file, unpacked in a folder.

        Raise `MistrayError` if there is none or the scene differs from it.
        """
        source = self._stored.source
        if not isinstance(source, PackedScene):
            raise MistrayError(
                "a scene of a dict cannot be painted, coated or blocked; write it to an XML file and load that"
            )
        file = source.unpack(folder)
        for key, numbers in read_numbers(load(file, **self.parts)).items():
            if not np.array_equal(numbers, self._stored.numbers[key]):
                raise MistrayError(
                    f"'{key}' of the scene is not what its file says, which is what is painted, coated or blocked; "
                    "reload the scene, and set it in the values of the configuration"
                )
        return file

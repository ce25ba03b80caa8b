"""Tasks packed as bytes for another process; scenes are sent separately, as the text that they were loaded from."""

from __future__ import annotations

import hashlib
import io
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cloudpickle
import mitsuba as mi

from mistray._variant import plugins_of_others
from mistray.errors import MistrayError
from mistray.execute.scene_numbers import put_numbers, read_numbers
from mistray.scene.source import source_of
from mistray.trace.forward import versions

SCENES_KEPT, TASKS_KEPT = 4, 2  # by a worker


@dataclass(frozen=True)
class Parcel:
    """
    Task packed as bytes for another process.

    Attributes
    ----------
    task : bytes
        Pickled task without its scenes.
    scenes : dict of str to bytes
        Packed scenes of the task, keyed by the hash of their source and numbers.
    digest : str
        Hash of the task.
    """

    task: bytes
    scenes: Mapping[str, bytes]
    digest: str

    @classmethod
    def of(cls, task: Any) -> Parcel:
        """
        Return a task packed as bytes, with its scenes packed separately.

        Raises
        ------
        MistrayError
            If a scene has no source that can be sent, or another object cannot be pickled.
        """
        buffer = io.BytesIO()
        pickler = _Pickler(buffer)
        _dump(pickler, task)
        content = buffer.getvalue()
        return cls(content, pickler.scenes, hashlib.sha256(content).hexdigest())


def surroundings() -> dict[str, str]:
    """Return the facts that must agree in all processes, by name: package versions, variant, plugins of others."""
    return {**versions(), "variant": mi.variant(), "plugins": ",".join(sorted(plugins_of_others()))}


class _Pickler(cloudpickle.Pickler):
    """Pickler that replaces scenes by their hashes and collects them."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self.scenes: dict[str, bytes] = {}
        self._known: dict[int, str] = {}

    def persistent_id(self, item: Any) -> Any:
        """Return the hash of a scene, which is packed when it is first met; None for all other objects."""
        if not isinstance(item, mi.Scene):
            return None
        if id(item) not in self._known:
            packed = _packed(item)
            self._known[id(item)] = digest = hashlib.sha256(packed).hexdigest()
            self.scenes[digest] = packed
        return self._known[id(item)]


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, scenes: Mapping[str, mi.Scene]) -> None:
        super().__init__(file)
        self._scenes = scenes

    def persistent_load(self, digest: str) -> mi.Scene:
        """Return the scene of a hash made by `persistent_id`."""
        return self._scenes[digest]


def _packed(scene: mi.Scene) -> bytes:
    """
    Return the source of a scene and the current values of its parameters, packed as bytes.

    Raise `MistrayError` if the scene has no source that can be sent.
    """
    buffer = io.BytesIO()
    _dump(_Pickler(buffer), source_of(scene))
    return pickle.dumps((buffer.getvalue(), read_numbers(scene)))


def _dump(pickler: Any, item: Any) -> None:
    try:
        pickler.dump(item)
    except (TypeError, AttributeError, pickle.PicklingError) as error:
        raise MistrayError(
            f"{type(item).__name__} cannot travel to another process ({error}); give it plain values, and a scene of "
            "objects as an XML file"
        ) from None


class Unpacked:
    """Scenes and tasks that a worker has unpacked and keeps in memory."""

    def __init__(self) -> None:
        self._scenes: dict[str, mi.Scene] = {}  # by the hash of the source
        self._made: dict[str, tuple[Any, Any, tuple[str, ...]]] = {}

    def task(self, content: bytes, digest: str, scenes: Mapping[str, bytes]) -> tuple[Any, Any]:
        """
        Return a task from its packed form, see `Parcel`, and the object that it makes.

        Its scenes are loaded and get their values. If the task is still in memory, it is returned from there. Errors of
        loading the scenes are raised.
        """
        if digest in self._made:
            task, made, _ = self._made[digest]
            return task, made
        found, sources = {}, []
        for name, packed in scenes.items():
            source, numbers = pickle.loads(packed)
            sources.append(key := hashlib.sha256(source).hexdigest())
            found[name] = scene = self._scene(key, source)
            if put_numbers(scene, numbers):  # what was made of it is of another scene now
                self._made = {k: entry for k, entry in self._made.items() if key not in entry[2]}
        task = _Unpickler(io.BytesIO(content), found).load()
        made = task.make()
        while len(self._made) >= TASKS_KEPT:
            del self._made[next(iter(self._made))]
        self._made[digest] = task, made, tuple(sources)
        return task, made

    def _scene(self, key: str, source: bytes) -> mi.Scene:
        if key not in self._scenes:
            given = _Unpickler(io.BytesIO(source), {}).load()
            while len(self._scenes) >= SCENES_KEPT:
                del self._scenes[next(iter(self._scenes))]
            self._scenes[key] = given.load()
        return self._scenes[key]

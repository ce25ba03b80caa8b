"""Numeric parameters of a scene by key of ``mi.traverse``: reading, writing, and copies of scenes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray._mitsuba_compat import holds_numbers, peek
from mistray.errors import MistrayError
from mistray.scene.source import PackedScene, SceneDict, source_of
from mistray.surfaces.upload import upload


@dataclass(frozen=True, eq=False)
class StoredScene:
    """Scene stored as the source that it was loaded from, with its numeric parameters at that moment."""

    source: PackedScene | SceneDict
    numbers: Mapping[str, np.ndarray]

    @classmethod
    def of(cls, scene: mi.Scene) -> StoredScene:
        """Return the present state of a scene; raise `MistrayError` if its source is not known, see `source_of`."""
        return cls(source_of(scene), read_numbers(scene))

    def load(self) -> mi.Scene:
        """
        Load a new scene from the source and set the stored parameters.

        Raise `MistrayError` if that is impossible here.
        """
        scene = self.source.load()
        put_numbers(scene, self.numbers)
        return scene


def read_numbers(scene: mi.Scene) -> dict[str, np.ndarray]:
    """
    Return a scene's arrays of numbers, by key of ``mi.traverse``: flat arrays and (4, 4) matrices.

    Parameters that are plain Python numbers are left out.
    """
    return {key: _on_host(value) for key, value in _numbers(mi.traverse(scene))}


def put_numbers(scene: mi.Scene, numbers: Mapping[str, np.ndarray]) -> bool:
    """
    Set the numeric parameters of a scene that differ from given ones.

    Returns
    -------
    bool
        True if any parameter differed.

    Raises
    ------
    MistrayError
        If the scene has other keys.
    """
    params = mi.traverse(scene)
    own = dict(_numbers(params))
    if own.keys() != numbers.keys():
        odd = min(own.keys() ^ numbers.keys())
        raise MistrayError(f"number '{odd}' of the scene is not in its source; load the scene again")
    differing = {key: value for key, value in own.items() if not np.array_equal(_on_host(value), numbers[key])}
    for key, value in differing.items():
        given = numbers[key]
        params[key] = type(value)(given) if _is_frame(value) else upload(type(value), given)
    if differing:
        params.update()
    return bool(differing)


def _numbers(params: Any) -> Iterator[tuple[str, Any]]:
    for key in params.keys():  # noqa: SIM118  SceneParameters iterates over pairs
        value = peek(params, key)
        if holds_numbers(value) or isinstance(value, mi.UInt32) or _is_frame(value):
            yield key, value


def _is_frame(value: Any) -> bool:
    return isinstance(value, mi.Transform4f)


def _on_host(value: Any) -> np.ndarray:
    return np.array(value.matrix).reshape(4, 4) if _is_frame(value) else np.array(dr.detach(value))

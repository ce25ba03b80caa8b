"""Setting parameters of a loaded scene, permanently or within a block."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from mistray._mitsuba_compat import peek
from mistray.errors import MistrayError, nearest_parameters
from mistray.surfaces.upload import upload


def assign(params: Any, values: Mapping[str, np.ndarray]) -> None:
    """
    Set parameters of a scene to new values and update the scene.

    Parameters
    ----------
    params : mi.SceneParameters
        Parameters of the scene.
    values : mapping of str to (entries,) float
        New values by key, in the units of the parameters.

    Raises
    ------
    MistrayError
        If the scene has no such parameter, a number is not finite, or a plugin refuses a value.
    """
    for key, value in values.items():
        if key not in params:
            raise MistrayError(f"the scene has no parameter '{key}'; {nearest_parameters(key, params.keys())}")
        if not np.all(np.isfinite(value)):
            raise MistrayError(f"parameter '{key}' would become {np.ravel(value).tolist()}; it must be finite")
        params[key] = upload(type(peek(params, key)), np.ravel(value))
    params.update()


@contextlib.contextmanager
def changed(params: Any, values: Mapping[str, np.ndarray]) -> Iterator[None]:
    """
    Set scene parameters to other values within a `with` block; they are restored at its end, also after an error.

    `values` are those of `assign`, for keys that exist. Raise `MistrayError` if a value is refused.
    """
    before = {key: np.array(params[key], dtype=np.float64) for key in values}
    try:
        assign(params, values)
        yield
    finally:
        assign(params, before)


def accepts(params: Any, values: Mapping[str, np.ndarray], check: Callable[[], object]) -> bool:
    """True if a scene can take the `values` of `assign` together, and `check` then raises no `MistrayError`."""
    try:
        with changed(params, values):
            check()
            return True
    except MistrayError:
        return False

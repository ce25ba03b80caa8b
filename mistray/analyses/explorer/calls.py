"""Calls that the explorer's page may make, by name; the local page and the notebook widget share this list."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mistray.analyses.explorer.explorer import Explorer
from mistray.errors import MistrayError, nearest

WAIT_S = 20.0  # of a page for something new
CALLS: dict[str, Callable[[Explorer, dict[str, Any]], Any]] = {
    "page": lambda explorer, _: {**explorer.page(), "view": explorer.view()},
    "move": lambda explorer, given: explorer.move(_values(given)),
    "reset": lambda explorer, _: explorer.reset(),
    "detail": lambda explorer, given: explorer.detail(*_path(given)),
    "save_scene": lambda explorer, _: {"path": str(explorer.save_scene())},
    "save_study": lambda explorer, _: {"path": str(explorer.save_study())},
    "wait": lambda explorer, given: explorer.wait(_version(given), WAIT_S),
}


def answer(explorer: Explorer, call: Any, given: Any) -> Any:
    """
    Carry out a call of the explorer's page by its name, and return its answer as JSON-serialisable values.

    Parameters
    ----------
    explorer : Explorer
        Explorer of a scene.
    call : str
        One of `CALLS`.
    given : dict
        Arguments: ``values`` of a move, ``events`` and ``source`` of a detail, ``since`` of a wait.

    Raises
    ------
    MistrayError
        If the call is unknown or its arguments are invalid.
    """
    if not isinstance(call, str) or call not in CALLS:
        raise MistrayError(f"call {call!r:.80} is unknown; {nearest(str(call), CALLS)}")
    if not isinstance(given, dict):
        raise MistrayError(f"call '{call}': its arguments are {type(given).__name__}; give an object")
    return CALLS[call](explorer, given)


def _values(given: dict[str, Any]) -> dict[str, Any]:
    values = given.get("values")
    if not isinstance(values, dict):
        raise MistrayError("call 'move': values are missing; give an object of controls and values")
    return values


def _path(given: dict[str, Any]) -> tuple[str, str | None]:
    source = given.get("source")
    return str(given.get("events", "")), None if source is None else str(source)


def _version(given: dict[str, Any]) -> int:
    since = given.get("since")
    return since if isinstance(since, int) else -1

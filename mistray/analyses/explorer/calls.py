"""Calls that a page may make to an explorer, by name: the one list that the local page and the widget share."""

from __future__ import annotations

from typing import Any

from mistray.analyses.explorer.explorer import Explorer
from mistray.errors import MistrayError, nearest

CALLS = ("page", "move", "reset", "detail", "save_scene", "save_study", "wait")
WAIT_S = 20.0  # of a page for something new


def answer(explorer: Explorer, call: Any, given: Any) -> Any:
    """
    Do what a page asks for.

    Parameters
    ----------
    explorer : Explorer
    call : str
        One of `CALLS`.
    given : dict
        ``values`` of a move, ``events`` of a detail, ``since`` of a wait.

    Raises
    ------
    MistrayError
        For another call, or arguments that are none.
    """
    if not isinstance(call, str) or call not in CALLS:
        raise MistrayError(f"call {call!r:.80} is unknown; {nearest(str(call), CALLS)}")
    if not isinstance(given, dict):
        raise MistrayError(f"call '{call}': its arguments are {type(given).__name__}; give an object")
    if call == "page":
        return {**explorer.page(), "view": explorer.view()}
    if call == "move":
        values = given.get("values")
        if not isinstance(values, dict):
            raise MistrayError("call 'move': values are missing; give an object of controls and values")
        return explorer.move(values)
    if call == "reset":
        return explorer.reset()
    if call == "detail":
        return explorer.detail(str(given.get("events", "")))
    if call == "wait":
        since = given.get("since")
        return explorer.wait(since if isinstance(since, int) else -1, WAIT_S)
    path = explorer.save_scene() if call == "save_scene" else explorer.save_study()
    return {"path": str(path)}

"""Importance targets that were searched, in the cache on disk: a search in a scene of many surfaces takes seconds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any, TypeVar

import mitsuba as mi
import numpy as np

from mistray.cache import kept
from mistray.kernel.targets import AnyTarget, Inside, Place, Target
from mistray.time_budget import is_limited

FEWEST = 8  # surfaces that scatter: a search for fewer takes no longer than a hash of the code, 0.05 s
STATED = ("asphere", "frustum", "collimated")  # plugins of which plain attributes say all that a search depends on

Targets = dict[Place, list[Target]]
Found = TypeVar("Found")


def kept_targets(
    scene: mi.Scene,
    surfaces: Sequence[int],
    key: str,
    search: Callable[[], Found],
    write: Callable[[Found], Any],
    read: Callable[[Any], Found],
) -> Found:
    """
    Return the importance targets of a scene from the cache if possible, or search them.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene. If it has shapes or sources other than those in `STATED`, targets are always searched.
    surfaces : sequence of int
        Surfaces that scatter. For fewer than `FEWEST` the targets are always searched.
    key : str
        Part of the key: surfaces, media and purpose, see `mistray.sampling.importance_targets.signature`.
    search : callable
        Function that searches them. In a time budget it is always called: such a search may end early.
    write, read : callable
        Functions from the targets to JSON values and back, see `mistray.cache.kept`.
    """
    stated = None if len(surfaces) < FEWEST or is_limited() else _stated(scene)
    if stated is None:
        return search()
    facts = {"kind": "importance targets", "variant": mi.variant(), "surfaces": key, "plugins": stated}
    return kept(facts, search, write, read)


def _stated(scene: mi.Scene) -> str | None:
    """Return the plain attributes of all shapes and sources of a scene, as text; None if one is not in `STATED`."""
    found = []
    for part in (*scene.shapes(), *scene.emitters()):
        package, _, name = type(part).__module__.rpartition(".")
        if not package.startswith("mistray.plugins") or name not in STATED:
            return None
        facts = {key: fact.tobytes() if isinstance(fact, np.ndarray) else fact for key, fact in vars(part).items()}
        found.append((name, sorted((key, fact) for key, fact in facts.items() if _is_plain(fact))))
    return repr(found)


def _is_plain(value: Any) -> bool:
    """True for Python's own numbers, texts and bytes, and for tuples and dicts of them."""
    if isinstance(value, tuple | dict):
        return all(map(_is_plain, value.values() if isinstance(value, dict) else value))
    return isinstance(value, bool | int | float | str | bytes)


def written(found: Mapping[Place, Sequence[AnyTarget]]) -> list[Any]:
    """Return targets by place as JSON values: whether it is in a medium, index and side of the surface, targets."""
    rows = []
    for place, targets in found.items():
        surface, at_back = (place.surface, place.at_back) if isinstance(place, Inside) else place
        rows.append([isinstance(place, Inside), int(surface), bool(at_back), written_list(targets)])
    return rows


def written_list(targets: Sequence[AnyTarget]) -> list[dict[str, Any]]:
    """Return targets as JSON values."""
    return [_facts(target) for target in targets]


def _facts(target: AnyTarget) -> dict[str, Any]:
    """Return the fields of a target by name, arrays as lists of float."""
    facts = {field.name: getattr(target, field.name) for field in fields(target)}
    return {name: fact.tolist() if isinstance(fact, np.ndarray | np.generic) else fact for name, fact in facts.items()}


def read(content: Any) -> Targets:
    """Return the targets that `written` wrote; raise ValueError, TypeError or KeyError for other content."""
    return {
        Inside(surface, at_back) if inside else (surface, at_back): read_list(targets)
        for inside, surface, at_back, targets in content
    }


def read_list(content: Any) -> list[Target]:
    """Return the targets that `written_list` wrote; raise ValueError, TypeError or KeyError for other content."""
    return [Target(**facts) for facts in content]

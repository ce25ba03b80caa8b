"""Importance targets that were searched, in the cache on disk: a search in a scene of many surfaces takes seconds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.cache import kept
from mistray.kernel.targets import Inside, Place, Target
from mistray.scene.allowed_plugins import foreign_plugins
from mistray.time_budget import is_limited

MANY = 8  # a search for fewer surfaces takes no longer than a hash of the code, 0.05 s

Targets = dict[Place, list[Target]]


def kept_targets(scene: mi.Scene, surfaces: Sequence[int], key: str, search: Callable[[], Targets]) -> Targets:
    """
    Return the importance targets of a scene, by place of scatter, from the cache if possible.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene. If it has plugins from elsewhere, whose code may change, nothing is read or stored.
    surfaces : sequence of int
        Surfaces that scatter. For fewer than `MANY` the targets are always searched.
    key : str
        Everything that the targets depend on, see `mistray.sampling.importance_targets.signature`.
    search : callable
        Function that searches them. In a time budget it is always called: such a search may end early.
    """
    if len(surfaces) < MANY or is_limited() or foreign_plugins(scene):
        return search()
    return kept({"kind": "importance targets", "scene": key}, search, _written, _read)


def _written(found: Targets) -> list[Any]:
    """Return targets by place as JSON values: whether it is in a medium, index and side of the surface, targets."""
    rows = []
    for place, targets in found.items():
        surface, at_back = (place.surface, place.at_back) if isinstance(place, Inside) else place
        rows.append([isinstance(place, Inside), int(surface), bool(at_back), [_facts(target) for target in targets]])
    return rows


def _facts(target: Target) -> dict[str, Any]:
    """Return the fields of a target by name, arrays as lists of float."""
    facts = {field.name: getattr(target, field.name) for field in fields(target)}
    return {name: fact.tolist() if isinstance(fact, np.ndarray | np.generic) else fact for name, fact in facts.items()}


def _read(content: Any) -> Targets:
    """Return the targets that `_written` wrote; raise ValueError, TypeError or KeyError for other content."""
    return {
        Inside(surface, at_back) if inside else (surface, at_back): [Target(**facts) for facts in targets]
        for inside, surface, at_back, targets in content
    }

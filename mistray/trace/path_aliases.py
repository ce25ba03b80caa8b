"""Aliases of the surfaces in a path table: one name for all faces of a lens, or of a body of a CAD model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from mistray.errors import MistrayError
from mistray.events import TRANSMITTED, event_of, kind_of, place_of
from mistray.ids import check_id
from mistray.ranges import TEXT, ByName
from mistray.recorders.design_sequences import DesignSequences
from mistray.recorders.path_events import Events, way
from mistray.recorders.path_key import padded
from mistray.trace.filter_rows import named_like, unknown_name

if TYPE_CHECKING:
    from mistray.surfaces.surfaces import SurfaceTable

PART, SPACE = "part", "space"
ALIASES = ByName(TEXT, "{'L1_*': 'lens 1'}")
NAMES = ("ghost_1", "ghost_2", "scatter_1", "last_object", "critical")  # columns that name a surface
KEPT_APART = ("kind", "order", "scatters", "diffractions", "structure_bounces", "tir")


def alias_names(table: SurfaceTable, aliases: Mapping[str, str] | str) -> list[str]:
    """
    Return the name under which each surface and medium is reported, an alias or its id, in order of their indices.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    aliases : mapping of str to str, or "part" or "space"
        Pattern of surfaces or parts, with * for any letters and ? for one, → name. The first pattern that fits is
        used; places that no pattern fits keep their names. "part" stands for the part of each surface, "space" for
        the optical space that the scene declares for it, as ``space_2``; surfaces without one keep their names.

    Raises
    ------
    MistrayError
        For a pattern that fits nothing, a name that cannot be an id, or a string other than these two.
    """
    ids, parts = table.event_ids, table.event_parts
    if isinstance(aliases, str) and aliases == PART:
        return [part if k < table.count else ids[k] for k, part in enumerate(parts)]
    if isinstance(aliases, str) and aliases == SPACE:
        spaces = [*table.spaces, *(-1 for _ in ids[table.count :])]
        return [f"space_{n}" if n >= 0 else name for n, name in zip(spaces, ids, strict=True)]
    if isinstance(aliases, str):
        raise MistrayError(f"aliases is '{aliases}'; use 'part', 'space', or a mapping of patterns to names")
    names = list(ids)
    # Of several patterns that fit a place the first is used
    free = np.full(len(ids), True)
    for pattern, name in ALIASES.check("aliases", aliases).items():
        check_id(name, "alias")
        found = named_like(pattern, ids, parts)
        if not found.any():
            raise MistrayError(f"alias '{name}': {unknown_name(pattern, ids, parts)}")
        for k in np.flatnonzero(found & free):
            names[k] = name
        free &= ~found
    return names


def aliased(events: Events, names: Sequence[str]) -> tuple[Events, dict[str, np.ndarray]]:
    """
    Return event lists with surfaces renamed by aliases, and with aimed scatter as random scatter.

    Consecutive events at surfaces of one name are one visit. Its transmissions are left out unless there is nothing
    else: light that passes a lens is ``lens:T``, and light that is reflected within it is ``lens:R``.

    Parameters
    ----------
    events : Events
        Event lists of paths.
    names : sequence of str
        Name of each surface and medium, from `alias_names`.

    Returns
    -------
    events : Events
        Events with the names as places.
    columns : dict
        Columns events, path, objects and unique_objects of `PathRow`, (p,) each.
    """
    # Number the names, and write events with these instead of places
    numbers = {name: k for k, name in enumerate(dict.fromkeys(names))}
    number = np.array([numbers[name] for name in names], dtype=np.uint32)
    renamed = replace(events, codes=event_of(number[events.places], kind_of(way(events.codes))))
    lists, words = map(_short, renamed.lists), np.zeros(len(numbers), dtype=np.uint32)
    short = Events(*padded(list(lists)), list(numbers), words, DesignSequences())
    return short, {
        "events": np.array(short.text, dtype=object),
        "path": np.array(short.letters, dtype=object),
        "objects": short.lengths,
        "unique_objects": short.distinct_places,
    }


def _short(events: Sequence[int]) -> list[int]:
    """
    Return event codes without transmissions next to another event at the same place.

    If a place has nothing but transmissions, the first stays.
    """
    kept: list[int] = []
    for _, same in groupby(events, place_of):
        run = list(same)
        kept += [code for code in run if kind_of(code) != TRANSMITTED] or run[:1]
    return kept

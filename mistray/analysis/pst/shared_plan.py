"""One plan for runs that are compared: light of equal ways is counted from the same direction, by the same rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mistray.analysis.pst.pilot import Plan
from mistray.recorders.path_key import EVENT_BITS, host_keys
from mistray.surfaces.surfaces import SurfaceTable


def share(plans: Sequence[Plan], tables: Sequence[SurfaceTable]) -> list[Plan]:
    """
    Plans that decide alike: what one of them counts with the light all do, everything else is counted against it.

    What a plan knows of its own scene, by which it widens errors, stays its own.

    Parameters
    ----------
    plans : sequence of Plan
        Of scenes with the same grid.
    tables : sequence of SurfaceTable
        Of the scenes. Objects and media are the same where their names are.

    Returns
    -------
    list of Plan
        With all ways that are counted forwards and whose objects their scene has.
    """
    names = [_names(table) for table in tables]
    number = {name: k for k, name in enumerate(dict.fromkeys(name for one in names for name in one))}
    places = [np.array([number[name] for name in one]) for one in names]
    common = [_renumbered(plan.events, plan.lengths, place) for plan, place in zip(plans, places, strict=True)]
    longest = max(events.shape[1] for events in common)
    events = np.concatenate([np.pad(one, ((0, 0), (0, longest - one.shape[1]))) for one in common])
    lengths = np.concatenate([plan.lengths for plan in plans])
    _, first, way = np.unique(host_keys(events, lengths), return_index=True, return_inverse=True)
    ways = np.split(way, np.cumsum([len(plan.lengths) for plan in plans])[:-1])
    cells = plans[0].rays.shape[1]
    pairs = [of[plan.way] * cells + plan.cell for of, plan in zip(ways, plans, strict=True)]
    forward = np.unique(np.concatenate([pair[plan.forward] for pair, plan in zip(pairs, plans, strict=True)]))
    shared = []
    for plan, pair, place, of in zip(plans, pairs, places, ways, strict=True):
        back = np.full(len(number), -1)
        back[place] = np.arange(len(place))
        new_way, new_cell = np.divmod(np.setdiff1d(forward, pair), cells)
        wanted = np.unique(new_way)
        chosen = first[wanted]
        there = np.arange(longest) < lengths[chosen, None]
        wanted = wanted[np.all((back[events[chosen] >> EVENT_BITS] >= 0) | ~there, axis=1)]
        held = np.isin(new_way, wanted)
        lacking = np.setdiff1d(wanted, of)
        own = _renumbered(events[first[lacking]], lengths[first[lacking]], np.maximum(back, 0))
        at = np.zeros(len(first), dtype=np.int64)
        at[of] = np.arange(len(of))
        at[lacking] = len(of) + np.arange(len(lacking))
        known = replace(
            plan,
            events=np.concatenate([np.pad(plan.events, ((0, 0), (0, longest - plan.events.shape[1]))), own]),
            lengths=np.concatenate([plan.lengths, lengths[first[lacking]]]),
            forward=np.isin(pair, forward),
        )
        shared.append(known.with_forward_pairs(at[new_way[held]], new_cell[held]))
    return shared


def _names(table: SurfaceTable) -> list[tuple[str, str]]:
    """Names of the places of events, those of media apart from those of objects."""
    return [*(("object", name) for name in table.ids), *(("medium", name) for name in table.optics.media)]


def _renumbered(events: np.ndarray, lengths: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Event lists with other numbers of their places."""
    codes = (place[events >> EVENT_BITS] << EVENT_BITS) | (events & ((1 << EVENT_BITS) - 1))
    return np.where(np.arange(events.shape[1]) < lengths[:, None], codes, 0).astype(np.uint32)

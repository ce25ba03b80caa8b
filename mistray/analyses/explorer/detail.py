"""Details of one path in the explorer: its rays, the surfaces where it turns, and coatings that weaken it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mistray.analyses.explorer.controls import COATING, VALUES, Control
from mistray.analyses.explorer.estimate import Guess
from mistray.analyses.explorer.traced import Traced
from mistray.analyses.ghosts.page.path_explorer import EVENT_WORDS
from mistray.events import INTERCEPTS, LETTERS
from mistray.ids import event_words
from mistray.recorders.path_events import DIRECT
from mistray.toolkit.drawings.section_layout import RAYS_DRAWN, meridional
from mistray.toolkit.pages.embedded import rounded

_WORDS = {letter: EVENT_WORDS[INTERCEPTS[code]] for code, letter in LETTERS.items()}
PASSES = "TA"


def path_detail(
    of: Traced,
    guessed: Callable[[Mapping[str, VALUES]], Guess],
    controls: Mapping[str, Control],
    state: Mapping[str, VALUES],
    row: int,
    digits: int,
) -> dict[str, Any]:
    """
    Return the details of a path as JSON-serialisable values for the page.

    Parameters
    ----------
    of : Traced
        Trace that contains the path.
    guessed : callable
        Returns the estimate of the light for values of all controls.
    controls : mapping of str to Control
        Controls of the explorer, by name.
    state : mapping
        Values of all controls.
    row : int
        Row of the path in `Traced.ways`.
    digits : int
        Decimals of coordinates.

    Returns
    -------
    dict
        ``events``: surface, event in words, and whether the light turns there, of each event. ``rays``: polylines z, y,
        z, y, …, mm. ``power_W``: power of the path. ``turns``: surfaces that reflect or scatter the path, each with the
        percentage of all stray light that turns there. ``remedies``: for each part with a choice of coatings and such a
        surface, the coating that leaves the least stray light, the best part first. Each has the power of the path and
        of all stray light left, W.
    """
    events = str(of.ways.events.iloc[row])
    lines = [of.sample.lines[k] for k in np.flatnonzero(of.sample.way == row)]
    words = [word.rpartition(":") for word in event_words(events)]
    now = guessed(state)
    turns = list(dict.fromkeys(name for name, _, letter in words if letter not in PASSES))
    return {
        "events": [[name, _WORDS[letter], letter not in PASSES] for name, _, letter in words],
        "rays": rounded([line[:, [2, 1]] for line in meridional(lines, RAYS_DRAWN)] if lines else [], digits),
        "power_W": _power(now, of, row),
        "turns": [{"surface": name, "percent": _share(now.ways, name)} for name in turns],
        "remedies": _remedies(of, guessed, controls, state, turns, row),
    }


def _power(guess: Guess, of: Traced, row: int) -> float:
    """
    Return the power, W, that an estimate gives to the path in row `row` of ``of.ways``.

    It is 0 if the estimate, which may be of another field, does not have that path.
    """
    path = of.ways.iloc[row]
    ways = guess.ways
    return float(ways.power_W[(ways.source == path.source) & (ways.events == path.events)].sum())


def _share(ways: Any, surface: str) -> float:
    """Return the percentage of all stray power on paths that a surface reflects or scatters; 0 without stray light."""
    stray = ways[ways.kind != DIRECT]
    total = stray.power_W.sum()
    there = [
        any(name == surface and letter not in PASSES for name, _, letter in (w.rpartition(":") for w in event_words(e)))
        for e in stray.events
    ]
    return float(100 * stray.power_W[there].sum() / total) if total > 0 else 0.0


def _remedies(
    of: Traced,
    guessed: Callable[[Mapping[str, VALUES]], Guess],
    controls: Mapping[str, Control],
    state: Mapping[str, VALUES],
    turns: list[str],
    row: int,
) -> list[dict[str, Any]]:
    """
    Return, for each part with one of the surfaces `turns`, the coating that leaves the least stray light.

    The best part is first. Each has the power of the path in row `row` and of all stray light that is left, W.
    """
    found = []
    for name, control in controls.items():
        if control.kind != COATING or not set(control.surfaces) & set(turns):
            continue
        tried = [(choice, guessed({**state, name: choice})) for choice in control.choices]
        choice, best = min(tried, key=lambda item: item[1].stray_W.value)
        found.append({
            "control": name,
            "part": control.label,
            "choice": choice,
            "now": state[name],
            "path_W": _power(best, of, row),
            "stray_W": best.stray_W.value,
        })  # fmt: skip
    return sorted(found, key=lambda item: item["stray_W"])

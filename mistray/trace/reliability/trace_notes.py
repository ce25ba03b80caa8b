"""Notes on the reliability of traces: light that limits cut, open energy, coarse tables, poor sampling of scatter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mistray.notes import Code, Note
from mistray.ranges import EVENTS
from mistray.settings import BRANCHES
from mistray.trace.reliability.sampling_check import sampling_notes, worst_note

if TYPE_CHECKING:
    from mistray.trace.result import Trace

LEAST_CUT = 1e-6  # share of the launched flux below which cut flux is not worth a note
MUCH_CUT = 0.01  # share of the launched flux above which cut flux is a warning
COARSE = 1e-4  # largest error of R and T by interpolation over the angle
OPEN = 1e-5  # largest relative error of the energy balance
ZERO_ON_AVERAGE = ("roulette", "scatter_sampling")
MEDIUM = "medium"
CUT_TEXTS = {
    "flux_threshold": "cut by flux_threshold = {flux_threshold:g} (after scatter: scatter_threshold = "
    "{scatter_threshold:g}); lower it, or use below_threshold = roulette",
    "max_reflections": "not followed beyond max_reflections = {max_reflections}; raise it to see where it goes",
    "max_scatters": "not scattered: max_scatters = {max_scatters} or another limit of scatter; raise it to see where "
    "it goes",
    "max_generations": "not followed beyond max_generations = {max_generations}; raise it to see where it goes",
    "max_events": "cut by max_events = {max_events}; ",
    "max_consecutive": "cut by max_consecutive = {max_consecutive}; raise it to see where it goes",
    "ray_control": "refused by ray_control = {ray_control}",
    "max_segments": "left of trees of more than max_segments = {max_segments} ray segments; lower max_reflections or "
    "max_scatters, or raise it",
    **{
        f"{branch}_below": f"cut by what cut_below says of {branch.replace('_', ' ')}; lower it"
        for branch in BRANCHES.values()
    },
    MEDIUM: "lost where a ray met a surface from the wrong material; the geometry has a gap or an overlap, or a "
    "surface has front and back exchanged",
}


def trace_notes(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """
    Return all that limits the reliability of the numbers, each line once for all traces that it is about.

    Parameters
    ----------
    traces : sequence of Trace
        Traces of one scene and equal settings, at several fields for instance.

    Returns
    -------
    list of (list of int, Note)
        Numbers of the traces, and the line, with the worst figures of any of them.
    """
    return [*_cut(traces), *_open(traces), *_coarse(traces), *_own(traces), *sampling_notes(traces)]


def _cut(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """Return notes on light that was not followed, by the reasons of the energy ledger."""
    found = []
    for reason in dict.fromkeys(reason for t in traces for reason in t.energy.cut if reason not in ZERO_ON_AVERAGE):
        shares = [abs(t.energy.cut.get(reason, 0.0)) / t.energy.launched_W for t in traces]
        if at := [k for k, share in enumerate(shares) if share > LEAST_CUT]:
            settings = traces[at[0]].settings
            text = CUT_TEXTS.get(reason, f"lost to '{reason}'").format(**settings)
            if reason == "max_events":
                longest = settings["max_events"] >= EVENTS.high
                remedy = "light is trapped there, and no path can be longer"
                text += remedy if longest else f"raise it, up to {EVENTS.high}"
            code = Code.MEDIUM if reason == MEDIUM else Code.CUT
            text = f"up to {max(shares):.1e} of the launched flux was {text}"
            found.append((at, Note(text, code, reason == MEDIUM or max(shares) > MUCH_CUT)))
    return found


def _open(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """Return a note on traces whose energy does not close."""
    text = f"the energy closes to {{:.1e}} only, not to {OPEN:g}"
    return worst_note(Code.CLOSURE, [abs(t.energy.closure) for t in traces], lambda error: error > OPEN, max, text)


def _coarse(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """Return a note on traces with a coating that its table does not resolve."""
    text = "R of a coating in total reflection varies too fast with the angle for its table; the error is up to {:.1e}"
    return worst_note(Code.COATING, [t.coating_error for t in traces], lambda error: error > COARSE, max, text)


def _own(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """Return the notes of traces on their scene, sources and rays."""
    lines = dict.fromkeys(note for t in traces for note in t.own_notes)
    return [([k for k, t in enumerate(traces) if note in t.own_notes], note) for note in lines]

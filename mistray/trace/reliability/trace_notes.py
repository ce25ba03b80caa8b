"""Notes on the reliability of traces: light that limits cut, open energy, coarse tables, poor sampling of scatter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mistray.messages import CUTS, Message
from mistray.notes import Note
from mistray.ranges import EVENTS
from mistray.trace.reliability.sampling_check import sampling_notes, worst_note

if TYPE_CHECKING:
    from mistray.trace.result import Trace

LEAST_CUT = 1e-6  # share of the launched flux below which cut flux is not worth a note
MUCH_CUT = 0.01  # share of the launched flux above which cut flux is a warning
COARSE = 1e-4  # largest error of R and T by interpolation over the angle
OPEN = 1e-5  # largest relative error of the energy balance
ZERO_ON_AVERAGE = ("roulette", "scatter_sampling")


def trace_notes(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """
    Return notes on the reliability of traces, each note once with the numbers of the traces that it is about.

    Parameters
    ----------
    traces : sequence of Trace
        Traces of one scene and equal settings, at several fields for instance.

    Returns
    -------
    list of (list of int, Note)
        Numbers of the traces, and the line, with the worst figures of any of them.
    """
    balance = worst_note(Message.OPEN, [abs(t.energy.closure) for t in traces], OPEN)
    coarse = worst_note(Message.COARSE_COATING, [t.coating_error for t in traces], COARSE)
    return [*_cut(traces), *balance, *coarse, *_own(traces), *sampling_notes(traces)]


def _cut(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """Return notes on light that was not followed, by the reasons of the energy ledger."""
    found = []
    for reason in dict.fromkeys(reason for t in traces for reason in t.energy.cut if reason not in ZERO_ON_AVERAGE):
        shares = [abs(t.energy.cut.get(reason, 0.0)) / t.energy.launched_W for t in traces]
        if at := [k for k, share in enumerate(shares) if share > LEAST_CUT]:
            settings = traces[at[0]].settings
            text = CUTS.get(reason, f"lost to '{reason}'").format(**settings)
            if reason == "max_events":
                longest = settings["max_events"] >= EVENTS.high
                remedy = "light is trapped there, and no path can be longer"
                text += remedy if longest else f"raise it, up to {EVENTS.high}"
            message = Message.LOST if reason == "medium" else Message.CUT
            warns = message is Message.LOST or max(shares) > MUCH_CUT
            found.append((at, message.note(warns, share=max(shares), what=text)))
    return found


def _own(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """Return the notes of traces on their scene, sources and rays."""
    lines = dict.fromkeys(note for t in traces for note in t.own_notes)
    return [([k for k, t in enumerate(traces) if note in t.own_notes], note) for note in lines]

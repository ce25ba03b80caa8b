"""Sampling of scattered light: numbers of rays that reach the detector, and of those aimed at it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mistray.messages import Message
from mistray.notes import Note
from mistray.percent import percent_text

if TYPE_CHECKING:
    from mistray.trace.result import Trace

LEAST_LANDED = 0.2  # share of the aimed rays of a surface that should reach the detector
LEAST_HITS, MOST_HITS = 0.1, 10.0  # hits of the detector by scattered rays, per start ray; about 1 is right
LARGEST_SHARE = 0.05  # share of the scattered light that one ray may carry
FEWEST_AIMED = 100  # aimed rays of a surface below which the share that lands says little
NAMES_SHOWN = 3
LEAST_LIT = 1e-3  # share of the launched flux below which a place that sends nothing is not worth a warning


@dataclass(frozen=True)
class AimedRow:
    """
    Judgement of the aimed rays of one surface or medium, by the fraction that reached the detector.

    Attributes
    ----------
    surface : str
        Name of the surface, or of the medium in brackets.
    aimed : int
        Number of rays sent to targets.
    share_landed : float
        Share of them that reached the detector without a further reflection.
    low : bool
        Whether the share is below `LEAST_LANDED`, and enough rays were aimed to say so.
    tight : bool
        Whether all of them reached the detector, enough rays were aimed to say so, and the target is not the detector
        itself: it may be smaller than the region through which light reaches the detector.
    """

    surface: str
    aimed: int
    share_landed: float
    low: bool
    tight: bool


@dataclass(frozen=True)
class SamplingCheck:
    """
    Quality of the sampling of the scattered light of a trace.

    Attributes
    ----------
    rows : tuple of AimedRow
        Surfaces that aimed rays, in the order of the trace.
    hits_per_start : float
        Number of hits of the detector by scattered rays, per start ray.
    largest_share : float
        Largest share of the scattered light that one ray carried; NaN without such light.
    effective_hits : float
        Number of hits of equal flux that would be as good as the actual ones.
    notes : tuple of Note
        Advice on settings, one line each; empty if there is none.
    """

    rows: tuple[AimedRow, ...]
    hits_per_start: float
    largest_share: float
    effective_hits: float
    notes: tuple[Note, ...]


def _names(found: Sequence[str]) -> str:
    """Return the first of some names, and the number of others."""
    more = f" and {len(found) - NAMES_SHOWN} more" if len(found) > NAMES_SHOWN else ""
    return ", ".join(found[:NAMES_SHOWN]) + more


def sampling_check(trace: Trace) -> SamplingCheck:
    """
    Return figures of the quality of the sampling of scattered light in a trace, with advice on settings.

    Parameters
    ----------
    trace : Trace
        Result of `mistray.trace`. Where nothing scatters there are no rows and no notes.
    """
    return SamplingCheck(
        _rows(trace),
        trace.scattered_rays_per_start,
        trace.largest_ray_share,
        trace.effective_scattered_rays,
        tuple(note for _, note in sampling_notes([trace])),
    )


def worst_note(
    message: Message, values: Sequence[float], limit: float, worst: Callable[..., float] = max
) -> list[tuple[list[int], Note]]:
    """Return a note with the worst of the values beyond a limit, and the numbers of their traces; [] if none is."""
    at = [k for k, value in enumerate(values) if (value > limit if worst is max else value < limit)]
    return [(at, message.note(value=worst(values[k] for k in at), limit=limit))] if at else []


def sampling_notes(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """
    Return advice on settings for scattered light, each note once with the numbers of the traces that it is about.

    Parameters
    ----------
    traces : sequence of Trace
        Traces of one scene, at several fields for instance.

    Returns
    -------
    list of (list of int, Note)
        Numbers of the traces, and the line, with the worst figures of any of them.
    """
    found: list[tuple[list[int], Note]] = []
    rows = [_rows(t) for t in traces]

    def named(message: Message, values: Sequence[Mapping[str, float]], worst: Callable[..., float]) -> None:
        """Add a line about places that have a figure each, the worst place first."""
        at = [k for k, each in enumerate(values) if each]
        if not at:
            return
        places = {name: worst(each[name] for each in values if name in each) for each in values for name in each}
        order = sorted(places, key=lambda name: places[name], reverse=worst is max)
        names = _names([f"{name} {percent_text(places[name])}" for name in order])
        count = f"{len(places)} surfaces or bodies scatter" if len(places) > 1 else "one surface or body scatters"
        found.append((at, message.note(names=names, count=count, limit=100 * LEAST_LANDED)))

    # Aimed rays that miss the detector
    named(Message.AIMED_MISS, [{row.surface: row.share_landed for row in each if row.low} for each in rows], min)

    # Targets that may cut off light
    tight = [[row.surface for row in each if row.tight] for each in rows]
    if any(tight):
        names = _names(list(dict.fromkeys(name for each in tight for name in each)))
        found.append(([k for k, each in enumerate(tight) if each], Message.TIGHT_TARGETS.note(names=names)))

    # Lit places of which nothing arrives
    silent = [{place.id: place.share for place in t.silent if place.share >= LEAST_LIT} for t in traces]
    named(Message.SILENT, silent, max)

    # Numbers of scattered rays at the detector; a trace without scattered light passes as if it had just enough
    hits = [t.scattered_rays_per_start for t in traces]
    scatters = [bool(each or t.scattered_rays_per_start > 0 or t.silent) for each, t in zip(rows, traces, strict=True)]
    judged = [n if any_light else LEAST_HITS for n, any_light in zip(hits, scatters, strict=True)]
    found += worst_note(Message.FEW_SCATTERED, judged, LEAST_HITS, min)
    found += worst_note(Message.MANY_SCATTERED, judged, MOST_HITS)
    found += worst_note(Message.ONE_RAY, [100 * t.largest_ray_share for t in traces], 100 * LARGEST_SHARE)
    return found


def _rows(trace: Trace) -> tuple[AimedRow, ...]:
    """Return the aimed rays of each surface that reached the detector."""
    return tuple(
        AimedRow(
            entry.id,
            round(entry.aimed),
            entry.landed / entry.aimed,
            entry.aimed >= FEWEST_AIMED and entry.landed < LEAST_LANDED * entry.aimed,
            entry.aimed >= FEWEST_AIMED and entry.landed == entry.aimed and not entry.at_detector,
        )
        for entry in trace.aiming
    )

"""Sampling of scattered light: numbers of rays that reach the detector, and of those aimed at it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mistray.notes import Code, Note
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
    Aimed rays of one surface.

    Attributes
    ----------
    surface : str
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
    Judge how the scattered light of a trace was sampled.

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
    code: Code, values: Sequence[float], wrong: Callable[[float], bool], worst: Callable[..., float], text: str
) -> list[tuple[list[int], Note]]:
    """Return a line about one figure of each trace, with the worst of those that are wrong; none if all are right."""
    at = [k for k, value in enumerate(values) if wrong(value)]
    return [(at, Note(text.format(worst(values[k] for k in at)), code))] if at else []


def sampling_notes(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """
    Return advice on settings, each line once for all traces that it is about.

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

    def named(code: Code, values: Sequence[Mapping[str, float]], worst: Callable[..., float], text: str) -> None:
        """Add a line about places that have a figure each, the worst place first."""
        at = [k for k, each in enumerate(values) if each]
        if not at:
            return
        places = {name: worst(each[name] for each in values if name in each) for each in values for name in each}
        order = sorted(places, key=lambda name: places[name], reverse=worst is max)
        names = _names([f"{name} {percent_text(places[name])}" for name in order])
        count = f"{len(places)} surfaces or bodies scatter" if len(places) > 1 else "one surface or body scatters"
        found.append((at, Note(text.format(names=names, count=count), code)))

    # Aimed rays that miss the detector
    named(
        Code.AIMED,
        [{row.surface: row.share_landed for row in each if row.low} for each in rows],
        min,
        f"few aimed rays reach the detector (less than {100 * LEAST_LANDED:g} %): {{names}}. Give these surfaces a "
        "smaller target or several; where only a lens is in view, more is not possible",
    )

    # Targets that may cut off light
    tight = [[row.surface for row in each if row.tight] for each in rows]
    if any(tight):
        names = _names(list(dict.fromkeys(name for each in tight for name in each)))
        text = (
            f"every aimed ray reaches the detector: {names}. These targets may be too small; enlarge them until some "
            "rays miss"
        )
        found.append(([k for k, each in enumerate(tight) if each], Note(text, Code.TARGET)))

    # Lit places of which nothing arrives
    named(
        Code.SILENT,
        [{place.id: place.share for place in t.silent if place.share >= LEAST_LIT} for t in traces],
        max,
        "{count} light, but none of it reaches the detector: {names} (share of the launched flux). If the detector "
        "sees such a place, give it a target or raise rays",
    )

    # Numbers of scattered rays at the detector; a trace without scattered light passes as if it had just enough
    hits = [t.scattered_rays_per_start for t in traces]
    scatters = [bool(each or t.scattered_rays_per_start > 0 or t.silent) for each, t in zip(rows, traces, strict=True)]
    judged = [n if any_light else LEAST_HITS for n, any_light in zip(hits, scatters, strict=True)]
    found += worst_note(
        Code.SCATTERED_RAYS,
        judged,
        lambda n: n < LEAST_HITS,
        min,
        f"only {{:.2g}} scattered rays reach the detector per start ray (at least {LEAST_HITS:g} is good); raise "
        "aimed_rays, or give the surfaces that scatter a target",
    )
    found += worst_note(
        Code.SCATTERED_RAYS,
        judged,
        lambda n: n > MOST_HITS,
        max,
        f"{{:.3g}} scattered rays reach the detector per start ray (at most {MOST_HITS:g} is good); trace more start "
        "rays with fewer scattered ones: lower aimed_rays or scatter_rays, or raise scatter_threshold",
    )
    found += worst_note(
        Code.ONE_RAY,
        [100 * t.largest_ray_share for t in traces],
        lambda share: share > 100 * LARGEST_SHARE,
        max,
        f"one ray carries {{:.3g}} % of the scattered light (at most {100 * LARGEST_SHARE:g} % is good); raise rays, "
        "or give the surface that scattered it a target",
    )
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

"""
Reliability of a trace: light that was cut, and how well scattered light is sampled.

Aimed rays are judged by the share that reaches the detector, scattered light by the number of its hits there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mistray.events import FIRST_SCATTERED, kind_of, place_of
from mistray.execute.tracer import Run
from mistray.ids import event_words
from mistray.kernel.targets import Inside, Target
from mistray.messages import CUTS, Message
from mistray.notes import Note
from mistray.percent import percent_text
from mistray.ranges import EVENTS
from mistray.recorders.tallies import AIMED, HITS, INCIDENT, LANDED
from mistray.sampling.bulk_aiming import medium_of
from mistray.sampling.outlines import outline
from mistray.surfaces.surfaces import SurfaceTable

if TYPE_CHECKING:
    from mistray.trace.result import Trace

IMAGE = 0.9  # share of the light of a detector from which on a path may be an image that nobody has declared
LEAST_CUT = 1e-6  # share of the launched flux below which cut flux is not worth a note
MUCH_CUT = 0.01  # share of the launched flux above which cut flux is a warning
COARSE = 1e-4  # largest error of R and T by interpolation over the angle
OPEN = 1e-5  # largest relative error of the energy balance
ZERO_ON_AVERAGE = ("roulette", "scatter_sampling")
LEAST_LANDED = 0.2  # share of the aimed rays of a surface that should reach the detector
LEAST_HITS, MOST_HITS = 0.1, 10.0  # hits of the detector by scattered rays, per start ray; about 1 is right
LARGEST_SHARE = 0.05  # share of the scattered light that one ray may carry
FEWEST_AIMED = 100  # aimed rays of a surface below which the share that lands says little
NAMES_SHOWN = 3
LEAST_LIT = 1e-3  # share of the launched flux below which a place that sends nothing is not worth a warning
FEWEST_HITS = 100.0  # hits of a place below which it may be chance that none of its rays arrives
SAME_SIZE = 1e-6  # relative to the size of the detector: lengths that differ by rounding


def trace_notes(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """
    Return notes on the reliability of traces, each note once with the indices of the traces that it is about.

    Parameters
    ----------
    traces : sequence of Trace
        Traces of one scene and equal settings, at several fields for instance.

    Returns
    -------
    list of (list of int, Note)
        Indices of the traces, and the note, with the worst figures of any of them.
    """
    balance = worst_note(Message.OPEN, [abs(t.energy.closure) for t in traces], OPEN)
    coarse = worst_note(Message.COARSE_COATING, [t.coating_error for t in traces], COARSE)
    return [*_cut(traces), *balance, *coarse, *_own(traces), *sampling_notes(traces)]


def _cut(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """
    Return a note for each reason for which flux was cut, with the indices of the traces that it is about.

    These have cut more than `LEAST_CUT` of the launched flux for this reason. There is no note without such traces, nor
    for reasons of `ZERO_ON_AVERAGE`.
    """
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


def undeclared_images(trace: Trace) -> list[Note]:
    """
    Return notes on detectors without a design path that get nearly all of their light by one path without scatter.

    The share of this path in the detector's power is above `IMAGE`. The trace must have a path table.
    """
    found = []
    table, design = trace.runs[0].table, trace.runs[0].design
    for detector in table.detectors:
        if design.lists.get(detector):
            continue
        paths = trace.paths
        power = paths.column("power_W")
        own = np.flatnonzero(paths.column("detector") == table.ids[detector])
        if not len(own) or not power[own].sum() > 0:
            continue
        share, row = power[own[0]] / power[own].sum(), paths[int(own[0])]
        words = event_words(row.events)[:-1]  # without the absorption at the detector
        if share > IMAGE and words and not row.scatters:
            facts = {"detector": row.detector, "share": percent_text(share), "path": " ".join(words)}
            found.append(Message.UNDECLARED_IMAGE.note(**facts))
    return found


def _own(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """Return the traces' own notes on scene, sources and rays, each with the indices of the traces that have it."""
    lines = dict.fromkeys(note for t in traces for note in t.own_notes)
    return [([k for k, t in enumerate(traces) if note in t.own_notes], note) for note in lines]


@dataclass(frozen=True)
class AimedRow:
    """
    Fraction of the rays aimed by one surface or medium that reached the detector, and whether it is too low.

    Attributes
    ----------
    surface : str
        Name of the surface, or of the medium in brackets.
    aimed : int
        Number of rays sent to targets.
    share_landed : float
        Share of them that reached the detector without a further reflection, 0 … 1.
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
    Measures of how well a trace samples scattered light, with advice on settings.

    Attributes
    ----------
    rows : tuple of AimedRow
        Surfaces and media that aimed rays, in the order of the trace.
    hits_per_start : float
        Number of hits of the detector by scattered rays, per start ray.
    largest_share : float
        Largest share of the scattered light that one ray carried, 0 … 1; NaN without such light.
    effective_hits : float
        Number of hits of equal flux that would have the same relative error as the actual ones.
    notes : tuple of Note
        Advice on settings, one line each; empty if there is none.
    """

    rows: tuple[AimedRow, ...]
    hits_per_start: float
    largest_share: float
    effective_hits: float
    notes: tuple[Note, ...]


def _names(found: Sequence[str]) -> str:
    """Return the first `NAMES_SHOWN` names in one string, and how many there are beyond these."""
    more = f" and {len(found) - NAMES_SHOWN} more" if len(found) > NAMES_SHOWN else ""
    return ", ".join(found[:NAMES_SHOWN]) + more


def sampling_check(trace: Trace) -> SamplingCheck:
    """
    Return how well a trace samples scattered light, with advice on settings.

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
    """
    Return a note with the worst value beyond `limit`, and the indices of the traces beyond it.

    Beyond is above if `worst` is max, else below. The result is empty if there are none.
    """
    at = [k for k, value in enumerate(values) if (value > limit if worst is max else value < limit)]
    return [(at, message.note(value=worst(values[k] for k in at), limit=limit))] if at else []


def sampling_notes(traces: Sequence[Trace]) -> list[tuple[list[int], Note]]:
    """
    Return advice on settings for scattered light, each note once with the indices of the traces that it is about.

    Parameters
    ----------
    traces : sequence of Trace
        Traces of one scene, at several fields for instance.

    Returns
    -------
    list of (list of int, Note)
        Indices of the traces, and the note, with the worst figures of any of them.
    """
    found: list[tuple[list[int], Note]] = []
    rows = [_rows(t) for t in traces]

    def named(message: Message, values: Sequence[Mapping[str, float]], worst: Callable[..., float]) -> None:
        """Add a note that lists the surfaces and media whose figure is bad, the worst first; none if all are good."""
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
    """Return a judgement of each surface or medium that aims rays: their number and the share that arrived."""
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


@dataclass(frozen=True)
class AimedSurface:
    """
    Numbers of scattered rays that a surface or medium aimed at targets, and of those that reached the detector.

    Attributes
    ----------
    id : str
        Name of the surface, or of the medium in brackets.
    aimed : float
        Number of rays that were sent to targets.
    landed : float
        Number of these that reached the detector without a further reflection.
    at_detector : bool
        Whether each target is the detector itself, or a part of its plane that contains it.
    """

    id: str
    aimed: float
    landed: float
    at_detector: bool = False


def aimed_surfaces(runs: Sequence[Run]) -> list[AimedSurface]:
    """Return the counts of aimed rays for each surface and medium that aims, summed over runs, in the scene's order."""
    sums: dict[str, np.ndarray] = {}
    for run in runs:
        table, found = run.table, run.sums.surfaces[:, [AIMED, LANDED]].sum(axis=-1)
        for i in (*table.listed, *range(table.count, len(found))):
            # By name, whatever the number of a medium in each run
            name = table.event_ids[i]
            sums[name] = sums.get(name, np.zeros(2)) + found[i]
    if not any(aimed for aimed, _ in sums.values()):
        return []
    elsewhere = _aims_elsewhere(runs)
    return [
        AimedSurface(name, float(aimed), float(landed), name not in elsewhere)
        for name, (aimed, landed) in sums.items()
        if aimed > 0
    ]


def _aims_elsewhere(runs: Sequence[Run]) -> set[str]:
    """Return the names of surfaces and media with a target that is not flat or covers no detector."""
    names = set()
    for run in runs:
        table = run.table
        detectors = [outline(table.shapes[i]) for i in table.detectors]
        for place, aim in run.scattering.tables.aims.items():
            flat = [target for target in aim.targets if isinstance(target, Target)]
            held = [any(_covers(target, detector) for detector in detectors) for target in flat]
            if len(flat) < len(aim.targets) or not all(held):
                if isinstance(place, Inside):  # in front of a wall may be any of the media
                    numbers = [table.count + medium for medium in np.flatnonzero(table.optics.host_scattering).tolist()]
                else:
                    numbers = [place[0]]
                names |= {table.event_ids[number] for number in numbers}
    return names


def _covers(target: Target, detector: Target) -> bool:
    """True if a target has the same centre as a detector, within a tolerance, and is at least as large."""
    size = max(detector.size)
    return (
        float(np.linalg.norm(target.centre - detector.centre)) < SAME_SIZE * size
        and min(target.size) >= (1 - SAME_SIZE) * min(detector.size)
        and max(target.size) >= (1 - SAME_SIZE) * size
    )


@dataclass(frozen=True)
class SilentPlace:
    """
    Surface or medium that receives light and scatters it, while no scattered ray of it reached the detector.

    Attributes
    ----------
    id : str
        Name of a surface, or of a medium in brackets.
    share : float
        Flux of all visits over the launched flux, dimensionless; for a medium that of its surface with most flux.
    """

    id: str
    share: float


def silent_places(runs: Sequence[Run]) -> list[SilentPlace]:
    """
    Return the surfaces and media whose scattered light never reached the detector, most flux first.

    They were hit at least `FEWEST_HITS` times. The list is empty if paths were not kept, `max_scatters` is 0, or
    `ray_control` is not "allow_all".
    """
    lit: dict[str, np.ndarray] = {}
    heard: set[str] = set()
    for run in runs:
        settings = run.settings
        if run.sums.paths is None or not settings.max_scatters or settings.ray_control != "allow_all":
            return []
        table, events = run.table, run.sums.paths.events
        sums = run.sums.surfaces[: table.count, [HITS, INCIDENT]].sum(axis=-1) * [1.0, run.unit]
        for place, found in _lit_places(table, sums).items():
            name = table.event_ids[place]
            lit[name] = lit.get(name, np.zeros(2)) + found
        # Places of the scatter events of all paths to the detector
        places = np.unique(place_of(events[kind_of(events) >= FIRST_SCATTERED]))
        heard |= {table.event_ids[place] for place in places.tolist()}
    launched = sum(run.source.power for run in runs)
    # Lit often enough, and in no path
    quiet = [
        SilentPlace(name, float(flux) / launched)
        for name, (hits, flux) in lit.items()
        if hits >= FEWEST_HITS and name not in heard
    ]
    return sorted(quiet, key=lambda place: -place.share)


def _lit_places(table: SurfaceTable, sums: np.ndarray) -> dict[int, np.ndarray]:
    """
    Return hits and incident flux, W, of each scattering surface or medium, (2,), by its place: media follow surfaces.

    `sums`, (s, 2), holds them for all surfaces. A medium has those of its surface with most flux. Detectors are left
    out.
    """
    lit = {i: sums[i] for i in table.listed if table.interfaces[i].scatter and i not in table.detectors}
    if table.optics.scatters:
        for i in table.listed:
            for side in (Inside(i, False), Inside(i, True)):
                medium = medium_of(table, side)
                if table.optics.host_scattering[medium] > 0:
                    place = table.count + medium
                    lit[place] = max(lit.get(place, sums[i]), sums[i], key=lambda found: float(found[1]))
    return lit

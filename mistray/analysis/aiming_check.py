"""Whether scattered light was sampled well: how many rays reach the detector, and how many of those aimed at it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mistray.trace import Trace

LEAST_LANDED = 0.2  # share of the aimed rays of a surface that should reach the detector
LEAST_HITS, MOST_HITS = 0.1, 10.0  # hits of the detector by scattered rays, per start ray; about 1 is right
LARGEST_SHARE = 0.05  # of the scattered light, by one ray
FEWEST_AIMED = 100  # aimed rays of a surface below which the share that lands says little
NAMES_SHOWN = 3
LEAST_LIT = 1e-3  # of the launched flux: a place with less of it that sends nothing is not worth a warning


@dataclass(frozen=True)
class AimedRow:
    """
    Aimed rays of one surface.

    Attributes
    ----------
    surface : str
    aimed : int
        Rays sent to targets.
    share_landed : float
        Share of them that reached the detector without a further reflection.
    low : bool
        The share is below `LEAST_LANDED`, and enough rays were aimed to say so.
    tight : bool
        All of them did, and enough rays were aimed to say so, at something else than the detector itself: the target
        may be smaller than what leads to the detector.
    """

    surface: str
    aimed: int
    share_landed: float
    low: bool
    tight: bool


@dataclass(frozen=True)
class SamplingCheck:
    """
    How well the scattered light of a trace was sampled.

    Attributes
    ----------
    rows : tuple of AimedRow
        Surfaces that aimed rays, in the order of the trace.
    hits_per_start : float
        Hits of the detector by scattered rays, per start ray.
    largest_share : float
        Largest share of the scattered light that came with one ray; NaN without such light.
    effective_hits : float
        Hits of equal flux that would be as good as those there were.
    warnings : tuple of str
        What to change, one line each; empty if nothing.
    """

    rows: tuple[AimedRow, ...]
    hits_per_start: float
    largest_share: float
    effective_hits: float
    warnings: tuple[str, ...]


def _names(found: Sequence[str]) -> str:
    """The first of some names, and how many more there are."""
    more = f" and {len(found) - NAMES_SHOWN} more" if len(found) > NAMES_SHOWN else ""
    return ", ".join(found[:NAMES_SHOWN]) + more


def sampling_check(trace: Trace) -> SamplingCheck:
    """
    Judge how the scattered light of a trace was sampled.

    Parameters
    ----------
    trace : Trace
        Result of `mistray.trace`. Where nothing scatters there are no rows and no warnings.
    """
    rows = tuple(
        AimedRow(
            entry.id,
            round(entry.aimed),
            entry.landed / entry.aimed,
            entry.aimed >= FEWEST_AIMED and entry.landed < LEAST_LANDED * entry.aimed,
            entry.aimed >= FEWEST_AIMED and entry.landed == entry.aimed and not entry.at_detector,
        )
        for entry in trace.aiming
    )
    hits, largest = trace.scattered_rays_per_start, trace.largest_ray_share
    warnings = []
    low = sorted((row for row in rows if row.low), key=lambda row: row.share_landed)
    if low:
        named = _names([f"{row.surface} {100 * row.share_landed:.2g} %" for row in low])
        warnings.append(
            f"few aimed rays reach the detector (less than {100 * LEAST_LANDED:g} %): {named}. Give these surfaces a "
            "smaller target or several; where only a lens is in view, more is not possible"
        )
    tight = [row.surface for row in rows if row.tight]
    if tight:
        warnings.append(
            f"every aimed ray reaches the detector: {_names(tight)}. These targets may be too small; enlarge them "
            "until some rays miss"
        )
    silent = [f"{place.id} {100 * place.share:.2g} %" for place in trace.silent if place.share >= LEAST_LIT]
    if silent:
        count = f"{len(silent)} surfaces or bodies scatter" if len(silent) > 1 else "one surface or body scatters"
        warnings.append(
            f"{count} light, but none of it reaches the detector: {_names(silent)} (share of the launched "
            "flux). If the detector sees such a place, give it a target or raise rays"
        )
    if rows or hits > 0 or trace.silent:
        if hits < LEAST_HITS:
            warnings.append(
                f"only {hits:.2g} scattered rays reach the detector per start ray (at least {LEAST_HITS:g} is good); "
                "raise aimed_rays, or give the surfaces that scatter a target"
            )
        if hits > MOST_HITS:
            warnings.append(
                f"{hits:.3g} scattered rays reach the detector per start ray (at most {MOST_HITS:g} is good); trace "
                "more start rays with fewer scattered ones: lower aimed_rays or scatter_rays, or raise "
                "scatter_threshold"
            )
    if largest > LARGEST_SHARE:
        warnings.append(
            f"one ray carries {100 * largest:.2g} % of the scattered light (at most {100 * LARGEST_SHARE:g} % is "
            "good); raise rays, or give the surface that scattered it a target"
        )
    return SamplingCheck(rows, hits, largest, trace.effective_scattered_rays, tuple(warnings))

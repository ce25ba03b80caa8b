"""Comparison of a PST with those that allow one more event on each path, and choice among them by stray light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mitsuba as mi
import numpy as np

from mistray.analyses.pst.result import Pst
from mistray.metrics.next_order import NextOrder, decided, next_limits
from mistray.settings import BATCHES, Settings
from mistray.surfaces.surfaces import SurfaceTable
from mistray.time_budget import is_limited, left, within

LEAST_SHARE = 0.4  # fraction of the time of the first measurement that another one needs at least to be started


def with_next_orders(scene: mi.Scene, first: Pst, seconds: float, measure: Callable[..., Pst]) -> Pst:
    """
    Return the PST to be used, after computing it again with one more scatter event, and with one more reflection.

    Both have the seed of the first and together as many rays as it had, whatever the time: equal seeds give equal
    results. Within a time budget they also have together as much time, except that a pass is never interrupted. The
    stray light is compared angle by angle. If a time budget is too short for one of them, a note reports it.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    first : Pst
        PST to compare with.
    seconds : float
        Time of the first measurement, s.
    measure : callable
        Takes a limit by its name and rays, as in ``measure(max_scatters=2, rays=1000)``, and returns the PST with them,
        otherwise computed as `first`.

    Returns
    -------
    Pst
        The PST with the further event whose change matters, or changes most of two such; else `first`. It has
        `next_orders`.
    """
    facts = first.facts
    settings = Settings(**facts["settings"])
    table = SurfaceTable(scene, float(facts["wavelength_nm"][0]), facts["detector"])
    limits = next_limits(settings, table)
    # Rays at each angle (forward), or from the detector
    rays = int(np.max(facts["rays_of_cell"] if first.method == "forward" else facts["rays"]))
    found: list[tuple[Pst, NextOrder]] = []
    late: list[str] = []
    prepared = seconds - float(facts["seconds"])  # time of the first one outside of its passes
    for limit, allowed in limits.items():
        if left() < max(LEAST_SHARE * seconds, prepared):
            late.append(f"the time was up before {limit} = {allowed} was measured")
            continue
        with within(seconds / len(limits) if is_limited() else None):
            more = measure(**{limit: allowed}, rays=max(rays // len(limits), BATCHES))
        found.append((more, _compared(first, more, limit, allowed)))
    orders = decided([order for _, order in found])
    chosen = next((more for (more, _), order in zip(found, orders, strict=True) if order.taken), first)
    notes = {"notes": [*chosen.facts["notes"], *late]} if late else {}
    return replace(chosen, next_orders=orders, facts=chosen.facts | notes)


def _compared(first: Pst, more: Pst, limit: str, allowed: int) -> NextOrder:
    (before, before_se), (after, after_se) = first.curve("stray"), more.curve("stray")
    names = tuple(f"the stray PST at {angle:g}°" for angle in first.field_deg)
    difference_se = np.hypot(before_se, after_se)
    if first.weight.shape == more.weight.shape and first.facts["rays"] == more.facts["rays"]:
        apart = replace(first, by_batch=more.by_batch - first.by_batch)  # same rays: errors cancel by batch
        difference_se = apart.curve("stray")[1]
    return NextOrder(limit, allowed, names, before, before_se, after, after_se, difference_se)

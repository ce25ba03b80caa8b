"""A PST beside those with one more event on each path; the result is the one that the light asks for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mitsuba as mi
import numpy as np

from mistray.analysis.next_order import NextOrder, decided, next_limits
from mistray.analysis.pst.result import Pst
from mistray.settings import BATCHES, Settings
from mistray.surfaces.surfaces import SurfaceTable
from mistray.time_budget import is_limited, left, within

LEAST_SHARE = 0.4  # of the time of the first measurement, in which another one is prepared and begins


def with_next_orders(scene: mi.Scene, first: Pst, seconds: float, measure: Callable[..., Pst]) -> Pst:
    """
    Measure a PST with one more scatter event and, apart from that, with one more reflection.

    They have the seed of the first and share as many rays as it had, whatever the time: equal seeds find equal numbers.
    Within a time budget they also share as much time; what a pass takes, it takes. The stray light is compared angle by
    angle. A note says so where a time budget is too short for one of them.

    Parameters
    ----------
    scene : mi.Scene
    first : Pst
    seconds : float
        That it took.
    measure : callable
        Gets a limit by its name and rays, as in ``measure(max_scatters=2, rays=1000)``, and gives the PST with them,
        else as `first`.

    Returns
    -------
    Pst
        With `next_orders`: that with more events if they matter, of both the one that changes more, or else `first`.
    """
    facts = first.facts
    settings = Settings(**facts["settings"])
    table = SurfaceTable(scene, float(facts["wavelength_nm"][0]), facts["detector"])
    limits = next_limits(settings, table)
    # At each angle, or from the detector
    rays = int(np.max(facts["rays_of_cell"] if first.method == "forward" else facts["rays"]))
    found: list[tuple[Pst, NextOrder]] = []
    prepared = seconds - float(facts["seconds"])  # what the first one took but for its passes
    for limit, allowed in limits.items():
        if left() < max(LEAST_SHARE * seconds, prepared):
            first.facts["notes"] = [*first.facts["notes"], f"the time was up before {limit} = {allowed} was measured"]
            continue
        with within(seconds / len(limits) if is_limited() else None):
            more = measure(**{limit: allowed}, rays=max(rays // len(limits), BATCHES))
        found.append((more, _compared(first, more, limit, allowed)))
    orders = decided([order for _, order in found])
    chosen = next((more for (more, _), order in zip(found, orders, strict=True) if order.taken), first)
    return replace(chosen, next_orders=orders)


def _compared(first: Pst, more: Pst, limit: str, allowed: int) -> NextOrder:
    (before, before_se), (after, after_se) = first.curve("stray"), more.curve("stray")
    names = tuple(f"the stray PST at {angle:g}°" for angle in first.field_deg)
    difference_se = np.hypot(before_se, after_se)
    if first.weight.shape == more.weight.shape and first.facts["rays"] == more.facts["rays"]:
        apart = replace(first, by_batch=more.by_batch - first.by_batch)  # batch by batch: the same rays
        difference_se = apart.curve("stray")[1]
    return NextOrder(limit, allowed, names, before, before_se, after, after_se, difference_se)

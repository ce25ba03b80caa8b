"""Images of points in step 8 of a study: contrast with all stray light, at the fields of the ghost analysis."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import mitsuba as mi
import pandas as pd

from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.image.run import LAST_GRID, image_quality
from mistray.analyses.study.step import Fact, gathered
from mistray.analyses.transfer.request import TransferRequest
from mistray.analyses.transfer.result import AZIMUTHS, Transfer
from mistray.analyses.transfer.run import run as transfer
from mistray.errors import MistrayError
from mistray.metrics.ghost_ranking import direct_image
from mistray.time_budget import coarse_first, is_limited, left

QUICK_GRID = 64  # cells across the pupil of a first look
LEAST_S = 3.0  # s, with less there are no images
CONTRAST = 0.5  # whose frequency the findings say


def images_with_stray_light(
    scene: mi.Scene,
    report: GhostReport,
    light: Mapping[str, Any],
    settings: Mapping[str, Any],
    quick: bool,
    progress: Callable[[int, int], None],
) -> Transfer | str:
    """
    Return the images of points at those fields of a ghost analysis whose direct image meets the detector.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    report : GhostReport
        Ghost analysis.
    light : mapping
        ``wavelength_nm``, ``weights`` and ``azimuth_deg`` of the study.
    settings : mapping
        Settings of the traces.
    quick : bool
        Use a coarse pupil. A time budget also makes it coarse if it is too short for a fine one, and may leave fields
        out.
    progress : callable
        Called with (fields done, fields in all).

    Returns
    -------
    Transfer or str
        Images, or in one line the reason why there are none.
    """
    fields = [field for field in report if direct_image(report[field].paths).power_W.value > 0]
    if not fields:
        return "no direct light meets the detector"
    if left() < LEAST_S:
        return "the time was too short for images of points"
    try:
        if is_limited():
            began = time.perf_counter()
            image_quality(scene, fields[:1], grid=QUICK_GRID, **light)
            each = time.perf_counter() - began
            fields = sorted(coarse_first(fields)[: max(1, int(left() / (2 * each)))], key=fields.index)
            quick = quick or len(fields) * each * (LAST_GRID / QUICK_GRID) ** 2 > left()
        quality = image_quality(scene, fields, grid=QUICK_GRID if quick else None, **light)
        return transfer(scene, TransferRequest(settings=settings), quality=quality, progress=progress)
    except MistrayError as error:
        return str(error)


def transfer_tables(found: Transfer) -> dict[str, pd.DataFrame]:
    """
    Return DataFrames of results, energy balances, transfer functions and rings for all fields, by table name.

    Frequencies are in 1/mm, radii in mm, irradiances in 1/mm², and shares 0 … 1.
    """
    return {
        "image_with_stray_light": found.to_pandas(),
        "books": found.books(),
        "transfer_functions": gathered("field_deg", ((one.image.field_deg, one.to_pandas()) for one in found)),
        "image_rings": gathered("field_deg", ((one.image.field_deg, one.rings_to_pandas()) for one in found)),
    }


def transfer_facts(found: Transfer) -> list[Fact]:
    """Return as facts the veiling floor of each field: contrast of fine detail over that without stray light, 0 … 1."""
    return [Fact(f"veiling floor at {one.name}", one.veiling_floor) for one in found]


def transfer_findings(found: Transfer) -> list[str]:
    """
    Return one sentence on the contrast lost to stray light, at the field where the loss is largest.

    If there is no loss, the sentence says so.
    """
    worst = min(found, key=lambda one: one.veiling_floor.value)
    floor = worst.veiling_floor
    lost, se = 100 * (1 - floor.value), 100 * floor.se
    if lost <= 0:
        return ["No stray light lowers the contrast of the image within the limits of the traces."]
    parts = [(name, 100 * worst.shares[name].value) for name in ("ghosts", "scatter")]
    told = " and ".join(f"{name} {value:.3g} %" for name, value in parts if value > 0)
    text = f"Stray light takes {lost:.3g} % ± {se:.1g} % of the contrast of fine detail at {worst.name} ({told} of the"
    text += " light on the detector)"
    without, with_stray = (worst.frequency_at(CONTRAST, AZIMUTHS[0], stray) for stray in (False, True))
    if math.isfinite(with_stray) and math.isfinite(without):
        text += f"; its MTF falls to {100 * CONTRAST:g} % at {with_stray:.4g} instead of {without:.4g} per mm"
    return [text + "."]

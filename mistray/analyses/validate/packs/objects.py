"""Flux that a detector sends to the objects that it sees, or that reaches the objects that light from outside meets."""

from __future__ import annotations

import functools

from mistray.analyses.objects.result import Objects
from mistray.analyses.objects.run import objects
from mistray.analyses.validate.declared import DeclaredRow, ReferenceFile
from mistray.analyses.validate.pack import Finder
from mistray.analyses.validate.scene_numbers import SceneNumbers
from mistray.estimate import Estimate

DISC_MM = -5.749, 3.083  # z and radius of the source outside, 5 mm in front of the window
OUTSIDE_DEG, DETECTOR_DEG = 20.0, 45.0  # half angles of the light from outside and from the detector


def ours(file: ReferenceFile, rays: int | None, seed: int) -> Finder:
    """
    Return the function that gives the flux, W, on the objects of a row, from 1 W of light that is only transmitted.

    Parameters are those of `SceneNumbers`.
    """
    scenes = SceneNumbers(file, rays, seed)

    @functools.cache
    def searched() -> Objects:
        return objects(
            scenes.scene(file.rows[0]),
            rays=rays or file.rays,
            disc_mm=DISC_MM,
            half_angle_deg=OUTSIDE_DEG,
            view_half_angle_deg=DETECTOR_DEG,
            threshold=0.0,
            total_reflection=False,
            seed=seed,
        )

    def number(row: DeclaredRow) -> Estimate:
        places = row.argument("here")
        if not places:  # no shape of the scene stands for what the source lists
            return Estimate(0.0, 0.0)
        found = searched()
        met = [entry for entry in getattr(found, row.argument("list")) if f"{entry.id}:{entry.side}" in places]
        if not met:  # a single ray would be this much
            return Estimate(0.0, 1 / found.facts["rays"])
        return Estimate(sum(entry.power for entry in met), sum(entry.power_se**2 for entry in met) ** 0.5)

    return number

"""Veiling glare index (ISO 9358) of a detector behind a window, from a PST, beside the closed form for its ghost."""

from __future__ import annotations

import numpy as np

from mistray.analyses.pst.glare.glare import veiling_glare_index
from mistray.analyses.pst.run import pst
from mistray.analyses.validate.declared import DeclaredRow, ReferenceFile
from mistray.analyses.validate.pack import Finder
from mistray.analyses.validate.scene_numbers import FAINTEST, SceneNumbers
from mistray.estimate import Estimate

CELL_DEG = 0.2
ANGLES_DEG = np.arange(0.5 * CELL_DEG, 1.8, CELL_DEG)  # of the white source, to 1.8°


def ours(file: ReferenceFile, rays: int | None, seed: int) -> Finder:
    """
    Return the function that gives mistray's veiling glare index, percent; parameters are those of `SceneNumbers`.

    The black patch has a radius of 0.2°, the white source one of 1.8°.
    """
    scenes = SceneNumbers(file, rays, seed)

    def number(row: DeclaredRow) -> Estimate:
        found = pst(
            scenes.scene(row),
            ANGLES_DEG,
            cell_deg=CELL_DEG,
            method="adjoint",
            rays=rays or file.rays,
            seed=seed,
            max_reflections=6,
            flux_threshold=FAINTEST,
        )
        glare = veiling_glare_index(found, CELL_DEG, source_deg=1.8, place="point")
        return Estimate(glare.value, glare.se)

    return number

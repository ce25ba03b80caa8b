"""Every sample lens of optiland: it is read, closed to a system, and its rays are optiland's own."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import peers
import pytest

from mistray.io.optiland import from_optiland
from mistray.prescription import from_optiland as take_over
from mistray.prescription import to_optiland
from mistray.prescription.closing.system import build
from mistray.prescription.sequential.rays import to_world, trace

pytestmark = pytest.mark.validation

OBJECTIVES = pytest.param("objectives", marks=pytest.mark.long)  # as many as all others together
FILES = ("eyepieces", "infrared", "lithography", "microscopes", "miscellaneous", OBJECTIVES, "simple", "telescopes")


# An image plane that the light meets from behind, which is no table of surfaces in the order of light
NOT_BACK = ("Microscope20x",)


def kinds(file: str) -> list[Any]:
    samples = peers.optiland(f"samples.{file}")
    found = [kind for _, kind in inspect.getmembers(samples, inspect.isclass) if kind.__module__ == samples.__name__]
    assert found
    return found


@pytest.mark.parametrize("file", FILES)
@pytest.mark.filterwarnings("ignore")
def test_there_and_back(file: str) -> None:
    """A lens that was closed to a system and given back has the same rays and the same clear apertures."""
    for kind in kinds(file):
        if kind.__name__ in NOT_BACK:
            continue
        optic = kind()
        lens = take_over(optic)
        back = to_optiland(lens)
        start = np.asarray(list(optic.surfaces)[1].geometry.cs.z, dtype=float)
        optic.trace(Hx=0, Hy=0, wavelength=optic.primary_wavelength, num_rays=6, distribution="hexapolar")
        there = {key: np.asarray(getattr(optic.surfaces, key), dtype=float) for key in "xyzLMN"}
        along = [there[key][0] for key in "LMN"]
        first = [there[key][1] - step for key, step in zip("xyz", along, strict=True)]
        count = len(along[0])
        rays = peers.optiland("rays").RealRays(
            first[0], first[1], first[2] - start, *along, np.ones(count), np.full(count, optic.primary_wavelength)
        )
        back.surfaces.trace(rays)
        assert np.asarray(rays.x) == pytest.approx(there["x"][-1], abs=1e-6), kind.__name__
        assert np.asarray(rays.y) == pytest.approx(there["y"][-1], abs=1e-6), kind.__name__
        again = take_over(back)
        assert [s.outer_radius for s in again.surfaces] == pytest.approx([s.outer_radius for s in lens.surfaces])


@pytest.mark.parametrize("file", FILES)
@pytest.mark.filterwarnings("ignore")
def test_samples(file: str) -> None:
    for kind in kinds(file):
        optic = kind()
        lens = from_optiland(optic)
        assert build(lens).prescription.surfaces
        for field in (0.0, 0.7, 1.0):
            optic.trace(Hx=0, Hy=field, wavelength=optic.primary_wavelength, num_rays=6, distribution="hexapolar")
            theirs = {key: np.asarray(getattr(optic.surfaces, key), dtype=float) for key in "xyzLMN"}
            first = np.stack([theirs[key][1] for key in "xyz"], axis=1)
            along = np.stack([theirs[key][0] for key in "LMN"], axis=1)
            hits, _ = trace(lens, first - along, along, 1e3 * optic.primary_wavelength)
            last = np.stack([theirs[key][-1] for key in "xyz"], axis=1)
            assert np.isfinite(last).all()
            assert to_world(lens, hits)[-1] == pytest.approx(last, abs=1e-9), kind.__name__

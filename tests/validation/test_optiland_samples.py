"""Every sample lens of optiland: it is read, closed to a system, and its rays are optiland's own."""

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
def test_samples(file: str) -> None:
    """A lens that was closed to a system and given back has the same rays, too, and the same clear apertures."""
    for kind in kinds(file):
        optic = kind()
        nm, read = 1e3 * optic.primary_wavelength, from_optiland(optic)
        assert build(read).prescription.surfaces
        for field in (0.7, 1.0, 0.0):
            optic.trace(Hx=0, Hy=field, wavelength=optic.primary_wavelength, num_rays=6, distribution="hexapolar")
            there = {key: np.asarray(getattr(optic.surfaces, key), dtype=float) for key in "xyzLMN"}
            along, first, last = (
                np.stack([there[key][k] for key in keys]) for k, keys in ((0, "LMN"), (1, "xyz"), (-1, "xyz"))
            )
            hits, _ = trace(read, (first - along).T, along.T, nm)
            assert np.isfinite(last).all()
            assert to_world(read, hits)[-1] == pytest.approx(last.T, abs=1e-9), kind.__name__
        if kind.__name__ in NOT_BACK:
            continue
        lens = take_over(optic)
        back = to_optiland(lens)
        start, one = float(np.asarray(list(optic.surfaces)[1].geometry.cs.z)), np.ones(len(last.T))
        place = first - along - [[0.0], [0.0], [start]]
        rays = peers.optiland("rays").RealRays(*place, *along, one, one * optic.primary_wavelength)
        back.surfaces.trace(rays)
        assert np.stack([rays.x, rays.y]) == pytest.approx(last[:2], abs=1e-6), kind.__name__
        again = take_over(back)
        assert [s.outer_radius for s in again.surfaces] == pytest.approx([s.outer_radius for s in lens.surfaces])

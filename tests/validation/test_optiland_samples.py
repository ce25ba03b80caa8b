"""Every sample lens of optiland: it is read, closed to a system, and its rays are optiland's own."""

from __future__ import annotations

import inspect

import numpy as np
import peers
import pytest

from mistray.io.optiland import from_optiland
from mistray.prescription.closing.system import build
from mistray.prescription.sequential.rays import to_world, trace

pytestmark = pytest.mark.validation

FILES = ("eyepieces", "infrared", "lithography", "microscopes", "miscellaneous", "objectives", "simple", "telescopes")


@pytest.mark.parametrize("file", FILES)
@pytest.mark.filterwarnings("ignore")
def test_samples(file: str) -> None:
    samples = peers.optiland(f"samples.{file}")
    found = [kind for _, kind in inspect.getmembers(samples, inspect.isclass) if kind.__module__ == samples.__name__]
    assert found
    for kind in found:
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

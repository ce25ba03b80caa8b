"""The phone camera with scatter: the models of the study's Tables 11 to 13, and what they leave of the ghosts."""

from __future__ import annotations

import numpy as np
import pytest
import vectors

import mistray
from mistray.scatter.harvey_shack import HarveyShack
from mistray.scatter.paint import Paint
from mistray.scatter.particulate import Particulate
from mistray.scatter.total import lobe_total

WAVELENGTH_NM = 550.0
RAYS = 500
OUTSIDE = {"window_front", "barrel_0_recess", "barrel_0_front_face"}


@pytest.fixture(scope="module")
def scene():
    return mistray.load("phone_camera_scatter")


@pytest.fixture(scope="module")
def models(scene) -> dict[str, dict[type, object]]:
    """Models of every face by their class."""
    return {shape.id(): {type(model): model for model in shape.bsdf().scatter} for shape in scene.shapes()}


def test_every_face_has_its_models(scene, models) -> None:
    """Table 12: polish on what light crosses, flat black on the structure, particles on everything."""
    for shape in scene.shapes():
        found = models[shape.id()]
        assert found[Particulate].level == (400 if shape.id() in OUTSIDE else 300), shape.id()
        assert found[Particulate].slope == pytest.approx(0.926)
        if shape.id() == "detector":
            assert len(found) == 1
        elif shape.bsdf().opaque:
            assert found[Paint].reflectance == pytest.approx(0.045)
            assert float(shape.bsdf().R[0]) == pytest.approx(0.07)
        else:
            polish = found[HarveyShack]
            assert (polish.rms_nm, polish.l, polish.s) == pytest.approx((4.0, 0.01, -1.5))


def test_table_13(models) -> None:
    """b0 and TIS of 40 Å in transmission with the indices that the table has, to its rounding."""
    polish = models["L1_front"][HarveyShack]
    for row in vectors.frame("harvey_table13.csv").itertuples():
        lobes = polish.lobes(WAVELENGTH_NM, 1.0, row.n, True)
        (lobe,) = (lobe for lobe in lobes if lobe.event == "transmission")
        assert float(lobe.profile(np.zeros(1))[0]) == pytest.approx(row.b0_seed, rel=1e-3)
        tis = 100 * float(lobe_total(lobe, np.ones(1), 1.0, row.n)[0])
        assert tis == pytest.approx(row.TIS_pct_seed, abs=6e-5)


def test_ghosts_are_those_of_the_camera_less_what_scatter_takes(scene, models) -> None:
    """The same paths; a path through all faces once loses what they scatter and absorb, less at normal incidence."""
    plain, scattering = (
        mistray.trace(s, rays=RAYS, max_scatters=0, flux_threshold=0.0) for s in (mistray.load("phone_camera"), scene)
    )
    assert abs(scattering.energy.closure) < 1e-5
    clean = {row.events: row for row in plain.paths}
    dirty = {row.events: row for row in scattering.paths}
    assert dirty.keys() == clean.keys()
    for events, row in dirty.items():
        assert row.rays == clean[events].rays
        assert 0.85 < row.power_W / clean[events].power_W < 1, events

    kept = {1.0: 1.0, 0.5: 1.0}  # cosine of incidence → share that the direct path keeps
    for shape in scene.shapes():
        if shape.bsdf().opaque or "bevel" in shape.id():
            continue
        n_in, n_out = shape.bsdf().indices(WAVELENGTH_NM)
        for cosine in kept:
            cos_i = np.full(1, cosine)
            for model in models[shape.id()].values():
                for lobe in model.lobes(WAVELENGTH_NM, n_in, n_out, True):
                    if lobe.event == "transmission" and lobe.optical_depth is not None:
                        kept[cosine] *= 1 - lobe.optical_depth * float(lobe.oblique(cos_i)[0])
                    elif lobe.event == "transmission":
                        kept[cosine] *= 1 - float(lobe_total(lobe, np.ones(1), n_in, n_out)[0])
    direct = next(events for events, row in clean.items() if row.kind == "direct")
    ratio = dirty[direct].power_W / clean[direct].power_W
    assert kept[0.5] < ratio < kept[1.0]

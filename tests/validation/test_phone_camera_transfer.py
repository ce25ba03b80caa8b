"""The rule of the phone camera study's Figure 36, 1 - TIS, with the TIS of its Table 13, in the traced camera."""

import math

import numpy as np
import pytest

import mistray
from mistray.scenes.phone_camera.prescription import build
from mistray.scenes.phone_camera_scatter.prescription import POLISH

pytestmark = [pytest.mark.validation, pytest.mark.long]

# Table 13, per cent for each face at normal incidence and 550 nm, and faces: window, L1 and L4, L2, L3 and L5, filter
TABLE_13 = ((0.1243, 2), (0.0618, 4), (0.0834, 6), (0.0558, 2))
PRODUCT = math.prod((1 - tis / 100) ** faces for tis, faces in TABLE_13)
OBLIQUE = 0.02  # of the TIS: angles of incidence, where the horizon cuts the lobe, and the window's index


def test_the_direct_light_and_the_mtf_of_the_polished_camera_fall_to_1_less_tis():
    """(1 - TIS) times the direct MTF, but for scatter onto the detector: the floor lies between 1 - TIS and 1."""
    camera = build()
    optics = {shape.name: (POLISH,) for shape in camera.shapes() if not (shape.coating and shape.coating.opaque)}
    optics.pop("detector", None)  # as it is
    kept = []
    for scene in (camera.to_scene(), camera.with_scatter(optics).to_scene()):
        t = mistray.trace(scene, rays=2000, field_deg=0.0, max_reflections=0, max_scatters=0)
        kept.append(t.paths.power(t.paths.ids(True).tolist())[0])
    assert kept[1] / kept[0] == pytest.approx(PRODUCT, abs=OBLIQUE * (1 - PRODUCT))
    found = mistray.transfer(scene, 0.0, frequencies_per_mm=[0.0, 100.0, 300.0], rays=4000, max_reflections=0)[0]
    floor = found.veiling_floor
    assert PRODUCT < floor.value < 1
    mtf = found.composite()
    # Where scatter is not resolved; 5 standard errors, false alarm 1e-6
    np.testing.assert_array_less(np.abs(mtf.value[1:] / found.lens()[1:] - floor.value), 5 * mtf.se[1:] + 1e-4)

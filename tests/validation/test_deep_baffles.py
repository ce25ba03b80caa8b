"""Deep transmittance of a two-stage baffle against walks in float64 from its optic."""

from pathlib import Path

import numpy as np
import pytest
from oracles.lens_behind_baffle import BaffledLens

import mistray
from mistray.prescription import Coating, Detector, Prescription, Scatter, Source, two_stage_baffle

ALBEDO = 0.02
SPLITS = {-22.8: 3, -53.9: 10, -66.4: 3, -92.7: 3}  # of the walks, by z


@pytest.mark.validation
@pytest.mark.slow
def test_transmittance_of_1e_10_is_that_of_a_random_walk(tmp_path: Path) -> None:
    """Both to 5 % or better, compared within 4 combined standard errors: false alarms 6e-5 for each of two sums."""
    baffle = two_stage_baffle("b", optic_radius=10, z_rear=0, field_deg=5, exclusion_deg=40, depth=8, clearance=0.2)
    inner, outer = baffle.inner, baffle.outer
    paint = Scatter("paint", {"reflectance": ALBEDO}, name="paint")
    system = Prescription(
        name="two stages",
        surfaces=(),
        structures=baffle.structures(coating=Coating(R=0.0), scatter=(paint,)),
        detector=Detector(z=inner.z_rear, semi_diameter=inner.optic_radius),
        source=Source(radius=outer.vanes[0].radius, z=outer.z_front, plane="axis"),
    )
    system.to_xml(tmp_path / "scene.xml")
    for scatters in (4, 5):
        walk = BaffledLens.read(tmp_path / "scene.xml", ALBEDO, scatters)
        ((wanted, wanted_se),) = walk.pst([(45.0, 75.0)], 320_000, SPLITS, seed=1)
        limits = {"max_scatters": scatters, "max_reflections": 0}
        found = mistray.pst(system.to_scene(), [60.0], cell_deg=30.0, rays=1_500_000, **limits)
        value, se = found.value[0], found.standard_error[0]
        assert wanted_se < 0.05 * wanted
        assert se < 0.08 * value
        assert abs(value - wanted) < 4 * np.hypot(se, wanted_se)
        assert value < 1e-10

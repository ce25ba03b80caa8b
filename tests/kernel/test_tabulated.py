"""A traced table of a paint scatters as the paint itself, from both kinds of files."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from lit_detector import BLACK, lit, square

import mistray
from mistray.scatter.measured.bsdf_csv import write_bsdf_csv
from mistray.scatter.measured.zemax_bsdf import write_zemax_bsdf
from mistray.scatter.paint import Paint
from mistray.scatter.scan import table

GLOSS = {"reflectance": 0.1, "b0": 0.3, "l": 0.2, "s": -3.0, "n": 1.5}
ACCURACY = 0.02  # of a measured BSDF, and of its interpolation between angles 5° apart


@pytest.mark.slow
def test_paint_and_its_tables(tmp_path: Path) -> None:
    """Expected to fail in less than 1e-5 of seeds: the errors of ≤ 0.3 % are well below the accuracy."""
    paint, angles = Paint(**GLOSS), np.arange(0, 90, 5)
    write_bsdf_csv(table(paint, angles, "normal"), tmp_path / "paint.csv")
    write_zemax_bsdf(table(paint, angles, "specular"), tmp_path / "paint.bsdf")
    files = [{"type": "tabulated", "file": str(tmp_path / f"paint.{kind}")} for kind in ("csv", "bsdf")]
    turned = mi.ScalarTransform4f().translate([0, 0, 20]).rotate([0, 1, 0], -25)
    beam, wall = {"type": "collimated", "radius": 1.0}, {"type": "asphere", "semi_diameter": 30.0, "to_world": turned}
    found = []
    for model in ({"type": "paint", **GLOSS}, *files):
        scene = lit(beam, wall={**wall, "bsdf": {**BLACK, "model": model}}, detector=square(6.0, x=20.0, z=-5.0))
        energy = mistray.trace(scene, rays=50_000).energy
        assert energy.detected_se_W < 3e-3 * energy.detected_W
        assert abs(energy.closure) < 1e-5
        found.append(energy.detected_W)
    assert found[1:] == pytest.approx([found[0]] * 2, rel=ACCURACY)
    assert found[1] != found[2]  # two tables are two models

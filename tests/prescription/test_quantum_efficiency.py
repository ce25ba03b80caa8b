"""A detector whose table of R and T says how much of the light it detects, reflects and loses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mistray
from mistray.prescription import Coating, Detector, Prescription, Source, Surface

pytestmark = pytest.mark.quick
TABLE = """wavelength_nm,angle_deg,R,T
500,0,0.2,0.1
500,60,0.4,0.3
700,0,0.1,0.5
700,60,0.3,0.6
"""


@pytest.mark.parametrize("field_deg", [0.0, 40.0, 60.0])
def test_the_books_have_what_is_detected_lost_and_reflected(tmp_path: Path, field_deg: float) -> None:
    """Linear between the nodes in wavelength and cosine; 600 nm lies in the middle."""
    (tmp_path / "qe.csv").write_text(TABLE, encoding="utf-8")
    size = {"half_width": 5.0, "half_height": 5.0}
    scene = Prescription(
        name="sensor",
        surfaces=(),
        structures=(Surface("lost", z=10.1, coating=Coating(R=0.0), **size),),
        detector=Detector("sensor", z=10.0, coating=Coating(table=str(tmp_path / "qe.csv")), **size),
        source=Source(z=10.0, radius=1.0),
    ).to_scene()
    t = mistray.trace(scene, rays=3000, field_deg=field_deg, wavelength_nm=(500.0, 600.0))
    along = (np.cos(np.radians(field_deg)) - 0.5) / 0.5  # 1 at 0°, 0 at 60°
    for nm, at_0, at_60 in ((500.0, (0.2, 0.1), (0.4, 0.3)), (600.0, (0.15, 0.3), (0.35, 0.45))):
        r, lost = along * np.array(at_0) + (1 - along) * np.array(at_60)
        energy = t.energy_at(nm)
        assert energy.detected_W == pytest.approx((1 - r - lost) * energy.launched_W, rel=1e-5)
        assert energy.absorbed["lost"][0] == pytest.approx(lost * energy.launched_W, rel=1e-5)
        assert energy.escaped_W == pytest.approx(r * energy.launched_W, rel=1e-5)
    assert abs(t.energy.closure) < 1e-6

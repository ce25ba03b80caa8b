"""Lens files with a near object: the light of a point comes to the image that the file has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mistray
from mistray.io.to_sequential import to_sequential
from mistray.io.zemax.write import write_zemax
from mistray.prescription import ObjectPoint, from_zemax

pytestmark = pytest.mark.quick

# An ellipsoid of revolution images one focus in the other without aberrations: at R/(1 - e) and R/(1 + e)
RADIUS, ECCENTRICITY = -60.0, 0.5
FAR, NEAR = -RADIUS / (1 - ECCENTRICITY), -RADIUS / (1 + ECCENTRICITY)
ELLIPSOID = f"""MODE SEQ
OBNA 0.1 0
FTYP 1 0 2 1 0 0 0
XFLN 0 0
YFLN 0 2
WAVM 1 0.55 1
SURF 0
  DISZ {FAR}
SURF 1
  STOP
  CURV {1 / RADIUS}
  CONI {-(ECCENTRICITY**2)}
  GLAS MIRROR 0 0
  DISZ {-NEAR}
SURF 2
  DISZ 0
  DIAM 3 1
"""


def test_an_ellipsoid_images_its_focus(tmp_path: Path) -> None:
    """It is written as it was read: Zemax file, scene, Zemax file."""
    file = tmp_path / "ellipsoid.zmx"
    file.write_text(ELLIPSOID)
    lens = from_zemax(file)
    assert isinstance(lens.source, ObjectPoint)
    lens.to_xml(tmp_path / "scene.xml")
    for scene in (lens.to_scene(), mistray.load(tmp_path / "scene.xml")):
        (direct,) = mistray.trace(scene, rays=20_000, max_reflections=0).paths.select("kind == 'direct'")
        assert direct.rms_radius_mm < 1e-4
        assert np.hypot(direct.x_mm, direct.y_mm) < 1e-4
        moved = mistray.trace(scene, rays=20_000, field_mm=1.0, max_reflections=0)
        assert moved.paths.select("kind == 'direct'")[0].y_mm == pytest.approx(-NEAR / FAR, rel=0.05)
    write_zemax(to_sequential(lens), tmp_path / "back.zmx")
    back = from_zemax(tmp_path / "back.zmx").source
    assert isinstance(back, ObjectPoint)
    assert back.distance - back.z == pytest.approx(FAR)

"""Lens files with a near object: the light of a point comes to the image that the file has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mistray
from mistray import cli
from mistray.io.to_sequential import to_sequential
from mistray.io.zemax.write import write_zemax
from mistray.prescription import ObjectPoint, Prescription, from_zemax

pytestmark = pytest.mark.quick

# An ellipsoid of revolution images one focus in the other without aberrations: at R/(1 - e) and R/(1 + e)
RADIUS, ECCENTRICITY = -60.0, 0.5
FAR, NEAR = -RADIUS / (1 - ECCENTRICITY), -RADIUS / (1 + ECCENTRICITY)
ELLIPSOID = f"""VERS 140000
MODE SEQ
NAME ellipsoid
UNIT MM X W X CM MR CPMM
OBNA 0.1 0
FTYP 1 0 2 1 0 0 0
XFLN 0 0
YFLN 0 2
WAVM 1 0.55 1
PWAV 1
SURF 0
  TYPE STANDARD
  DISZ {FAR}
SURF 1
  STOP
  TYPE STANDARD
  CURV {1 / RADIUS}
  CONI {-(ECCENTRICITY**2)}
  GLAS MIRROR 0 0
  DISZ {-NEAR}
SURF 2
  TYPE STANDARD
  DISZ 0
  DIAM 3 1
"""


@pytest.fixture
def lens(tmp_path: Path) -> Prescription:
    file = tmp_path / "ellipsoid.zmx"
    file.write_text(ELLIPSOID)
    return from_zemax(file)


def test_an_ellipsoid_images_its_focus(lens: Prescription, tmp_path: Path) -> None:
    assert isinstance(lens.source, ObjectPoint)
    lens.to_xml(tmp_path / "scene.xml")
    for scene in (lens.to_scene(), mistray.load(tmp_path / "scene.xml")):
        (direct,) = mistray.trace(scene, rays=20_000, max_reflections=0).paths.select("kind == 'direct'")
        assert direct.rms_radius_mm < 1e-4
        assert np.hypot(direct.x_mm, direct.y_mm) < 1e-4
        moved = mistray.trace(scene, rays=20_000, field_mm=1.0, max_reflections=0)
        assert moved.paths.select("kind == 'direct'")[0].y_mm == pytest.approx(-NEAR / FAR, rel=0.05)


def test_it_is_written_as_it_was_read(lens: Prescription, tmp_path: Path) -> None:
    """Zemax file → scene → Zemax file: the object stays where it is."""
    write_zemax(to_sequential(lens), tmp_path / "back.zmx")
    back = from_zemax(tmp_path / "back.zmx").source
    assert isinstance(back, ObjectPoint)
    assert back.distance - back.z == pytest.approx(FAR)


OFFNER = """VERS 140000
MODE SEQ
NAME Offner
UNIT MM X W X CM MR CPMM
OBNA 0.05 0
FTYP 1 0 1 1 0 0 0
XFLN 0
YFLN 100
WAVM 1 0.55 1
PWAV 1
SURF 0
  TYPE STANDARD
  DISZ 1000
SURF 1
  TYPE STANDARD
  CURV -0.001
  GLAS MIRROR 0 0
  DISZ -500
SURF 2
  STOP
  TYPE STANDARD
  CURV -0.002
  GLAS MIRROR 0 0
  DISZ 500
SURF 3
  TYPE STANDARD
  CURV -0.001
  GLAS MIRROR 0 0
  DISZ -1000
SURF 4
  TYPE STANDARD
  DISZ 0
"""


def test_an_offner_relay_is_traced_at_the_height_of_its_file(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """
    Telecentric, and beside the axis only: import says at which height to trace it.

    Of concentric spheres of R and R/2 each ray is turned by 2 asin 2u - 4 asin u = 2 u³, here 2e-3 with u = h/R. The
    rms of a cone of NA 0.05 is h times that times NA/2.
    """
    file, scene = tmp_path / "offner.zmx", tmp_path / "offner.xml"
    file.write_text(OFFNER)
    assert cli.main(["import", str(file), "-o", str(scene)]) == 0
    assert capsys.readouterr().out.splitlines()[0].endswith(f"mistray ghosts {scene} --field-mm 100")
    t = mistray.trace(mistray.load(scene), rays=50_000, max_reflections=0, field_mm=100.0)
    image = max(t.paths, key=lambda row: row.power_W)
    assert image.events == "S1:R S2:R S3:R detector:A"
    assert (image.x_mm, image.y_mm) == pytest.approx((0.0, -100.0), abs=1e-3)
    assert image.rms_radius_mm == pytest.approx(100 * 2e-3 * 0.05 / 2, rel=0.05)

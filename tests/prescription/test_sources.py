"""Near objects, polarised sources, and detectors with a quantum efficiency, as prescriptions have them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mistray
from mistray.io.to_sequential import to_sequential
from mistray.io.zemax.write import write_zemax
from mistray.prescription import Coating, Detector, ObjectPoint, Prescription, Source, Surface, from_zemax
from mistray.scene.read_optics import read_optics

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


EMPTY = Prescription(name="empty", surfaces=(), detector=Detector(z=20.0, half_width=10.0, half_height=10.0))
SOURCES = [Source(radius=2.0), ObjectPoint(distance=50.0)]
STATES = [
    ({"stokes": (0.25, -0.5, 0.75)}, (0.25, -0.5, 0.75)),
    ({"jones": (1, -1j)}, (0, 0, 1)),
    ({"jones": (0.5 + 1j, 2)}, ((1.25 - 4) / 5.25, 2 / 5.25, 4 / 5.25)),
    ({"polarization_deg": 45.0}, (0, 1, 0)),
    ({}, None),
]


@pytest.mark.parametrize(("light", "stokes"), STATES)
@pytest.mark.parametrize("source", SOURCES)
def test_a_polarised_source_comes_back(tmp_path: Path, source, light, stokes) -> None:
    lens = replace(EMPTY, source=replace(source, **light))
    file = tmp_path / "lens.xml"
    lens.to_xml(file)
    for scene in (lens.to_scene(), mistray.load(file)):
        (emitter,) = scene.emitters()
        assert emitter.stokes == pytest.approx(stokes, abs=1e-12)
    found, _ = read_optics(file)
    assert {key: getattr(found.source, key) for key in light} == light
    text = file.read_text(encoding="utf-8")
    assert any(key in text for key in ("stokes", "jones", "polarization")) == bool(light)


def test_sources_of_a_call_and_refusals() -> None:
    for light in ({"stokes": (1, 1, 1)}, {"jones": (0, 0)}, {"jones": (1, 0), "polarization_deg": 3.0}):
        for source in SOURCES:
            with pytest.raises(mistray.MistrayError, match=next(iter(light))):
                replace(source, **light)
    scene = mistray.load("plate", sources=["beam:radius=2,stokes=0 0.6 0.8"])
    (emitter,) = scene.emitters()
    assert emitter.stokes == pytest.approx((0, 0.6, 0.8))
    assert mistray.trace(scene, rays=64).paths[0].s2 == pytest.approx(0.6, abs=1e-6)


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
    lost = Surface("lost", z=10.1, coating=Coating(R=0.0), **size)
    sensor = Detector("sensor", z=10.0, coating=Coating(table=str(tmp_path / "qe.csv")), **size)
    parts = {"surfaces": (), "structures": (lost,), "detector": sensor, "source": Source(z=10.0, radius=1.0)}
    scene = Prescription(name="sensor", **parts).to_scene()
    t = mistray.trace(scene, rays=3000, field_deg=field_deg, wavelength_nm=(500.0, 600.0))
    along = (np.cos(np.radians(field_deg)) - 0.5) / 0.5  # 1 at 0°, 0 at 60°
    for nm, at_0, at_60 in ((500.0, (0.2, 0.1), (0.4, 0.3)), (600.0, (0.15, 0.3), (0.35, 0.45))):
        r, lost = along * np.array(at_0) + (1 - along) * np.array(at_60)
        energy = t.energy_at(nm)
        assert energy.detected_W == pytest.approx((1 - r - lost) * energy.launched_W, rel=1e-5)
        assert energy.absorbed["lost"][0] == pytest.approx(lost * energy.launched_W, rel=1e-5)
        assert energy.escaped_W == pytest.approx(r * energy.launched_W, rel=1e-5)
    assert abs(t.energy.closure) < 1e-6

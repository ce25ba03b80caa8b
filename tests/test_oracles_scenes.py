"""The shipped scenes under the float64 oracles alone: closed energy, no gaps between media, phone camera figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from oracles import beams, nonsequential, scene_xml
from oracles.geometry import Plane
from oracles.replay import Replay, replay

SCENES = sorted((Path(__file__).parents[1] / "scenes").glob("*/scene.xml"))
PHONE = Path(__file__).parents[1] / "scenes" / "phone_camera" / "scene.xml"
D_LINE_NM = 587.5618
STOP_RADIUS = 1.25171162
LENSES = [f"{part}_{side}" for part in ("L1", "L2", "L3", "L4", "L5", "filter") for side in ("front", "rear")]
WINDOW = ("window_front", "window_rear")
DIRECT = [*((surface, "SpecTran") for surface in LENSES), ("detector", "Absorbed")]


@pytest.mark.long
@pytest.mark.parametrize("path", SCENES, ids=[path.parent.name for path in SCENES])
@pytest.mark.parametrize("field_deg", [0.0, 0.4, 9.0])
def test_energy_closes_and_media_fit(path: Path, field_deg: float) -> None:
    """Every ray meets each surface in the medium that the surface expects, and none ends inside of glass."""
    model = scene_xml.read_scene(path)
    rays = 40 if path.parent.name == "rubin" else 400  # its figure errors take the oracle long
    beam = beams.start(model, rays, field_deg)
    ledger = nonsequential.trace(
        model, beam.origin, beam.direction, beam.power, D_LINE_NM, max_reflections=1, max_events=64, flux_threshold=1e-6
    )
    assert abs(ledger.closure) < 1e-13
    open_plate = path.parent.name in ("plate", "lens_and_reflector")  # no edge: light leaves sideways
    leaks = {key: power for key, power in ledger.leaks_W.items() if not (open_plate and key[1] == "escape")}
    assert not leaks
    if field_deg == 0:
        assert ledger.detected_W > 0
        assert all(kind in ("SpecTran", "SpecRefl", "Absorbed") for _, kind in ledger.paths[0].events)


@pytest.fixture(scope="module")
def phone() -> scene_xml.SceneModel:
    return scene_xml.read_scene(PHONE)


@pytest.fixture(scope="module")
def wide_phone(phone: scene_xml.SceneModel) -> scene_xml.SceneModel:
    """With a larger detector: at 18 deg the image lies at 2.186 mm, the edge of the detector at 2.184 mm."""
    larger = replace(phone.by_id["detector"], surface=Plane(half_width=3.0, half_height=3.0))
    return replace(phone, shapes=tuple(larger if s.shape_id == "detector" else s for s in phone.shapes))


def through_stop(model: scene_xml.SceneModel, field_deg: float, rays: int, radius: float = STOP_RADIUS) -> Replay:
    """Rays that fill the stop plane evenly, through the lenses' rims and nothing else."""
    points = np.column_stack([beams.disc_points(rays, radius), np.zeros(rays)])
    direction = beams.field_direction(field_deg)
    origin = points - 0.3 * direction  # between window and stop
    return replay(model, origin, np.tile(direction, (rays, 1)), DIRECT, D_LINE_NM, first_hit=False)


def chief_height(model: scene_xml.SceneModel, field_deg: float) -> float:
    return float(through_stop(model, field_deg, 1, 1e-12).end[0, 1])


# field, rms spot (um), chief-ray height (mm), relative illumination, share of the stop that passes the rims
PHONE_FIGURES = [
    (0.0, 2.751, 0.0, 1.0, 1.0),
    (5.0, 2.920, 0.57584, 0.9712, 1.0),
    (10.0, 2.999, 1.17260, 0.8914, 1.0),
    (14.0, 3.313, 1.67895, 0.8057, 1.0),
    (15.0, 3.454, 1.80960, 0.7937, 1.0),
    (16.0, 3.900, 1.93940, 0.7993, 1.0),
    (17.0, 3.649, 2.06523, 0.8060, 0.9759),
    (18.0, 3.075, 2.18592, 0.5234, 0.6153),
]


@pytest.mark.long
@pytest.mark.validation
@pytest.mark.parametrize(("field_deg", "rms_um", "chief_mm", "illumination", "passed"), PHONE_FIGURES)
def test_phone_camera_figures(
    wide_phone: scene_xml.SceneModel,
    field_deg: float,
    rms_um: float,
    chief_mm: float,
    illumination: float,
    passed: float,
) -> None:
    """Figures of an independent float64 trace, d line.

    The rms spot is heavy-tailed where the rims cut: a few rays in 1e4 pass the steep rim of L2_rear and land 60 um (17
    deg) or 150 um (18 deg) away, against a median of 2 um. Fully sampled it is 3.74 and 3.18 um there; the figures hold
    to 3 % without the tail beyond 100 um. Elsewhere they hold to 0.5 %, which is the sampling.
    """
    phone = wide_phone
    traced = through_stop(phone, field_deg, 40000)
    hits = traced.end[traced.valid]
    distance = 1e3 * np.linalg.norm(hits - np.median(hits, axis=0), axis=1)
    assert np.mean(distance > 100) < 5e-4
    core = hits[distance < 100]
    rms = 1e3 * np.sqrt(np.mean(np.sum((core - core.mean(axis=0)) ** 2, axis=1)))
    assert rms == pytest.approx(rms_um, rel=5e-3 if passed == 1 else 3e-2)
    assert traced.valid.mean() == pytest.approx(passed, abs=5e-4)
    assert chief_height(phone, field_deg) == pytest.approx(chief_mm, abs=6e-6)
    # irradiance of an even scene by conservation of etendue: A cos(theta) dOmega / dA_image
    step, shares = 0.05, []
    for angle_deg, share in ((0.01, 1.0), (max(field_deg, 0.01), traced.valid.mean())):
        theta, y = np.radians(angle_deg), chief_height(phone, angle_deg)
        slope = (chief_height(phone, angle_deg + step) - chief_height(phone, angle_deg - step)) / np.radians(2 * step)
        shares.append(share * np.cos(theta) * np.sin(theta) / (y * slope))
    assert shares[1] / shares[0] == pytest.approx(illumination, abs=5e-4)


@pytest.mark.validation
def test_phone_camera_on_axis_irradiance(phone: scene_xml.SceneModel) -> None:
    """Detected power of the direct path over pi rms^2, by quadrature over the stop: 129.2 kW/mm^2 per W/mm^2, d line.

    The whole scene blocks nothing of it, and the beam of the scene loses only its rim beyond the stop.
    """
    nodes, weights = np.polynomial.legendre.leggauss(300)
    radius = STOP_RADIUS * np.sqrt(0.5 * (nodes + 1))
    origin = np.stack([0 * radius, radius, np.full_like(radius, -3.0)], axis=1)
    direction = np.tile([0.0, 0.0, 1.0], (len(radius), 1))
    events = [*((surface, "SpecTran") for surface in WINDOW), *DIRECT]
    traced = replay(phone, origin, direction, events, D_LINE_NM)
    assert traced.valid.all(), traced.summary()
    flux = 0.99**4 * 0.98**10 * 0.8
    np.testing.assert_allclose(traced.flux, flux, rtol=1e-12)
    rms2 = 0.5 * weights @ traced.end[:, 1] ** 2
    assert STOP_RADIUS**2 * flux / rms2 == pytest.approx(129.19e3, rel=5e-4)
    emitter = phone.emitters[0]
    beam = beams.collimated(emitter, 3000, 3.0)
    ledger = nonsequential.trace(phone, beam.origin, beam.direction, beam.power, D_LINE_NM, max_reflections=0)
    direct = ledger.paths[0]
    assert direct.power_W == pytest.approx(np.pi * STOP_RADIUS**2 * flux, rel=2e-3)
    assert direct.rms_irradiance_W_mm2 == pytest.approx(129.2e3, rel=5e-3)

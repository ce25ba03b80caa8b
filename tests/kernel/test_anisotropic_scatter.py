"""Scatter that depends on how a sample lies, in a trace: within 4 standard errors (6e-5 each) and what is written at
the test for interpolation."""

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from lit_detector import BLACK, lit, meter
from oracles import brushed
from oracles.statistics import assert_z

import mistray
from mistray.metrics.scene_values import changed

T = mi.ScalarTransform4f
FLAT, TWO_FOLD = 0.1, 0.06  # of the two-fold table, a + b cos 2(φ - ρ)
PLATE = {"type": "asphere", "semi_diameter": 5.0}
FRONT_NORMAL = np.array([0.0, 0.0, -1.0])


@pytest.fixture(scope="module")
def brdf(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    rotations, incidence = np.arange(0.0, 361.0, 15.0), np.array([0.0, 20.0, 40.0, 60.0, 80.0])
    file = brushed.write_asymmetrical_4d(tmp_path_factory.mktemp("bsdf") / "brdf.bsdf", rotations, incidence)
    return {"type": "tabulated", "file": str(file), "anisotropy": "keep"}


def towards(polar_deg: float, azimuth_deg: float, side: float = -1.0) -> np.ndarray:
    """A unit vector on the side z < 0, where the light comes from, or on the other."""
    t, p = np.radians([polar_deg, azimuth_deg])
    return np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), side * np.cos(t)])


def axis_at(turn_deg: float) -> np.ndarray:
    """x of a sample that is turned about z."""
    return np.array([np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg)), 0.0])


def beam_direction(field_deg: float, azimuth_deg: float) -> np.ndarray:
    """Of a `collimated` source: its azimuth counts from +y towards -x."""
    f, a = np.radians([field_deg, 90 + azimuth_deg])
    return np.array([np.sin(f) * np.cos(a), np.sin(f) * np.sin(a), np.cos(f)])


def scene(
    model: dict[str, Any],
    seen: np.ndarray,
    field_deg: float = 20.0,
    azimuth_deg: float = 0.0,
    *,
    distance: float = 60.0,
    radius: float = 0.5,
    plate: dict[str, Any] = PLATE,
    behind: str = "air",
    start: float = 0.0,
    aim: bool = True,
) -> mi.Scene:
    """A narrow beam of 1 W on a plate at the origin, and a round detector that faces it, in the medium behind it."""
    place = T().look_at(origin=(distance * seen).tolist(), target=(2 * distance * seen).tolist(), up=[0.1, 0.2, 1.0])
    # What transmits nothing at all is opaque, and scatters nothing to the other side
    interface = {**BLACK, "T": 1e-6, "back": behind, "model": model}
    target = {"type": "disk", "to_world": place @ T().scale(radius), "bsdf": {"type": "target", "surfaces": "plate"}}
    beam = {"type": "collimated", "radius": 0.2, "irradiance": 1 / (np.pi * 0.04), "field_deg": field_deg}
    end = {"bsdf": {**BLACK, "front": behind, "back": behind}, "sensor": meter()}
    return lit(
        beam | {"azimuth_deg": azimuth_deg, "distance": start},
        plate=plate | {"bsdf": interface},
        detector={"type": "asphere", "semi_diameter": radius, "to_world": place, **end},
        **({"target": target} if aim else {}),
    )


def power(given: mi.Scene, rays: int = 10_000, **settings: Any) -> tuple[float, float]:
    e = mistray.trace(given, rays=rays, **settings).energy
    assert abs(e.closure) < 1e-6
    return e.detected_W / e.launched_W, e.detected_se_W / e.launched_W


def small_detector(f: float, polar_deg: float, distance: float = 60.0, radius: float = 0.5) -> float:
    return f * np.cos(np.radians(polar_deg)) * np.pi * radius**2 / (distance**2 + radius**2)


class TestClosedForms:
    def test_transmission(self, tmp_path: Path) -> None:
        """A BTDF into glass: the specular direction is the refracted one, and the angles are seen from the light."""
        rotations, angles = np.arange(0.0, 361.0, 15.0), np.array([0.0, 12.0, 24.0, 36.0])
        file = brushed.write_asymmetrical_4d(tmp_path / "btdf.bsdf", rotations, angles, kind="BTDF")
        model = {"type": "tabulated", "file": str(file), "anisotropy": "keep", "rotation_deg": 20.0}
        seen, d = towards(30.0, 155.0, 1.0), beam_direction(40.0, 65.0)
        found, se = power(scene(model, seen, 40.0, 65.0, behind="1.6"), rays=2_000)
        specular = np.append(d[:2] / 1.6, -np.sqrt(1 - d[:2] @ d[:2] / 1.6**2))
        # Seen from the light only tangential parts count
        exact = small_detector(brushed.bsdf(specular, seen, axis_at(20.0), FRONT_NORMAL), 30.0)
        assert_z("BTDF", found, exact, se, k=4.0, floor=small_detector(0.015 * brushed.A, 30.0))

    def test_file(self, brdf: dict[str, Any]) -> None:
        """The closed form behind an Asymmetrical4D file, also on a turned plate: 1.5 % of A is interpolation."""
        rng = np.random.default_rng(4)
        rectangle = {"type": "rectangle", "to_world": T().scale(5.0)}
        for plate, more in ((PLATE, 0.0), (PLATE | {"tilt_z": 90.0}, 90.0), (rectangle, 0.0)):
            field, beam, polar, azimuth, turn = rng.random(5) * [60, 360, 70, 360, 360]
            seen, d = towards(polar, azimuth), beam_direction(field, beam)
            found, se = power(scene(brdf | {"rotation_deg": turn}, seen, field, beam, plate=plate), rays=2_000)
            exact = small_detector(brushed.bsdf(d * [1, 1, -1], seen, axis_at(turn + more), FRONT_NORMAL), polar)
            assert_z("odd angles", found, exact, se, k=4.0, floor=small_detector(0.015 * brushed.A, polar))

    @pytest.mark.parametrize("beam", [0.0, 30.0, 140.0])
    def test_absorbed(self, brdf: dict[str, Any], beam: float) -> None:
        """What the plate keeps is 1 - TIS, which changes with the azimuth of incidence; 0.6 % is interpolation."""
        given = scene(brdf | {"rotation_deg": 10.0}, towards(80.0, 0.0), 60.0, beam, aim=False)
        e = mistray.trace(given, rays=2_000).energy
        tis = brushed.total(beam_direction(60.0, beam) * [1, 1, -1], axis_at(10.0), FRONT_NORMAL)
        assert e.absorbed["plate"][0] / e.launched_W == pytest.approx(1 - tis, abs=7e-3 * tis)
        assert abs(e.closure) < 1e-6

    def test_meridian_and_lathe_turned_tube(self, tmp_path: Path) -> None:
        """On a turned plate the axis points away from the middle, here to a spot aside."""
        file = brushed.write_two_fold(tmp_path / "two.csv", FLAT, TWO_FOLD)
        model = {"type": "tabulated", "file": str(file), "anisotropy": "keep", "sample_axis": "meridian"}
        at = np.array([3.0, 1.5, 0.0])
        beside = PLATE | {"to_world": T().translate((-at).tolist())}
        turned = scene(model | {"rotation_deg": 15.0}, towards(40.0, 100.0), plate=beside)
        found, se = power(turned, rays=2_000, max_reflections=0)
        axis = np.degrees(np.arctan2(at[1], at[0])) + 15.0
        exact = small_detector(FLAT + TWO_FOLD * np.cos(2 * np.radians(100.0 - axis)), 40.0)
        assert_z("meridian", found, exact, se, k=4.0, floor=0.01 * exact)
        # A tube looks alike from all sides: a beam to its wall sends the same back, whatever its azimuth
        tube = {"type": "frustum", "r0": 10.0, "z0": -40.0, "r1": 10.0, "z1": 40.0}
        found, end = [], np.array([0.0, 0.0, 1.0])
        for azimuth in (0.0, 70.0, 200.0):
            given = scene(model, end, 50.0, azimuth, distance=30.0, radius=5.0, plate=tube, start=2.0)
            found.append(power(given, rays=20_000))
        values, errors = np.array(found).T
        assert np.all(errors < 0.01 * values)
        assert_z("azimuths", values[1:], values[0], np.hypot(errors[1:], errors[0]), k=4.0)


CONE = {"type": "frustum", "r0": 0.0, "z0": 0.0, "r1": 5.0, "z1": 1.0}
SAMPLES = {
    "curved": (PLATE | {"radius": 12.0}, {"rotation_deg": 25.0}),
    "turned cone": (CONE, {"sample_axis": "meridian", "rotation_deg": 40.0}),
}


@pytest.mark.parametrize("name", ["curved", pytest.param("turned cone", marks=pytest.mark.slow)])
def test_pst_by_both_directions(brdf: dict[str, Any], name: str) -> None:
    (shape, turned), found = SAMPLES[name], []
    for method, rays in (("adjoint", 3_000_000), ("forward", 60_000)):
        given = scene(brdf | turned, towards(35.0, 70.0), distance=12.0, radius=4.0, plate=shape, aim=False)
        cells = {"azimuths_deg": [0, 90, 180, 270], "cell_deg": 40.0, "azimuth_cell_deg": 90.0}
        found.append(mistray.pst(given, [40.0], method=method, rays=rays, seed=3, **cells).map("single_scatter"))
    (against, against_se), (along, along_se) = found
    both = np.hypot(against_se, along_se)
    clean = both < 0.05 * along  # a cell that one rare ray has lit says nothing
    assert np.sum(clean) >= 3
    assert_z("quadrants", against[clean], along[clean], both[clean], k=4.0)
    assert along[clean].max() > 1.2 * along[clean].min()


@pytest.mark.slow
def test_gradient_by_tilts(tmp_path: Path) -> None:
    """Derivatives of the scattered power by tilts of the plate; 2 % is that slopes are differences over cells."""
    file = brushed.write_asymmetrical_4d(
        tmp_path / "fine.bsdf", np.arange(0.0, 361.0, 10.0), np.array([0.0, 10, 20, 30, 40, 50, 60, 70, 80])
    )
    model = {"type": "tabulated", "file": str(file), "anisotropy": "keep", "rotation_deg": 25.0}
    given = scene(model, towards(40.0, 70.0), 35.0, 20.0, distance=12.0, radius=3.0)
    settings: dict[str, Any] = {"rays": 20_000, "seed": 1, "max_scatters": 1}
    params = mi.traverse(given)
    keys = ["plate.tilt_x", "plate.tilt_y", "plate.tilt_z"]
    gradient = mistray.gradient(mistray.optimize.path_power(given, "single scatter", **settings), params, keys)
    scale = max(abs(float(np.ravel(value)[0])) for value in gradient.gradient.values())
    for key in keys:
        ends = []
        for step in (2.0, -2.0):
            with changed(params, {key: np.array([step])}):
                ends.append(mistray.trace(given, **settings).energy.detected_W)
        assert float(np.ravel(gradient.gradient[key])[0]) == pytest.approx((ends[0] - ends[1]) / 4, abs=0.05 * scale)

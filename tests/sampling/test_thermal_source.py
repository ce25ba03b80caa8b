"""The scene's own emission as a source: closed forms, an isothermal cavity, and `mistray.thermal` from the detector."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from lit_detector import BLACK, RADIUS, discs, lit, meter
from oracles.statistics import assert_z

import mistray
from mistray.physics.planck import band_radiance
from mistray.surfaces.host_points import area, even_points
from mistray.surfaces.surfaces import SurfaceTable

pytestmark = pytest.mark.quick

BEAM = {"type": "collimated", "radius": 5.0}
GREY = {"type": "interface", "R": 0.25}
WARM = {"type": "thermal", "temperature_K": 300.0, "parts": "detector = 0"}
BAND_UM = (8.0, 12.0)


L300 = band_radiance(300.0, *BAND_UM)
FLAT = {"type": "asphere", "semi_diameter": 30.0, "z": -40.0}
CASES: dict[str, tuple[dict[str, Any], float]] = {
    "black disc": ({**FLAT, "bsdf": BLACK}, np.pi * L300 * np.pi * 900 * discs(40, 30)),
    "grey disc": ({**FLAT, "bsdf": GREY}, 0.75 * np.pi * L300 * np.pi * 900 * discs(40, 30)),
    "window that absorbs": (
        {**FLAT, "bsdf": {"type": "interface", "R": 0.1, "T": 0.7}},
        0.2 * np.pi * L300 * np.pi * 900 * discs(40, 30),
    ),
    "ring": (
        {**FLAT, "inner_semi_diameter": 20.0, "bsdf": BLACK},
        np.pi * L300 * np.pi * (900 * discs(40, 30) - 400 * discs(40, 20)),
    ),
    "ball": (
        # Its irradiance is that of a point, π L (R/r)² cos θ, and cos θ dA / r² = dΩ
        {"type": "sphere", "center": [0, 0, -40], "radius": 30.0, "bsdf": BLACK},
        np.pi * L300 * 900 * 2 * np.pi * (1 - 40 / np.hypot(40, RADIUS)),
    ),
    "deep bowl": (
        # A hemisphere that opens to the detector is seen as its black opening: a disc of 30 mm at 40 mm
        {"type": "asphere", "radius": 30.0, "semi_diameter": 29.999999, "z": -70.0, "bsdf": BLACK},
        np.pi * L300 * np.pi * 900 * discs(40, 30),
    ),
    "tube": (
        # From ends of radius 30 at 20 and 60 mm: what comes through the near one and not through the far one
        {"type": "frustum", "r0": 30.0, "r1": 30.0, "z0": -60.0, "z1": -20.0, "bsdf": BLACK},
        np.pi * L300 * np.pi * 900 * (discs(20, 30) - discs(60, 30)),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_closed_form(name: str) -> None:
    """View factor × Planck, in its band; false alarms 0.05 % each."""
    shape, exact = CASES[name]
    t = mistray.trace(lit(WARM, shape=shape), rays=40_000)
    assert_z(name, t.energy.detected_W, exact, t.energy.detected_se_W, false_alarm=5e-4)
    assert abs(t.energy.closure) < 1e-6
    assert set(t.paths.to_pandas().source) == {"lamp:shape"}


def test_temperatures_by_name() -> None:
    """Each surface has that of the last name that fits, and is a source of its own; false alarms 0.2 %."""
    names = {"near shield": 80.0, "far": 400.0, "shield_2": 100.0}
    sizes = [(30.0 + 10 * k, 20.0 + 10 * k) for k in range(3)]
    black = {"type": "asphere", "z": -20.0, "bsdf": BLACK}
    rings = {
        name: {**black, "semi_diameter": outer, "inner_semi_diameter": inner, "part": f"part {k}"}
        for k, (name, (outer, inner)) in enumerate(zip(names, sizes, strict=True))
    }
    parts = "detector=0; *shield*=90; near*=80; part 1=400; shield_2=100"
    given = {"type": "scene", **rings}
    text = f"thermal:temperature_K=300,band_nm=8000 12000,parts={parts}"
    given["detector"] = {"type": "asphere", "semi_diameter": RADIUS, "bsdf": BLACK, "sensor": meter()}
    t = mistray.trace(mistray.load(given, text), rays=60_000)
    for (name, kelvin), (outer, inner) in zip(names.items(), sizes, strict=True):
        energy = t.energy_of(f"source:{name}")
        assert energy.launched_W == pytest.approx(
            2 * np.pi**2 * (outer**2 - inner**2) * band_radiance(kelvin, *BAND_UM), rel=1e-6
        )
        exact = outer**2 * discs(20, outer) - inner**2 * discs(20, inner)
        exact *= np.pi**2 * band_radiance(kelvin, *BAND_UM)
        assert_z(name, energy.detected_W, exact, energy.detected_se_W, false_alarm=5e-4)


def test_isothermal_cavity() -> None:
    """In a grey box of one temperature every wall absorbs what it emits, and the detector π L; false alarms 0.2 %."""
    shapes = {
        "tube": {"type": "frustum", "r0": RADIUS, "r1": RADIUS, "z0": -15.0, "z1": 0.0, "bsdf": GREY},
        "lid": {"type": "asphere", "semi_diameter": RADIUS, "z": -15.0, "bsdf": {"type": "interface", "back": "Al"}},
    }
    lamp = {"type": "thermal", "temperature_K": 300.0}
    t = mistray.trace(lit(lamp, **shapes), rays=100_000, max_reflections=40, splitting="one")
    inside = np.pi * RADIUS**2 * np.pi * L300
    assert_z("detector", t.energy.detected_W, inside, t.energy.detected_se_W, false_alarm=5e-4)
    emitted = {name: t.energy_of(f"lamp:{name}").launched_W for name in shapes}
    # Both sides of the tube emit, and one side of the metal
    for name, share in (("tube", 0.5), ("lid", 1.0)):
        absorbed, error = t.energy.absorbed[name]
        assert_z(name, absorbed, share * emitted[name], error, false_alarm=5e-4)


HALF_CLEAR = {"type": "interface", "R": 0.05, "T": 0.8}
LENS = {"type": "asphere", "semi_diameter": 12.0, "part": "lens"}
SAG = 40.0 - np.sqrt(40.0**2 - 12.0**2)
PAINTED = {**BLACK, "paint": {"type": "paint", "reflectance": 0.2}}
INSTRUMENT = {
    "front": {**LENS, "radius": 40.0, "z": -34.0, "bsdf": {**HALF_CLEAR, "back": "1.5"}},
    "rear": {**LENS, "radius": -40.0, "z": -28.0, "bsdf": {**HALF_CLEAR, "front": "1.5"}},
    # Painted: black on the glass and to the air
    "edge": {"type": "frustum", "r0": 12.0, "r1": 12.0, "z0": -34.0 + SAG, "z1": -28.0 - SAG, "part": "lens",
             "bsdf": {**BLACK, "front": "1.5"}},
    "barrel": {"type": "frustum", "r0": 12.5, "r1": 12.5, "z0": -36.0, "z1": 0.0, "bsdf": PAINTED},
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
def test_beside_the_trace_from_the_detector(seed: int) -> None:
    """Surface by surface the irradiance that `mistray.thermal` finds, by lenses and scatter; false alarms 0.1 %."""
    lamp = {"type": "thermal", "temperature_K": 293.0, "parts": "detector=0; lens=250"}
    limits = {"max_reflections": 3, "max_scatters": 2, "seed": seed}
    t = mistray.trace(lit(lamp, **INSTRUMENT), rays=100_000, **limits)
    cold = {"temperatures": {"detector": 0, "lens": 250}}
    backward = mistray.thermal(lit(BEAM, **INSTRUMENT), 293.0, BAND_UM, rays=100_000, **cold, **limits)
    for name in INSTRUMENT:
        (other,) = (e.irradiance_W_mm2 for e in backward.emitters if e.name == name)
        energy = t.energy_of(f"lamp:{name}")
        value, error = (v / (np.pi * RADIUS**2) for v in (energy.detected_W, energy.detected_se_W))
        assert_z(name, value, other.value, np.hypot(error, other.se), false_alarm=1.5e-4)


@pytest.mark.parametrize(
    "shape",
    [
        {"type": "asphere", "radius": 10.0, "conic": -0.5, "semi_diameter": 9.0, "inner_semi_diameter": 3.0},
        {"type": "asphere", "radius": 20.0, "half_width": 9.0, "half_height": 5.0},
        {"type": "frustum", "r0": 2.0, "r1": 9.0, "z0": 0.0, "z1": 4.0},
        {"type": "freeform", "radius": 12.0, "semi_diameter": 8.0, "zernike_6": 0.3, "zernike_radius": 8.0},
        {"type": "sphere", "radius": 3.0},
    ],
    ids=["conic", "rectangle", "cone", "freeform", "ball"],
)
def test_points_are_even(shape: dict[str, Any]) -> None:
    """Over eight parts of a surface in x and y, each as its area; χ² with false alarms 0.1 % each."""
    here = lit(BEAM, shape={**shape, "bsdf": BLACK})
    table = SurfaceTable(here, 550.0)
    rng, count = np.random.default_rng(1), 40_000
    k = table.ids.index("shape")
    p, _ = even_points(table, k, lambda: rng.random(count), count)
    # The same by uniform points with the weights of their areas: of a fine mesh, by its triangles
    mesh = table.shapes[k]
    assert area(table, k) == pytest.approx(float(np.array(mesh.surface_area()).ravel()[0]), rel=2e-3)
    sample = mi.Point2f(*rng.random((2, 400_000)).astype(np.float32))
    other = np.array(mesh.sample_position(0.0, sample).p).T
    edges = np.quantile(other[:, 0], np.linspace(0, 1, 9)[1:-1])
    found, expected = (np.bincount(np.searchsorted(edges, q[:, 0]), minlength=8) for q in (p, other))
    share = expected / expected.sum()
    chi2 = float(np.sum((found - count * share) ** 2 / (count * share * (1 + count / 400_000))))
    assert chi2 < 24.3  # 7 degrees of freedom


def test_media_that_absorb_are_told() -> None:
    window = {**FLAT, "bsdf": {"type": "interface", "back": "1.5+0.0001i"}}
    with pytest.warns(mistray.MistrayWarning, match="absorbs"):
        mistray.trace(lit(WARM, shape=window, wall={**FLAT, "z": -50.0, "bsdf": BLACK}), rays=1000)

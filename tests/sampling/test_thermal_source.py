"""Sources: the own emission of a scene, rays of files, and derivatives by every number that has them."""

import struct
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import vectors
from lit_detector import BLACK, RADIUS, TUBE, discs, lit, meter, square
from oracles.statistics import assert_z
from refusals import refused

import mistray
from mistray.files.ray_sets import RaySet, read_ray_set, save_ray_set
from mistray.optimize import combine, path_power
from mistray.physics.planck import band_radiance
from mistray.plugins.emitters.light_source import LightSource
from mistray.sampling.sources import scene_sources
from mistray.surfaces.host_points import area, even_points
from mistray.surfaces.surfaces import SurfaceTable

pytestmark = pytest.mark.quick

BEAM = {"type": "collimated", "radius": 5.0}
GREY = {"type": "interface", "R": 0.25}
WARM = {"type": "thermal", "temperature_K": 300.0, "parts": "detector = 0"}
BAND_UM = (8.0, 12.0)

L300 = band_radiance(300.0, *BAND_UM)
FLAT = {"type": "asphere", "semi_diameter": 30.0, "z": -40.0}
FLUX = np.pi**2 * L300  # of a black surface by its area over π, W/mm²
DISC = FLUX * 900 * discs(40, 30)
BALL = {"type": "sphere", "center": [0, 0, -40], "radius": 30.0}
BOWL = {"type": "asphere", "radius": 30.0, "semi_diameter": 29.999999, "z": -70.0}
CYLINDER = {"type": "frustum", "r0": 30.0, "r1": 30.0, "z0": -60.0, "z1": -20.0}
CASES: dict[str, tuple[dict[str, Any], float]] = {
    "black disc": (FLAT, DISC),
    "grey disc": (FLAT | {"bsdf": GREY}, 0.75 * DISC),
    "window that absorbs": (FLAT | {"bsdf": {"type": "interface", "R": 0.1, "T": 0.7}}, 0.2 * DISC),
    "ring": (FLAT | {"inner_semi_diameter": 20.0}, DISC - FLUX * 400 * discs(40, 20)),
    # Its irradiance is that of a point, π L (R/r)² cos θ, and cos θ dA / r² = dΩ
    "ball": (BALL, FLUX * 900 * 2 * (1 - 40 / np.hypot(40, RADIUS))),
    # A hemisphere that opens to the detector is seen as its black opening: a disc of 30 mm at 40 mm
    "deep bowl": (BOWL, DISC),
    # From ends of radius 30 at 20 and 60 mm: what comes through the near one and not through the far one
    "tube": (CYLINDER, FLUX * 900 * (discs(20, 30) - discs(60, 30))),
}


@pytest.mark.parametrize("name", CASES)
def test_closed_form(name: str) -> None:
    """View factor × Planck, in its band; false alarms 0.05 % each."""
    shape, exact = CASES[name]
    t = mistray.trace(lit(WARM, shape={"bsdf": BLACK} | shape), rays=40_000)
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
    given["detector"] = {"type": "asphere", "semi_diameter": RADIUS, "bsdf": BLACK, "sensor": meter()}
    t = mistray.trace(mistray.load(given, f"thermal:temperature_K=300,band_nm=8000 12000,parts={parts}"), rays=60_000)
    for (name, kelvin), (outer, inner) in zip(names.items(), sizes, strict=True):
        energy = t.energy_of(f"source:{name}")
        both_sides = 2 * np.pi**2 * (outer**2 - inner**2)
        assert energy.launched_W == pytest.approx(both_sides * band_radiance(kelvin, *BAND_UM), rel=1e-6)
        exact = outer**2 * discs(20, outer) - inner**2 * discs(20, inner)
        exact *= np.pi**2 * band_radiance(kelvin, *BAND_UM)
        assert_z(name, energy.detected_W, exact, energy.detected_se_W, false_alarm=5e-4)


def test_cold_surfaces_emit_in_the_lit_parts_of_their_band() -> None:
    """At 3 K the first of five parts of the band has no light at all, and no wavelength."""
    lamp = mi.load_dict({"type": "thermal", "temperature_K": 3.0, "band_nm": "1000, 20000", "bands": 5})
    assert len(lamp.wavelengths_nm) == 4
    radiances = [lamp._radiance(3.0, line) for line in range(4)]
    assert np.allclose(radiances, lamp.weights * band_radiance(3.0, 1.0, 20.0), rtol=1e-9, atol=0)


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
    table = SurfaceTable(lit(BEAM, shape={**shape, "bsdf": BLACK}), 550.0)
    rng, count = np.random.default_rng(1), 40_000
    k = table.ids.index("shape")
    p, _ = even_points(table, k, lambda: rng.random(count), count)
    # The same by uniform points with the weights of their areas: of a fine mesh, by its triangles
    mesh = table.shapes[k]
    assert area(table, k) == pytest.approx(float(np.array(mesh.surface_area()).ravel()[0]), rel=2e-3)
    other = np.array(mesh.sample_position(0.0, mi.Point2f(*rng.random((2, 400_000)).astype(np.float32))).p).T
    edges = np.quantile(other[:, 0], np.linspace(0, 1, 9)[1:-1])
    found, expected = (np.bincount(np.searchsorted(edges, q[:, 0]), minlength=8) for q in (p, other))
    share = expected / expected.sum()
    chi2 = float(np.sum((found - count * share) ** 2 / (count * share * (1 + count / 400_000))))
    assert chi2 < 24.3  # 7 degrees of freedom


def test_media_that_absorb_are_told() -> None:
    window = {**FLAT, "bsdf": {"type": "interface", "back": "1.5+0.0001i"}}
    with pytest.warns(mistray.MistrayWarning, match="absorbs"):
        mistray.trace(lit(WARM, shape=window, wall={**FLAT, "z": -50.0, "bsdf": BLACK}), rays=1000)


def scene(lamp: dict[str, Any]) -> mi.Scene:
    detector = {"type": "asphere", "semi_diameter": RADIUS, "bsdf": BLACK, "sensor": meter(8)}
    return mi.load_dict({"type": "scene", "detector": detector, "lamp": lamp, "tube": TUBE}, optimize=False)


GRADIENTS: dict[str, tuple[dict[str, Any], str, float]] = vectors.toml("source_gradients.toml")


def places_of(lamp: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Where a source starts, (n, 2), and the share of each place: Gauss's quadratures."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    if lamp["type"] == "point_source":
        return np.zeros((1, 2)), np.ones(1)
    if lamp["type"] == "gaussian_beam":
        (x, w), sizes = np.polynomial.hermite_e.hermegauss(9), [0.5 * lamp[f"waist_{axis}"] for axis in "xy"]
        w = w / w.sum()
    elif "half_width" in lamp:
        x, w, sizes = nodes, weights / 2, [lamp["half_width"], lamp["half_height"]]
    else:
        rho, phi = np.sqrt(0.5 + 0.5 * nodes) * lamp["radius"], np.arange(24) * 2 * np.pi / 24
        shares = np.repeat(weights / 2 / 24, 24)
        return np.stack([np.outer(rho, np.cos(phi)).ravel(), np.outer(rho, np.sin(phi)).ravel()], axis=1), shares
    grid = np.stack(np.meshgrid(sizes[0] * x, sizes[1] * x, indexing="ij"), axis=-1).reshape(-1, 2)
    return grid, np.outer(w, w).ravel()


def lights(lamp: dict[str, Any], at: np.ndarray, q: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Irradiance at points (n, 3) of a plane, W/mm², by the light of one place of a source of 1 W, in its own frame."""
    if lamp["type"] == "gaussian_beam":  # rays of one place of the waist have normal slopes
        found, slopes = np.ones(len(q)), np.ones((len(q), 3))
        for k, axis in enumerate("xy"):
            width = lamp[f"m2_{axis}"] * lamp["wavelength_nm"] * 1e-6 / (2 * np.pi * lamp[f"waist_{axis}"])
            away = q[:, 2] - lamp.get(f"offset_{axis}", 0.0)
            slopes[:, k] = (q[:, k] - at[k]) / away
            found *= np.exp(-0.5 * (slopes[:, k] / width) ** 2) / (np.sqrt(2 * np.pi) * width * away)
        return found * (slopes @ normal)
    away = q - np.append(at, 0.0)
    r = np.linalg.norm(away, axis=1)
    lambertian = lamp["type"] == "surface_source"
    power, half = lamp.get("exponent", float(lambertian)), lamp.get("half_angle_deg", 90.0 if lambertian else 180.0)
    edge, cosine = np.cos(np.radians(half)), away[:, 2] / r
    whole = 2 * np.pi * (1 - (max(edge, 0.0) if power else edge) ** (power + 1)) / (power + 1)
    return np.asarray(np.where(cosine >= edge, np.maximum(cosine, 0) ** power, 0) / whole * (away @ normal) / r**3)


def exact_flux(lamp: dict[str, Any]) -> float:
    """Of 1 W, what the detector gets; of 1 W/mm² of the sun."""
    turned, aside = (np.radians(lamp.get(key, 0.0)) for key in ("tilt_x", "tilt_y"))
    if lamp["type"] == "distant_disc":
        # cos of the middle; with a size times the mean of cos, as for the wide disc above
        half = np.radians(lamp.get("diameter_deg", 0.533)) / 2
        mean = 2 / 3 * (1 - np.cos(half) ** 3) / np.sin(half) ** 2
        return float(np.pi * RADIUS**2 * mean * np.cos(aside) * np.cos(np.radians(lamp.get("field_deg", 0.0)) - turned))
    place = np.array([lamp.get(key, 0.0) for key in "xyz"])
    place[1] += place[2] * np.tan(np.radians(lamp.get("field_deg", 0.0)))
    angle = np.radians(lamp.get("half_angle_deg", 90.0))
    if angle < np.pi / 4:  # the edge of the cone is on the detector
        return cone_share(-place[2], lamp.get("radius", 0.0), angle, lamp.get("exponent", float("radius" in lamp)))
    (sx, cx), (sy, cy) = ((np.sin(tilt), np.cos(tilt)) for tilt in (turned, aside))
    axes = np.array([[cy, sx * sy, -cx * sy], [0, cx, sx], [sy, -sx * cy, cx * cy]])
    nodes, weights = np.polynomial.legendre.leggauss(48)
    rho, phi = np.sqrt(0.5 + 0.5 * nodes) * RADIUS, np.arange(96) * 2 * np.pi / 96
    q = np.stack([np.outer(rho, np.cos(phi)).ravel(), np.outer(rho, np.sin(phi)).ravel(), np.zeros(48 * 96)], axis=1)
    area = np.repeat(weights / 2 / 96 * np.pi * RADIUS**2, 96)
    parts = zip(*places_of(lamp), strict=True)
    return sum(share * float(lights(lamp, at, (q - place) @ axes.T, axes[:, 2]) @ area) for at, share in parts)


def cone_share(distance: float, size: float, angle: float, power: float) -> float:
    """Share of the light of a disc (a point) on the axis, in cones of cosⁿ θ, that meets the detector."""
    if not size:
        inner = max(np.cos(angle), distance / np.hypot(distance, RADIUS))
        return float((1 - inner ** (power + 1)) / (1 - np.cos(angle) ** (power + 1)))
    nodes, weights = np.polynomial.legendre.leggauss(200)
    rho = np.sqrt(0.5 + 0.5 * nodes)[:, None] * size
    theta = (np.arange(5000) + 0.5) / 5000 * angle
    law, s = np.sin(theta) * np.cos(theta) ** power, distance * np.tan(theta)
    within = np.arccos(np.clip((s * s + rho**2 - RADIUS**2) / (2 * s * rho), -1, 1)) / np.pi  # of each ring of light
    return float(weights / 2 @ (within @ law) / law.sum())


# Of others above
TWINS = (
    "distance off the axis", "place in y", "tilt about y", "height", "cone of a disc", "direction of the sun about y"
)  # fmt: skip

# They differ from another gradient by the axis or by a source that starts in the same way
ALIKE = [one for one in GRADIENTS if one in TWINS or one.startswith(("disc", "screen", "beam")) or one.endswith("in y")]


@pytest.mark.parametrize("name", [pytest.param(one, marks=[pytest.mark.long] * (one in ALIKE)) for one in GRADIENTS])
def test_gradient(name: str) -> None:
    """By numbers of the source, with what the rim of the detector takes; false alarms 0.02 % each of 32."""
    lamp, key, step = GRADIENTS[name]
    here = scene(lamp)
    metric = path_power(here, "straight shot", rays=400_000, seed=1)  # half of them go to the detector
    g = mistray.gradient(metric, mi.traverse(here), keys=[f"lamp.{key}"])
    up, down = (exact_flux({**lamp, key: lamp.get(key, 0.0) + sign * step}) for sign in (1, -1))
    (source,) = scene_sources(here)
    exact = (up - down) / (2 * step) / source.power  # the metric is a share
    found, error = (float(values[f"lamp.{key}"][0]) for values in (g.gradient, g.standard_error))
    assert_z(name, found, exact, error, false_alarm=2e-4)
    assert error < 0.15 * abs(exact)


def test_a_height_is_held_as_an_angle() -> None:
    here = scene(GRADIENTS["distance"][0])
    for field, told in (({"field_mm": 5.0}, True), ({"field_deg": 5.0}, False)):
        metric = path_power(here, "direct", rays=1000, **field)
        for one in metric, combine({"light": metric}, lambda m: m["light"]):
            found = mistray.gradient(one, mi.traverse(here), keys=["lamp.z"])
            assert any("field_mm" in text for text in found.left_out) is told


def test_every_gradient_is_compared() -> None:
    module = "mistray.plugins.emitters."
    pending, found = [LightSource], set()
    while pending:
        kind = pending.pop()
        pending += kind.__subclasses__()
        if kind.__module__.startswith(module) and not kind.__subclasses__():
            found |= {(kind.__module__.removeprefix(module), key) for key in kind.differentiable}
    assert found == {(lamp["type"], key) for lamp, key, _ in GRADIENTS.values()}
    assert {kind for kind, _ in found} == {"point_source", "surface_source", "gaussian_beam", "distant_disc"}
    here = lit({"type": "sky"})  # as of the others
    with pytest.raises(mistray.MistrayError, match="lamp"):
        mistray.gradient(path_power(here, "straight shot", rays=1000), mi.traverse(here), keys=["lamp.*"])


def rays(count: int = 500, known: bool = True) -> RaySet:
    rng = np.random.default_rng(4)
    o, d = rng.normal(size=(2, count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    wavelength = rng.choice([450.0, 550.0, 632.8], count) if known else np.full(count, np.nan)
    return RaySet(o * 1e3, d, rng.exponential(size=count), wavelength)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".dat"])
def test_round_trip(suffix: str, known: bool, tmp_path: Path) -> None:
    given, file = rays(known=known), tmp_path / f"a lamp{suffix}"
    save_ray_set(file, given)
    found = read_ray_set(file)
    for key in ("origins", "directions", "flux_W", "wavelength_nm"):
        one, other = getattr(given, key), getattr(found, key)
        if suffix == ".dat":  # 32-bit floats
            np.testing.assert_allclose(other, one, rtol=2e-6, atol=1e-6)
        else:
            assert one.tobytes() == other.tobytes(), key


def test_zemax_file_by_hand(tmp_path: Path) -> None:
    """Written byte by byte: two rays in inches, spectral; then as text in cm, flux only."""
    head = struct.pack("<iI100s3f4fi9f4f4i", 1010, 2, b"by hand", 3.0, 3.0, 0.0, *[0.0] * 4, 1, *[0.0] * 13, 2, 0, 0, 0)
    assert len(head) == 208
    body = struct.pack("<16f", 1, 2, 3, 0, 0, 1, 1.0, 0.5, -1, 0, 0, 0, 0.6, 0.8, 2.0, 0.7)
    (tmp_path / "binary.dat").write_bytes(head + body)
    found = read_ray_set(tmp_path / "binary.dat")
    np.testing.assert_allclose(found.origins, [[25.4, 50.8, 76.2], [-25.4, 0, 0]])
    np.testing.assert_allclose(found.directions, [[0, 0, 1], [0, 0.6, 0.8]], atol=1e-7)
    np.testing.assert_allclose(found.wavelength_nm, [500, 700], rtol=1e-6)
    assert found.flux_W.tolist() == [1.0, 2.0]
    (tmp_path / "text.dat").write_text("1 2\n1 2 3 0 0 1 5.5\n")
    found = read_ray_set(tmp_path / "text.dat")
    assert (found.origins.tolist(), found.flux_W.tolist()) == ([[10, 20, 30]], [5.5])
    (tmp_path / "no_unit.dat").write_text("1\n1 2 3 0 0 1 5.5\n")
    assert read_ray_set(tmp_path / "no_unit.dat", unit="m").origins.tolist() == [[1000, 2000, 3000]]


def test_light_of_a_trace_goes_on(tmp_path: Path) -> None:
    """Rays at a plane, in a file, traced on: the image behind it is that of the whole trace. False alarms 0.1 %."""
    lamp = {"type": "surface_source", "radius": 2.0, "z": -30.0, "half_angle_deg": 20.0, "wavelength_nm": "450, 600"}
    t = mistray.trace(lit(lamp, detector=square(200.0, 8)), rays=100_000)
    file = tmp_path / "plane.csv"
    t.rays(n=None).to_csv(file, index=False)
    stop = {"type": "asphere", "semi_diameter": 300.0, "inner_semi_diameter": 4.0, "z": 10.0, "bsdf": BLACK}
    onward = {"type": "scene", "stop": stop, "detector": square(10.0, 8, z=30.0)}
    whole = mistray.trace(mistray.load({**onward, "lamp": lamp}), rays=100_000)
    again = mistray.trace(mistray.load(onward, f"rays:filename={file}"), rays=100_000)
    assert again.wavelengths_nm == [450.0, 600.0]
    assert again.energy.launched_W == pytest.approx(t.energy.detected_W, rel=1e-9)
    assert abs(again.energy.closure) < 1e-6
    # The rays of the file stand for all of them: their number is in the error as well
    error = np.sqrt(whole.irradiance_se**2 + 2 * again.irradiance_se**2)
    known = np.isfinite(error)
    assert known.sum() >= 30
    assert_z("image", again.irradiance[known], whole.irradiance[known], error[known], false_alarm=1e-3)


def test_flux_and_wavelengths(tmp_path: Path) -> None:
    """Rays are drawn by their flux; more wavelengths than 32 are put together; the power may be another."""
    o = np.zeros((2, 3))
    o[:, 2] = -5
    d = np.array([[0, 0, 1.0], [0.5, 0, np.sqrt(0.75)]])
    save_ray_set(tmp_path / "two.parquet", RaySet(o, d, np.array([1.0, 3.0]), np.full(2, np.nan)))
    lamp = {"type": "ray_file", "filename": str(tmp_path / "two.parquet"), "wavelength_nm": 633.0}
    t = mistray.trace(lit(lamp, detector=square(10.0, 8)), rays=10_000)
    share = t.irradiance[:, 4:5].sum() / t.irradiance.sum()  # the first ray lands in this column, the other does not
    assert_z("share", share, 0.25, np.sqrt(0.25 * 0.75 / 10_000), false_alarm=1e-3)
    assert (t.energy.launched_W, t.wavelengths_nm) == (pytest.approx(4.0), [633.0])
    many = rays(2000)
    rng = np.random.default_rng(1)
    save_ray_set(tmp_path / "many.csv", RaySet(many.origins, many.directions, many.flux_W, rng.uniform(400, 700, 2000)))
    made = mi.load_dict({"type": "ray_file", "filename": str(tmp_path / "many.csv"), "power": 2.0})
    assert (len(made.wavelengths_nm), made.power()) == (32, 2.0)
    assert np.all(np.diff(made.wavelengths_nm) > 0)
    assert made.weights == pytest.approx(np.full(32, 1 / 32), rel=0.2)
    # A strong line among 40 weak ones is one wavelength, with its own share
    nm = np.concatenate([np.full(1000, 546.1), np.repeat(np.linspace(400, 700, 40), 25)])
    save_ray_set(tmp_path / "line.csv", RaySet(many.origins[:2000], many.directions[:2000], np.ones(2000), nm))
    made = mi.load_dict({"type": "ray_file", "filename": str(tmp_path / "line.csv")})
    assert len(made.wavelengths_nm) == len(set(made.wavelengths_nm.tolist())) <= 32
    assert dict(zip(made.wavelengths_nm.tolist(), made.weights, strict=True))[546.1] == pytest.approx(0.5)
    assert made.weights @ made.wavelengths_nm == pytest.approx(nm.mean())


def tm25(
    rows: list[list[float]], flags: tuple[int, ...] = (1, 1, 1, 0, 0, 0, 0, 0), text: str = "", **more: Any
) -> bytes:
    """A TM-25 file, byte by byte as the sections 4.7.1 to 4.7.7 of IES TM-25-13 have it."""
    lumens, watts, nm = (more.get(name, float("nan")) for name in ("lumens", "watts", "nm"))
    spectrum, tables, names = more.get("spectrum", 0), more.get("tables", ()), more.get("names", ())
    note = text.encode("utf-32-le")
    note += bytes(-len(note) % 32)
    head = struct.pack("<4siiffQ28s", b"TM25", 2013, 0, lumens, watts, len(rows), b"2026-11-28T00:00:00+00:00")
    head += struct.pack("<iifffiii", 0, spectrum, nm, nm, nm, len(tables), len(names), len(note)) + bytes(168)
    body = struct.pack("<8i", *flags) + b"".join(f"line {k}".encode("utf-32-le").ljust(4000, b"\0") for k in range(9))
    block = b"".join(struct.pack(f"<i{len(t)}f", len(t) // 2, *t) for t in tables)
    block += bytes(-len(block) % 32)
    columns = b"".join(name.encode("utf-32-le").ljust(512, b"\0") for name in names)
    assert len(head) == 256
    return head + body + block + columns + note + np.array(rows, dtype="<f4").tobytes()


class TestTM25:
    def test_watts_wavelengths_and_further_columns_and_lumens(self, tmp_path: Path) -> None:
        file = tmp_path / "lamp.TM25RAY"
        file.write_bytes(tm25([[1, 2, 3, 0, 0, 1, 0.5], [4, 5, 6, 0, 0.6, 0.8, 1.5]], watts=8.0, spectrum=1, nm=632.8))
        found = read_ray_set(file)
        np.testing.assert_allclose(found.origins, [[1, 2, 3], [4, 5, 6]])
        np.testing.assert_allclose(found.directions, [[0, 0, 1], [0, 0.6, 0.8]], atol=1e-7)
        np.testing.assert_allclose(found.flux_W, [2.0, 6.0])
        np.testing.assert_allclose(found.wavelength_nm, 632.8)
        rows = [[0, 0, 0, 0, 0, 1, 1.0, 450.0, 0.1, 0.2, 0.3, 7.0], [1, 0, 0, 0, 0, -1, 3.0, 650.0, 0, 0, 0, 8.0]]
        file.write_bytes(tm25(rows, (1, 1, 1, 1, 0, 1, 0, 0), spectrum=2, names=("chip",), text="of the bench"))
        found = read_ray_set(file)
        assert found.flux_W.tolist() == [1.0, 3.0]  # the header states no total
        assert (found.wavelength_nm.tolist(), found.directions[1].tolist()) == ([450.0, 650.0], [0, 0, -1])
        # 337 lm that are 0.694 W; without the watts, only with the power of all
        rows = [[0, 0, 0, 0, 0, 1, 1.0], [1, 0, 0, 0, 0, 1, 3.0]]
        flags = (1, 1, 0, 0, 1, 0, 0, 0)
        (tmp_path / "both.tm25ray").write_bytes(tm25(rows, flags, watts=0.694, lumens=337.0))
        np.testing.assert_allclose(read_ray_set(tmp_path / "both.tm25ray").flux_W, [0.1735, 0.5205], rtol=1e-6)
        (tmp_path / "lumens.tm25ray").write_bytes(tm25(rows, flags, lumens=337.0))
        with refused("lumens"):
            read_ray_set(tmp_path / "lumens.tm25ray")
        np.testing.assert_allclose(read_ray_set(tmp_path / "lumens.tm25ray", power_W=2.0).flux_W, [0.5, 1.5])
        lamp = mi.load_dict({"type": "ray_file", "filename": str(tmp_path / "lumens.tm25ray"), "power": 2.0})
        assert lamp.power() == 2.0

    @pytest.mark.parametrize("each", [False, True])
    def test_a_spectrum_keeps_its_moments(self, each: bool, tmp_path: Path) -> None:
        """Weights 1 to 3 from 500 to 600 nm, linear: mean 500 + 100 · (1/2 + 2/3)/2 nm, second moment likewise."""
        wedge = (500.0, 1.0, 600.0, 3.0)
        rows = [[0.0, 0, 0, 0, 0, 1, 1] + ([2.0] if each else []) for _ in range(4000)]
        tables = ((400.0, 1.0), wedge) if each else (wedge,)
        flags = (1, 1, 1, 0, 0, 0, 0, int(each))
        (tmp_path / "lamp.tm25ray").write_bytes(tm25(rows, flags, spectrum=4 if each else 3, tables=tables))
        t = (read_ray_set(tmp_path / "lamp.tm25ray").wavelength_nm - 500) / 100
        assert 0 <= t.min() < t.max() <= 1
        # p(t) = (1 + 2 t)/2
        assert t.mean() == pytest.approx(1 / 4 + 1 / 3, abs=1e-3)
        assert (t**2).mean() == pytest.approx(1 / 6 + 1 / 4, abs=1e-3)


ONE = [[0, 0, 0, 0, 0, 1, 1]]


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("cut.dat", struct.pack("<iI100s", 1010, 5, b"cut") + bytes(100)),
        ("short.dat", "3 4\n1 2 3 0 0 1 1\n"),
        ("words.dat", "hello\n"),
        ("lamp.txt", "x_mm,y_mm,z_mm,dx,dy,dz,flux_W\n"),
        ("none.parquet", "PAR1"),
        ("empty.tm25ray", b""),
        ("short.tm25ray", b"TM25"),
        ("other.tm25ray", b"TM26" + bytes(40000)),
        ("cut.tm25ray", tm25(ONE)[:-4]),
        ("version.tm25ray", tm25(ONE)[:4] + struct.pack("<i", 2031) + tm25(ONE)[8:]),
        ("no_wavelengths.tm25ray", tm25(ONE, spectrum=2)),
        ("kind.tm25ray", tm25(ONE, spectrum=5)),
        ("no_table.tm25ray", tm25(ONE, spectrum=3)),
        ("falling.tm25ray", tm25(ONE, spectrum=3, tables=((600.0, 1.0, 500.0, 1.0),))),
        ("negative.tm25ray", tm25(ONE, spectrum=3, tables=((500.0, -1.0, 600.0, 1.0),))),
        ("no_such_table.tm25ray", tm25([[*ONE[0], 2]], (1, 1, 1, 0, 0, 0, 0, 1), spectrum=4, tables=((500.0, 1.0),))),
        ("no_directions.tm25ray", tm25(ONE, (1, 0, 1, 0, 0, 0, 0, 0))),
        ("no_flux.tm25ray", tm25([[0, 0, 0, 0, 0, 1]], (1, 1, 0, 0, 0, 0, 0, 0))),
        ("no_rays.tm25ray", tm25([])),
        ("nan.tm25ray", tm25([[float("nan"), 0, 0, 0, 0, 1, 1]])),
    ],
)
def test_files_that_are_none(name: str, content: str | bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with refused(name):
        read_ray_set(tmp_path / name)

"""Light of sources near and far on a detector, beside closed forms; sources that cannot be, by each way in."""

import warnings
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import vectors
from command_line import fails
from lit_detector import BLACK, RADIUS, TUBE, discs, lit, meter, square
from oracles.statistics import assert_z
from refusals import refused
from scene_dicts import detector, load

import mistray
from mistray.execute.tracer import prepare
from mistray.physics.geometry.healpix import pixel
from mistray.sampling import sky_map
from mistray.sampling.emission_laws import cosine_power_angle
from mistray.sampling.sky_map import SkyMap
from mistray.sampling.sources import scene_sources
from mistray.settings import Settings

pytestmark = pytest.mark.quick

WATTS = {"type": "spectrum", "value": 2.0}  # a number of a stock emitter


def cone(distance: float) -> float:
    return float(2 * np.pi * (1 - distance / np.hypot(distance, RADIUS)))


def squares(distance: float, first: float, second: float, n: int = 60) -> float:
    """View factor of two parallel squares on one axis by their half sides: Gauss-Legendre in four dimensions."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    x = first * nodes[:, None] - second * nodes[None]
    w = 0.5 * weights[:, None] * second * weights[None]
    r2 = (x**2)[:, :, None, None] + (x**2)[None, None] + distance**2
    return float(np.sum(w[:, :, None, None] * w[None, None] * distance**2 / (np.pi * r2**2)))


def spot(distance: float, intensity: float, beam: float, cutoff: float) -> float:
    """Flux on the detector of Mitsuba's spot: the intensity falls off linearly in the angle."""
    edge = np.arctan(RADIUS / distance)
    theta = (np.arange(400_000) + 0.5) / 400_000 * edge
    fall = np.clip((np.radians(cutoff) - theta) / np.radians(cutoff - beam), 0, 1)
    return float(2 * np.pi * intensity * np.sum(fall * np.sin(theta)) * edge / 400_000)


BALL = {"type": "sphere", "bsdf": BLACK}
AT = mi.ScalarTransform4f().look_at([0, 0, -30], [0, 0, 0], [0, 1, 0])
SPOT = {"type": "spot", "to_world": AT, "intensity": WATTS}
CASES: dict[str, tuple[dict[str, Any], float]] = {
    "point": ({"type": "point_source", "z": -20.0, "power": 3.0}, 3 * cone(20.0) / (4 * np.pi)),
    "point far away": ({"type": "point_source", "z": -1e9, "intensity": 2.0}, 2 * np.pi * (RADIUS / 1e9) ** 2),
    "cone": ({"type": "point_source", "z": -500.0, "half_angle_deg": 30.0, "intensity": 2.0}, 2 * cone(500.0)),
    "power of the cosine": ({"type": "point_source", "z": -20.0, "exponent": 5.0, "intensity": 2.0},
                            2 * 2 * np.pi / 6 * (1 - (20 / np.hypot(20, RADIUS)) ** 6)),
    "disc": ({"type": "surface_source", "z": -100.0, "radius": 30.0, "radiance": 2.0},
             2 * np.pi**2 * 900 * discs(100, 30)),
    "disc close by": ({"type": "surface_source", "z": -5.0, "radius": 9.0}, discs(5, 9)),
    "disc of 1 µm": ({"type": "surface_source", "z": -0.7, "radius": 1e-3}, discs(0.7, 1e-3)),
    "ring": ({"type": "surface_source", "z": -40.0, "radius": 30.0, "inner_radius": 20.0},
             (900 * discs(40, 30) - 400 * discs(40, 20)) / 500),
    "sun": ({"type": "distant_disc"}, np.pi * RADIUS**2),
    "wide disc": (
        {"type": "distant_disc", "diameter_deg": 80.0, "radiance": 3.0},
        # Of uniform radiance: L ∫ cos θ dΩ = π L sin² θ
        3 * np.pi * np.sin(np.radians(40)) ** 2 * np.pi * RADIUS**2),
    "sky": ({"type": "sky", "radiance": 2.0}, 2 * 2 * np.pi * np.pi * RADIUS**2),
    "part of the sky": ({"type": "sky", "half_angle_deg": 20.0},
                        np.pi * np.sin(np.radians(20)) ** 2 * np.pi * RADIUS**2),
    "stock point": ({"type": "point", "position": [0, 0, -20], "intensity": WATTS}, 2 * cone(20.0)),
    "stock spot": ({**SPOT, "cutoff_angle": 25.0, "beam_width": 10.0}, spot(30.0, 2.0, 10.0, 25.0)),
    "stock spot with an edge": ({**SPOT, "cutoff_angle": 4.0, "beam_width": 4.0},
                                4 * np.pi * (1 - np.cos(np.radians(4.0)))),
    "stock spot that fades from its axis": ({**SPOT, "cutoff_angle": 25.0, "beam_width": 0.0},
                                            spot(30.0, 2.0, 0.0, 25.0)),
    "stock sky": ({"type": "constant", "radiance": WATTS}, 2 * 2 * np.pi * np.pi * RADIUS**2),
    "stock beam": ({"type": "directional", "direction": [0, 0, 1], "irradiance": WATTS}, 2 * np.pi * RADIUS**2),
    "stock area": (
        {**BALL, "center": [0, 0, -100], "radius": 30.0, "emitter": {"type": "area", "radiance": WATTS}},
        # A Lambertian ball has the irradiance of a point: π L (R/r)² cos θ, and cos θ dA / r² = dΩ
        np.pi * 2 * 900 * cone(100.0)),
}  # fmt: skip


@pytest.mark.parametrize("tube", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_closed_forms(name: str, tube: bool) -> None:
    """Flux on the detector; 38 of them: false alarms 0.12 % in all."""
    lamp, exact = CASES[name]
    t = mistray.trace(lit(lamp, **({"tube": TUBE} if tube else {})), rays=60_000)
    assert_z(name, t.energy.detected_W, exact, max(t.energy.detected_se_W, 1e-6 * exact), false_alarm=3e-5)
    assert abs(t.energy.closure) < 1e-6


def test_stock_area_emitters() -> None:
    with refused("its area emitter has no object plane"):
        mistray.trace(lit(CASES["stock area"][0]), rays=10, field_mm=1.0)
    # The flux is that of the surface, not of its mesh: of π L A with A = 2π R h
    cap = {"type": "asphere", "curvature": 0.1, "semi_diameter": 8.0, "bsdf": BLACK, "emitter": {"type": "area"}}
    (source,) = scene_sources(lit(cap))
    assert source.power == pytest.approx(np.pi * 80 * np.pi, rel=1e-6)


def test_squares() -> None:
    """A square that shines on a square, and on one turned away; false alarms 6e-5."""
    detector = square(8.0)
    lamp = {"type": "surface_source", "half_width": 5.0, "half_height": 5.0, "z": -12.0}
    energy = mistray.trace(lit(lamp, detector=detector), rays=100_000).energy
    assert_z("flux", energy.detected_W, squares(12.0, 5.0, 8.0), energy.detected_se_W, false_alarm=3e-5)
    tilted = mistray.trace(lit({**lamp, "tilt_x": 90.0}, detector=detector), rays=100_000).energy
    n = 400_000
    rng = np.random.default_rng(5)
    # The normal (0, -1, 0): half of the detector is before it
    p = np.stack([*rng.uniform(-5, 5, (1, n)), np.zeros(n), -12 + rng.uniform(-5, 5, n)])
    q = np.stack([*rng.uniform(-8, 8, (2, n)), np.zeros(n)])
    away = q - p
    r2 = (away**2).sum(axis=0)
    parts = np.maximum(-away[1], 0) * np.maximum(away[2], 0) / (np.pi * r2 * r2) * 256
    error = float(np.hypot(parts.std() / np.sqrt(n), tilted.detected_se_W))
    assert_z("tilted", tilted.detected_W, float(parts.mean()), error, false_alarm=3e-5)


def test_errors_hold_over_seeds() -> None:
    """χ² of 40 seeds of four sources; false alarms 0.2 %."""
    for name in ("cone", "disc", "part of the sky", "stock area"):
        lamp, exact = CASES[name]
        here = lit(lamp, tube=TUBE)
        z = []
        for seed in range(40):
            energy = mistray.trace(here, rays=8000, seed=seed, ledger=False).energy
            z.append((energy.detected_W - exact) / energy.detected_se_W)
        assert_z(f"mean of {name}", float(np.mean(z)), 0.0, 1 / np.sqrt(40), false_alarm=2.5e-4)
        # t with 31 degrees of freedom: variance 31/29, that of its square 2 · (31/29)² · (1 + 3 · …) < 3
        assert_z(f"spread of {name}", float(np.mean(np.square(z))), 31 / 29, np.sqrt(3 / 40), false_alarm=2.5e-4)


@pytest.mark.long
def test_few_rays_of_a_sky() -> None:
    """Batches of one ray have no room for strata: the mean of 20 runs; false alarm 1e-4."""
    lamp, exact = CASES["part of the sky"]
    here = lit(lamp, tube=TUBE | {"r0": 20.0, "r1": 20.0, "z0": 0.0, "z1": 50.0})
    seen = np.array([mistray.trace(here, rays=40, seed=k, ledger=False).energy.detected_W for k in range(20)])
    assert_z("sky", seen.mean(), exact, seen.std(ddof=1) / np.sqrt(20), false_alarm=1e-4)


def test_a_sky_is_aimed_at_the_front_of_a_short_scene() -> None:
    """A cone of sky on a detector whose sphere stands out of that of the scene: π L sin² ρ A; false alarms 1.6e-4."""
    stop = {"type": "frustum", "r0": 0.0, "z0": 30.0, "r1": RADIUS, "z1": 30.0, "bsdf": BLACK}
    here = lit({"type": "sky", "half_angle_deg": 60.0}, stop=stop)
    (run,) = prepare(here, Settings())
    source = run.source
    assert source.aperture is not None
    assert np.linalg.norm(source.aperture.centre - source.scene.centre) + source.aperture.radius > source.scene.radius
    aimed, blind = (mistray.trace(here, rays=30_000, aim=aim) for aim in ("auto", "none"))
    exact = np.pi * np.sin(np.radians(60)) ** 2 * np.pi * RADIUS**2
    assert_z("flux", aimed.energy.detected_W, exact, aimed.energy.detected_se_W, false_alarm=1e-4)
    assert aimed.energy.detected_se_W < 0.7 * blind.energy.detected_se_W
    (a, b), n = ((float(np.sum(t.energy.absorbed["stop"])) / t.energy.launched_W for t in (aimed, blind)), 30_000)
    # Weights of rays beside the aperture are at most 1/0.25 of their share
    assert abs(a - b) < 4 * np.sqrt((4 + 1) * b / n)
    assert aimed.energy.launched_W == pytest.approx(blind.energy.launched_W, rel=1e-9)


def test_the_sun_gaussian_beams_and_near_sources() -> None:
    """Behind a straight edge the irradiance falls as the part of the sun that is seen does; false alarms 0.1 %."""
    edge = {"type": "asphere", "half_width": 50.0, "half_height": 50.0, "y": 50.0, "z": -200.0, "bsdf": BLACK}
    for limb in (0.0, 0.6):
        lamp = {"type": "distant_disc", "diameter_deg": 0.8, "limb": limb}
        t = mistray.trace(lit(lamp, pixels=64, edge=edge), rays=2_000_000, ledger=False)
        y = (np.arange(64) + 0.5) / 64 * 2 * RADIUS - RADIUS
        reach = 200 * np.tan(np.radians(0.4))
        x = np.linspace(-1, 1, 4001)
        rows = []
        for place in y:
            # Light travels to +y by s · reach; the edge covers y > 0 at its distance, so s > place / reach is seen
            s = (place + np.linspace(-0.5, 0.5, 21) * 2 * RADIUS / 64)[:, None] / reach
            mu = np.sqrt(np.maximum(1 - x**2, 0))
            # ∫ 1 - c (1 - μ) along a chord of half length h: 2 h (1 - c) + c π h² / 2
            chord = 2 * mu * (1 - limb) + limb * np.pi / 2 * mu * mu
            whole = np.pi * (1 - limb / 3)
            rows.append(float(np.mean(np.sum(np.where(x > s, chord, 0), axis=1)) * (x[1] - x[0]) / whole))
        middle = slice(28, 36)  # columns of which all of the detector is there
        found = t.irradiance[:, middle].mean(axis=1)
        inside = np.abs(y) < 9
        error = np.linalg.norm(t.light.apart[:, middle], axis=(1, 2)) / 8
        z = (found - np.array(rows))[inside] / np.maximum(error[inside], 2e-3)
        assert np.max(np.abs(z)) < 4.7  # of 2 · 58 numbers
    # Second moments before, at and behind the waists of an astigmatic beam; false alarms 0.1 %
    numbers = {"waist_x": 0.4, "waist_y": 1.1, "m2_x": 2.0, "m2_y": 9.0, "offset_x": 300.0, "offset_y": 900.0}
    for z in (-10.0, -300.0, -1500.0):
        t = mistray.trace(lit({"type": "gaussian_beam", "z": z, "wavelength_nm": 1000.0, **numbers}, 64), rays=100_000)
        places = (np.arange(64) + 0.5) / 64 * 2 * RADIUS - RADIUS
        for k, axis in enumerate("xy"):
            profile = t.irradiance.sum(axis=k)
            mean = float(np.sum(profile * places**2) / profile.sum()) - (2 * RADIUS / 64) ** 2 / 12  # of the pixels
            waist, m2, offset = (numbers[f"{key}_{axis}"] for key in ("waist", "m2", "offset"))
            size = np.sqrt(waist**2 + (m2 * 1e-3 * (-z - offset) / (np.pi * waist)) ** 2)
            error = size**2 / 4 * np.sqrt(2 / 100_000)
            assert_z(f"{axis} at {z}", mean, size**2 / 4, error, false_alarm=1.5e-4)
    here = lit({"type": "point_source", "z": -100.0})
    (source,) = scene_sources(here, field_deg=30.0, azimuth_deg=90.0)
    assert source.pivot + np.array([0, 0, -100]) == pytest.approx([100 * np.tan(np.radians(30)), 0, -100])
    (beam,) = scene_sources(lit({"type": "gaussian_beam", "z": -100.0, "waist_x": 0.1, "waist_y": 0.1}), field_deg=30.0)
    assert beam.direction == pytest.approx([0, 0.5, np.sqrt(0.75)])
    fields: tuple[dict[str, Any], ...] = {"field_mm": 5.0}, {"field_deg": np.degrees(np.arctan(-0.05))}
    both = [mistray.trace(here, rays=1000, **field).energy.detected_W for field in fields]
    assert both[0] == pytest.approx(both[1], rel=1e-5)
    for lamp in ({"type": "collimated", "radius": 1.0}, {"type": "point_source"}, {"type": "sky"}):
        with pytest.raises(mistray.MistrayError, match="degrees"):
            mistray.trace(lit(lamp), rays=1000, field_mm=1.0)


@pytest.mark.long
def test_few_rays_of_a_wide_lamp() -> None:
    """A hundredth of a half space through a window, by ten rays in a batch: the mean of 20 runs, 6 standard errors."""
    window = {"type": "interface", "front": "air", "back": "1.0", "R": 0.0, "T": 1.0}
    scene = load(
        lamp={"type": "point_source", "z": -30.0, "half_angle_deg": 90.0},
        window={"type": "asphere", "semi_diameter": 5.0, "bsdf": window},
        tube=TUBE | {"z0": -5.0, "z1": 50.0, "r0": 20.0, "r1": 20.0},
        detector=detector(1.0, semi_diameter=5.0),
    )
    runs = [mistray.trace(scene, rays=320, seed=seed, ledger=False).energy for seed in range(20)]
    seen = np.array([energy.detected_W / energy.launched_W for energy in runs])
    assert_z("light", seen.mean(), 1 - 31 / np.hypot(31, 5), seen.std(ddof=1) / np.sqrt(20), k=6.0)
    assert max(abs(energy.closure) for energy in runs) < 1e-5


def test_sky_beside_a_bright_sun_has_all_its_directions() -> None:
    """Of a sky with 1e-6 of the light, to which 8 of the 2^23 values of a random float32 lead."""
    share, edge = 1e-6, np.cos(0.1)
    bright = (1 - share) / share * 2 / (1 - edge)
    sky = SkyMap(lambda d: np.where(d[:, 2] > edge, bright, 1.0), 1024)
    rng = np.random.default_rng(0)
    first = 1 - 2.0**-23 * rng.integers(1, 9, 4000)
    sample = mi.Point2d(mi.Float64(first), mi.Float64(mi.Float(rng.random(4000))))
    assert len(np.unique(np.array(sky.directions(sample))[2])) > 2000


def test_star_in_a_sky_with_more_pixels_than_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sky_map, "MOST_ROWS", 64)

    def star(d: np.ndarray) -> np.ndarray:
        rows = np.floor(np.arccos(d[:, 2]) * 256 / np.pi)
        return np.where((rows == 101) & (np.floor(np.arctan2(d[:, 1], d[:, 0]) * 256 / np.pi) == 37), 1.0, 0.0)

    exact = np.pi / 256 * (np.cos(101 * np.pi / 256) - np.cos(102 * np.pi / 256))
    assert SkyMap(star, 256).irradiance == pytest.approx(exact, rel=1e-9)


def test_picture_of_a_sky(tmp_path: Path) -> None:
    """A rough picture, by Mitsuba's envmap and by `sky`, as `path` renders it on a plate; false alarms 0.1 %."""
    file = str(tmp_path / "a sky.exr")
    mi.Bitmap(np.kron(np.random.default_rng(1).random((8, 16, 1)), np.ones((4, 4, 3))).astype(np.float32)).write(file)
    turned = mi.ScalarTransform4f().rotate([0, 0.6, 0.8], 40)
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}, "pixel_format": "luminance"}
    place, sensor = mi.ScalarTransform4f().rotate([0, 1, 0], 180), {"type": "irradiancemeter", "film": film}
    plate = {"type": "rectangle", "to_world": place.scale([5, 5, 1]), "bsdf": BLACK, "sensor": sensor}
    lid = {"type": "asphere", "half_width": 60.0, "half_height": 60.0, "z": 0.1, "bsdf": BLACK}
    around = {"type": "envmap", "filename": file, "scale": 2.0, "to_world": turned}
    path = mi.load_dict({"type": "path"})
    stock = lit(around, lid=lid, detector=plate)
    rendered = [float(np.array(mi.render(stock, spp=100_000, seed=k, integrator=path)).ravel()[0]) for k in range(4)]
    for lamp in (around, {"type": "sky", "filename": file, "radiance": 2.0, "to_world": turned}):
        energy = mistray.trace(lit(lamp, lid=lid, detector=plate), rays=400_000).energy
        error = float(np.hypot(energy.detected_se_W / 100, np.std(rendered)))
        assert_z(lamp["type"], energy.detected_W / 100, float(np.mean(rendered)), error, false_alarm=5e-4)
        assert abs(energy.closure) < 1e-6


@pytest.mark.parametrize("ordering", ["RING", "NESTED"])
def test_sky_in_healpix(ordering: str, tmp_path: Path) -> None:
    """Of L = 1 + z² in the direction that light comes from, a plate with a normal n gets ∫ L cos dΩ; 0.1 % each."""
    fits = pytest.importorskip("astropy.io.fits")
    side = 32
    count = 400_000
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    d = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    number = pixel(side, d, ordering == "NESTED")
    values = np.bincount(number, 1 + z * z) / np.bincount(number)
    file = tmp_path / "a sky.fits"
    table = fits.BinTableHDU.from_columns([fits.Column("I", "D", array=values)])
    table.header["ORDERING"] = ordering
    table.writeto(file)
    energy = mistray.trace(lit({"type": "sky", "filename": str(file)}), rays=200_000).energy
    # Both sides of the detector, across z: 2 · 2π ∫ (1 + c²) c dc = 4π (1/2 + 1/4)
    exact = 3 * np.pi * np.pi * RADIUS**2
    assert_z("flux", energy.detected_W, exact, np.hypot(energy.detected_se_W, 2e-4 * exact), false_alarm=5e-4)
    aside = {"type": "sky", "filename": str(file), "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90)}
    energy = mistray.trace(lit(aside), rays=200_000).energy
    # Across another axis z is s cos φ: 2 ∫ (1 + s² cos² φ) c dΩ = 4π (1/2 + 1/2 · 1/4)
    exact = 4 * np.pi * (0.5 + 0.125) * np.pi * RADIUS**2
    assert_z("aside", energy.detected_W, exact, np.hypot(energy.detected_se_W, 2e-4 * exact), false_alarm=5e-4)
    table.header["ORDERING"] = "none"
    table.writeto(file, overwrite=True)
    with pytest.raises(mistray.MistrayError, match="ORDERING"):
        lit({"type": "sky", "filename": str(file)})


def test_several_sources_of_scenes_and_calls() -> None:
    lamps = {
        "lamp": {"type": "point_source", "z": -20.0, "power": 2.0},
        "moon": {"type": "distant_disc", "irradiance": 1e-3},
        "screen": {"type": "surface_source", "radius": 3.0, "z": -9.0},
    }
    t = mistray.trace(lit(lamps.pop("lamp"), **lamps), rays=30_000)
    table = t.paths.to_pandas()
    assert set(table.source) == {"lamp", "moon", "screen"}
    assert abs(t.energy.closure) < 1e-6
    for name, launched in (("lamp", 2.0), ("screen", 1.0)):
        own = t.energy_of(name)
        assert own.launched_W == pytest.approx(launched, rel=1e-6)
        assert abs(own.closure) < 1e-6
        assert set(t.rays(f"source = {name}", n=20).source) == {name}
        assert own.detected_W == pytest.approx(table.power_W[table.source == name].sum(), rel=1e-6)
    with pytest.raises(mistray.MistrayError, match="'sun'"):
        t.energy_of("sun")
    assert table.power_W.sum() == pytest.approx(t.energy.detected_W, rel=1e-9)
    detector = {"type": "asphere", "semi_diameter": RADIUS, "bsdf": BLACK, "sensor": meter()}
    given = {"type": "scene", "detector": detector, "own": {"type": "collimated", "radius": 1.0}}
    for sources, names in (
        ("point:0,0,-20,power=3", {"source"}),
        ({"type": "sky"}, {"source"}),
        (["sun:field_deg=10", {"type": "point_source", "z": -5.0, "id": "a lamp"}], {"source_1", "a lamp"}),
        ("laser:0,0,-5,waist_x=1e-3,waist_y=1e-3,wavelength_nm=450 550", {"source"}),
    ):
        here = mistray.load(given, sources)
        assert {emitter.id() for emitter in here.emitters()} == names
        assert mistray.trace(here, rays=1000).energy.detected_W > 0
    for wrong in ("point:0,0", "point:0,a,1", "", "point:0,0,1,z=2", "warp:0,0,1", "point:0,0,1,power", {"z": 1.0}):
        with pytest.raises(mistray.MistrayError):
            mistray.load(given, wrong)
    # From its middle all light meets the surface at right angles, 4 % of it comes back there
    glass = {"type": "interface", "back": "1.5"}
    ball = {"type": "sphere", "center": [0, 0, -50], "radius": 5.0, "flip_normals": True, "bsdf": glass}
    energy = mistray.trace(lit({"type": "point_source", "z": -50.0, "power": 1.0}, block=ball), rays=1000).energy
    assert energy.escaped_W + energy.detected_W == pytest.approx(0.96 * (1 + 0.04 + 0.04**2), rel=1e-5)


LIT_MM = 8.0  # radius of the light on the detector
TURNS = [*(([0, 1, 0], angle) for angle in (0.0, 5.0, -12.0)), ([1, 0, 0], 30.0), ([1, 2, 3], 47.0), ([2, -1, 5], 171)]


def turned(axis: list[int], angle: float) -> mi.ScalarTransform4f:
    unit = np.array(axis) / np.linalg.norm(axis)
    return mi.ScalarTransform4f().rotate(unit.tolist(), angle)


def turned_scene(source: dict[str, Any], frame: mi.ScalarTransform4f) -> mi.Scene:
    detector = {"type": "asphere", "semi_diameter": 10.0, "bsdf": BLACK, "sensor": meter(), "to_world": frame}
    return lit({"id": "source", **source, "to_world": frame}, detector=detector)


@pytest.mark.filterwarnings("ignore:source 'source'. to_world is in single precision")
@pytest.mark.parametrize("half_angle_deg", [3.0, 0.02, 0.00458, 1e-3, 1e-4])
def test_a_turned_scene_has_the_same_light(half_angle_deg: float) -> None:
    """Uniform in solid angle, tan² θ is sec α - 1 on average; the error of the strata is 5 times below the 1e-3."""
    half_angle = np.radians(half_angle_deg)
    distance = LIT_MM / np.tan(half_angle)
    rms = distance * np.sqrt(2 * np.sin(half_angle / 2) ** 2 / np.cos(half_angle))
    source = {"type": "point_source", "z": -distance, "half_angle_deg": half_angle_deg}
    for axis, angle in TURNS:
        found = mistray.trace(turned_scene(source, turned(axis, angle)), rays=40_000, seed=1)
        assert found.energy.detected_W == pytest.approx(1.0, rel=1e-5), (axis, angle)
        assert found.paths[0].rms_radius_mm == pytest.approx(rms, rel=1e-3), (axis, angle)


@pytest.mark.parametrize("half_angle_deg", [90.0, 40.0, 3.0, 0.02, 1e-4, 1e-6])
@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.5, 1e4])
def test_solid_angle_of_a_cone(exponent: float, half_angle_deg: float) -> None:
    """By Gauss and Legendre in 200 parts of the angle."""
    edges = np.linspace(0, np.radians(half_angle_deg), 201)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    half = 0.5 * np.diff(edges)[:, None]
    theta = edges[:-1, None] + half * (1 + nodes)
    log_cosine = np.log1p(-2 * np.sin(theta / 2) ** 2)
    expected = 2 * np.pi * float(np.sum(half * weights * np.exp(exponent * log_cosine) * np.sin(theta)))
    assert cosine_power_angle(exponent, float(np.radians(half_angle_deg))) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("lamp", "key", "value", "words"),
    [
        ({"type": "surface_source", "radius": 1.0, "inner_radius": 0.5}, "radius", 0.4, "inner_radius is 0.5 mm"),
        ({"type": "surface_source", "radius": 1.0}, "radius", 0.0, "radius is 0"),
        ({"type": "point_source", "half_angle_deg": 60.0, "exponent": 1.0}, "half_angle_deg", 120.0, "at most 90"),
    ],
)
def test_an_update_is_refused_as_a_scene_is(lamp: dict[str, Any], key: str, value: float, words: str) -> None:
    with refused("source 'lamp'", words):
        lit({**lamp, key: value})
    made = lit(lamp).emitters()[0]
    params = mi.traverse(made)
    params[key] = mi.Float(value)
    with refused("source 'lamp'", words):
        params.update()
    params[key] = mi.Float([])
    with refused("source 'lamp'", f"{key} has 0 entries"):
        params.update()
    assert made.values[key] == float(mi.traverse(made)[key][0]) == lamp[key]


@pytest.mark.parametrize("kind", ["distant_disc", "sky"])
def test_a_particle_tracer_gets_no_light_that_fills_the_scene(kind: str) -> None:
    image = mi.render(lit({"type": kind}), integrator=mi.load_dict({"type": "ptracer"}), spp=1)
    assert not np.any(np.array(image))


def test_a_rough_axis_is_named() -> None:
    """1e-7 rad is 6 % of 1e-4 degrees; frames without a turn, or in double precision, are exact."""
    source = {"type": "point_source", "z": -100.0, "half_angle_deg": 1e-4}
    laser = {"type": "gaussian_beam", "waist_x": 50.0, "waist_y": 1.0, "wavelength_nm": 500.0}  # 3.2e-6 rad
    turn = turned([0, 1, 0], 5.0)
    for given in (source, laser):
        with pytest.warns(mistray.MistrayWarning, match="source 'source'.* 1e-07 rad, (6|3) % of the half angle"):
            turned_scene(given, turn)
    double = mi.ScalarTransform4d().rotate([0, 1, 0], 5.0)
    quarter = mi.ScalarTransform4f([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        turned_scene(source, double)
        turned_scene(source, quarter)
        turned_scene({**source, "half_angle_deg": 1e-3}, turn)


METAL = {"type": "interface", "back": "Al"}
BLOCK = {"type": "sphere", "center": [0, 0, 50], "radius": 5.0, "flip_normals": True, "bsdf": METAL}
SHAPES = """
<shape type="asphere" id="screen"><float name="semi_diameter" value="10"/>
  <bsdf type="interface"><float name="R" value="0"/></bsdf>
  <sensor type="irradiancemeter"><film type="hdrfilm"><rfilter type="box"/></film></sensor></shape>
"""


@pytest.mark.parametrize("row", vectors.toml("plugin_refusals.toml")["sources"], ids=repr)
def test_one_line(row: list[Any], tmp_path: Path) -> None:
    lamp, *words = row
    for name, text in vectors.toml("tables.toml")["files of lamps"].items():
        (tmp_path / name).write_text(text)
    mi.Bitmap(np.zeros((4, 8, 3), dtype=np.float32)).write(str(tmp_path / "dark.exr"))
    kinds = ("csv", "dat", "ies", "exr")
    files = {key: str(tmp_path / str(value)) for key, value in lamp.items() if str(value).endswith(kinds)}
    with refused("lamp", *words):
        mistray.trace(lit({"id": "my lamp", **lamp, **files}, block=BLOCK), rays=1000)


def test_by_a_file_and_by_an_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same lines; in a list of an option blanks stand for commas."""
    file = tmp_path / "a scene.xml"
    for keys, words in (
        ({"power": "-1"}, ("power is -1", "1e-30")),
        ({"stokes": "1, 1, 0"}, ("stokes is 1, 1, 0", "at most 1")),
        ({"filename": str(tmp_path / "none.ies")}, ("none.ies", "check the path")),
    ):
        rows = "".join(f'<{"float" if k == "power" else "string"} name="{k}" value="{v}"/>' for k, v in keys.items())
        emitter = f'<emitter type="point_source" id="my lamp">{rows}</emitter>'
        option = ",".join(["point_source:id=my lamp", *(f"{k}={v.replace(',', '')}" for k, v in keys.items())])
        for text, more in ((emitter, ()), ("", ("--source", option))):
            file.write_text(f'<scene version="3.0.0">{text}{SHAPES}</scene>')
            message = fails(capsys, "ghosts", file, "--rays", 1000, *more)
            for word in ("my lamp", *words):
                assert word in message


def test_kinds_that_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The kinds of sources are named, and no plugin that is none; stock emitters that cannot be traced are none."""
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0"><emitter type="warp"/>{SHAPES}</scene>')
    message = fails(capsys, "ghosts", tmp_path / "scene.xml")
    assert "point_source" in message
    assert not any(name in message for name in ("asphere", "light_source"))
    with pytest.raises(mistray.MistrayError, match="Projector"):
        mistray.trace(lit({"type": "projector", "irradiance": {"type": "spectrum", "value": 1.0}, "fov": 20.0}))

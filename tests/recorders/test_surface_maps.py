"""Light at surfaces: what they do with it, where it falls on walls, and parts of it; closed forms and the ledger."""

import json
from collections.abc import Callable

import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
from command_line import fails, succeeds
from lit_detector import BLACK, lit, meter, square
from oracles import closed_forms

import mistray
from mistray import MistrayError
from mistray.recorders import FluxSplit, SplitRow, SurfaceMaps
from mistray.recorders.path_events import DIRECT, STRAY_KINDS
from mistray.report import IrradianceMap, read_irradiance
from mistray.scene.other_sensors import sensor_dict

N = 1.5
R = ((N - 1) / (N + 1)) ** 2
SOURCE = np.array([0.7, -0.4, 3.0])
Place = Callable[[np.ndarray, np.ndarray], np.ndarray]


def scene_of(source: np.ndarray, **shapes: dict) -> mi.Scene:
    """Shapes, a lamp of 1 W that shines everywhere, and a small detector far away."""
    detector = {"type": "asphere", "semi_diameter": 0.01, "z": 500.0, "bsdf": BLACK, "sensor": meter()}
    lamp = {"type": "point_source", **dict(zip("xyz", map(float, source), strict=True))}
    return lit(lamp, **{"detector": detector} | shapes)


def tube(z0: float, z1: float, **more: str) -> dict:
    return {"type": "frustum", "r0": 5.0, "r1": 5.0, "z0": z0, "z1": z1, "bsdf": BLACK, **more}


def in_tube(one: mistray.recorders.SurfaceMap, z0: float) -> np.ndarray:
    """Share of the light of a lamp at z0 on the axis of a tube of 5 mm in each cell of a ring."""
    u = (one.along_mm - z0) / np.hypot(5.0, one.along_mm - z0)
    return 0.5 * np.diff(u)[:, None] / one.incident.value.shape[1]


def flux(place: Place, source: np.ndarray, u: np.ndarray, v: np.ndarray, steps: int = 24) -> np.ndarray:
    """Flux of an isotropic lamp of 1 W through cells with borders u and v of a surface p(u, v), W."""
    found = np.zeros((len(u) - 1, len(v) - 1))
    for i, j in np.ndindex(found.shape):
        fine = [np.linspace(a[k], a[k + 1], steps + 1) for a, k in ((u, i), (v, j))]
        middle = np.meshgrid(*[0.5 * (f[:-1] + f[1:]) for f in fine], indexing="ij")
        du, dv = (f[1] - f[0] for f in fine)
        h = 1e-5
        along = (place(middle[0] + h * du, middle[1]) - place(middle[0] - h * du, middle[1])) / (2 * h)
        across = (place(middle[0], middle[1] + h * dv) - place(middle[0], middle[1] - h * dv)) / (2 * h)
        away = place(*middle) - source
        found[i, j] = np.abs(np.sum(away * np.cross(along, across), axis=-1) / np.linalg.norm(away, axis=-1) ** 3).sum()
    return found / (4 * np.pi)


def turned(radius: Callable[[np.ndarray], np.ndarray], z: Callable[[np.ndarray], np.ndarray]) -> Place:
    def place(u: np.ndarray, deg: np.ndarray) -> np.ndarray:
        phi = np.radians(deg)
        return np.stack([radius(u) * np.cos(phi), radius(u) * np.sin(phi), z(u)], axis=-1)

    return place


@pytest.mark.quick
def test_the_wall_of_a_tube_about_a_lamp_on_its_axis():
    """E = Φ a / (4π (a² + z²)^(3/2)); a ring between z1 and z2 has Φ/2 (u(z2) - u(z1)), u = z / √(a² + z²)."""
    a, z0 = 5.0, 3.0
    walls = SurfaceMaps("walls", azimuths=6, lengths=10)
    t = mistray.trace(scene_of(np.array([0, 0, z0]), tube=tube(-10.0, 20.0)), rays=200_000, recorders=[walls])
    one = walls.maps["tube"]
    np.testing.assert_allclose(one.along_mm, np.linspace(-10, 20, 11), atol=1e-12)
    # 60 cells within 6 standard errors of 32 batches: fails once in 10 000
    assert np.all(np.abs(one.incident.value - in_tube(one, z0)) < 6 * one.incident.se)
    value, se = one.irradiance
    centre = 0.5 * (one.along_mm[1:] + one.along_mm[:-1])
    middle = a / (4 * np.pi * (a * a + (centre - z0) ** 2) ** 1.5)
    # Over cells of 3 mm the mean differs from the value in the middle by E'' h² / 24, at most 2 % here
    assert np.all(np.abs(value - middle[:, None]) < 6 * se + 0.06 * middle[:, None])
    np.testing.assert_allclose(one.areas, 2 * np.pi * a * 3 / 6)
    assert one.absorbed_power[0] == pytest.approx(t.energy.absorbed["tube"][0], rel=1e-6)
    assert one.power[1] == pytest.approx(t.energy.absorbed["tube"][1], rel=1e-6)
    hemisphere = {"type": "asphere", "radius": 3.0, "semi_diameter": 3.0, "bsdf": BLACK}
    walls = SurfaceMaps("walls", azimuths=4, lengths=3)
    mistray.trace(scene_of(SOURCE, half=hemisphere), rays=100, recorders=[walls])
    one = walls.maps["half"]
    np.testing.assert_allclose(one.areas * 4, 2 * np.pi * 3 * np.diff(3 - np.sqrt(9 - one.along_mm**2)), rtol=1e-9)
    x0, x1, y0, y1 = one.unrolled_mm
    assert (x1 - x0) * (y1 - y0) == pytest.approx(2 * np.pi * 9, rel=1e-9)


POSE = mi.ScalarTransform4d().translate([1, 2, -4]).rotate([1, 0, 0], 20).rotate([0, 0, 1], 35)
CASES: dict[str, tuple[dict, Place]] = {
    "tube": ({"type": "frustum", "r0": 5.0, "r1": 5.0, "z0": -8.0, "z1": 10.0},
             turned(lambda z: 5.0 + 0 * z, lambda z: z)),
    "cone": ({"type": "frustum", "r0": 7.0, "r1": 4.0, "z0": 9.0, "z1": -6.0},
             turned(lambda z: 4.0 + (z + 6) / 5, lambda z: z)),
    "ring": ({"type": "frustum", "r0": 9.0, "r1": 2.0, "z0": 12.0, "z1": 12.0},
             turned(lambda r: r, lambda r: 12.0 + 0 * r)),
    "bowl": ({"type": "asphere", "radius": -12.0, "conic": -0.4, "semi_diameter": 9.0, "inner_semi_diameter": 1.0,
              "z": 14}, turned(lambda r: r, lambda r: 14 - (r * r / 12) / (1 + np.sqrt(1 - 0.6 * (r / 12) ** 2)))),
    "plane": ({"type": "asphere", "half_width": 6.0, "half_height": 4.0, "z": 9.0},
              lambda y, x: np.stack([x, y, 9.0 + 0 * x], axis=-1)),
}  # fmt: skip


@pytest.mark.quick
@pytest.mark.parametrize("name", CASES)
def test_surfaces_beside_a_lamp(name):
    """Flux through each cell of a tilted surface, by quadrature of its solid angle; azimuths from x towards y."""
    shape, place = CASES[name]
    matrix = np.array(POSE.matrix, dtype=np.float64)
    source = matrix[:3, :3] @ SOURCE + matrix[:3, 3]
    walls = SurfaceMaps("walls", azimuths=8, lengths=5)
    mistray.trace(scene_of(source, wall=shape | {"to_world": POSE, "bsdf": BLACK}), rays=150_000, recorders=[walls])
    one = walls.maps["wall"]
    exact = flux(place, SOURCE, one.along_mm, one.across_borders)
    # 40 cells within 6 standard errors of 32 batches: fails once in 20 000 for each surface
    assert np.all(np.abs(one.incident.value - exact) < 6 * one.incident.se + 1e-5 * exact)
    middles = np.meshgrid(*[0.5 * (b[1:] + b[:-1]) for b in (one.along_mm, one.across_borders)], indexing="ij")
    np.testing.assert_allclose(one.places, place(*middles) @ matrix[:3, :3].T + matrix[:3, 3], atol=1e-9)


@pytest.mark.parametrize("name", ["plate_and_wall", pytest.param("double_gauss_barrel", marks=pytest.mark.long)])
def test_powers_are_those_of_the_ledger(name):
    scene = mistray.load(name, sources=["point:0,3,-300,half_angle_deg=3,id=lamp", "beam:radius=9,distance=20,id=sun"])
    walls = SurfaceMaps("all", "*", azimuths=5, lengths=3)
    t = mistray.trace(scene, rays=4000, wavelength_nm=[480.0, 640.0], max_reflections=2, recorders=[walls])
    assert set(walls.maps) == {row.id for row in t.surfaces} - set(walls.left_out)
    assert not walls.left_out
    rows = {row.id: row for row in t.surfaces}
    for name, one in walls.maps.items():
        for power, ledger in ((one.absorbed_power, rows[name].absorbed_W), (one.power, rows[name].incident_W)):
            assert power[0] == pytest.approx(ledger, rel=1e-6, abs=1e-9 * t.energy.launched_W), name
    assert walls.power[0] == pytest.approx(sum(row.incident_W for row in t.surfaces), rel=1e-6)


def test_standard_errors_hold_over_seeds():
    """z² of 24 cells over 24 seeds, each of a t-distribution of 31 degrees: mean 1.07 ± 0.07; fails once in 10⁶."""
    scene = scene_of(np.array([0, 0, 3.0]), tube=tube(-3.0, 9.0))
    squares = []
    for seed in range(24):
        walls = SurfaceMaps("walls", azimuths=4, lengths=6)
        mistray.trace(scene, rays=20_000, seed=seed, recorders=[walls])
        one = walls.maps["tube"]
        squares.append(((one.incident.value - in_tube(one, 3.0)) / one.incident.se) ** 2)
    assert abs(np.mean(squares) - 31 / 29) < 5 * 0.07


def test_patterns_and_what_cannot_be_unrolled():
    scene = scene_of(
        SOURCE,
        tube=tube(-3.0, 9.0, part="barrel"),
        lump={"type": "cube", "bsdf": BLACK},
        lens={"type": "asphere", "semi_diameter": 1.0, "z": 8.0, "bsdf": {"type": "interface", "back": "1.5"}},
    )
    every = {"tube", "lens", "detector"}
    for patterns, mapped in (((), {"tube"}), ("barrel", {"tube"}), (["l*"], {"lens"}), ("*", every)):
        walls = SurfaceMaps("walls", patterns)
        mistray.trace(scene, rays=100, recorders=[walls])
        assert set(walls.maps) == mapped
        assert set(walls.left_out) == ({"lump"} if patterns in ((), ["l*"], "*") else set())
    for patterns, word in (("barel", "barrel"), ("lump", "lump")):
        with pytest.raises(MistrayError, match=word):
            mistray.trace(scene, rays=100, recorders=[SurfaceMaps("walls", patterns)])
    with pytest.raises(MistrayError, match="recorded nothing"):
        _ = SurfaceMaps("walls").maps
    used = SurfaceMaps("walls")
    mistray.trace(scene, rays=100, recorders=[used])
    with pytest.raises(MistrayError, match="another scene"):
        mistray.trace(mistray.load("plate"), rays=100, recorders=[used])
    for numbers in ({"azimuths": 0}, {"lengths": -1}, {"azimuths": 2.5}, {"azimuths": 65536, "lengths": 65536}):
        with pytest.raises(MistrayError):
            SurfaceMaps("walls", **numbers)


@pytest.mark.quick
def test_a_sensor_of_a_scene_and_its_text():
    assert sensor_dict("surface_maps:barrel* hood,azimuths=8,id=walls") == {
        "type": "surface_maps", "surfaces": "barrel* hood", "azimuths": 8, "id": "walls",
    }  # fmt: skip
    for text in ("surface_maps:azimuths=many", "surface_maps:x,width=3", "surface_maps:id=a,id=b"):
        with pytest.raises(MistrayError):
            sensor_dict(text)
    with pytest.raises(MistrayError, match=r"edges_deg.* of probe"):
        mistray.load("plate", sensors="probe:0,0,17,edges_deg=0:90:5")
    with pytest.raises(Exception, match="to_world"):
        mi.load_dict({"type": "surface_maps", "to_world": mi.ScalarTransform4f()})
    walls = {"type": "surface_maps", "surfaces": "tube_?", "azimuths": 8, "lengths": 4}
    tubes = {f"tube_{k}": tube(3.0 * k, 3.0 * k + 2) for k in (1, 2)}
    lamp = scene_of(SOURCE, walls=walls, **tubes)
    assert list(mistray.trace(lamp, rays=1000, max_reflections=0).recorders["walls"].maps) == ["tube_1", "tube_2"]
    number = [sensor.id() for sensor in lamp.sensors()].index("walls")
    image = np.array(mi.render(lamp, sensor=number, integrator=mi.load_dict({"type": "straylight", "rays": 1000})))
    assert image.shape == (8, 8, 1)


def power_of(one: IrradianceMap) -> float:
    x0, x1, y0, y1 = one.extent
    return float(one.irradiance.sum()) * (x1 - x0) * (y1 - y0) / one.irradiance.size


def test_the_command_prints_draws_and_writes_them(tmp_path, capsys):
    out = tmp_path / "out"
    command = ["ghosts", "plate_and_wall", "--field-deg", "20", "--rays", "500", "--max-scatters", "0"]
    more = ["--surface-maps", "housing*", "screen,lengths=6", "--formats", "npy", "--json", "--quiet"]
    rows = json.loads(succeeds(capsys, *command, *more, "--out", out))["sections"]["walls"]
    table = pd.read_csv(out / "surface_maps.csv")
    assert len(table) == 3 == len(rows["surface_maps"] if isinstance(rows, dict) else rows)
    assert (out / "surface_maps_20deg.png").stat().st_size > 10_000
    one = read_irradiance(out / "irradiance_surface_maps_housing_wall_20deg.npy")
    assert one.irradiance.shape == (6, 36)
    row = table[table.surface == "housing_wall"].iloc[0]
    assert power_of(one) == pytest.approx(row.incident_W, rel=1e-6)
    assert row.brightest_cell_W_mm2 == pytest.approx(one.irradiance.max(), rel=1e-6)


@pytest.mark.quick
def test_ghosts_of_a_window_on_a_plate():
    """R of the front, R (1 - R)² of the rear, and the ghost of three reflections R³ (1 - R)² within the window."""
    face = {"type": "asphere", "semi_diameter": 6.0}
    shapes = {
        "front": face | {"z": 10.0, "bsdf": {"type": "interface", "back": f"{N}"}},
        "rear": face | {"z": 12.0, "bsdf": {"type": "interface", "front": f"{N}"}},
        "plate": {"type": "asphere", "half_width": 8.0, "half_height": 8.0, "z": -5.0, "bsdf": BLACK},
    }
    beam = {"type": "collimated", "radius": 5.0, "irradiance": 1 / (25 * np.pi), "distance": 3.0}
    t = mistray.trace(lit(beam, **shapes, detector=square(8.0, 16, z=20.0)), rays=2000, max_reflections=3)
    parts = {
        "G(front) & !G(rear)": R,
        "G(rear) & !G(front)": (1 - R) ** 2 * R,
        "G = 3": (1 - R) ** 2 * R**3,
        "ghost": R + (1 - R) ** 2 * (R + R**3),
        "order < 2": R + (1 - R) ** 2 * R,
        "rear -> front": 0.0,
        "all": R + (1 - R) ** 2 * (R + R**3),
    }
    found = t.surface_maps("plate", list(parts), azimuths=5, lengths=4)
    for maps, (text, power) in zip(found, parts.items(), strict=True):
        # The rays carry equal flux, and all of them meet the plate
        assert maps["plate"].power[0] == pytest.approx(power, rel=2e-6, abs=1e-12), text
        assert maps["plate"].absorbed_power[0] == pytest.approx(power, rel=2e-6, abs=1e-12), text
    for wrong in ("power_W > 1", "S(plat)", "ghosts", "kind = ghst"):
        with pytest.raises(MistrayError):
            t.surface_maps("plate", wrong)
    with pytest.raises(MistrayError, match="plat"):
        t.surface_maps("plat")


def test_parts_add_up_to_what_a_recorder_sums():
    """Cell by cell, of light that scatters, at two wavelengths; the recorder sums in the kernel, without the parts."""
    walls = SurfaceMaps("walls", ["housing*", "screen", "detector"], azimuths=6, lengths=4)
    settings = {"field_deg": 12.0, "wavelength_nm": [480.0, 640.0], "max_reflections": 1}
    t = mistray.trace(mistray.load("plate_and_wall"), rays=6000, recorders=[walls], **settings)
    kinds = [DIRECT, *STRAY_KINDS]
    whole, *parts = t.surface_maps(walls.patterns, ["all", *kinds], azimuths=6, lengths=4)
    assert set(whole) == set(walls.maps)
    for name, one in walls.maps.items():
        for what in ("incident", "absorbed"):
            expected, sums = getattr(one, what), [getattr(maps[name], what) for maps in parts]
            scale = 1e-9 * t.energy.launched_W
            np.testing.assert_allclose(getattr(whole[name], what).value, expected.value, rtol=1e-6, atol=scale)
            np.testing.assert_allclose(getattr(whole[name], what).se, expected.se, rtol=1e-5, atol=scale)
            np.testing.assert_allclose(sum(s.value for s in sums), expected.value, rtol=1e-6, atol=scale)
    by_kind = {kind: maps["detector"].absorbed_power[0] for kind, maps in zip(kinds, parts, strict=True)}
    for kind, power in by_kind.items():
        assert power == pytest.approx(sum(row.power_W for row in t.paths.select(kind)), rel=1e-6, abs=1e-12), kind


COMMAND = ["ghosts", "plate_and_wall", "--rays", "500", "--max-scatters", "1", "--quiet"]


def test_the_command_maps_parts_of_the_light(tmp_path, capsys):
    for wrong, word in (("goost", "ghost"), ("S(screeen)", "screen"), ("power_W > 1", "power_W")):
        assert word in fails(capsys, *COMMAND, "--maps", wrong, "--surface-maps", "screen")
    out = tmp_path / "out"
    lights = ["single scatter", "S(plate*) & !G", "stray"]
    more = ["--surface-maps", "screen", "lengths=6", "--formats", "npy", "--json"]
    found = succeeds(capsys, *COMMAND, "--maps", *lights, *more, "--out", out)
    assert [(row["light"], row["surface"]) for row in json.loads(found)["sections"]["light"]["light_maps"]] == [
        (light, where) for light in lights for where in ("detector", "screen")
    ]
    table = pd.read_csv(out / "light_maps.csv")
    assert (out / "light_maps_0deg.png").stat().st_size > 10_000
    files = ("single_scatter", "single_scatter_screen", "S_plate_G", "S_plate_G_screen", "stray", "stray_screen")
    for name, (_, row) in zip(files, table.iterrows(), strict=True):
        assert power_of(read_irradiance(out / f"irradiance_{name}_0deg.npy")) == pytest.approx(row.power_W, rel=1e-6)
    probes = [f"0,0,{z},half_width=0.5,half_height=0.25,id={name}" for z, name in ((-1, "ghost"), (-2, "ghost!"))]
    succeeds(capsys, *COMMAND, "--maps", "ghost", "--probe", *probes, "--formats", "npy", "--out", tmp_path / "two")
    assert {file.name for file in (tmp_path / "two").glob("irradiance_ghost*")} == {
        f"irradiance_ghost{number}_0deg.npy" for number in ("", "_2", "_3")
    }
    paths = pd.read_csv(out / "paths.csv")
    assert table.power_W[4] == pytest.approx(paths[(paths.kind != DIRECT)].power_W.sum(), rel=1e-6)


A, B = 0.02, 0.25
TIS = np.pi * A / (1 + B)  # of ABg scatter with g = 0, which is Lambertian
SHARES = ("absorbed", "specular_reflection", "specular_transmission", "scattered_reflection", "scattered_transmission")
BEAM = {"type": "collimated", "radius": 2.0, "irradiance": 1 / (4 * np.pi)}


def split(bsdf: dict, split_of: str = "sample", tilt: float = 0.0, **settings: object) -> dict[str, SplitRow]:
    """A beam of 1 W on a plane sample, tilted about x, before a black wall and a detector that stands aside."""
    pose = mi.ScalarTransform4d().rotate([1, 0, 0], tilt)
    detector = {"type": "asphere", "semi_diameter": 0.5, "x": 300.0, "z": -300.0, "bsdf": BLACK, "sensor": meter()}
    sample = {"type": "asphere", "semi_diameter": 20.0, "to_world": pose, "bsdf": bsdf}
    scene = lit({**BEAM, "distance": 50.0}, sample=sample, detector=detector)
    found = FluxSplit("split", split_of)
    t = mistray.trace(scene, rays=500, recorders=[found], **settings)
    for row in found.rows:
        ledger = next(one for one in t.surfaces if one.id == row.surface)
        assert row.incident == pytest.approx((ledger.incident_W, ledger.incident_se_W), rel=1e-6, abs=1e-9)
        assert row.absorbed == pytest.approx((ledger.absorbed_W, ledger.absorbed_se_W), rel=1e-6, abs=1e-9)
        assert abs(row.closure) < 1e-6
    return {row.surface: row for row in found.rows}


def interface(*nested: dict, **what: object) -> dict:
    return {"type": "interface", **what} | {f"scatter_{k}": one for k, one in enumerate(nested)}


ABG = {"type": "abg", "A": A, "B": B, "g": 0.0}
ROUGH_MIRROR = interface(ABG | {"event": "reflection"}, R=0.8, T=0.0)
SURFACES = {
    "bare glass": (interface(back=f"{N}"), (0.0, R, 1 - R, 0.0, 0.0)),
    "lossy coating": (interface(R=0.2, T=0.5), (0.3, 0.2, 0.5, 0.0, 0.0)),
    "rough glass": (interface(ABG, back=f"{N}"), (0.0, R * (1 - TIS), (1 - R) * (1 - TIS), R * TIS, (1 - R) * TIS)),
    "rough lossy mirror": (ROUGH_MIRROR, (0.2, 0.8 * (1 - TIS), 0.0, 0.8 * TIS, 0.0)),
}


@pytest.mark.quick
@pytest.mark.parametrize("name", SURFACES)
def test_a_plane_at_right_angles(name):
    """All rays meet the sample alike: there is no noise. What the limits cut has its share."""
    bsdf, shares = SURFACES[name]
    row = split(bsdf, max_reflections=0, max_scatters=0)["sample"]
    assert row.incident[0] == pytest.approx(1.0, rel=1e-6)
    for what, share in zip(SHARES, shares, strict=True):
        # The kernel has R of a bare surface in float32, and TIS from a table
        assert getattr(row, what)[0] == pytest.approx(share, rel=1e-5, abs=1e-7), what
        assert getattr(row, what)[1] < 1e-6


@pytest.mark.parametrize("cut", [{"ray_control": "TIMRtr"}, {"cut_below": "A=2"}])
def test_absorption_that_is_not_followed_has_its_share(cut):
    found = FluxSplit("split")
    mistray.trace(mistray.load("lens_and_window"), rays=200, recorders=[found], **cut)
    (row,) = (row for row in found.rows if row.surface == "detector")
    assert row.absorbed[0] == pytest.approx(0.8 * row.incident[0], rel=1e-6)
    assert all(abs(row.closure) < 1e-6 for row in found.rows)


@pytest.mark.parametrize("polarization", ["unpolarized", pytest.param("stokes", marks=pytest.mark.long)])
def test_a_tilted_plate_and_total_reflection(polarization):
    """Fresnel's equations at 50°, mean of s and p; from within glass at 50° all light is reflected."""
    r_s, r_p = closed_forms.fresnel(50.0, N)
    row = split(interface(front="air", back=f"{N}"), tilt=50.0, polarization=polarization)["sample"]
    assert row.specular_reflection[0] == pytest.approx((r_s + r_p) / 2, rel=1e-5)
    assert row.specular_transmission[0] == pytest.approx(1 - (r_s + r_p) / 2, rel=1e-5)
    row = split(interface(front=f"{N}", back="air"), tilt=50.0, polarization=polarization)["sample"]
    assert (row.specular_reflection[0], row.specular_transmission[0]) == (pytest.approx(1.0, rel=1e-6), 0)


def test_all_surfaces_of_a_barrel_close(capsys):
    """Lenses, edges, painted walls and a hood, with all that comes back."""
    found = FluxSplit("split")
    scene = mistray.load("double_gauss_barrel")
    t = mistray.trace(scene, rays=2000, field_deg=15.0, max_reflections=1, recorders=[found])
    table = found.to_pandas()
    assert list(table.surface) == [row.id for row in t.surfaces]
    parts = sum(table[f"{what}_W"] for what in SHARES)
    np.testing.assert_allclose(parts, table.incident_W, rtol=1e-6, atol=1e-9 * t.energy.launched_W)
    np.testing.assert_allclose(table.incident_W, [row.incident_W for row in t.surfaces], rtol=1e-6)
    np.testing.assert_allclose(table.absorbed_se_W, [row.absorbed_se_W for row in t.surfaces], rtol=1e-5)
    command = ["ghosts", "plate_and_wall", "--rays", "500", "--max-scatters", "1", "--quiet", "--json", "--flux-split"]
    assert "screen" in fails(capsys, *command, "scren")
    found = json.loads(succeeds(capsys, *command, "plate", "screen"))
    rows = pd.DataFrame(found["sections"]["split"]["flux_split"])
    assert set(rows.surface) == {"plate_front", "plate_rear", "plate_edge", "screen"}
    parts = sum(rows[f"{what}_W"] for what in SHARES)
    np.testing.assert_allclose(parts, rows.incident_W, rtol=1e-6, atol=1e-6)
    screen = rows[rows.surface == "screen"].iloc[0]
    assert screen.scattered_reflection_W == pytest.approx(0.2 * screen.incident_W, rel=1e-4)


@pytest.mark.quick
def test_a_mesh_and_patterns():
    place = mi.ScalarTransform4d().scale(9).translate([0, 0, 2])
    scene = lit(
        BEAM,
        wall={"type": "rectangle", "to_world": place, "bsdf": interface({"type": "paint", "reflectance": 0.25}, R=0.0)},
        detector={"type": "asphere", "semi_diameter": 0.1, "z": 90.0, "bsdf": BLACK, "sensor": meter()},
        own={"type": "flux_split", "surfaces": "wall"},
    )
    (row,) = mistray.trace(scene, rays=300).recorders["own"].rows
    assert row.scattered_reflection[0] == pytest.approx(0.25, rel=1e-6)
    assert row.absorbed[0] == pytest.approx(0.75, rel=1e-6)
    with pytest.raises(MistrayError, match="wall"):
        mistray.trace(scene, rays=100, recorders=[FluxSplit("other", "wal")])
    with pytest.raises(MistrayError, match="recorded nothing"):
        _ = FluxSplit("other").rows
    number = [sensor.id() for sensor in scene.sensors()].index("own")
    image = np.array(mi.render(scene, sensor=number, integrator=mi.load_dict({"type": "straylight", "rays": 300})))
    np.testing.assert_allclose(image[0, :, 0], [1, 0.75, 0, 0, 0.25, 0], rtol=1e-6, atol=1e-12)

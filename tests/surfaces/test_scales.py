"""One optic at scales 1e-4 … 1e4 and far from the origin: light does not scale, derivatives by their dimensions."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts

import mistray
from mistray.metrics import metric as metrics
from mistray.surfaces.families.sag_surface import SagSurface
from mistray.surfaces.host_rays import crossings, first_hit, inside, normals
from mistray.surfaces.surfaces import SurfaceTable

SMALL, LARGE = 2.0**-13, 2.0**13
STRONG = {f"a{order}": (-1) ** (order // 2) * 0.4 * 6.0 ** (1 - order) for order in range(4, 21, 2)}
MILD = {f"a{order}": 4e-4 * 6.0 ** (1 - order) for order in range(4, 21, 2)}


def optic(scale: float) -> mi.Scene:
    """Two lenses, a barrel and a detector, `scale` times as large."""

    def sized(z: float, terms: dict[str, float], bsdf: dict[str, Any], **lengths: float) -> dict[str, Any]:
        scaled = {key: value if key == "conic" else value * scale for key, value in lengths.items()}
        scaled |= {key: a * scale ** (1 - int(key[1:])) for key, a in terms.items()}
        return {"type": "asphere", **scaled, "bsdf": bsdf, "to_world": scene_dicts.at(z * scale)}

    glass, rear = {"type": "interface", "back": "1.5"}, {"type": "interface", "front": "1.5"}
    barrel = {"r0": 5.5 * scale, "z0": -1.0 * scale, "r1": 5.5 * scale, "z1": 12.0 * scale}
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 3.0 * scale, "to_world": scene_dicts.at(-2 * scale)},
        strong_front=sized(0, STRONG, glass, radius=20.0, semi_diameter=5.0),
        mild_rear=sized(3, MILD, rear, radius=-30.0, semi_diameter=5.0, conic=-0.4),
        clipped_front=sized(6, STRONG, glass, radius=25.0, half_width=4.0, half_height=3.0),
        flat_rear=sized(9, {}, rear, semi_diameter=5.0),
        barrel={"type": "frustum", **barrel, "bsdf": {"type": "interface", "R": 0.3}},
        detector=scene_dicts.detector(25 * scale, semi_diameter=8.0 * scale),
    )


def lens(scale: float, name: str, coefficient: float, semi_diameter: float) -> mi.Scene:
    """Plane-parallel beam, one refracting asphere, a detector in the glass."""
    inside = {"type": "interface", "front": "1.5", "R": 0.0}
    face = {"type": "asphere", "bsdf": {"type": "interface", "back": "1.5"}}
    face[name] = coefficient * scale ** (1 - int(name[1:]))
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 0.95 * semi_diameter * scale},
        lens=face | {"radius": 1000.0 * scale, "semi_diameter": semi_diameter * scale},
        detector=scene_dicts.detector(2000.0 * scale, semi_diameter=500.0 * scale, bsdf=inside),
    )


@pytest.mark.parametrize("scale", [SMALL, LARGE, 1e-4, 1e4])
def test_paths(scale: float) -> None:
    one, other = (mistray.trace(optic(f), rays=2000, max_reflections=2, seed=3) for f in (1.0, scale))
    exact = scale in (SMALL, LARGE)
    rows = [{row.events: row for row in t.paths} for t in (one, other)]
    assert len(rows[0]) > 5
    if exact:
        assert rows[0].keys() == rows[1].keys()
    for key in (key for key in rows[0].keys() & rows[1].keys() if rows[0][key].rays >= 100):
        a, b = rows[0][key], rows[1][key]
        share = b.power_W / other.energy.launched_W
        assert share == pytest.approx(a.power_W / one.energy.launched_W, rel=1e-6 if exact else 5e-3)
        assert b.rms_radius_mm / scale == pytest.approx(a.rms_radius_mm, rel=1e-5 if exact else 5e-3)


@pytest.mark.parametrize("scale", [SMALL, LARGE])
def test_gradients(scale: float) -> None:
    found = []
    for f in (1.0, scale):
        scene = optic(f)
        metric = metrics.rms_spot(scene, rays=2000, max_reflections=0, seed=3)
        keys = ["strong_front.a*", "clipped_front.a*", "mild_rear.curvature", "mild_rear.a*", "flat_rear.z"]
        gradient = mistray.gradient(metric, mi.traverse(scene), keys)
        found.append({key: float(np.ravel(value)[0]) for key, value in gradient.gradient.items()})
    assert len(found[0]) == 29
    for key, value in found[0].items():
        name = key.rpartition(".")[2]
        power = int(name[1:]) if name[0] == "a" else {"curvature": 2, "z": 0}[name]  # of rms radius by the parameter
        assert found[1][key] / scale**power == pytest.approx(value, rel=1e-3), key


@pytest.mark.parametrize(
    ("scale", "name", "coefficient", "semi_diameter"),
    [(1.0, "a16", 2e-40, 300.0), (1e-2, "a16", 2e-40, 300.0), (1.0, "a12", 1e-30, 300.0), (1e-4, "a20", 0.02, 1.0)],
)
def test_beyond_single_precision(scale: float, name: str, coefficient: float, semi_diameter: float) -> None:
    """The path table, in float32, against the history of all its rays, in float64, and against the lens without."""
    scene = lens(scale, name, coefficient, semi_diameter)
    t = mistray.trace(scene, rays=2000, max_reflections=0, seed=1)
    (row,) = t.paths
    history = t.history(row.path_id, n=2000).to_pandas()
    hits = history[history.surface == "detector"]
    assert len(hits) == row.rays
    exact = float(np.sqrt(np.mean(hits.x_mm**2 + hits.y_mm**2)))
    about = float(np.hypot(row.x_mm, row.y_mm))
    assert np.hypot(row.rms_radius_mm, about) == pytest.approx(exact, rel=2e-5)
    plain = mistray.trace(lens(scale, name, 0.0, semi_diameter), rays=2000, max_reflections=0, seed=1)
    assert abs(plain.paths[0].rms_radius_mm / row.rms_radius_mm - 1) > 1e-2


def test_parameters_keep_their_values() -> None:
    scene = lens(1.0, "a16", 2e-40, 300.0)
    params = mi.traverse(scene)
    assert float(params["lens.a16"][0]) == 2e-40
    before = mistray.trace(scene, rays=2000, max_reflections=0, seed=1).paths[0].rms_radius_mm
    for value in (mi.Float64(0.0), dr.opaque(mi.Float64, 2e-40)):
        params["lens.a16"] = value
        params.update()
    assert mistray.trace(scene, rays=2000, max_reflections=0, seed=1).paths[0].rms_radius_mm == before


def test_gradients_through_render() -> None:
    """The reverse pass of the integrator, where the derivative by a20 of a lens of 1 µm is 1e-80."""
    found = []
    for f in (1.0, SMALL):
        scene = optic(f)
        params = mi.traverse(scene)
        key = "strong_front.a20"
        dr.enable_grad(params[key])
        params.update()
        integrator = mi.load_dict({"type": "straylight", "rays": 2000, "max_reflections": 0, "edges": False})
        image = mi.render(scene, params, integrator=integrator)
        dr.backward(dr.sum(image.array * mi.Float(np.arange(64.0))))
        found.append(float(dr.grad(params[key])[0]))
    assert found[0] != 0
    assert found[1] / SMALL**19 == pytest.approx(found[0], rel=1e-3)


FAR = (-3e4, 5e4, -1e5)


def far_lens(place: tuple[float, float, float]) -> mi.Scene:
    """A lens of 60 mm in a scattering tube."""
    base = mi.ScalarTransform4d().translate(list(place))
    behind, rear = base.translate([0, 0, 57]), {"type": "interface", "front": "1.5"}
    grey = {"type": "interface", "R": 0.05}
    wall = {"type": "interface", "R": 0.1, "model": {"type": "abg", "A": 0.01, "B": 0.01, "g": 1.0}}
    face, back = {"type": "asphere", "semi_diameter": 15.0, "to_world": base}, {"type": "interface", "back": "1.5"}
    tube = {"type": "frustum", "r0": 15.0, "z0": 0.0, "r1": 12.0, "z1": 50.0, "to_world": base}
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 10.0, "field_deg": 3.0, "to_world": base},
        front=face | {"radius": 60.0, "bsdf": back},
        rear=face | {"radius": -60.0, "conic": -2.0, "a4": 1e-7, "to_world": base.translate([0, 0, 6]), "bsdf": rear},
        tube=tube | {"bsdf": wall},
        detector=scene_dicts.detector(0, half_width=12.0, half_height=12.0, to_world=behind, bsdf=grey),
    )


def plates(z: float, gap: float, stop: bool = False) -> mi.Scene:
    """Two plates of index 1.7 with a gap; with `stop` a ring at the origin belongs to the scene."""
    ring = {"type": "frustum", "r0": 24.0, "r1": 30.0, "z0": 0.0, "z1": 0.0, "bsdf": scene_dicts.BLACK}
    face, surfaces = {"type": "asphere", "semi_diameter": 25.0}, {}
    for i, height in enumerate([z, z + 2, z + 2 + gap, z + 4 + gap]):
        side = {"type": "interface", "front" if i % 2 else "back": "1.7"}
        surfaces[f"s{i}"] = face | {"to_world": scene_dicts.at(height), "bsdf": side}
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 1.0, "to_world": scene_dicts.at(z)},
        **surfaces,
        **({"stop": ring} if stop else {}),
        detector=scene_dicts.detector(z + 10, semi_diameter=30.0),
    )


@pytest.mark.parametrize("place", [(0.0, 0.0, 1e4), (0.0, 0.0, 1e5), FAR])
def test_paths_and_rays_far_away(place: tuple[float, float, float]) -> None:
    settings = {"rays": 3000, "field_deg": 25.0, "max_reflections": 1, "max_scatters": 1, "seed": 1}
    here, there = (mistray.trace(far_lens(p), **settings) for p in ((0.0, 0.0, 0.0), place))
    assert len(here.paths) == len(there.paths) > 4
    for a, b in zip(here.paths, there.paths, strict=True):
        assert (a.events, a.rays) == (b.events, b.rays)
        scattered = any(event.startswith(("Rand", "Imp")) for _, event in a.event_list)  # roundings grow
        assert b.power_W == pytest.approx(a.power_W, rel=1e-4 if scattered else 1e-6)
        assert (b.x_mm, b.y_mm) == pytest.approx((a.x_mm, a.y_mm), abs=1e-3 if scattered else 1e-5)
        assert b.rms_radius_mm == pytest.approx(a.rms_radius_mm, rel=1e-3 if scattered else 1e-5, abs=1e-5)
    rays = [t.history(t.paths[0].path_id, n=4).to_pandas() for t in (here, there)]
    xyz = [table[["x_mm", "y_mm", "z_mm"]].to_numpy() for table in rays]
    assert np.abs(xyz[1] - xyz[0] - place).max() < 1e-5  # the start rays are rounded
    assert rays[1].opl_mm.to_numpy() == pytest.approx(rays[0].opl_mm.to_numpy(), abs=1e-5)


def test_backward_trace() -> None:
    """The same rays to float32, but for one in many thousands that the rounding of its start moves past a rim."""
    settings = {"field_deg": [0, 10, 30], "method": "adjoint", "rays": 20_000, "seed": 1}
    here, there = (mistray.pst(far_lens(p), **settings) for p in ((0.0, 0.0, 0.0), FAR))
    np.testing.assert_allclose(there.value[:2], here.value[:2], rtol=1e-4)
    _, se = here.curve("total")
    assert np.all(np.abs(there.value - here.value) < 1e-5 * here.value + 0.05 * se)


def test_gradients_far_away() -> None:
    found = []
    for place in ((0.0, 0.0, 0.0), FAR):
        scene = far_lens(place)
        metric = metrics.rms_spot(scene, rays=1000, max_reflections=0, max_scatters=0, field_deg=[3.0])
        keys = ["front.curvature", "rear.a4", "rear.tilt_x", "front.z"]
        gradient = mistray.gradient(metric, mi.traverse(scene), keys)
        found.append([float(np.ravel(value)[0]) for value in gradient.gradient.values()])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-5)


@pytest.mark.parametrize(("z", "gap"), [(3000.0, 3e-4), (3000.0, 1e-4), (300.0, 1e-5), (1e5, 1e-4)])
def test_thin_gap(z: float, gap: float) -> None:
    """Incoherent: all orders between four faces of R = (0.7/2.7)² pass 1 / (1 + 4 R / (1 - R)) of the light."""
    t = mistray.trace(plates(z, gap), rays=500, max_reflections=20)
    reflectance = (0.7 / 2.7) ** 2
    passed = 1 / (1 + 4 * reflectance / (1 - reflectance))
    assert t.energy.detected_W / t.energy.launched_W == pytest.approx(passed, rel=1e-4)
    assert t.own_notes == []


def test_unresolved_gap() -> None:
    """The stop at the origin makes the scene 3 m long."""
    scene = plates(3000.0, 1e-4, stop=True)
    line, lost = mistray.trace(scene, rays=500, max_reflections=2).own_notes
    assert lost.startswith("no light reaches the detector")
    assert all(word in line for word in ("'s1'", "'s2'", "0.0001 mm"))
    assert line in mistray.ghosts(scene, field_deg=[0.0], rays=500).notes
    assert not mistray.trace(plates(3000.0, 1e-2, stop=True), rays=500, max_reflections=2).own_notes


@pytest.mark.parametrize(("field_deg", "azimuth_deg"), [(0.0, 0.0), (17.3, 0.0), (35.0, 61.0)])
def test_optical_path_of_an_oblique_ray(field_deg: float, azimuth_deg: float) -> None:
    """Closed form through a plate, from the table's own start: Σ n t / cos θ; the kernel's directions are float32."""
    field = {"field_deg": field_deg, "azimuth_deg": azimuth_deg}
    t = mistray.trace(plates(40.0, 2.0), rays=200, max_reflections=0, seed=2, **field)
    table = t.history(t.paths[0].path_id, n=20).to_pandas()
    theta = np.radians(field_deg)
    inside = np.sqrt(1 - (np.sin(theta) / 1.7) ** 2)
    for _, ray in table.groupby("ray"):
        start, z = ray.z_mm.iloc[0], ray.z_mm.to_numpy()
        assert z[1:] == pytest.approx([40.0, 42.0, 44.0, 46.0, 50.0], abs=1e-11)
        expected = (50.0 - start - 4.0) / np.cos(theta) + 4.0 * 1.7 / inside
        assert ray.opl_mm.iloc[-1] == pytest.approx(expected, rel=1e-12)
        phi = np.radians(azimuth_deg)
        direction = [-np.sin(theta) * np.sin(phi), np.sin(theta) * np.cos(phi), np.cos(theta)]
        assert ray[["dx", "dy", "dz"]].iloc[0].to_numpy() == pytest.approx(direction, abs=1e-15)
    assert np.ptp(table[table.node == 0][["x_mm", "y_mm", "z_mm"]].to_numpy() @ direction) < 1e-11


@pytest.mark.parametrize("name", ["cooke_triplet", "newtonian_scatter", "phone_camera", "head_up_display", "rubin"])
def test_first_hits(name) -> None:
    table = SurfaceTable(mistray.load(name), 550.0)
    rng = np.random.default_rng(4)
    n, count = 300, len(table.pieces)
    size = np.ptp(table.vertices[:count], axis=0).max() + max(piece.size for piece in table.pieces)
    # Half of the rays start on a surface, which they may meet again
    last = np.where(np.arange(n) % 2, rng.integers(count, size=n), -1)
    o = table.centre + size * rng.normal(size=(n, 3)) / 2
    for ray in np.flatnonzero(last >= 0):
        (q,) = table.pieces[last[ray]].points(*rng.random((2, 1)))
        o[ray] = q @ table.rotations[last[ray]].T + table.vertices[last[ray]]
    d = table.vertices[rng.integers(count, size=n)] + 0.2 * size * rng.normal(size=(n, 3)) - o
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    nearest, expected = np.full(n, np.inf), np.full(n, -1)
    for k, piece in enumerate(table.pieces):
        for t in crossings(table, k, o, d).T:
            ahead = t > np.where(last == k, piece.self_hit, 0.0)
            hit = ahead & (t < nearest) & inside(table, k, o + t[:, None] * d)
            nearest[hit], expected[hit] = t[hit], k
    surface, p, normal = first_hit(table, o, d, last)
    assert np.count_nonzero(expected >= 0) > n / 3
    assert len(set(expected)) > 5
    assert np.array_equal(surface, expected)
    hit = expected >= 0
    assert np.allclose(p[hit], (o + np.where(hit, nearest, 0)[:, None] * d)[hit], rtol=0, atol=1e-9 * size)
    for k in set(expected[hit]):
        assert np.allclose(normal[surface == k], normals(table, k, p[surface == k]), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("radius", "outer", "coefficients"),
    [
        (-15.649, 1.32375102, (0.0693172, -0.0431157, 0.0233346, -0.0233074, 0.0222119, -0.00484076)),
        (21.119, 1.098, (0.101117, -0.0321118, 0.0903668, -0.0337156, -0.00652751)),
    ],
)
def test_host_rays_find_all_crossings_with_a_strong_asphere(radius, outer, coefficients):
    """Lines through points of faces of the phone camera, up to 66° off the normal; 4 and 5 % of them were missed."""
    piece, rng = SagSurface.of(1 / radius, 0.0, coefficients, outer=outer), np.random.default_rng(1)
    q = piece.points(*rng.random((2, 3000)))
    d, normal = rng.normal(size=q.shape), piece.gradient(q)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    steep = np.abs(np.sum(d * normal, axis=1)) > 0.4 * np.linalg.norm(normal, axis=1)
    q, d = q[steep], d[steep]
    away = 5 * rng.random(len(q))
    with np.errstate(all="ignore"):
        t = piece.crossings(q - away[:, None] * d, d)
        parallel = piece.crossings(np.array([[1.01 * outer, 0.0, -1.0]]), np.array([[0.0, 0.0, 1.0]]))
    assert np.nanmin(parallel) == np.nanmax(parallel) == pytest.approx(1 + piece.sag((1.01 * outer) ** 2))
    apart = np.abs(t - away[:, None])
    assert np.all(np.min(apart, axis=1, where=np.isfinite(apart), initial=np.inf) < 1e-8)
    assert np.all(np.sum(apart < 1e-6, axis=1) == 1)

"""The product estimate of common objects, the patches that it is made with, and the sources of the rays."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.object_scenes import open_tube_text, painted_tube_text
from oracles.scatter_integrals import disc_to_disc
from oracles.scatter_scenes import beam_xml, bsdf_xml, discs_text, placed_xml, scatter_scene, scattering_xml
from oracles.statistics import assert_z, z_limit

import mistray
from mistray.analysis.objects.estimates import surface_bsdf
from mistray.analysis.objects.patches import Patches
from mistray.analysis.objects.search import objects
from mistray.analysis.objects.sources import DiskSource, Surroundings
from mistray.sampling.sources import field_axes
from mistray.surfaces.host_points import surface_points
from mistray.surfaces.surfaces import SurfaceTable

RAYS = 100_000


# ---- the product estimate


def test_product_of_coaxial_discs(load_scene):
    """A Lambertian disc lit evenly and a detector: Φ · (1/π) · π F, exactly; one of a thousand fails by chance."""
    found = objects(load_scene(discs_text(1.0, 1.5, 2.0)), rays=RAYS, field_deg=[0.0])
    (estimate,) = found.estimates().itertuples(index=False)
    exact = np.pi * disc_to_disc(1.0, 1.5, 2.0)
    assert estimate.bsdf_1_sr == pytest.approx(1 / np.pi, rel=1e-6)
    assert_z("flux", estimate.flux_W, np.pi, estimate.flux_W_se)
    assert_z("detector", estimate.detector_W, exact, estimate.detector_W_se)
    assert_z("pst", estimate.pst, exact / (np.pi * 1.5**2), estimate.pst_se)
    assert estimate.detector_W == pytest.approx(estimate.flux_W * estimate.bsdf_1_sr * np.pi * estimate.gcf, rel=1e-12)
    assert estimate.detector_W_se < 0.02 * exact  # an error of 10 % would be noticed


@pytest.mark.parametrize("angle", [20.0, 60.0])
def test_product_of_a_tube_wall_against_a_trace(load_scene, angle):
    """Within 2 % and the errors; means over the whole wall, without patches, are wrong by a factor of 3 at 60°."""
    rho = 0.3
    scene = load_scene(painted_tube_text(3.0, 1.0, 0.7, rho))
    found = objects(scene, rays=RAYS, field_deg=[angle])
    (estimate,) = found.estimates().itertuples(index=False)
    traced = mistray.trace(scene, field_deg=angle, rays=60_000, max_scatters=1, max_reflections=0)
    table = traced.paths.to_pandas()
    once = table[table.scatters == 1]
    value, se = traced.paths.power(list(once.path_id))
    assert set(once.scatter_1) == {"wall"}
    assert estimate.bsdf_1_sr == pytest.approx(rho / np.pi, rel=1e-6)
    limit = z_limit() * np.hypot(estimate.detector_W_se, se) + 0.02 * value
    assert abs(estimate.detector_W - value) < limit
    assert limit < 0.1 * value
    if angle == 60.0:
        mean = found.critical[0].power * np.pi * 0.7**2 / (2 * np.pi * 3.0)
        assert estimate.flux_W * rho * mean > 3 * value


def test_product_ranks_the_faces_of_a_scattering_scene():
    """Both faces of a scattering plate in front of a screen, within 15 % of a trace; the screen is among them."""
    scene = mistray.load("plate_and_wall")
    estimates = objects(scene, rays=RAYS, field_deg=[10.0]).estimates().set_index("id").detector_W
    table = mistray.trace(scene, field_deg=10.0, rays=40_000, max_scatters=1, max_reflections=0).paths.to_pandas()
    power = table[table.scatters == 1].groupby("scatter_1").power_W.sum()
    for name in ("plate_front", "plate_rear", "screen"):
        assert estimates[name] == pytest.approx(power[name], rel=0.15), name
    assert list(estimates.nlargest(2).index) == list(power.nlargest(2).index)


def seen_share(half_width: float, gap: float, glass: float, n: float) -> float:
    """Projected solid angle of a square seen from over its middle through a gap and a plate, over π."""
    theta = np.linspace(0.0, np.pi / 2, 4001)[1:-1]
    offset = gap * np.tan(theta) + glass * np.tan(np.arcsin(np.sin(theta) / n))
    ratio = np.clip(half_width / offset, 0.0, 1.0)
    azimuths = np.where(ratio < np.sqrt(0.5), 0.0, 1 - 4 / np.pi * np.arccos(ratio))
    return float(np.trapezoid(np.sin(2 * theta) * azimuths, theta))


@pytest.mark.long
@pytest.mark.parametrize("total", [True, False])
def test_gcf_of_one_side_is_at_most_one(total):
    """Closed forms of the last faces; L5 is seen by total reflection, too; one of a thousand fails by chance."""
    found = objects(mistray.load("phone_camera_scatter"), rays=RAYS // 2, field_deg=[0.0], total_reflection=total)
    estimates = found.estimates()
    rows = estimates.set_index(["id", "side"])
    half, gap, glass, behind = 2.18393, 0.1337, 0.21, 0.1363
    # Each face of the filter reflects 1 %
    for name, exact in (
        ("L5_rear", 0.99**2 * seen_share(half, gap + behind, glass, 1.518)),
        ("filter_rear", seen_share(half, behind, 0.0, 1.0)),
    ):
        row = rows.loc[name, "back"]
        assert_z(name, row.gcf, exact, row.pst_se / row.pst * row.gcf)
    assert (rows.gcf.get(("L5_rear", "front"), 0.0) > 0.05) == total
    relative = (estimates.pst_se / estimates.pst.where(estimates.pst > 0, np.inf)).to_numpy()
    assert np.all(estimates.gcf <= 1 + z_limit() * relative)


def test_bsdf_of_a_surface_in_any_orientation(load_scene):
    """Of a tilted mirror with Harvey-Shack scatter: b0 (1 + (r/l)²)^(s/2) of |β - β0| in its own plane."""
    b0, length, slope = 2.0, 0.02, -1.5
    lobe = bsdf_xml("harvey_shack", b0=b0, l=length, s=slope)
    scene = load_scene(
        scatter_scene(
            beam_xml(1.0),
            placed_xml("asphere", "mirror", scattering_xml([lobe], R=0.8, T=0.0, mirror=True), facing=(0.3, 0.5, 1.0),
                       semi_diameter=5.0),
            placed_xml("asphere", "detector", at=(0.0, 0.0, -20.0), pixels=8, semi_diameter=1.0),
        )
    )  # fmt: skip
    table = SurfaceTable(scene, 550.0)
    number = table.ids.index("mirror")
    normal = np.array([0.3, 0.5, 1.0]) / np.linalg.norm([0.3, 0.5, 1.0])
    rng = np.random.default_rng(1)
    leaving = rng.normal(size=(50, 3))
    leaving /= np.linalg.norm(leaving, axis=1, keepdims=True)
    d = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
    light = table, number, np.array([True]), d[None], normal[None], leaving[None]
    found = surface_bsdf(*light, np.ones((1, 50), dtype=bool))[0]
    specular = d - 2 * (d @ normal) * normal
    r = np.linalg.norm((leaving - specular) - np.outer((leaving - specular) @ normal, normal), axis=1)
    expected = np.where(leaving @ normal < 0, 0.8 * b0 * (1 + (r / length) ** 2) ** (slope / 2), 0.0)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert np.count_nonzero(expected) > 10
    assert not np.any(surface_bsdf(*light, np.zeros((1, 50), dtype=bool)))


# ---- patches and sources


@pytest.mark.parametrize(
    ("kind", "numbers", "area"),
    [
        ("frustum", {"r0": 1.0, "z0": 0.0, "r1": 3.0, "z1": 2.0}, np.pi * 4 * np.sqrt(8)),
        ("frustum", {"r0": 2.0, "z0": 1.0, "r1": 2.0, "z1": 4.0}, 12 * np.pi),
        ("frustum", {"r0": 1.0, "z0": 0.0, "r1": 2.0, "z1": 0.0}, 3 * np.pi),
        ("asphere", {"radius": 4.0, "semi_diameter": 3.0}, 2 * np.pi * 16 * (1 - np.sqrt(7) / 4)),
        ("asphere", {"half_width": 2.0, "half_height": 1.0}, 8.0),
    ],
)
def test_patches_have_known_areas(load_scene, kind, numbers, area):
    """The areas add up to that of the surface, and uniform points fall into the patches in proportion to them."""
    scene = load_scene(
        scatter_scene(
            beam_xml(1.0),
            placed_xml(kind, "object", at=(1.0, 2.0, 3.0), facing=(0.2, 0.1, 1.0), **numbers),
            placed_xml("asphere", "detector", at=(0.0, 0.0, 30.0), pixels=8, semi_diameter=1.0),
        )
    )
    table = SurfaceTable(scene, 550.0)
    number = table.ids.index("object")
    patches = Patches.of(table, number, 200)
    assert patches.count == 25
    assert patches.areas.sum() == pytest.approx(area, rel=1e-3)
    points, normals = surface_points(table, number, 200_000, np.random.default_rng(2))
    weight = np.ones(len(points))
    if kind == "asphere":  # those points are uniform in the projection
        weight = 1 / np.abs(normals @ table.rotations[number][:, 2])
    found = np.bincount(patches.numbers(points), weight, minlength=patches.count) / weight.sum()
    np.testing.assert_allclose(found, patches.areas / patches.areas.sum(), rtol=0.06)


def test_directions_of_the_sources(load_scene):
    """A disc sends cos θ per solid angle, the surroundings are even in solid angle; both about their axis."""
    rng = np.random.default_rng(3)
    n, half = 200_000, 40.0
    axis = np.array([0.2, -0.3, 1.0])
    disc = DiskSource((1.0, 2.0, 3.0), 2.0, half, inner_radius=1.0, inner_half_angle_deg=10.0, axis=tuple(axis))
    start = disc.sample(n, rng)
    axis = axis / np.linalg.norm(axis)
    away = start.o - [1.0, 2.0, 3.0]
    assert np.abs(away @ axis).max() < 1e-12
    r2 = np.sum(away**2, axis=1)
    assert r2.min() >= 1
    assert r2.max() <= 4
    assert_z("r²", r2.mean(), 2.5, r2.std() / np.sqrt(n))
    sine2 = 1 - (start.d @ axis) ** 2
    low, high = np.sin(np.radians([10.0, half])) ** 2
    assert sine2.min() >= low - 1e-12
    assert_z("sin²", sine2.mean(), (low + high) / 2, sine2.std() / np.sqrt(n))
    scene = load_scene(open_tube_text(3.0, 1.0, 0.7))
    table = SurfaceTable(scene, 550.0)
    cone = Surroundings.cone(table, field_axes(scene), half).sample(n, rng)
    cosine = cone.d[:, 2]
    assert_z("cos", cosine.mean(), (1 + np.cos(np.radians(half))) / 2, cosine.std() / np.sqrt(n))
    assert np.allclose(cone.d.mean(axis=0)[:2], 0, atol=5e-3)


def test_azimuths_are_those_of_the_source():
    """Field angle and azimuth give the direction of the scene's own source."""
    scene = mistray.load("phone_camera")
    table, axes = SurfaceTable(scene, 550.0), field_axes(scene)
    (emitter,) = (entry for entry in scene.emitters() if hasattr(entry, "frame"))
    for angle, azimuth in ((12.0, 70.0), (-12.0, 70.0), (40.0, 200.0)):
        found = Surroundings.direction(table, axes, angle, azimuth).sample(4, np.random.default_rng(0))
        np.testing.assert_allclose(found.d, np.tile(emitter.frame(angle, azimuth)[1], (4, 1)), atol=1e-7)

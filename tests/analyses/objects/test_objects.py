"""Critical, illuminated and common objects: view factors, set logic, places, product estimates, patches, bad input."""

import re

import numpy as np
import pytest
import vectors
from oracles.object_scenes import common_area, open_tube_text, painted_tube_text, vane_text
from oracles.scatter_integrals import disc_to_disc, element_to_disc
from oracles.scatter_scenes import beam_xml, bsdf_xml, discs_text, placed_xml, scatter_scene, scattering_xml
from oracles.small_scenes import interface_xml, plates_text
from oracles.statistics import assert_z, z_limit
from refusals import each_refused, refused

import mistray
from mistray.analyses.objects.estimates import surface_bsdf
from mistray.analyses.objects.patches import Patches
from mistray.analyses.objects.run import objects
from mistray.execute.seen import see
from mistray.sampling.sources import field_axes
from mistray.surfaces.host_points import surface_points
from mistray.surfaces.surfaces import SurfaceTable
from mistray.trace.host.ray_sources import DiskSource, Surroundings

RAYS = 100_000
TUBE = 3.0, 1.0, 0.7  # mm: length, and radii of the tube and of the detector


@pytest.fixture(scope="module")
def phone():
    return objects(mistray.load("phone_camera"), rays=RAYS)


def table_of(load_scene, shape):
    detector = placed_xml("asphere", "detector", at=(0.0, 0.0, 30.0), pixels=8, semi_diameter=1.0)
    return SurfaceTable(load_scene(scatter_scene(beam_xml(1.0), shape, detector)), 550.0)


def row(rows, name, side=None):
    (found,) = (entry for entry in rows if entry.id == name and side in (None, entry.side))
    return found


def test_unpolarised_light_is_noted(load_scene):
    """Through four plates: half of (1 - s)⁸ + (1 - p)⁸ of the light, where their means have (1 - (s + p)/2)⁸."""
    scene, angle = load_scene(plates_text(4)), 60.0
    c, t = np.cos(np.radians(angle)), np.sqrt(1 - (np.sin(np.radians(angle)) / 1.5) ** 2)
    r_s, r_p = ((c - 1.5 * t) / (c + 1.5 * t)) ** 2, ((1.5 * c - t) / (1.5 * c + t)) ** 2
    truth = 100 * (((1 - r_s) ** 8 + (1 - r_p) ** 8) / 2 / (1 - (r_s + r_p) / 2) ** 8 - 1)
    (note,) = [text for text in objects(scene, field_deg=angle, rays=2000).notes if "Stokes" in text]
    assert f"direct light by +{truth:.3g}" in note
    assert not [text for text in objects(scene, field_deg=10.0, rays=2000).notes if "Stokes" in text]


def plate_text(**coating):
    """A plate of radius 50 and a smaller detector behind it."""
    return re.sub('(half_(?:width|height)" value=)"50.0"', r'\1"30.0"', plates_text(1, **coating))


def test_a_tube_seen_from_its_end(load_scene):
    """The detector sees the opening with the view factor of coaxial discs, and the wall with the rest of its view."""
    length, radius, detector_radius = TUBE
    found = objects(load_scene(open_tube_text(*TUBE)), rays=RAYS)
    wall = row(found.critical, "wall")
    opening = disc_to_disc(detector_radius, radius, length)
    assert_z("wall", wall.power, 1 - opening, wall.power_se)
    (shot,) = found.straight_shots
    assert (shot.surfaces, shot.missed, shot.beside) == ((), (), ())
    assert_z("opening", shot.share, opening, shot.share_se)
    assert abs(wall.power - 1) > 10 * wall.power_se  # a detector that saw nothing but the wall would be noticed
    assert any("with no surface in between" in text for text in found.notes)
    low, high = shot.field_deg
    assert low < 2
    assert -2 < high - np.degrees(np.arctan((radius + detector_radius) / length)) < 1e-3
    # A disk of Mitsuba's own as the detector and another one as what it sees
    plate = placed_xml("disk", "plate", interface_xml(R=0.0), at=(0.0, 0.0, 0.0), scale=(1.2, 1.2, 1.0))
    detector = placed_xml("rectangle", "detector", at=(0.0, 0.0, 2.0), scale=(0.01, 0.01, 1.0), pixels=8)
    found = objects(load_scene(scatter_scene(beam_xml(1.0), plate, detector)), rays=RAYS)
    plate = row(found.critical, "plate")
    assert_z("plate", plate.power, element_to_disc(1.2, 2.0, 0.0), plate.power_se, floor=1e-5)
    assert found.common == []  # its other side is lit
    lit = row(found.illuminated, "plate").side
    assert lit != plate.side
    assert found.illumination("plate", lit)[0].value > 0
    with refused("'plate' has no side 'nope'"):
        found.illumination("plate", "nope")


@pytest.mark.parametrize("angle", [0.0, 10.0, -25.0, 60.0])
def test_a_tube_lit_from_outside(load_scene, angle):
    """Flux on the detector is what two discs share, shifted by L tan θ; the rest of the opening's goes to the wall."""
    length, radius, detector_radius = TUBE
    found = objects(load_scene(open_tube_text(*TUBE)), rays=RAYS, field_deg=[angle], azimuth_deg=30.0)
    theta = np.radians(angle)
    direct = np.cos(theta) * common_area(length * abs(np.tan(theta)), radius, detector_radius)
    (wall,) = found.illumination("wall", "front")
    (detector,) = found.illumination("detector", "front")
    if angle:
        # What passes the opening and goes by the detector, within the tube, leaves behind
        passed = np.cos(theta) * common_area(length * abs(np.tan(theta)), radius, radius)
        assert_z("wall", wall.value, np.pi * radius**2 * np.cos(theta) - passed, wall.se)
        (outside,) = found.illumination("wall", "back")
        assert_z("outside", outside.value, 2 * radius * length * abs(np.sin(theta)), outside.se)
    else:
        assert wall.value == 0
    assert_z("detector", detector.value, direct, max(detector.se, 1e-12))


def test_openings_and_plates(load_scene):
    """Averaged over the solid angle of a cone, an area takes A (1 + cos h)/2; a disc source gives the same."""
    scene, half = load_scene(open_tube_text(1e-3, 1.0, 0.999)), 35.0
    source = {"source": DiskSource((0.0, 0.0, -1e-3), 3.0, half)}
    both = (objects(scene, rays=RAYS, **given) for given in ({"half_angle_deg": half}, source))
    cone, near = (found.illumination("detector", "front")[0] for found in both)
    expected = np.pi * 0.999**2 * (1 + np.cos(np.radians(half))) / 2
    # A disc of three times the radius this near fills the cone everywhere but for 1e-3
    assert_z("cone and disc", [cone.value, near.value], expected, [cone.se, near.se], floor=2e-3 * expected)
    assert abs(cone.value - np.pi) > 10 * cone.se
    found = objects(load_scene(plate_text(R=0.1, T=0.8)), rays=20_000, view_half_angle_deg=10.0, field_deg=[0.0])
    for name, seen, lit in (("p0_front", 0.8, 1.0), ("p0_rear", 1.0, 0.8), ("detector", 0.0, 0.64)):
        entry = row(found.optics, name)
        assert entry.critical_power == pytest.approx(seen * entry.critical_rays / 20_000, rel=1e-5)
        assert entry.illuminated_power == pytest.approx(lit * entry.illuminated_rays / 20_000, rel=1e-5)
        assert entry.illuminated_rays > 5_000
    # An absorbing plate takes exp(-α t/cos θ'): both views have the light that is left
    tau = 0.6  # of 5 mm along the axis
    k = float(-np.log(tau) * 550e-6 / (4 * np.pi * 5.0))
    scene = load_scene(plate_text(index=f"1.5+{k!r}i", R=0.0, T=1.0))
    sine, cosine = np.sin(np.radians(20.0)), np.cos(np.radians(20.0))
    disc = DiskSource((0.0, 0.0, -20.0), 10.0, 1e-3, axis=(0.0, sine, cosine))
    found = objects(scene, rays=20_000, view_half_angle_deg=20.0, source=disc)
    front, *behind = (row(found.optics, name) for name in ("p0_front", "p0_rear", "detector"))
    slanted = tau ** (1 / np.sqrt(1 - (sine / 1.5) ** 2))
    for entry in behind:
        assert entry.illuminated_power == pytest.approx(slanted * entry.illuminated_rays / 20_000, rel=1e-4)
    assert slanted * front.critical_rays / 20_000 < front.critical_power < tau * front.critical_rays / 20_000


@pytest.mark.parametrize(
    ("vanes", "length", "detector", "half_deg", "common", "apart"),
    [
        ([(10.0, 2.0)], 20.0, 2.0, 10.0, None, None),  # the vane shows its front to the light, its back to the detector
        ([(20.0, 2.0)], 40.0, 0.5, 5.0, [], ["wall"]),  # before the vane the wall is lit, behind it is seen
        ([], 40.0, 0.5, 5.0, ["wall"], []),
    ],
)
def test_lit_and_seen_in_different_places(load_scene, vanes, length, detector, half_deg, common, apart):
    found = objects(load_scene(vane_text(vanes, length, 5.0, detector)), rays=RAYS, half_angle_deg=half_deg)
    if common is None:
        assert [row(rows, "vane_1").side for rows in (found.illuminated, found.critical)] == ["front", "back"]
        assert "vane_1" not in [entry.id for entry in (*found.common, *found.apart)]
    else:
        assert [[entry.id for entry in rows] for rows in (found.common, found.apart)] == [common, apart]
        assert all(entry.side == "front" for entry in found.common)


def test_common_objects_are_in_both_lists_and_rows_agree_with_the_kernel(phone):
    lists = phone.critical, phone.illuminated, (*phone.common, *phone.apart)
    critical, illuminated, common = ({(entry.id, entry.side) for entry in rows} for rows in lists)
    assert common == critical & illuminated
    assert not {entry.id for entry in phone.optics} & {name for name, _ in critical | illuminated}
    assert len(phone.optics) == 15
    assert all(entry.optic for entry in phone.optics)
    assert not any(entry.optic for entry in (*phone.critical, *phone.illuminated, *phone.common))
    # A higher threshold, a share of the flux, takes the rows below it away and leaves the others as they are
    found = objects(phone.scene, rays=RAYS, threshold=1e-3)
    for name in ("critical", "illuminated"):
        assert getattr(found, name) == [entry for entry in getattr(phone, name) if entry.power > 1e-3]
    assert len(found.common) < len(phone.common)
    without = {entry.id for entry in objects(phone.scene, rays=RAYS, total_reflection=False).critical}
    assert without < {entry.id for entry in phone.critical} - {"board_left"}
    # The ray tree backwards, with the same ray control, sees the same shares; one of a thousand fails by chance
    seen = see(phone.scene, rays=200_000, ray_control="transmit_specular")
    own = {entry.id: (entry.critical_power, entry.critical_power_se) for entry in phone.optics}
    for entry in phone.critical:  # of a surface with two sides their sum
        value, error = own.get(entry.id, (0.0, 0.0))
        own[entry.id] = value + entry.power, np.hypot(error, entry.power_se)
    rows = [entry for entry in seen.rows if entry.share > 2e-4]
    assert len(rows) > 40
    value, error = (np.array([own[entry.id][k] for entry in rows]) for k in (0, 1))
    share, share_se = (np.array([getattr(entry, key) for entry in rows]) for key in ("share", "share_se"))
    assert_z("share", value, share, np.hypot(error, share_se), names=[entry.id for entry in rows])


def test_the_stop_is_found_by_marginal_rays():
    stops = {"double_gauss": "stop", "newtonian": "primary", "cooke_triplet": "L2", "singlet_window_detector": "L1"}
    for scene, stop in (stops | {"plate": ""}).items():
        assert objects(mistray.load(scene), rays=100).stop == stop


def test_before_and_after_the_stop(phone):
    places = {entry.id: (entry.between, entry.stop) for entry in (*phone.critical, *phone.illuminated)}
    expected = {name: tuple(place) for name, place in vectors.toml("tables.toml")["places of objects"].items()}
    assert {name: places[name] for name in expected} == expected
    assert objects(phone.scene, rays=2000, ray_control="allow_all").stop == phone.stop == "stop"
    found = objects(phone.scene, rays=20_000, stop="L3_front")
    assert found.stop == "L3"
    named = {entry.id: entry.stop for entry in found.critical}
    assert (named["barrel_3_cone"], named["barrel_4_cone"], named["L3_edge"]) == ("before", "after", "stop")
    (shot,) = (shot for shot in phone.straight_shots if shot.beside == ("L3_bevel_2",))
    assert shot.missed == ("L3_rear",)
    assert 15 < shot.field_deg[0] < shot.field_deg[1] < 27
    assert any("past L3_rear through L3_bevel_2" in text for text in phone.notes)
    found = objects(mistray.load("newtonian"), rays=RAYS)
    tube = row(found.critical, "eyepiece_tube", "front")
    assert (tube.between, tube.stop) == ("diagonal – image", "after")
    assert row(found.illuminated, "vane_1", "front").between == "before primary"
    assert [entry.id for entry in found.optics] == ["primary", "diagonal", "image"]


def test_ray_controls(load_scene):
    scene = load_scene(plate_text(R=0.3, T=0.5))
    disc, hits = DiskSource((0.0, 0.0, -1.0), 20.0, 1.0), {}
    for control in ("halt_all", "reflect_specular", "transmit_specular", "allow_all"):
        found = objects(scene, rays=RAYS, ray_control=control, source=disc, view_half_angle_deg=10.0)
        hits[control] = {entry.id: entry for entry in found.optics}
        # Light that the faces reflect to and fro is no straight shot, and what nothing transmits is not closed in
        assert not found.straight_shots
        assert not [text for text in found.notes if "closed in" in text]
    front, rear = hits["halt_all"]["p0_front"], hits["halt_all"]["p0_rear"]
    assert (front.illuminated_rays, front.critical_rays) == (RAYS, 0)
    assert (rear.illuminated_rays, rear.critical_rays) == (0, RAYS)
    assert hits["reflect_specular"]["p0_rear"].illuminated_rays == 0
    assert hits["reflect_specular"]["detector"].critical_power == pytest.approx(0.3, rel=0.1)
    assert hits["transmit_specular"]["detector"].illuminated_power == pytest.approx(0.25, rel=1e-5)
    detector = hits["allow_all"]["detector"]  # T²/(1 - R²), all orders between the faces
    assert_z("all", detector.illuminated_power, 0.25 / (1 - 0.3**2), detector.illuminated_power_se)


def test_bad_arguments_are_one_line(phone):
    both = {"field_deg": [1.0], "half_angle_deg": 3.0}
    each_refused(
        (lambda: objects(phone.scene, **both), "half_angle_deg and field_deg are given, two kinds of source"),
        (lambda: objects(phone.scene, detector="L1_front"), "'L1_front' is not a detector"),
        (lambda: phone.to_pandas("seen"), "there is no list 'seen'"),
        (lambda: phone.illumination("L9"), "'L9' has no side"),
        (lambda: DiskSource((0, 0, 0), 1.0, 10.0, inner_radius=2.0), "inner_radius is 2"),
        (lambda: DiskSource((0, 0, 0), 1.0, 10.0, inner_half_angle_deg=10.0), "inner_half_angle_deg is 10"),
        (lambda: DiskSource((0, 0, np.nan), 1.0, 10.0), "centre is"),
        (lambda: DiskSource((0, 0, 0), 1.0, 10.0, axis=(0, 0, 0)), "axis is 0, 0, 0"),
    )


def test_a_detector_in_a_closed_box_says_so(load_scene):
    box = (("lid", 0.0, -5.0, -5.0), ("tube", 5.0, -5.0, 5.0), ("floor", 0.0, 5.0, 5.0))
    walls = [placed_xml("frustum", name, r0=r0, z0=z0, r1=5.0, z1=z1) for name, r0, z0, z1 in box]
    detector = placed_xml("asphere", "detector", pixels=8, semi_diameter=1.0)
    scene = load_scene(scatter_scene(beam_xml(1.0, at=(0.0, 0.0, -20.0), distance=5.0), *walls, detector))
    found = objects(scene, rays=20_000)
    assert any("no ray from the detector leaves the scene" in text for text in found.notes)
    assert any("without a design path" in text for text in found.notes)
    assert not found.common
    assert row(found.critical, "lid").stop == ""


def test_product_of_coaxial_discs_and_the_bsdf_in_any_orientation(load_scene):
    """A Lambertian disc lit evenly and a detector: Φ · (1/π) · π F, exactly; one of a thousand fails by chance."""
    scene, exact = load_scene(discs_text(1.0, 1.5, 2.0)), np.pi * disc_to_disc(1.0, 1.5, 2.0)
    for view in (90.0, 60.0):  # all light of the disc arrives within 52° of the detector's normal
        found = objects(scene, rays=RAYS // 2, field_deg=[0.0], view_half_angle_deg=view)
        (estimate,) = found.estimates().itertuples(index=False)
        assert estimate.bsdf_1_sr == pytest.approx(1 / np.pi, rel=1e-6)
        assert_z("flux", estimate.flux_W, np.pi, estimate.flux_W_se)
        assert_z("detector", estimate.detector_W, exact, estimate.detector_W_se)
        assert_z("pst", estimate.pst, exact / (np.pi * 1.5**2), estimate.pst_se)
        product = estimate.flux_W * estimate.bsdf_1_sr * np.pi * estimate.gcf
        assert estimate.detector_W == pytest.approx(product, rel=1e-12)
        assert estimate.detector_W_se < 0.02 * exact  # an error of 10 % would be noticed
    # Of a tilted mirror with Harvey-Shack scatter: b0 (1 + (r/l)²)^(s/2) of |β - β0| in its own plane
    b0, length, slope = 2.0, 0.02, -1.5
    lobe = scattering_xml([bsdf_xml("harvey_shack", b0=b0, l=length, s=slope)], R=0.8, T=0.0, mirror=True)
    table = table_of(load_scene, placed_xml("asphere", "mirror", lobe, facing=(0.3, 0.5, 1.0), semi_diameter=5.0))
    number = table.ids.index("mirror")
    directions = np.array([[0.3, 0.5, 1.0], [0.1, -0.2, 1.0], *np.random.default_rng(1).normal(size=(50, 3))])
    normal, d, *leaving = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    leaving = np.array(leaving)
    light = table, number, np.array([True]), d[None], normal[None], leaving[None]
    found = surface_bsdf(*light, np.ones((1, 50), dtype=bool))[0]
    specular = d - 2 * (d @ normal) * normal
    r = np.linalg.norm((leaving - specular) - np.outer((leaving - specular) @ normal, normal), axis=1)
    expected = np.where(leaving @ normal < 0, 0.8 * b0 * (1 + (r / length) ** 2) ** (slope / 2), 0.0)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert np.count_nonzero(expected) > 10
    assert not np.any(surface_bsdf(*light, np.zeros((1, 50), dtype=bool)))


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


def seen_share(half_width: float, gap: float, glass: float, n: float) -> float:
    """Projected solid angle of a square seen from over its middle through a gap and a plate, over π."""
    theta = np.linspace(0.0, np.pi / 2, 4001)[1:-1]
    offset = gap * np.tan(theta) + glass * np.tan(np.arcsin(np.sin(theta) / n))
    ratio = np.clip(half_width / offset, 0.0, 1.0)
    azimuths = np.where(ratio < np.sqrt(0.5), 0.0, 1 - 4 / np.pi * np.arccos(ratio))
    return float(np.trapezoid(np.sin(2 * theta) * azimuths, theta))


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


def test_rings_of_a_hemisphere(load_scene):
    """Rings of a sphere have 2π R times their height along the axis (Archimedes), the outermost too."""
    table = table_of(load_scene, placed_xml("asphere", "dome", radius=5.0, semi_diameter=5.0))
    piece = table.pieces[table.ids.index("dome")]
    heights = 5.0 * np.sqrt(1 - np.arange(41) / 40)  # of the rims of rings of equal area across the axis
    np.testing.assert_allclose(piece.areas(40, 2).sum(axis=1), -2 * np.pi * 5.0 * np.diff(heights), rtol=1e-6)


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
    place = {"at": (1.0, 2.0, 3.0), "facing": (0.2, 0.1, 1.0)}
    table = table_of(load_scene, placed_xml(kind, "object", **place, **numbers))
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
    assert 1 <= r2.min() <= r2.max() <= 4
    assert_z("r²", r2.mean(), 2.5, r2.std() / np.sqrt(n))
    sine2 = 1 - (start.d @ axis) ** 2
    low, high = np.sin(np.radians([10.0, half])) ** 2
    assert sine2.min() >= low - 1e-12
    assert_z("sin²", sine2.mean(), (low + high) / 2, sine2.std() / np.sqrt(n))
    scene = load_scene(open_tube_text(*TUBE))
    table = SurfaceTable(scene, 550.0)
    cone = Surroundings.cone(table, field_axes(scene), half).sample(n, rng)
    cosine = cone.d[:, 2]
    assert_z("cos", cosine.mean(), (1 + np.cos(np.radians(half))) / 2, cosine.std() / np.sqrt(n))
    assert np.allclose(cone.d.mean(axis=0)[:2], 0, atol=5e-3)
    # Field angle and azimuth give the direction of the scene's own source
    scene = mistray.load("phone_camera")
    table, axes = SurfaceTable(scene, 550.0), field_axes(scene)
    (emitter,) = (entry for entry in scene.emitters() if hasattr(entry, "frame"))
    for angle, azimuth in ((12.0, 70.0), (-12.0, 70.0), (40.0, 200.0)):
        found = Surroundings.direction(table, axes, angle, azimuth).sample(4, np.random.default_rng(0))
        np.testing.assert_allclose(found.d, np.tile(emitter.frame(angle, azimuth)[1], (4, 1)), atol=1e-7)

"""Vane tubes, spiders and Cassegrain baffles by straight float64 rays: what they shade, and what cannot be one."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from refusals import each_refused

import mistray
from mistray.prescription import Coating, Detector, Prescription, Source, Surface, spider
from mistray.prescription.baffles.cassegrain import cassegrain_baffles
from mistray.prescription.baffles.two_stage import two_stage_baffle
from mistray.prescription.baffles.vane_edges import Vane, VaneEdge, vane_faces
from mistray.prescription.baffles.vane_tube import BaffleTube, hood_length, vane_tube
from mistray.prescription.baffles.zones import first_order_zones, lit_zones, seen_zones

SKIN = 1e-6  # distance of tested points from the faces, mm


def fan(rays, steepest_deg=89.99, least_deg=0.0):
    """Unit vectors towards -z, evenly over field angle and azimuth, (n, 3)."""
    side = math.isqrt(rays)
    angle = np.radians(np.linspace(least_deg, steepest_deg, side))
    azimuth = np.arange(side) * (2 * np.pi / side)
    angle, azimuth = (grid.ravel() for grid in np.meshgrid(angle, azimuth))
    return np.column_stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), -np.cos(angle)])


def disc(radius, z, rays):
    """Points on a disc, rim included, (n, 3)."""
    side = math.isqrt(rays)
    r, azimuth = np.linspace(0, radius, side), np.arange(side) * (2 * np.pi / side)
    r, azimuth = (grid.ravel() for grid in np.meshgrid(r, azimuth))
    return np.column_stack([r * np.cos(azimuth), r * np.sin(azimuth), np.full(r.size, z)])


def passes(tube, point, directions, z_end):
    """Which rays from a point of the tube get to the plane z_end through the openings between, (n,) bool."""
    free = np.sign(directions[:, 2]) == np.sign(z_end - point[2])
    for vane in (*tube.vanes, Vane(z_end, math.inf)):
        way = (vane.z - point[2]) / directions[:, 2]
        between = (way > 0) & (np.abs(vane.z - point[2]) <= abs(z_end - point[2]))
        x, y = (point[i] + way * directions[:, i] for i in (0, 1))
        share = (vane.z - tube.z_front) / (tube.z_rear - tube.z_front)
        wall = tube.wall_front + (tube.wall_rear - tube.wall_front) * share
        free &= ~between | (np.hypot(x, y) <= min(vane.radius, wall))
    return free


def is_lit(tube, point, least_deg=0.0, rays=2500):
    return passes(tube, point, fan(rays, least_deg=least_deg), tube.z_front).any()


def is_seen(tube, point, rays=900):
    return passes(tube, point, disc(tube.optic_radius, tube.z_rear, rays) - point, tube.z_rear).any()


def inner_points(tube, count=300):
    """Points just inside of the wall, and just before and behind the vanes, (n, 3)."""
    z = np.linspace(tube.z_front, tube.z_rear, count + 2)[1:-1]
    away = [at for at in z if min(abs(at - vane.z) for vane in tube.vanes) > SKIN]
    points = [(tube.wall_radius(at) - SKIN, 0.0, at) for at in away]
    for vane in tube.vanes:
        for r in np.linspace(vane.radius + 0.01, tube.wall_radius(vane.z) - 0.01, 10):
            points += [(r, 0.0, vane.z + SKIN)]
            if vane.z > tube.z_front:
                points += [(r, 0.0, vane.z - SKIN)]
    return np.array(points)


def first_order(tube, least_deg=0.0, count=300):
    """Points that are lit and seen."""
    return [p for p in inner_points(tube, count) if is_seen(tube, p) and is_lit(tube, p, least_deg)]


TUBES = {
    "straight": {"optic_radius": 18.0, "length": 102.0, "wall_radius": 30.0, "field_deg": 4.0},
    "exclusion": {"optic_radius": 10.0, "length": 60.0, "wall_radius": 25.0, "field_deg": 5.0}
    | {"exclusion_deg": 50.0, "clearance": 0.3},
    "widening": {"optic_radius": 12.0, "length": 80.0, "wall_radius": (30.0, 18.0), "field_deg": 8.0},
    "narrowing": {"optic_radius": 5.0, "length": 90.0, "wall_radius": (12.0, 16.0), "field_deg": 3.0, "overlap": 0.05},
    "no field": {"optic_radius": 10.0, "length": 100.0, "wall_radius": 13.0, "field_deg": 0.0},
}


def tube_of(key, **changes):
    return vane_tube("tube", z_rear=7.0, **(TUBES[key] | changes))


@pytest.mark.parametrize("key", TUBES)
def test_no_point_is_lit_and_seen(key):
    """And the tips leave the field free: from every point of the optic, along all its directions, the sky is seen."""
    tube, given = tube_of(key), TUBES[key]
    least = given.get("exclusion_deg", 0.0)
    assert first_order(tube, least) == []
    assert any(is_seen(tube, point) for point in inner_points(tube, 50))
    assert any(is_lit(tube, point, least) for point in inner_points(tube, 50))
    directions = fan(400, given["field_deg"] - 1e-9) if given["field_deg"] else np.array([[0.0, 0.0, -1.0]])
    for point in disc(tube.optic_radius * (1 - 1e-9), tube.z_rear, 100):
        assert passes(tube, point, directions, tube.z_front).all()
    assert tube.vanes[0].z == tube.z_front
    assert all(v.radius < tube.wall_radius(v.z) for v in tube.vanes)
    assert first_order_zones(tube, least) == ()
    assert len(seen_zones(tube)) >= len(tube.vanes) - 1
    assert not least or first_order_zones(tube, 0.0)


@pytest.mark.parametrize("key", ["straight", "exclusion", "widening", "narrowing"])
def test_every_vane_is_needed(key):
    tube = tube_of(key)
    least = TUBES[key].get("exclusion_deg", 0.0)
    for k in range(1, len(tube.vanes)):
        missing = replace(tube, vanes=tube.vanes[:k] + tube.vanes[k + 1 :])
        assert first_order(missing, least, 150), f"without vane {k + 1} of {len(tube.vanes)}"
        assert first_order_zones(missing, least)


def test_vanes_stand_as_far_apart_as_they_may():
    """A vane moved by 2 mm towards the optic leaves a lit and seen zone before it."""
    tube = tube_of("straight", overlap=0.0)
    for k in range(1, len(tube.vanes) - 1):
        moved = replace(tube.vanes[k], z=tube.vanes[k].z + 2.0)
        assert first_order(replace(tube, vanes=(*tube.vanes[:k], moved, *tube.vanes[k + 1 :])), count=600)


@pytest.mark.parametrize("key", TUBES)
def test_light_beyond_direct_deg_does_not_meet_the_optic(key):
    tube = tube_of(key)
    heights = np.linspace(-1, 1, 2001) * tube.optic_radius
    for share, wanted in ((0.99, True), (1.01, False)):
        towards = np.array([[-math.tan(math.radians(tube.direct_deg)) * share, 0.0, -1.0]])
        assert wanted == any(passes(tube, np.array([h, 0.0, tube.z_rear]), towards, tube.z_front)[0] for h in heights)


def test_lengths_and_numbers():
    length = hood_length(10.0, 5.0, 30.0)
    opening = 10.0 + length * math.tan(math.radians(5.0))
    assert math.degrees(math.atan((opening + 10.0) / length)) == pytest.approx(30.0, abs=1e-12)
    counts = [len(tube_of("straight", exclusion_deg=angle).vanes) for angle in (0.0, 30.0, 50.0, 70.0)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[-1]


@pytest.mark.parametrize("bevel", ["front", "rear"])
@pytest.mark.parametrize(("bevel_deg", "radius"), [(None, 0.0), (None, 0.5), (30.0, 0.0), (30.0, 0.2)])
def test_faces_of_a_vane_form_a_closed_profile(bevel_deg, radius, bevel):
    """A rounded edge is an arc that ends along both faces."""
    vane = Vane(5.0, 10.0, VaneEdge(thickness=1.0, bevel_deg=bevel_deg, radius=radius), bevel)
    faces = [((r0, z0), (r1, z1)) for _, r0, z0, r1, z1 in vane_faces(vane, lambda z: 20.0)]
    for (_, end), (start, _) in pairwise(faces):
        assert start == pytest.approx(end, abs=1e-12)
    assert faces[0][0][0] == faces[-1][1][0] == 20.0
    radii, depths = np.array(faces).reshape(-1, 2).T
    assert radii.min() == pytest.approx(10.0, abs=0.04 * radius + 1e-12)  # facets of an arc stay within it
    assert (np.ptp(depths), depths.max() if bevel == "front" else depths.min()) == pytest.approx((1.0, 5.0))
    if bevel_deg and radius and bevel == "front":
        arc = np.array([start for start, _ in faces[2:]])
        np.testing.assert_allclose(np.hypot(arc[:, 0] - 10.2, arc[:, 1] - 4.8), 0.2, atol=1e-12)
        (r0, z0), (r1, z1) = faces[1]
        assert math.degrees(math.atan2(z1 - z0, r0 - r1)) == pytest.approx(30.0)
        # tangent: the radius to the point of contact is normal to the bevel
        assert (r1 - 10.2) * (r1 - r0) + (z1 - 4.8) * (z1 - z0) == pytest.approx(0.0, abs=1e-12)


def test_structures_have_names_and_bevels_that_are_dark_or_unseen():
    tube = tube_of("straight", edge=VaneEdge(thickness=0.5, bevel_deg=25.0, radius=0.05))
    shapes = tube.structures(space=3)
    assert shapes[0].name == "tube_wall"
    assert len({shape.name for shape in shapes}) == len(shapes)
    assert {shape.part for shape in shapes} == {"tube", *(f"tube_vane_{k}" for k in range(1, len(tube.vanes) + 1))}
    assert {shape.space for shape in shapes} == {3}
    assert shapes[0].z0 == min(min(s.z0, s.z1) for s in shapes)  # no gap between a plate and the wall
    assert [s.name for s in tube_of("straight").structures()[:3]] == ["tube_wall", "tube_vane_1", "tube_vane_2"]
    tube = tube_of("straight", edge=VaneEdge(thickness=0.5, bevel_deg=25.0))
    assert (tube.vanes[0].bevel, tube.vanes[-1].bevel) == ("front", "rear")
    for vane in tube.vanes:
        bevel = next(face for face in vane_faces(vane, tube.wall_radius) if face[0] == "_bevel")
        middle = np.array([0.5 * (bevel[1] + bevel[3]) - 1e-3, 0.0, 0.5 * (bevel[2] + bevel[4])])
        assert (is_seen if vane.bevel == "front" else is_lit)(tube, middle) is np.False_


STAR_TRACKER = {"optic_radius": 10.0, "z_rear": 0.0, "field_deg": 5.0, "exclusion_deg": 40.0, "depth": 8.0}


def test_impossible_tubes_edges_hoods_stages_and_baffles():
    each_refused(
        ({"optic_radius": 0.0}, "optic_radius is 0; it must lie between 1e-15"),
        ({"wall_radius": 20.0}, "wall radius 20 mm at the front; the unobscured beam is 25"),
        ({"wall_radius": (25.1331, 18.0001)}, "more than 200 vanes"),
        ({"field_deg": -1.0}, "field_deg is -1; it must lie between 0 and 90"),
        ({"clearance": -0.1}, "clearance is -0.1; it must lie between 0"),
        ({"overlap": 20.0}, "make the overlap smaller"),
        ({"edge": VaneEdge(thickness=5.0, bevel_deg=20.0)}, "beyond the wall"),
        ({"edge": VaneEdge(thickness=7.5, bevel_deg=45.0)}, "where the next vane or the optic begins"),
        ({"edge": VaneEdge(thickness=0.5, bevel_deg=80.0)}, "would be lit and seen; make it at most"),
        (lambda: VaneEdge(thickness=0.0), "for an ideal edge give none"),
        (lambda: VaneEdge(thickness=1.0, bevel_deg=90.0), "bevel_deg is 90"),
        (lambda: VaneEdge(thickness=1.0, radius=0.6), "half the thickness"),
        (lambda: VaneEdge(thickness=1.0, radius=0.1), r"0 \(square\) or half the thickness"),
        (lambda: hood_length(10.0, 30.0, 20.0), "between the half field and 90"),
        (lambda: two_stage_baffle("b", inner_length=20.0, **STAR_TRACKER), "inner_length = 20 mm"),
        (lambda: two_stage_baffle("b", **(STAR_TRACKER | {"exclusion_deg": 4.0})), "between the half field and 90"),
        (lambda: two_stage_baffle("b", clearance=-1.0, **STAR_TRACKER), "clearance"),
        (lambda: baffles(detector=replace(DETECTOR, semi_diameter=60.0)), "narrower than detector 'detector', 60 mm"),
        (lambda: baffles(field_deg=8.0), "no baffles keep the sky from detector 'detector'"),
        (lambda: baffles(field_deg=-1.0), "field_deg is -1; it must lie between 0 and 90"),
        (lambda: baffles(wall_rear=60.0), "whose hole has 26 mm"),
        (lambda: baffles(detector=replace(DETECTOR, x=1.0)), "off the axis"),
        by=lambda changes: changes() if callable(changes) else tube_of("straight", **changes).structures(),
    )


@pytest.mark.parametrize("clearance", [0.0, 0.5])
def test_the_optic_sees_nothing_of_the_outer_stage(clearance):
    baffle = two_stage_baffle("b", clearance=clearance, **STAR_TRACKER)
    outer, inner = baffle.outer, baffle.inner
    both = {"z_rear": inner.z_rear, "optic_radius": inner.optic_radius, "vanes": (*outer.vanes, *inner.vanes)}
    everything = replace(outer, **both)  # the inner one's opening is a vane of the outer one's wall
    points = inner_points(outer, 100)
    tips = [(v.radius + 1e-3, 0.0, v.z + SKIN) for v in outer.vanes]
    assert not any(is_seen(everything, point) for point in np.vstack([points, tips]))
    closer = np.array([(v.radius - clearance - 0.1, 0.0, v.z) for v in outer.vanes])
    assert all(is_seen(everything, point, 3600) for point in closer)
    assert outer.direct_deg == pytest.approx(40.0, abs=1e-9)
    assert first_order(outer, 40.0) == first_order(inner) == []


@pytest.mark.parametrize("clearance", [0.0, 0.5, 3.0])
def test_two_stages_of_least_length(clearance):
    best = two_stage_baffle("b", clearance=clearance, **STAR_TRACKER)
    length = best.inner.z_rear - best.inner.z_front
    others = [two_stage_baffle("b", clearance=clearance, inner_length=length * f, **STAR_TRACKER) for f in (0.99, 1.01)]
    assert best.length < min(other.length for other in others)
    if clearance == 0:
        slopes = [math.tan(math.radians(STAR_TRACKER[key])) for key in ("exclusion_deg", "field_deg")]
        assert length == pytest.approx(40.0 / (slopes[0] - slopes[1]))
        assert best.length == pytest.approx(length * (1 + best.outer.optic_radius / 10.0))


HAND_MADE = {
    "sparse": [(0, 24), (40, 20), (70, 18)],
    "low": [(0, 28), (30, 27), (60, 26), (90, 25)],
    "jagged": [(0, 20), (25, 26), (50, 15), (75, 22)],
    "cone": [(0, 18), (20, 19), (50, 17)],
}


@pytest.mark.parametrize("name", HAND_MADE)
@pytest.mark.parametrize("exclusion_deg", [0.0, 35.0])
def test_zones_are_those_of_the_cast_rays(name, exclusion_deg):
    """Of tubes that no construction made: vanes too far apart, too low, tips not in line, a conical wall."""
    walls = {"wall_front": 22.0, "wall_rear": 34.0} if name == "cone" else {"wall_front": 30.0, "wall_rear": 30.0}
    vanes = tuple(Vane(float(z), a) for z, a in HAND_MADE[name])
    tube = BaffleTube(name="t", z_front=0.0, z_rear=100.0, optic_radius=12.0, vanes=vanes, **walls)
    lit, seen, both = lit_zones(tube, exclusion_deg), seen_zones(tube), first_order_zones(tube, exclusion_deg)
    assert min(len(lit), len(seen)) > 0
    for z in np.linspace(0.25, 99.75, 150):
        point = (tube.wall_radius(z) - 1e-9, 0.0, z)
        for zones, cast in ((lit, is_lit(tube, point, exclusion_deg, 3600)), (seen, is_seen(tube, point, 3600))):
            inside = any(a <= z <= b for a, b in zones)
            at_border = any(abs(z - end) < 1.3 for zone in zones for end in zone)  # the oracle's rays have gaps
            assert cast == inside or (inside and at_border), z
        assert any(a <= z <= b for a, b in both) == all(any(a <= z <= b for a, b in zones) for zones in (lit, seen))


KIND = {"vanes": 4, "inner_radius": 20.0, "outer_radius": 100.0, "thickness": 2.0, "depth": 30.0, "z": -50.0}


@pytest.mark.parametrize(("vanes", "offset"), [(4, 0.0), (3, 0.0), (3, 12.0), (1, -5.0)])
def test_it_shades_its_own_area(vanes, offset):
    """A round beam along the axis loses the length of each vane times its thickness; false alarms 6e-5."""
    faces = spider("spider", **(KIND | {"vanes": vanes, "offset": offset}))
    screen = Detector(z=10.0, half_width=90.0, half_height=90.0)
    beam = Source(radius=80.0, z=-200.0)
    plate = Prescription(name="spider", surfaces=(), structures=faces, detector=screen, source=beam)
    t = mistray.trace(plate.to_scene(), rays=400_000, seed=2)
    share = vanes * (math.sqrt(80.0**2 - offset**2) - 20.0) * 2.0 / (math.pi * 80.0**2)
    taken = 1 - sum(row.power_W for row in t.paths) / t.energy.launched_W
    assert abs(taken - share) < 4 * math.sqrt(share / 400_000) + 2e-5  # the end of a vane is round, not straight


def test_faces_are_boxes_and_what_cannot_be_a_spider():
    """The middles of the four faces of a vane stand half a thickness or half a depth from its own middle."""
    faces = spider("s", **(KIND | {"start_deg": 30.0}), coating=Coating(R=0.1))
    assert [face.name for face in faces[:4]] == ["s_1_front", "s_1_rear", "s_1_left", "s_1_right"]
    along = np.array([math.cos(math.radians(30)), math.sin(math.radians(30)), 0.0])
    aside = np.array([-along[1], along[0], 0.0])
    middle = 60.0 * along + [0, 0, -35.0]
    normals = []
    for face, offset in zip(faces, ([0, 0, -15.0], [0, 0, 15.0], aside, -aside), strict=False):
        frame = face.to_world()
        assert frame[:3, 3] == pytest.approx(middle + offset, abs=1e-6)
        assert frame[:3, 0] == pytest.approx(along, abs=1e-9)
        normals.append(np.abs(frame[:3, 2]))
    assert normals == [pytest.approx(v, abs=1e-9) for v in ([0, 0, 1], [0, 0, 1], np.abs(aside), np.abs(aside))]
    assert ({face.coating for face in faces}, len(faces)) == ({Coating(R=0.1)}, 16)
    each_refused(
        ({"vanes": 0}, "vanes is 0"),
        ({"thickness": 0.0}, "thickness is 0"),
        ({"inner_radius": 100.0}, "inner_radius is 100"),
        ({"inner_radius": 0.5, "vanes": 4}, "overlap within 1 mm"),
        by=lambda change: spider("s", **(KIND | change)),
        pattern="spider 's'.*{}",
    )


@pytest.mark.parametrize("vanes", [3, 4, 5, 6, 9])
@pytest.mark.parametrize("offset", [0.0, 0.4, -2.5])
def test_vanes_may_begin_where_they_part(vanes, offset):
    """Points of a fine grid in two vanes at once: none where `spider` lets them begin, some 0.1 mm nearer the axis."""
    given = KIND | {"vanes": vanes, "offset": offset}
    least = 0.0
    try:
        spider("s", **(given | {"inner_radius": 0.0}))
    except mistray.MistrayError as refusal:
        least = float(str(refusal).partition("within ")[2].partition(" mm")[0]) + 1e-5
    spider("s", **(given | {"inner_radius": least}))
    shared = []
    for inner in (least, least - 0.1):
        along, aside = np.meshgrid(inner + np.arange(0.005, 6.0, 0.01), offset + np.arange(-0.995, 1.0, 0.01))
        others = [(along + 1j * aside) * np.exp(-2j * math.pi * k / vanes) for k in range(1, vanes)]
        shared.append(any(np.any((p.real > inner) & (np.abs(p.imag - offset) < 1.0)) for p in others))
    assert shared == [False, least > 0.0]


FIELD_DEG = 0.286
GIVEN = {"field_deg": FIELD_DEG, "wall_depth": 4.0, "wall_rear": 26.0}
MIRROR = {"coating": Coating(R=0.95), "mirror": True}
PRIMARY = Surface("primary", radius=-1000.0, conic=-1.0, semi_diameter=100.0, inner_semi_diameter=26.0, **MIRROR)
SECONDARY = Surface("secondary", z=-370.0, radius=-1040 / 3, conic=-25 / 9, semi_diameter=24.0, **MIRROR)
DETECTOR = Detector(z=150.0, semi_diameter=10.0)


def baffles(primary=PRIMARY, secondary=SECONDARY, detector=DETECTOR, **changes):
    return cassegrain_baffles(primary, secondary, detector, **(GIVEN | changes))


def meet(o, d, radius, conic, vertex):
    """Where rays meet a conic r² = 2 R ζ - (1 + k) ζ² on the side of its vertex, and how they are reflected."""
    o = o - np.array([0.0, 0.0, vertex])
    k = 1 + conic
    a = d[:, 0] ** 2 + d[:, 1] ** 2 + k * d[:, 2] ** 2
    b = o[:, 0] * d[:, 0] + o[:, 1] * d[:, 1] + k * o[:, 2] * d[:, 2] - radius * d[:, 2]
    c = o[:, 0] ** 2 + o[:, 1] ** 2 + k * o[:, 2] ** 2 - 2 * radius * o[:, 2]
    root = np.sqrt(b * b - a * c)
    with np.errstate(divide="ignore"):  # along the axis of a paraboloid the second crossing is at infinity
        ways = np.stack([c / (-b - np.sign(b) * root), (-b - np.sign(b) * root) / a])
    p = o + ways[np.argmin(np.abs(o[:, 2] + ways * d[:, 2]), axis=0), np.arange(len(d))][:, None] * d
    normal = np.column_stack([p[:, 0], p[:, 1], k * p[:, 2] - radius])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return p + np.array([0.0, 0.0, vertex]), d - 2 * np.sum(d * normal, axis=1)[:, None] * normal


def radius_at(p, d, z):
    """Distance from the axis where rays pass a plane."""
    t = (z - p[:, 2]) / d[:, 2]
    return np.hypot(p[:, 0] + t * d[:, 0], p[:, 1] + t * d[:, 1])


def beam(field_deg, rays=200_000, rim=24.0, seed=3):
    """Rays of one field that meet both mirrors within their rims, baffles or not: (points, directions) of each leg."""
    rng = np.random.default_rng(seed)
    r, phi = 100 * np.sqrt(rng.random(rays)), rng.uniform(0, 2 * np.pi, rays)
    phi[: rays // 4], r[: rays // 4] = np.pi / 2, np.linspace(-100, 100, rays // 4)  # and many in the meridional plane
    angle = math.radians(field_deg)
    d = np.tile([0.0, math.sin(angle), math.cos(angle)], (rays, 1))
    o = np.column_stack([r * np.cos(phi), r * np.sin(phi), np.zeros(rays)])
    p1, d1 = meet(o, d, PRIMARY.radius, PRIMARY.conic, PRIMARY.z)
    p2, d2 = meet(p1, d1, SECONDARY.radius, SECONDARY.conic, SECONDARY.z)
    used = (np.hypot(*p1[:, :2].T) <= 100.0) & (np.hypot(*p2[:, :2].T) <= rim)
    return [(p[used], direction[used]) for p, direction in ((p1, d), (p1, d1), (p2, d2))]


def test_no_line_from_the_detector_passes_the_secondary_baffle():
    made, rng, ends = baffles(), np.random.default_rng(0), []
    for radius, z in ((10.0, 150.0), made.inner_rim):
        r, phi = radius * np.minimum(1.0, 1.1 * np.sqrt(rng.random(200_000))), rng.uniform(0, 2 * np.pi, 200_000)
        ends.append(np.column_stack([r * np.cos(phi), r * np.sin(phi), np.full(200_000, z)]))
    start, through = ends
    worst = radius_at(start, through - start, made.outer_rim[1]).max()
    assert made.outer_rim[0] - 0.05 < worst <= made.outer_rim[0] + 1e-9


@pytest.mark.parametrize("field_deg", [0.0, FIELD_DEG])
def test_nothing_of_the_field_is_cut(field_deg):
    """The beam passes inside of A, around the tube and into it; the oracle's telescope has f = 2000 mm and an image."""
    made = baffles()
    (r_a, z_a), (r_b, z_b) = made.outer_rim, made.inner_rim
    before, between, behind = beam(field_deg)
    y = behind[0][:, 1] + (150.0 - behind[0][:, 2]) / behind[1][:, 2] * behind[1][:, 1]
    assert np.median(y) == pytest.approx(2000 * math.tan(math.radians(field_deg)), abs=0.03)
    unshadowed = radius_at(*before, z_a) > r_a
    assert radius_at(*between, z_a).max() <= r_a + 1e-9
    wall = made.tube.wall_radius(z_b)
    assert wall == pytest.approx(r_b + 4.0)
    used, after = ([part[unshadowed] for part in leg] for leg in (between, behind))
    assert radius_at(*used, z_b).min() >= wall - 1e-9
    for z in (-50.0, -1.0):
        assert radius_at(*used, z).min() >= made.tube.wall_radius(z)
    assert radius_at(*after, z_b).max() <= r_b + 1e-9
    for vane in made.tube.vanes:
        assert radius_at(*after, vane.z).max() <= vane.radius + 0.05
    if field_deg:  # the rims touch the beam
        assert radius_at(*between, z_a).max() > r_a - 0.02
        assert radius_at(*used, z_b).min() < wall + 0.02


def test_no_smaller_pair_does_it():
    """Nearer to the secondary along the beam, with the mouth that goes with it, a line from the detector passes A."""
    made = baffles()
    (r_a, z_a), (r_b, z_b) = made.outer_rim, made.inner_rim
    tau = (150.0 - z_a) / (150.0 - z_b)
    assert tau * r_b + (tau - 1) * 10.0 == pytest.approx(r_a, abs=1e-6)
    before, inmost, outmost = beam(FIELD_DEG, 20_000)
    for back in (2.0, 10.0):
        nearer = z_a - back
        smaller = radius_at(*inmost, nearer).max()
        passing = radius_at(*before, nearer) > smaller
        # the mouth may move until its wall meets the innermost ray that is left
        places = np.arange(z_b + 5, z_b - 20, -0.1)
        used = [part[passing] for part in inmost]
        rooms = [radius_at(*used, z).min() - radius_at(*outmost, z).max() for z in places]
        z = places[np.argmax(np.array(rooms) < 4.0)]
        tau = (150.0 - nearer) / (150.0 - z)
        assert tau * radius_at(*outmost, z).max() + (tau - 1) * 10.0 > smaller + 0.02


def test_obscuration_is_the_shadow_of_the_rim():
    made = baffles()
    (p1, _), *_ = beam(0.0)
    assert made.obscuration == pytest.approx((made.outer_rim[0] / np.hypot(p1[:, 0], p1[:, 1]).max()) ** 2, rel=1e-3)
    assert baffles(field_deg=0.15).obscuration < made.obscuration < baffles(clearance=1.0).obscuration
    assert made.obscuration < baffles(wall_depth=8.0).obscuration
    cone, wall, vane, *_ = made.structures()
    assert [cone.name, wall.name, vane.name] == ["secondary_baffle", "inner_baffle_wall", "inner_baffle_vane_1"]
    assert (cone.r0, cone.z0) == SECONDARY.rim


@pytest.mark.parametrize("radius", [24.0, 25.9, 28.0])
def test_whichever_mirror_limits_the_beam(radius):
    """A touches the beam of all fields from outside, with the stop at the secondary, at both and at the primary."""
    made = baffles(secondary=replace(SECONDARY, semi_diameter=radius))
    widest = max(radius_at(*beam(f, 20_000, radius)[1], made.outer_rim[1]).max() for f in np.linspace(0, FIELD_DEG, 12))
    assert made.outer_rim[0] - 0.03 <= widest <= made.outer_rim[0] + 1e-9

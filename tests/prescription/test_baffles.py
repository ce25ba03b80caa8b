"""Vane tubes against straight float64 rays in three dimensions: what is lit from outside is not seen from the optic."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.prescription.baffles.tube import BaffleTube, hood_length, vane_tube
from mistray.prescription.baffles.two_stage import two_stage_baffle
from mistray.prescription.baffles.vanes import Vane, VaneEdge, vane_faces
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


@pytest.mark.long
def test_vanes_stand_as_far_apart_as_they_may():
    """A vane moved by 2 mm towards the optic leaves a lit and seen zone before it."""
    tube = tube_of("straight", overlap=0.0)
    for k in range(1, len(tube.vanes) - 1):
        moved = replace(tube.vanes[k], z=tube.vanes[k].z + 2.0)
        assert first_order(replace(tube, vanes=(*tube.vanes[:k], moved, *tube.vanes[k + 1 :])), count=600)


@pytest.mark.long
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
    assert np.ptp(depths) == pytest.approx(1.0)
    assert (depths.max() if bevel == "front" else depths.min()) == pytest.approx(5.0)
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
    plain = tube_of("straight").structures()
    assert [shape.name for shape in plain[:3]] == ["tube_wall", "tube_vane_1", "tube_vane_2"]
    tube = tube_of("straight", edge=VaneEdge(thickness=0.5, bevel_deg=25.0))
    assert tube.vanes[0].bevel == "front"
    assert tube.vanes[-1].bevel == "rear"
    for vane in tube.vanes:
        bevel = next(face for face in vane_faces(vane, tube.wall_radius) if face[0] == "_bevel")
        middle = np.array([0.5 * (bevel[1] + bevel[3]) - 1e-3, 0.0, 0.5 * (bevel[2] + bevel[4])])
        assert (is_seen if vane.bevel == "front" else is_lit)(tube, middle) is np.False_


STAR_TRACKER = {"optic_radius": 10.0, "z_rear": 0.0, "field_deg": 5.0, "exclusion_deg": 40.0, "depth": 8.0}


def test_impossible_tubes_edges_hoods_and_stages():
    for changes, wanted in (
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
    ):
        with pytest.raises(MistrayError, match=wanted):
            changes() if callable(changes) else tube_of("straight", **changes).structures()


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
    lit, seen = lit_zones(tube, exclusion_deg), seen_zones(tube)
    both = first_order_zones(tube, exclusion_deg)
    assert lit
    assert seen
    for z in np.linspace(0.25, 99.75, 150):
        point = (tube.wall_radius(z) - 1e-9, 0.0, z)
        for zones, cast in (
            (lit, is_lit(tube, point, exclusion_deg, 3600)),
            (seen, is_seen(tube, point, 3600)),
        ):
            inside = any(a <= z <= b for a, b in zones)
            at_border = any(abs(z - end) < 1.3 for zone in zones for end in zone)  # the oracle's rays have gaps
            assert cast == inside or (inside and at_border), z
        assert any(a <= z <= b for a, b in both) == all(any(a <= z <= b for a, b in zones) for zones in (lit, seen))

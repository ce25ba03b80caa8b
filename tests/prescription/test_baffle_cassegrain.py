"""Cassegrain baffles by float64 rays: no straight line to the detector, nothing of the field cut, no smaller pair."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.prescription import Coating, Detector, Surface
from mistray.prescription.baffles.cassegrain import cassegrain_baffles

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
    used = (np.hypot(p1[:, 0], p1[:, 1]) <= 100.0) & (np.hypot(p2[:, 0], p2[:, 1]) <= rim)
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
    used = (between[0][unshadowed], between[1][unshadowed])
    assert radius_at(*used, z_b).min() >= wall - 1e-9
    for z in (-50.0, -1.0):
        assert radius_at(*used, z).min() >= made.tube.wall_radius(z)
    assert radius_at(behind[0][unshadowed], behind[1][unshadowed], z_b).max() <= r_b + 1e-9
    for vane in made.tube.vanes:
        assert radius_at(behind[0][unshadowed], behind[1][unshadowed], vane.z).max() <= vane.radius + 0.05
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
        rooms = [
            radius_at(inmost[0][passing], inmost[1][passing], z).min() - radius_at(*outmost, z).max() for z in places
        ]
        z = places[np.argmax(np.array(rooms) < 4.0)]
        tau = (150.0 - nearer) / (150.0 - z)
        assert tau * radius_at(*outmost, z).max() + (tau - 1) * 10.0 > smaller + 0.02


def test_obscuration_is_the_shadow_of_the_rim():
    made = baffles()
    (p1, _), *_ = beam(0.0)
    assert made.obscuration == pytest.approx((made.outer_rim[0] / np.hypot(p1[:, 0], p1[:, 1]).max()) ** 2, rel=1e-3)
    assert made.obscuration < baffles(wall_depth=8.0).obscuration
    assert made.obscuration < baffles(clearance=1.0).obscuration
    assert made.obscuration > baffles(field_deg=0.15).obscuration
    cone, wall, vane, *_ = made.structures()
    assert [cone.name, wall.name, vane.name] == ["secondary_baffle", "inner_baffle_wall", "inner_baffle_vane_1"]
    assert (cone.r0, cone.z0) == SECONDARY.rim


@pytest.mark.parametrize("radius", [24.0, 25.9, 28.0])
def test_whichever_mirror_limits_the_beam(radius):
    """A touches the beam of all fields from outside, with the stop at the secondary, at both and at the primary."""
    made = baffles(secondary=replace(SECONDARY, semi_diameter=radius))
    widest = max(radius_at(*beam(f, 20_000, radius)[1], made.outer_rim[1]).max() for f in np.linspace(0, FIELD_DEG, 12))
    assert widest == pytest.approx(made.outer_rim[0], abs=0.03)
    assert widest <= made.outer_rim[0] + 1e-9


def test_impossible_baffles():
    for changes, wanted in (
        ({"detector": replace(DETECTOR, semi_diameter=60.0)}, "narrower than detector 'detector', 60 mm"),
        ({"field_deg": 8.0}, "no baffles keep the sky from detector 'detector'"),
        ({"field_deg": -1.0}, "field_deg is -1; it must lie between 0 and 90"),
        ({"wall_rear": 60.0}, "whose hole has 26 mm"),
        ({"detector": replace(DETECTOR, x=1.0)}, "off the axis"),
    ):
        with pytest.raises(MistrayError, match=wanted):
            baffles(**changes)

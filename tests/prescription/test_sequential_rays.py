"""Float64 rays and first orders of tables of surfaces against closed forms, Snell's law and batoid."""

import math
from dataclasses import replace

import numpy as np
import pytest
from refusals import each_refused, refused

from mistray.physics.geometry.sag import sag
from mistray.prescription import Decentre, Row, Sequential, circle, rectangle
from mistray.prescription.sequential.edge_rays import edge_rays, launch
from mistray.prescription.sequential.first_order import first_order
from mistray.prescription.sequential.rays import passes, trace

ALONG, IMAGE = (0.0, 0.0, 1.0), Row(99, kind="image")


def lens(*rows: Row, **system) -> Sequential:
    return Sequential("test", (*rows, IMAGE), **({"aperture": 10.0} | system))


def parallel(*heights):
    """Rays along +z at heights y, from z = -5 mm."""
    return np.array([[0.0, y, -5.0] for y in heights]), np.tile(ALONG, (len(heights), 1))


def test_spheres_and_conics_by_textbook():
    """A ray parallel to the axis at height h: sin I = h/R, n' sin I' = sin I, L' = R + R sin I' / sin(I - I')."""
    radius, n, h = 50.0, 1.5, 20.0
    incidence, refracted = math.asin(h / radius), math.asin(h / radius / n)
    crossing = radius + radius * math.sin(refracted) / math.sin(incidence - refracted)
    hits, onward = trace(lens(Row(1, radius=radius, thickness=crossing, material="1.5")), *parallel(h))
    assert hits[0, 0] == pytest.approx([0, h, radius - math.sqrt(radius**2 - h**2)], abs=1e-13)
    assert hits[1, 0] == pytest.approx([0, 0, 0], abs=1e-12)
    # Rays that miss, or are totally reflected as sin I = 0.8 and 1.5 · 0.8 > 1, are NaN from there
    rows = lens(Row(1, thickness=5.0, material="1.5"), Row(2, radius=-10.0, thickness=5.0))
    lost = np.isnan(trace(rows, *parallel(1.0, 8.0, 11.0))[0]).all(axis=2)
    assert lost.tolist() == [[False, False, False], [False, False, True], [False, True, True]]
    assert math.asin(-onward[0, 0, 1]) == pytest.approx(incidence - refracted, abs=1e-14)
    # A paraboloid, and a plano-convex lens whose rear is a hyperboloid of conic -n²
    mirror = lens(Row(1, radius=-200.0, conic=-1.0, mirror=True, thickness=-100.0))
    hits, onward = trace(mirror, *parallel(0, 10, -30, 80))
    assert np.abs(hits[1, :, :2]).max() < 1e-12
    assert (onward[0, :, 2] < 0).all()
    n, radius = 1.6, -30.0
    rear = Row(2, radius=radius, conic=-(n**2), thickness=-radius / (n - 1))
    hits, _ = trace(lens(Row(1, thickness=8.0, material="1.6"), rear), *parallel(1.0, 6.0, 12.0))
    assert np.abs(hits[2, :, :2]).max() < 1e-12
    # An ellipsoid of semi-axes a, b joins its foci at a ± e: R = b²/a, conic = -(e/a)²
    a, b = 100.0, 80.0
    e = math.sqrt(a * a - b * b)
    rows = lens(Row(1, radius=-b * b / a, conic=-((e / a) ** 2), mirror=True, thickness=-(a - e)))
    hits, _ = trace(rows, np.tile([0.0, 0.0, -(a + e)], (3, 1)), [[0.0, 0.1, 1.0], [0.2, -0.1, 1.0], [0.0, 0.3, 1.0]])
    assert np.abs(hits[1, :, :2]).max() < 1e-11


def test_aspheres_obey_snell_and_apertures_stop_rays():
    row = Row(1, radius=25.0, conic=-0.7, coefficients=(2e-5, -3e-8, 1e-11), material="1.7", thickness=10.0)
    rng = np.random.default_rng(1)
    positions = np.column_stack([rng.uniform(-6, 6, (50, 2)), np.full(50, -3.0)])
    directions = np.column_stack([rng.uniform(-0.2, 0.2, (50, 2)), np.ones(50)])
    hits, onward = trace(lens(row), positions, directions)
    inward = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    r2 = hits[0, :, 0] ** 2 + hits[0, :, 1] ** 2
    assert np.abs(hits[0, :, 2] - sag(r2, 1 / 25.0, -0.7, row.coefficients)).max() < 1e-13
    # On the ray: the cross product with its direction vanishes
    assert np.abs(np.cross(hits[0] - positions, inward)).max() < 1e-12
    # The normal from differences of the sag, not from its derivative
    step = 1e-5
    x, y = hits[0, :, 0], hits[0, :, 1]

    def height(dx: float, dy: float) -> np.ndarray:
        return sag((x + dx) ** 2 + (y + dy) ** 2, 1 / 25.0, -0.7, row.coefficients)

    slopes = [(height(*s) - height(*-s)) / (2 * step) for s in step * np.eye(2)]
    normal = np.column_stack([-slopes[0], -slopes[1], np.ones(50)])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert np.abs(np.cross(inward, normal) - 1.7 * np.cross(onward[0], normal)).max() < 1e-9
    assert np.linalg.norm(onward[0], axis=1) == pytest.approx(1.0, abs=1e-15)
    for row, through in (
        (Row(1, aperture=circle(2.0)), [1, 1, 0, 0, 0]),  # a ray that touches a rim passes
        (Row(1, aperture=circle(2.0, 1.0)), [0, 1, 0, 0, 0]),
        (Row(1, obscuration=circle(2.0)), [0, 1, 1, 1, 0]),
        (Row(1, aperture=circle(1.5, y=3.0)), [0, 1, 1, 0, 0]),
        (Row(1, aperture=rectangle(1.0, 3.5)), [1, 1, 1, 0, 0]),
        (Row(1, semi_diameter=2.0), [1, 1, 1, 1, 0]),  # a drawn radius
        (Row(1, semi_diameter=2.0, semi_diameter_fixed=True), [1, 1, 0, 0, 0]),
    ):
        points = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 3.0, 0.0], [0.0, 5.0, 0.0], [np.nan, 0.0, 0.0]])
        assert passes(row, points).tolist() == [bool(passed) for passed in through]


def test_batoid_traces_the_same_rays():
    """A triplet with an asphere and a tilted, decentred middle lens; batoid works in metres."""
    batoid = pytest.importorskip("batoid")
    rows = lens(
        Row(1, radius=22.0, conic=-0.4, coefficients=(1e-6, 2e-9), thickness=3.2, material="1.62"),
        Row(2, radius=-435.0, thickness=6.0),
        Row(3, kind="coordinate_break", decentre=Decentre(y=0.3, x=-0.1, tilt_deg=(2.0, -1.5, 0.0))),
        Row(4, radius=-22.2, thickness=1.0, material="1.617"),
        Row(5, radius=20.3, thickness=4.7),
        Row(6, radius=79.7, thickness=2.9, material="1.62"),
        Row(7, radius=-18.4, thickness=40.0),
    )
    rng = np.random.default_rng(3)
    positions = np.column_stack([rng.uniform(-4, 4, (40, 2)), np.full(40, -5.0)])
    directions = np.column_stack([rng.uniform(-0.1, 0.1, (40, 2)), np.ones(40)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits, onward = trace(rows, positions, directions)
    index, medium = [1.0], 1.0
    for row in rows.rows:
        medium = float(row.material) if row.material != "air" else 1.0
        index.append(index[-1] if row.kind != "surface" else medium)
    elements = []
    # By hand: the frame of row 3 holds for all later ones, and batoid's rotation is RotX · RotY as well
    turn = batoid.RotX(math.radians(2.0)) @ batoid.RotY(math.radians(-1.5))
    for k, (row, z) in enumerate(zip(rows.rows, [0.0, 3.2, 9.2, 0.0, 1.0, 5.7, 8.6, 48.6], strict=True)):
        if row.kind == "coordinate_break":
            continue
        own = turn if k >= 2 else np.eye(3)
        origin = own @ np.array([0.0, 0.0, z]) + ([-0.1, 0.3, 3.2 + 6.0] if k >= 2 else 0.0)
        system = batoid.CoordSys(origin=origin * 1e-3, rot=own)
        figure = batoid.Plane()
        if not math.isinf(row.radius):
            terms = [1e-6 * 1e9, 2e-9 * 1e15] if row.coefficients else [0.0]
            figure = batoid.Asphere(row.radius * 1e-3, row.conic, terms)
        kind = batoid.Detector if row.kind == "image" else batoid.RefractiveInterface
        media = {"inMedium": batoid.ConstMedium(index[k]), "outMedium": batoid.ConstMedium(index[k + 1])}
        elements.append(kind(figure, name=str(k), coordSys=system, **media))
    optic = batoid.CompoundOptic(elements, inMedium=batoid.ConstMedium(1.0), outMedium=batoid.ConstMedium(1.0))
    rays = batoid.RayVector(*(positions.T * 1e-3), *directions.T, t=0.0, wavelength=5e-7)
    optic.trace(rays)
    assert not rays.failed.any()
    assert np.abs(rays.r * 1e3 - hits[-1]).max() < 1e-10
    assert np.abs(rays.v - onward[-1]).max() < 1e-12


N, R1, R2, T = 1.5168, 60.0, -80.0, 9.0


def singlet(**system) -> Sequential:
    """A thick lens, then a stop 12 mm behind it."""
    rows = Row(1, radius=R1, thickness=T, material=str(N)), Row(2, radius=R2, thickness=12.0)
    return lens(*rows, Row(3, stop=True, thickness=60.0), **system)


def lensmaker() -> tuple[float, float]:
    """EFL and BFL of the thick lens in air."""
    efl = 1 / ((N - 1) * (1 / R1 - 1 / R2 + (N - 1) * T / (N * R1 * R2)))
    return efl, efl * (1 - (N - 1) * T / (N * R1))


def test_focal_lengths_and_pupils_of_a_thick_lens():
    """The stop's image in front of a thick lens: Gauss' formula from the principal planes, light going backwards."""
    efl, bfl = lensmaker()
    front_principal = -efl * (N - 1) * T / (N * R2)  # from the first vertex, along +z
    rear_principal = -efl * (N - 1) * T / (N * R1)  # from the second vertex
    s = 12.0 - rear_principal  # from the rear principal plane to the stop
    image = 1 / (1 / efl - 1 / s)  # negative: virtual, on the side of the stop
    data = first_order(singlet())
    assert (data.efl, data.f_number) == pytest.approx((efl, efl / 10.0), rel=1e-13)
    # From the last surface, which is the stop, 12 mm behind the lens
    assert data.bfl == pytest.approx(bfl - 12.0, rel=1e-12)
    data = first_order(singlet(aperture_kind="stop_diameter", aperture=6.0))
    assert (data.entrance_pupil_z, data.epd) == pytest.approx((front_principal - image, 6.0 * -image / s), rel=1e-12)
    assert (data.stop_radius, data.stop_number) == (pytest.approx(3.0, rel=1e-13), 3)
    assert first_order(singlet(aperture_kind="f_number", aperture=4.0)).epd == pytest.approx(efl / 4, rel=1e-13)
    near = singlet(aperture_kind="object_na", aperture=0.02, object_distance=300.0)
    data = first_order(near)
    assert data.epd / 2 / (300.0 + data.entrance_pupil_z) == pytest.approx(math.tan(math.asin(0.02)), rel=1e-12)
    start, heading = launch(near, data, (0.0, 0.0), [[0.0, 1.0], [1.0, 0.0]])
    assert start == pytest.approx(np.tile([0, 0, -300.0], (2, 1)))
    assert heading[0] == pytest.approx([0, 0.02, math.sqrt(1 - 0.02**2)], rel=1e-12)
    oil = {"aperture_kind": "object_na", "object_distance": 2.0, "object_material": "1.515"}  # NA = n sin θ
    data = first_order(singlet(aperture=1.25, **oil))
    assert data.epd / 2 / (2.0 + data.entrance_pupil_z) == pytest.approx(math.tan(math.asin(1.25 / 1.515)), rel=1e-12)
    with refused(r"object NA 1.52 needs .* a value below 1.515, the index of its medium"):
        first_order(singlet(aperture=1.52, **oil))


def test_telecentric_systems():
    """Cones about rays that leave the object parallel to the axis; the stop aims none and is as wide as they need."""
    distance, na = 30.0, 0.1
    system = {"object_distance": distance, "aperture_kind": "object_na", "aperture": na, "telecentric": True}
    lens = singlet(field_kind="object_height", fields=((0.0, 0.0), (0.0, 4.0)), **system)
    data = first_order(lens)
    assert (data.entrance_pupil_z, data.f_number) == (math.inf, math.inf)
    assert data.epd == pytest.approx(2 * distance * math.tan(math.asin(na)), rel=1e-13)
    start, heading = launch(lens, data, 1, [[0.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
    assert start == pytest.approx(np.tile([0.0, 4.0, -distance], (3, 1)))
    along = math.sqrt(1 - na * na)
    assert heading == pytest.approx(np.array([[0, 0, 1], [0, na, along], [-na, 0, along]]), abs=1e-13)
    rays = edge_rays(lens)
    # In the plane of the first vertex the beam of the outer field reaches 4 mm + 30 mm tan(asin 0.1)
    flat = edge_rays(lens.with_rows([Row(9), *lens.rows]))
    assert flat.reach[0] == pytest.approx(4.0 + distance * math.tan(math.asin(na)), rel=1e-12)
    assert rays.stop_radius == pytest.approx(np.hypot(*rays.positions[2, :, :2].T).max(), rel=1e-13)
    assert any("telecentric" in note for note in rays.notes)
    # The stop's image lies at infinity; object NA and stop diameter then mean the same cone, u = r/f
    efl, bfl = lensmaker()
    rows = list(singlet().rows)
    rows[1] = Row(2, radius=R2, thickness=bfl)
    near = {"object_distance": 90.0, "fields": ((0.0, 0.0), (0.0, 2.0)), "field_kind": "object_height"}
    lens = singlet(aperture_kind="stop_diameter", aperture=4.0, **near).with_rows(rows)
    data = first_order(lens)
    assert (data.entrance_pupil_z, data.epd) == (math.inf, pytest.approx(2 * 90.0 * 2.0 / efl, rel=1e-9))
    by_na = singlet(aperture_kind="object_na", aperture=math.sin(math.atan(2.0 / efl)), **near).with_rows(rows)
    assert first_order(by_na).stop_radius == pytest.approx(2.0, rel=1e-9)
    assert np.hypot(*edge_rays(lens).positions[2, :, :2].T).max() == pytest.approx(2.0, rel=1e-7)
    with refused(r"its entrance pupil lies at infinity, so its aperture .* limits no beam"):
        first_order(singlet(aperture=5.0, **near).with_rows(rows))


def test_mirrors():
    """f = R/2; of two f1 f2/(f1 + f2 - d), back focus f (f1 - d)/f1; a flat changes nothing; at 2f it is -1."""

    def of(*rows: Row, **system: float):
        return first_order(lens(*rows, **({"aperture": 20.0} | system)))

    mirror = Row(1, radius=-500.0, mirror=True, stop=True, thickness=-200.0)
    fold = Row(2, kind="coordinate_break", decentre=Decentre(tilt_deg=(45.0, 0.0, 0.0)))
    newtonian = of(mirror, fold, Row(3, mirror=True), replace(fold, number=4, thickness=50.0))
    assert (of(mirror).efl, of(mirror).bfl) == pytest.approx((250.0, 250.0), rel=1e-14)
    assert (newtonian.efl, newtonian.bfl) == pytest.approx((250.0, 50.0), rel=1e-13)
    f1, f2, d = 1000.0, -400.0, 700.0
    data = of(replace(mirror, radius=-2 * f1, thickness=-d), Row(2, radius=2 * f2, mirror=True, thickness=900.0))
    efl = f1 * f2 / (f1 + f2 - d)
    assert (data.efl, data.bfl) == pytest.approx((efl, efl * (f1 - d) / f1), rel=1e-12)
    f = 1 / (0.5 * (2 / 100.0))
    front = Row(1, radius=100.0, thickness=1e-9, material="1.5", stop=True)
    data = of(front, Row(2, radius=-100.0, thickness=2 * f), object_distance=2 * f, aperture=5.0)
    assert data.magnification == pytest.approx(-1.0, rel=1e-8)


def test_edge_rays_meet_the_rim_of_the_stop():
    light = {"wavelengths_nm": (486.1, 587.6, 656.3), "weights": (1.0, 1.0, 1.0), "primary": 1}
    lens = singlet(fields=((0.0, 0.0), (0.0, 15.0), (10.0, 20.0)), **light)
    rays = edge_rays(lens)
    assert rays.notes == ()
    stop = np.hypot(*rays.positions[2, :, :2].T).reshape(9, 17)
    assert stop[:, 0] == pytest.approx(0.0, abs=1e-7)
    assert stop[:, 1:] == pytest.approx(rays.stop_radius, rel=1e-8)
    hits, _ = trace(lens, [[0.0, 5.0, -1.0]], [[0.0, 0.0, 1.0]])
    assert rays.stop_radius == pytest.approx(hits[2, 0, 1], rel=1e-12)
    assert rays.reach[0] == pytest.approx(np.nanmax(np.hypot(rays.positions[0, :, 0], rays.positions[0, :, 1])))
    lens = singlet(fields=((0.0, 10.0),), vignetting=((0.0, 0.1, 0.2, 0.4),))
    rays = edge_rays(lens)
    y = rays.positions[2, 1:, 1] / rays.stop_radius
    assert (y.max(), y.min()) == pytest.approx((0.1 + 0.6, 0.1 - 0.6), abs=1e-7)
    assert np.abs(rays.positions[2, 1:, 0]).max() / rays.stop_radius == pytest.approx(0.8, abs=1e-7)
    start, _ = launch(lens, rays.data, 0, [[0.0, 1.0]])
    assert start[0, 1] == pytest.approx(5.0 * 0.7)
    # The first field stays the first where 24 of 60 are used; its chief ray comes and goes along the axis
    rays = edge_rays(singlet(fields=tuple((0.0, k / 6) for k in range(60))))
    assert (rays.entering[1, 0], rays.chief[-1]) == (pytest.approx(ALONG), pytest.approx(ALONG))


def test_what_has_no_meaning_and_apertures_that_no_ray_passes():
    away = (Row(7, radius=20.0, material="1.5", decentre=Decentre(y=100.0), stop=True), IMAGE)
    each_refused(
        ({"aperture": 0.0}, "its aperture .* is 0; it must be greater than 0"),
        ({"aperture_kind": "object_na", "aperture": 0.1}, "object NA 0.1 needs an object at a finite distance"),
        ({"field_kind": "object_height", "fields": ((0.0, 5.0),)}, "its object lies at infinity; give angles"),
        ({"telecentric": True}, "its object space is telecentric and its object lies at infinity"),
        ({"fields": ((0.0, 90.0),)}, "a field of 90°; it must be less than 90°"),
        ({"rows": away}, "no ray reaches the image; field .* 17 at surface 7"),
        ({"rows": (Row(1, material="NOGLASS"), IMAGE)}, "lens 'test', surface 1: .*NOGLASS"),
        by=lambda changes: edge_rays(replace(singlet(), **changes)),
    )
    # Of one that no sampled ray passes the lens is not hidden; at the stop itself it is the stop
    ring = circle(1.0, 0.5)
    front, rear = Row(6, stop=True), Row(7, radius=20.0, thickness=1.0, material="1.5")
    rays = edge_rays(lens(front, replace(rear, aperture=ring), aperture=3.0))
    assert np.isfinite(rays.positions[-1]).all()
    assert rays.notes[-1].startswith("of these no ray of the rim gets through")
    assert edge_rays(lens(replace(front, aperture=ring), rear, aperture=3.0)).stop_radius == 1.0

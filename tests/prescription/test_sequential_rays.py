"""The float64 trace of a table of surfaces against closed forms, Snell's law and batoid."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mistray import MistrayError
from mistray.physics.geometry.outline import circle, rectangle
from mistray.physics.geometry.sag import sag
from mistray.prescription import Decentre, Row, Sequential
from mistray.prescription.sequential.rays import passes, trace

ALONG = (0.0, 0.0, 1.0)


def lens(*rows: Row, **system) -> Sequential:
    return Sequential("test", (*rows, Row(99, kind="image")), aperture=10.0, **system)


def parallel(*heights):
    """Rays along +z at heights y, from z = -5 mm."""
    return np.array([[0.0, y, -5.0] for y in heights]), np.tile(ALONG, (len(heights), 1))


def test_a_refracting_sphere_has_the_textbook_aberration():
    """A ray parallel to the axis at height h: sin I = h/R, n' sin I' = sin I, L' = R + R sin I' / sin(I - I')."""
    radius, n, h = 50.0, 1.5, 20.0
    incidence = math.asin(h / radius)
    refracted = math.asin(h / radius / n)
    crossing = radius + radius * math.sin(refracted) / math.sin(incidence - refracted)
    hits, onward = trace(lens(Row(1, radius=radius, thickness=crossing, material="1.5")), *parallel(h))
    assert hits[0, 0] == pytest.approx([0, h, radius - math.sqrt(radius**2 - h**2)], abs=1e-13)
    assert hits[1, 0] == pytest.approx([0, 0, 0], abs=1e-12)
    assert math.asin(-onward[0, 0, 1]) == pytest.approx(incidence - refracted, abs=1e-14)


def test_conics_focus_exactly():
    """A paraboloid, and a plano-convex lens whose rear is a hyperboloid of conic -n²."""
    hits, onward = trace(
        lens(Row(1, radius=-200.0, conic=-1.0, mirror=True, thickness=-100.0)), *parallel(0, 10, -30, 80)
    )
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
    start = np.tile([0.0, 0.0, -(a + e)], (3, 1))
    hits, _ = trace(rows, start, [[0.0, 0.1, 1.0], [0.2, -0.1, 1.0], [0.0, 0.3, 1.0]])
    assert np.abs(hits[1, :, :2]).max() < 1e-11


def test_aspheres_are_met_where_their_sag_is_and_obey_snell():
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
    slopes = [
        (sag((x + dx) ** 2 + (y + dy) ** 2, 1 / 25.0, -0.7, row.coefficients)
         - sag((x - dx) ** 2 + (y - dy) ** 2, 1 / 25.0, -0.7, row.coefficients)) / (2 * step)
        for dx, dy in ((step, 0.0), (0.0, step))
    ]  # fmt: skip
    normal = np.column_stack([-slopes[0], -slopes[1], np.ones(50)])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert np.abs(np.cross(inward, normal) - 1.7 * np.cross(onward[0], normal)).max() < 1e-9
    assert np.linalg.norm(onward[0], axis=1) == pytest.approx(1.0, abs=1e-15)


def test_rays_that_miss_or_are_totally_reflected_are_nan_from_there():
    rows = lens(Row(1, thickness=5.0, material="1.5"), Row(2, radius=-10.0, thickness=5.0))
    hits, _ = trace(rows, *parallel(1.0, 8.0, 11.0))
    assert np.isfinite(hits[:, 0]).all()
    # sin I = 0.8, 1.5 · 0.8 > 1: it meets the sphere and does not get out
    assert np.isfinite(hits[1, 1]).all()
    assert np.isnan(hits[2, 1]).all()
    assert np.isnan(hits[1:, 2]).all()


def test_unknown_glass_names_the_surface():
    with pytest.raises(MistrayError, match=r"lens 'test', surface 1: .*NOGLASS"):
        trace(lens(Row(1, material="NOGLASS")), *parallel(1.0))


@pytest.mark.parametrize(
    ("row", "through"),
    [
        (Row(1, aperture=circle(2.0)), [1, 1, 0, 0, 0]),  # a ray that touches a rim passes
        (Row(1, aperture=circle(2.0, 1.0)), [0, 1, 0, 0, 0]),
        (Row(1, obscuration=circle(2.0)), [0, 1, 1, 1, 0]),
        (Row(1, aperture=circle(1.5, y=3.0)), [0, 1, 1, 0, 0]),
        (Row(1, aperture=rectangle(1.0, 3.5)), [1, 1, 1, 0, 0]),
        (Row(1, semi_diameter=2.0), [1, 1, 1, 1, 0]),  # a drawn radius
        (Row(1, semi_diameter=2.0, semi_diameter_fixed=True), [1, 1, 0, 0, 0]),
    ],
)
def test_stated_apertures_stop_rays(row, through):
    points = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 3.0, 0.0], [0.0, 5.0, 0.0], [np.nan, 0.0, 0.0]])
    assert passes(row, points).tolist() == [bool(passed) for passed in through]


def test_batoid_traces_the_same_rays():
    """A triplet with an asphere and a tilted, decentred middle lens; batoid works in metres."""
    batoid = pytest.importorskip("batoid")
    tilt = Decentre(y=0.3, x=-0.1, tilt_deg=(2.0, -1.5, 0.0))
    rows = lens(
        Row(1, radius=22.0, conic=-0.4, coefficients=(1e-6, 2e-9), thickness=3.2, material="1.62"),
        Row(2, radius=-435.0, thickness=6.0),
        Row(3, kind="coordinate_break", decentre=tilt),
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
    break_z, along = 3.2 + 6.0, 0.0
    for k, (row, z) in enumerate(zip(rows.rows, [0.0, 3.2, 9.2, 0.0, 1.0, 5.7, 8.6, 48.6], strict=True)):
        if row.kind == "coordinate_break":
            continue
        if k < 2:
            system = batoid.CoordSys().shiftGlobal([0, 0, z * 1e-3])
        else:
            along = np.array([-0.1, 0.3, break_z]) + turn @ np.array([0.0, 0.0, z])
            system = batoid.CoordSys(origin=along * 1e-3, rot=turn)
        if math.isinf(row.radius):
            figure = batoid.Plane()
        elif row.coefficients:
            figure = batoid.Asphere(row.radius * 1e-3, row.conic, [1e-6 * 1e9, 2e-9 * 1e15])
        else:
            figure = batoid.Quadric(row.radius * 1e-3, row.conic)
        kind = batoid.Detector if row.kind == "image" else batoid.RefractiveInterface
        media = {"inMedium": batoid.ConstMedium(index[k]), "outMedium": batoid.ConstMedium(index[k + 1])}
        elements.append(kind(figure, name=str(k), coordSys=system, **media))
    optic = batoid.CompoundOptic(elements, inMedium=batoid.ConstMedium(1.0), outMedium=batoid.ConstMedium(1.0))
    rays = batoid.RayVector(*(positions.T * 1e-3), *directions.T, t=0.0, wavelength=5e-7)
    optic.trace(rays)
    assert not rays.failed.any()
    assert np.abs(rays.r * 1e3 - hits[-1]).max() < 1e-10
    assert np.abs(rays.v - onward[-1]).max() < 1e-12

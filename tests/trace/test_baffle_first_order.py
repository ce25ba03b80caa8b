"""Generated tubes show no first-order path, forwards and backwards; spoiled ones do: false alarms 0."""

import importlib
import math
from dataclasses import replace

import numpy as np
import pytest

import mistray
from mistray.analyses.pst.run import pst
from mistray.prescription import Coating, Detector, Prescription, Scatter, Source, VaneEdge, two_stage_baffle, vane_tube

ANGLES = range(0, 81, 4)
ONCE = {"rays": 100_000, "max_scatters": 1, "max_reflections": 0, "paths": False}


def system(tube, without=()):
    """The tube with a detector in the place of its optic; `tube` is a `BaffleTube` or a `TwoStageBaffle`."""
    stages = (tube,) if hasattr(tube, "vanes") else (tube.outer, tube.inner)
    shapes = tube.structures(coating=Coating(R=0.0), scatter=(Scatter("paint", {"reflectance": 0.3}, name="grey"),))
    assert not (set(without) - {shape.name for shape in shapes})
    kept, front, rear = tuple(shape for shape in shapes if shape.name not in without), stages[0], stages[-1]
    detector = Detector(z=rear.z_rear, semi_diameter=rear.optic_radius, pixels=(8, 8))
    source = Source(radius=front.vanes[0].radius, z=front.z_front, plane="axis")
    return Prescription(name="tube", surfaces=(), structures=kept, detector=detector, source=source)


def scattered(prescription, field_deg, scatters=1, rays=20_000):
    """Power that meets the detector after scatter from a beam of this field angle, W, of about 2000 W."""
    scene = prescription.with_source(field_deg=field_deg).to_scene()
    paths = mistray.trace(scene, rays=rays, max_scatters=scatters, max_reflections=0).paths.to_pandas()
    return paths.incident_W[paths.scatters > 0].sum()


def tube(**changes):
    given = {"optic_radius": 18.0, "z_rear": 102.0, "length": 102.0, "wall_radius": 30.0, "field_deg": 4.0}
    return vane_tube("tube", **(given | changes))


def test_no_light_arrives_after_one_scatter_forwards():
    made = tube()
    spoiled = replace(made, vanes=made.vanes[:2] + made.vanes[3:])
    for field_deg in (0.0, 10.0, 30.0, 60.0, 85.0):
        assert scattered(system(made), field_deg) == 0
    for field_deg in (30.0, 60.0):
        assert scattered(system(spoiled), field_deg) > 1e-4
    assert scattered(system(made), 30.0, scatters=2) > 1e-4
    made = tube(exclusion_deg=60.0, length=60.0)
    assert len(made.vanes) < len(tube(length=60.0).vanes)
    found = pst(system(made).to_scene(), range(2, 83, 4), **ONCE)
    outside = np.array(found.field_deg) - 2 >= 60.0
    np.testing.assert_array_equal(found.stray[outside], 0)
    assert found.stray[~outside].max() > 0


def test_no_light_arrives_after_one_scatter_backwards():
    """All angles and azimuths at once; the vane that is missing shows at the angles that light its gap."""
    made = tube()
    found = pst(system(made).to_scene(), ANGLES, **ONCE)
    np.testing.assert_array_equal(found.stray, 0)
    assert ((found.value > 0) == (np.asarray(ANGLES) < made.direct_deg)).all()
    for k in range(2, len(made.vanes) + 1):
        spoiled = pst(system(made, without=(f"tube_vane_{k}",)).to_scene(), [50.0], cell_deg=70.0, **ONCE)
        assert spoiled.stray[0] > 5 * spoiled.stray_se[0], f"without vane {k}"


def test_bevels_hide_and_square_or_round_edges_do_not():
    """A rounded edge scatters in proportion to its radius; a bevel without rounding is as good as no thickness."""
    sharp = system(tube(edge=VaneEdge(thickness=0.6, bevel_deg=20.0)))
    options = ONCE | {"rays": 200_000}
    np.testing.assert_array_equal(pst(sharp.to_scene(), ANGLES, **options).stray, 0)
    assert scattered(system(tube(edge=VaneEdge(thickness=0.6))), 40.0) > 1e-4
    light = []
    for radius in (0.1, 0.2):
        rounded = system(tube(edge=VaneEdge(thickness=0.6, bevel_deg=20.0, radius=radius)))
        found = pst(rounded.to_scene(), [30.0], cell_deg=20.0, **options)
        light.append((found.stray[0], found.stray_se[0]))
    (small, small_se), (large, large_se) = light
    assert small > 5 * small_se
    # 4 standard errors (false alarms 6e-5), and 10 % for edges that are no longer thin
    assert abs(large / small - 2) < 4 * 2 * math.hypot(small_se / small, large_se / large) + 0.2


def test_four_scatters_through_two_stages():
    made = two_stage_baffle("b", optic_radius=10, z_rear=0, field_deg=5, exclusion_deg=40, depth=8, clearance=0.2)
    options = {"rays": 100_000, "max_reflections": 0, "paths": False, "cell_deg": 10.0}
    grid = [46.0, 60.0, 75.0]
    np.testing.assert_array_equal(pst(system(made).to_scene(), grid, max_scatters=3, **options).value, 0)
    deep = pst(system(made).to_scene(), grid, max_scatters=4, **options)
    assert (deep.value > 3 * deep.standard_error).any()
    assert pst(system(made, without=("b_inner_vane_2",)).to_scene(), grid, max_scatters=3, **options).value.max() > 0


@pytest.mark.parametrize(("name", "beyond_deg", "scatters"), [("baffle_tube", 23.5, 1), ("two_stage_baffle", 40.5, 3)])
def test_shipped_tubes_are_dark_where_the_lens_is_not_lit(name, beyond_deg, scatters):
    """Without scatter at the lens nothing arrives after so many scatters, and something after one more or two."""
    given = importlib.import_module(f"mistray.scenes.{name}.prescription").build()
    scene = replace(given, surfaces=tuple(replace(surface, scatter=()) for surface in given.surfaces)).to_scene()
    angles = np.arange(beyond_deg + 1, 82, 2)
    np.testing.assert_array_equal(pst(scene, angles, rays=50_000, max_scatters=scatters, paths=False).value, 0)
    assert pst(scene, angles, rays=50_000, max_scatters=scatters + 2, paths=False).value.max() > 0


def shipped(name, without=()):
    given = importlib.import_module(f"mistray.scenes.{name}.prescription").build()
    return replace(given, structures=tuple(shape for shape in given.structures if shape.name not in without)).to_scene()


DIRECT = {"rays": 200_000, "max_scatters": 0, "max_reflections": 0}


# Field angle beyond which nothing may meet the detector without scatter and ghosts
@pytest.mark.parametrize(
    ("name", "beyond_deg"),
    [("cassegrain", 0.6), ("newtonian_scatter", 2.0), ("double_gauss_barrel", 40.0), ("plate_and_wall", 43.0)],
)
def test_no_straight_shots(name, beyond_deg):
    found = pst(shipped(name), np.arange(beyond_deg + 1, 89, 2), cell_deg=2.0, **DIRECT)
    np.testing.assert_array_equal(found.value, 0)
    assert found.path_rows.empty


def test_the_baffles_of_a_cassegrain() -> None:
    """Straight shots pass where a part is missing; without the inner baffle just as much light makes the image."""
    for part in ("secondary_baffle", "inner_baffle_vane_1"):  # from a mouth as wide as its wall, past its baffle
        found = pst(shipped("cassegrain", without=(part,)), [4.5], cell_deg=7.0, **DIRECT)
        assert set(found.path_rows.path) == {"A"}
        assert found.value[0] > 0
    inner = ("inner_baffle_wall", *(f"inner_baffle_vane_{k}" for k in range(1, 6)))
    for field_deg in (0.0, 0.28):
        powers = []
        for without in ((), inner):
            trace = mistray.trace(shipped("cassegrain", without), field_deg=field_deg, **DIRECT | {"rays": 20_000})
            paths = trace.paths.to_pandas()
            powers.append(paths.incident_W[paths.path == "RRA"].sum())
        assert powers[0] == pytest.approx(powers[1], rel=1e-6)

"""Sags and their derivatives by formulas, steps and polynomials; first-order numbers by hand and by textbooks."""

import math
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from refusals import each_refused
from vectors import analytic, frame, rows

import mistray  # noqa: F401  (settles libLLVM and the variant)
from mistray.physics.geometry import sag as sags
from mistray.physics.geometry.sag import conic_end, sag, sag_derivative
from mistray.physics.imaging.paraxial import ParaxialSystem, chief_ray_angle, image_seen, natural_illumination
from mistray.physics.sags.terms import vertex_curvatures

N = 1.5168
R_BARE = ((N - 1) / (N + 1)) ** 2
PLATE = ParaxialSystem([0.0, 0.0], [0.0, 5.0], [1.0, N, 1.0])
SINGLET = ParaxialSystem([1 / 100, -1 / 100], [0.0, 5.0], [1.0, N, 1.0])
WITH_WINDOW = ParaxialSystem([1 / 100, -1 / 100, 0.0, 0.0], [0.0, 5.0, 85.0, 87.0], [1.0, N, 1.0, N, 1.0])


def test_focal_lengths_ghosts_chief_rays_and_images():
    (ghost,) = SINGLET.ghosts(5.0, 10.0, [R_BARE, R_BARE])
    for quantity, found in (("EFL", SINGLET.efl), ("BFL", SINGLET.bfl), ("ghost BFL", ghost.focus_mm)):
        assert found == pytest.approx(analytic("singlet R", quantity), rel=1e-13)
    assert PLATE.efl == PLATE.bfl == math.inf
    each_refused(
        (lambda: ParaxialSystem([0.0], [0.0], [1.0]), "one more index"),
        (lambda: SINGLET.ghosts(10.0, 1.0, [0.04]), "1 reflectances for 2 surfaces"),
        (lambda: SINGLET.chief_ray(1.0, 5.0 + SINGLET.bfl), "focus"),
    )
    image_z = 87.0 + WITH_WINDOW.bfl
    assert WITH_WINDOW.bfl == pytest.approx(14.599477266251874, rel=1e-13)
    ghosts = WITH_WINDOW.ghosts(image_z, 10.0, [R_BARE] * 4, image_reflectance=0.2)
    expected = rows("ghost_lens_window_det.csv")
    assert len(ghosts) == len(expected) == 10
    by_pair = {(ghost.second + 1, ghost.first + 1): ghost for ghost in ghosts}
    for row in expected:
        ghost = by_pair[int(row["second_reflecting_surface"]), int(row["first_reflecting_surface"])]
        assert ghost.spot_radius_mm == pytest.approx(float(row["spot_radius_mm"]), rel=1e-12)
        assert ghost.power == pytest.approx(float(row["incident_power_per_W"]), rel=1e-12)
        irradiance = float(row["irradiance_on_detector_per_entrance_irradiance"])
        assert ghost.irradiance(10.0) == pytest.approx(irradiance, rel=1e-11)
    for row in rows("ghost_counts.csv"):
        n = int(row["n_surfaces"])
        system = ParaxialSystem([0.01] * n, list(range(n)), [1.0 + k % 2 / 2 for k in range(n + 1)])
        assert len(system.ghosts(n + 10.0, 1.0, [0.04] * n)) == int(row["2_bounce"])
    marginal, slope = WITH_WINDOW.trace(10.0, 0.0), math.tan(math.radians(10.0))
    for stop_z in (-10.0, 0.0, 2.0, 40.0, 90.0):
        rays = WITH_WINDOW.chief_ray(10.0, stop_z)
        k = int(np.searchsorted(WITH_WINDOW.z, stop_z)) - 1
        place = max(k, 0)
        way = (slope if k < 0 else rays[k, 1]) * (stop_z - WITH_WINDOW.z[place])
        assert rays[place, 0] + way == pytest.approx(0, abs=1e-12)
        invariant = WITH_WINDOW.index[1:] * (rays[:, 1] * marginal[:, 0] - marginal[:, 1] * rays[:, 0])
        np.testing.assert_allclose(invariant, 10.0 * slope, rtol=1e-12)
    # ISL and ISH from the rays of a published table, whose own values belong to the wrong surfaces
    audit = frame("table15_audit.csv")
    length, height = image_seen(*(audit[name].to_numpy() for name in ("y", "u_after", "ybar", "ubar_after")))
    np.testing.assert_allclose(length, audit["ISL_correct=-y_k/u'_k"], rtol=1e-3)
    np.testing.assert_allclose(height, audit["ISH_correct"], rtol=1e-3)
    # The table has for each surface the slope after the next one: the mistake must not come back
    assert np.nanmax(np.abs(audit["ISL_seed"][2:-1] / length[2:-1] - 1)) > 0.4


def images_seen(system: ParaxialSystem) -> tuple[np.ndarray, np.ndarray]:
    """Distance and half size, mm, of the image of a field of 1 degree from the space after each surface."""
    marginal, chief = system.trace(1.0, 0.0), system.chief_ray(1.0, stop_z=0.0)
    return image_seen(marginal[:, 0], marginal[:, 1], chief[:, 0], chief[:, 1])


def test_image_seen_from_a_lens_and_natural_illumination():
    length, height = images_seen(SINGLET)
    assert length[-1] == pytest.approx(SINGLET.bfl, rel=1e-13)
    assert height[-1] == pytest.approx(SINGLET.efl * math.tan(math.radians(1)), rel=1e-12)
    # From the front surface the light has only that surface behind it: focus at n R/(n - 1)
    assert length[0] == pytest.approx(100 * N / (N - 1), rel=1e-13)
    length, height = images_seen(PLATE)
    assert np.all(np.isinf([length, height]))
    diverging = ParaxialSystem([-1 / 50, 1 / 50], [0.0, 2.0], [1.0, N, 1.0])
    length, height = images_seen(diverging)
    assert np.all(length < 0)
    assert np.all(height > 0)
    # The 17.14° and 0.834 of "Stray Light Analysis of a Mobile Phone Camera", equations 3 and 4
    height = 7.075 * np.tan(np.radians(17.14))
    angle = chief_ray_angle([0.0, height, -height], 7.075)
    np.testing.assert_allclose(np.degrees(angle), [0.0, 17.14, -17.14], rtol=1e-12)
    np.testing.assert_allclose(natural_illumination(angle), [1.0, 0.83384, 0.83384], atol=5e-6)
    t = np.array([0.0, 0.3, -2.0])
    np.testing.assert_allclose(natural_illumination(chief_ray_angle(3 * t, 3.0)), (1 + t * t) ** -2, rtol=1e-14)


# L2 rear of the phone camera: the steepest surface at hand, slope 2.07 at its rim
STEEP = (1 / 3.482, 8.701, (0.00521579, 0.0715829, -0.0460926, 0.012431, 0.0332216))


def test_conics_their_ends_and_rims_of_the_phone_camera():
    r = np.linspace(0, 7, 50)
    for radius in (-20.0, 7.5):
        sphere = radius - math.copysign(1, radius) * np.sqrt(radius**2 - r**2)
        np.testing.assert_allclose(sag(r**2, 1 / radius, 0.0), sphere, rtol=0, atol=1e-12)
    np.testing.assert_allclose(sag(r**2, 1 / 50, -1.0), r**2 / 100, rtol=1e-15)
    assert np.all(sag(r**2, 0.0, 3.0) == 0)
    other = 1 / 1.679, 0.22669364, (0.00980281, -0.0381227, 0.0239681, -0.00629128, -0.00275496, -0.000269638)
    for printed_rim, radius, shape in ((0.379217, 1.06523826, STEEP), (0.58172, 1.43762465, other)):
        assert float(sag(radius**2, *shape)) == pytest.approx(printed_rim, abs=5.1e-7)
    c, k, _ = STEEP
    end = conic_end(c, k)
    assert end == pytest.approx(1.118, abs=5e-4)
    assert np.isfinite(sag(np.float64((end * (1 - 1e-9)) ** 2), c, k))
    assert np.isnan(sag(np.array([(end * 1.001) ** 2]), c, k)).all()
    assert math.isnan(sag((end * 1.001) ** 2, c, k))
    assert (conic_end(c, -1.0), conic_end(0.0, 2.0)) == (math.inf, math.inf)


@pytest.mark.parametrize("shape", [STEEP, (-1 / 9.162, 0.0, (0.0373187, -0.0089176)), (0.05, -1.3, ())])
def test_derivative_against_central_differences(shape):
    r2, h = np.linspace(1e-3, 1.06**2, 40), 1e-6
    slope = sag_derivative(r2, *shape)
    np.testing.assert_allclose(slope, (sag(r2 + h, *shape) - sag(r2 - h, *shape)) / (2 * h), rtol=1e-8)
    for function, expected in ((sag, sag(r2, *shape)), (sag_derivative, slope)):
        np.testing.assert_allclose(np.array(function(mi.Float64(r2), *shape)), expected, rtol=1e-14)


def test_polynomial_derivatives_are_those_of_the_terms():
    """Against NumPy's polynomials: a term a_i r^(2i) is that of degree i in r²; the sag of a plane has no other."""
    coefficients = (0.3, -0.2, 0.15, 0.07, -0.04, 0.02, 0.05, -0.01, 0.03)
    whole = np.polynomial.Polynomial([0.0, 0.0, *coefficients])
    r2 = np.linspace(0, 1.2, 9)
    functions = (sags.polynomial, sags.polynomial_derivative, sags.polynomial_second_derivative)
    for order, function in enumerate(functions):
        np.testing.assert_allclose(function(r2, coefficients), whole.deriv(order)(r2), rtol=1e-13, atol=1e-15)
        assert np.all(np.asarray(function(r2, ())) == 0)
    np.testing.assert_allclose(sag(r2, 0.0, 0.0, coefficients), whole(r2), rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(sag_derivative(r2, 0.0, 0.0, coefficients), whole.deriv()(r2), rtol=1e-13, atol=1e-15)


def test_vertex_curvatures_are_the_second_derivatives_at_the_vertex():
    """Of a r² they are 2 a; r1 has a kink there, and higher powers have none."""
    odd = {"curvature": 0.01, "conic": -0.5, "r1": 2e-3, "r2": 1e-3, "r3": 1e-2, "r4": 1e-2}
    biconic = {"curvature_x": 0.02, "curvature": 0.01, "a2": 1e-3, "r2": 2e-3, "xy_2_0": 3e-3, "slope_y": 0.1}
    for terms, x, y in (({"r2": 1e-3}, 2e-3, 2e-3), (odd, 0.012, 0.012), (biconic, 0.032, 0.016)):
        np.testing.assert_allclose(vertex_curvatures(terms, 1e-3), (x, y), rtol=1e-6, err_msg=str(terms))


def test_a_ghost_in_focus_has_infinite_irradiance():
    """A mirror of f = 50 mm sends light back to a plane one 25 mm before it; it meets in the vertex of the first."""
    (ghost,) = ParaxialSystem([0.0, -1 / 100], [0.0, 25.0], [1.0, 1.0, 1.0]).ghosts(25.0, 8.0, [0.1, 0.2])
    assert (ghost.spot_radius_mm, ghost.focus_mm) == (0.0, 0.0)
    assert ghost.power == pytest.approx(0.9 * 0.2 * 0.1 * 0.8)
    assert (ghost.irradiance(8.0), replace(ghost, power=0.0).irradiance(8.0)) == (math.inf, 0.0)

from __future__ import annotations

import math

import numpy as np
import pytest
from vectors import analytic, rows

from mistray.errors import MistrayError
from mistray.physics.geometry.paraxial import ParaxialSystem, chief_ray_angle, image_seen, natural_illumination

N = 1.5168
R_BARE = ((N - 1) / (N + 1)) ** 2
PLATE = ParaxialSystem([0.0, 0.0], [0.0, 5.0], [1.0, N, 1.0])


@pytest.fixture
def singlet():
    return ParaxialSystem([1 / 100, -1 / 100], [0.0, 5.0], [1.0, N, 1.0])


@pytest.fixture
def with_window():
    return ParaxialSystem([1 / 100, -1 / 100, 0.0, 0.0], [0.0, 5.0, 85.0, 87.0], [1.0, N, 1.0, N, 1.0])


def test_focal_lengths(singlet):
    (ghost,) = singlet.ghosts(5.0, 10.0, [R_BARE, R_BARE])
    for quantity, found in (("EFL", singlet.efl), ("BFL", singlet.bfl), ("ghost BFL", ghost.focus_mm)):
        assert found == pytest.approx(analytic("singlet R", quantity), rel=1e-13)


def test_the_ten_ghosts_of_lens_window_and_detector(with_window):
    image_z = 87.0 + with_window.bfl
    assert with_window.bfl == pytest.approx(14.599477266251874, rel=1e-13)
    ghosts = with_window.ghosts(image_z, 10.0, [R_BARE] * 4, image_reflectance=0.2)
    expected = rows("ghost_lens_window_det.csv")
    assert len(ghosts) == len(expected) == 10
    by_pair = {(ghost.second + 1, ghost.first + 1): ghost for ghost in ghosts}
    for row in expected:
        ghost = by_pair[int(row["second_reflecting_surface"]), int(row["first_reflecting_surface"])]
        assert ghost.spot_radius_mm == pytest.approx(float(row["spot_radius_mm"]), rel=1e-12)
        assert ghost.power == pytest.approx(float(row["incident_power_per_W"]), rel=1e-12)
        irradiance = float(row["irradiance_on_detector_per_entrance_irradiance"])
        assert ghost.irradiance(10.0) == pytest.approx(irradiance, rel=1e-11)


def test_number_of_ghosts():
    for row in rows("ghost_counts.csv"):
        n = int(row["n_surfaces"])
        system = ParaxialSystem([0.01] * n, list(range(n)), [1.0 + k % 2 / 2 for k in range(n + 1)])
        assert len(system.ghosts(n + 10.0, 1.0, [0.04] * n)) == int(row["2_bounce"])


def test_chief_ray_crosses_the_axis_in_the_stop(with_window):
    for stop_z in (-10.0, 0.0, 2.0, 40.0, 90.0):
        rays = with_window.chief_ray(10.0, stop_z)
        k = int(np.searchsorted(with_window.z, stop_z)) - 1
        slope = math.tan(math.radians(10.0)) if k < 0 else rays[k, 1]
        place = max(k, 0)
        assert rays[place, 0] + slope * (stop_z - with_window.z[place]) == pytest.approx(0, abs=1e-12)


def test_lagrange_invariant(with_window):
    marginal, chief = with_window.trace(10.0, 0.0), with_window.chief_ray(5.0, 40.0)
    invariant = with_window.index[1:] * (chief[:, 1] * marginal[:, 0] - marginal[:, 1] * chief[:, 0])
    np.testing.assert_allclose(invariant, 10.0 * math.tan(math.radians(5.0)), rtol=1e-12)


def test_afocal_and_bad_input(singlet):
    assert PLATE.efl == PLATE.bfl == math.inf
    with pytest.raises(MistrayError, match="one more than surfaces"):
        ParaxialSystem([0.0], [0.0], [1.0])
    with pytest.raises(MistrayError, match="1 reflectances for 2 surfaces"):
        singlet.ghosts(10.0, 1.0, [0.04])
    with pytest.raises(MistrayError, match="focus"):
        singlet.chief_ray(1.0, 5.0 + singlet.bfl)


AUDIT = rows("table15_audit.csv")


def column(name):
    return np.array([float(row[name]) for row in AUDIT])


def test_images_that_scattered_light_should_go_to():
    """ISL and ISH from the rays of a published table, whose own values belong to the wrong surfaces."""
    length, height = image_seen(*(column(name) for name in ("y", "u_after", "ybar", "ubar_after")))
    np.testing.assert_allclose(length, column("ISL_correct=-y_k/u'_k"), rtol=1e-3)
    np.testing.assert_allclose(height, column("ISH_correct"), rtol=1e-3)
    # The table has for each surface the slope after the next one: the mistake must not come back
    assert np.nanmax(np.abs(column("ISL_seed")[2:-1] / length[2:-1] - 1)) > 0.4


def test_image_seen_from_a_lens(singlet):
    length, height = singlet.images_seen(field_deg=1.0, stop_z=0.0)
    assert length[-1] == pytest.approx(singlet.bfl, rel=1e-13)
    assert height[-1] == pytest.approx(singlet.efl * math.tan(math.radians(1)), rel=1e-12)
    # From the front surface the light has only that surface behind it: focus at n R/(n - 1)
    assert length[0] == pytest.approx(100 * N / (N - 1), rel=1e-13)
    # Behind a plate it is at infinity, of a diverging lens it is virtual
    length, height = PLATE.images_seen(field_deg=1.0, stop_z=0.0)
    assert np.all(np.isinf([length, height]))
    diverging = ParaxialSystem([-1 / 50, 1 / 50], [0.0, 2.0], [1.0, N, 1.0])
    length, height = diverging.images_seen(field_deg=1.0, stop_z=0.0)
    assert np.all(length < 0)
    assert np.all(height > 0)


def test_natural_illumination():
    """The 17.14° and 0.834 of "Stray Light Analysis of a Mobile Phone Camera", equations 3 and 4."""
    height = 7.075 * np.tan(np.radians(17.14))
    angle = chief_ray_angle([0.0, height, -height], 7.075)
    np.testing.assert_allclose(np.degrees(angle), [0.0, 17.14, -17.14], rtol=1e-12)
    np.testing.assert_allclose(natural_illumination(angle), [1.0, 0.83384, 0.83384], atol=5e-6)
    # Through the sine and the tangent instead of the cosine
    t = np.array([0.0, 0.3, -2.0])
    np.testing.assert_allclose(natural_illumination(chief_ray_angle(3 * t, 3.0)), (1 + t * t) ** -2, rtol=1e-14)

"""What sources say of their polarisation, against fields in time."""

import numpy as np
import pytest
import vectors
from refusals import refused

from mistray.physics.polarization.state import jones_numbers, polarization_state


@pytest.mark.parametrize("seed", range(20))
def test_jones_vectors_are_their_fields_in_time(seed) -> None:
    """s1 and s2 are the power through polarisers, the sign of s3 is the sense in which the field turns."""
    rng = np.random.default_rng(seed)
    ex, ey = rng.normal(size=2) + 1j * rng.normal(size=2)
    turn = np.exp(-1j * np.linspace(0, 2 * np.pi, 721))  # the real field Re(e exp(-iωt)) over a period
    x, y = (ex * turn).real, (ey * turn).real
    total = np.mean(x[:-1] ** 2 + y[:-1] ** 2)
    s1, s2, s3 = polarization_state("", jones=(ex, ey))
    assert s1 == pytest.approx(np.mean(x[:-1] ** 2 - y[:-1] ** 2) / total, abs=1e-12)
    assert s2 == pytest.approx(np.mean(2 * x[:-1] * y[:-1]) / total, abs=1e-12)
    assert s1**2 + s2**2 + s3**2 == pytest.approx(1, abs=1e-12)
    # With x to the right and y up the light comes to the observer: counter-clockwise is from x to y
    assert np.sign(np.sum(x[:-1] * np.diff(y) - y[:-1] * np.diff(x))) == -np.sign(s3)


def test_ways_to_state_it() -> None:
    for given, expected in (
        ({"polarization_deg": 0.0}, (1, 0, 0)),
        ({"polarization_deg": -45.0}, (0, -1, 0)),
        ({"polarization_deg": 90.0}, (-1, 0, 0)),
        ({"jones": "1, -1i"}, (0, 0, 1)),
        ({"jones": "1 +j"}, (0, 0, -1)),
        ({"jones": "0, 3e-12"}, (-1, 0, 0)),
        ({"jones": (1e30, 0)}, (1, 0, 0)),
        ({"jones": "0.6+0.8i, -0.6-0.8i"}, (0, -1, 0)),
        ({"stokes": "0.1, 0.2, -0.3"}, (0.1, 0.2, -0.3)),
        ({"stokes": (0.57735, 0.57735, 0.57736)}, (0.57735, 0.57735, 0.57736)),
        ({"stokes": np.array([0.0, 0.0, 1.0])}, (0, 0, 1)),
        ({"stokes": "0, 0, 0"}, None),
        ({}, None),
    ):
        assert polarization_state("", **given) == pytest.approx(expected, abs=1e-5)
    assert jones_numbers("", "1, 0.5-2i") == (1, 0.5 - 2j)


def test_what_no_light_can_be() -> None:
    for given, fact in [
        *vectors.toml("refusals.toml")["polarization of a source"],
        ({"jones": (complex("nan"), 1)}, "2 numbers"),
    ]:
        with refused("source 'laser'", fact):
            polarization_state("source 'laser'", **given)

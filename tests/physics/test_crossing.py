from __future__ import annotations

import numpy as np
import pytest

from mistray.physics.geometry.crossing import SAMPLES, meeting


def flat(r):
    return np.zeros_like(r)


def test_spheres_cross_where_their_sags_add_up_to_the_thickness():
    met = meeting(lambda r: r**2 / 20, lambda r: 1 - r**2 / 20, 0.0, 5.0)
    assert met is not None
    assert not met.coincide
    # the first sample beyond
    assert 0 <= met.r - np.sqrt(10) <= 5 / (SAMPLES - 1)
    assert met.between("a", "b").startswith("surfaces 'a' and 'b' cross at r = 3.1")
    assert meeting(lambda r: 1 - r**2 / 20, lambda r: r**2 / 20, 0.0, 5.0) == met


@pytest.mark.parametrize(
    "bump", [lambda r: r**2, lambda r: 25 - r**2, lambda r: (r - 2) ** 2, lambda r: 25 - r**2 - 1e-10]
)
def test_surfaces_may_touch(bump):
    """At the vertex, at the rim, along a circle, at the rim but for rounding."""
    assert meeting(flat, bump, 0.0, 5.0) is None
    assert meeting(bump, flat, 0.0, 5.0) is None


def test_only_the_shared_ring_counts():
    for ring in ((2.0, 5.0), (0.0, 2.0), (3.0, 2.0)):
        assert meeting(flat, lambda r: r - 2, *ring) is None
    assert meeting(flat, lambda r: r - 2, 0.0, 5.0) is not None


def test_coincidence():
    met = meeting(flat, lambda r: r * 1e-12, 1.0, 5.0)
    assert met is not None
    assert met.coincide
    assert "coincide; remove one of them" in met.between("a", "b")
    assert meeting(flat, lambda r: flat(r) + 1e-6, 1.0, 5.0) is None
    assert meeting(flat, lambda r: flat(r) + 1e-6, 1.0, 5.0, tolerance=1e-5) is not None

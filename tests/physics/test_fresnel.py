import math

import numpy as np
import pytest
import vectors

from mistray.physics.fresnel import amplitudes, cos2_refracted, reflectance

pytestmark = pytest.mark.quick


def cosines(angle_deg, n1, n2):
    cos_i = math.cos(math.radians(angle_deg))
    return cos_i, math.sqrt(max(0.0, cos2_refracted(cos_i, n1, n2)))


def test_vectors():
    for row in vectors.frame("fresnel.csv").itertuples():
        at = *cosines(row.aoi, row.n1, row.n2), row.n1, row.n2
        assert reflectance(*at) == pytest.approx(row.Runpol, abs=1e-12)
        assert np.square(amplitudes(*at)) == pytest.approx((row.Rs, row.Rp), abs=1e-12)


@pytest.mark.parametrize("n", [1.0, 1.3, 1.5168, 4.0])
def test_limits(n):
    """Normal and grazing incidence, the critical angle, and the same R from either side along a pair of angles."""
    assert reflectance(1.0, 1.0, 1.0, n) == pytest.approx(((n - 1) / (n + 1)) ** 2, abs=1e-15)
    assert reflectance(0.0, 0.0, n, n) == 0.0  # grazing without a step: 0/0 without the guard
    cos_i = np.linspace(0.01, 1, 50)
    cos_t = np.sqrt(cos2_refracted(cos_i, 1.0, n))
    np.testing.assert_allclose(reflectance(cos_i, cos_t, 1.0, n), reflectance(cos_t, cos_i, n, 1.0), rtol=1e-13)
    if n > 1:
        assert reflectance(0.0, math.sqrt(1 - 1 / n**2), 1.0, n) == pytest.approx(1.0)
        assert reflectance(*cosines(89.999, n, 1.0), n, 1.0) == pytest.approx(1.0, abs=1e-15)
        cosine = math.cos(math.asin(1 / n))
        assert cos2_refracted(cosine, n, 1.0) == pytest.approx(0, abs=4e-16 * n * n)
        assert cos2_refracted(cosine - 1e-6, n, 1.0) < 0 < cos2_refracted(cosine + 1e-6, n, 1.0)


def test_float32_stays_finite_and_in_range():
    cos_i = np.concatenate([np.linspace(0, 1, 1001), [1e-7, 1e-20, 1e-38]]).astype(np.float32)
    for n1, n2 in [(1.0, 1.5), (1.5, 1.0), (1.0, 1.0)]:
        cos_t = np.sqrt(np.maximum(cos2_refracted(cos_i, np.float32(n1), np.float32(n2)), np.float32(0)))
        r = reflectance(cos_i, cos_t, np.float32(n1), np.float32(n2))
        assert r.dtype == np.float32
        assert np.all((r >= 0) & (r <= 1 + 1e-6))

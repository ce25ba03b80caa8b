"""Rays on the host, many surfaces at once with boxes and trees, against one surface after the other."""

import numpy as np
import pytest

import mistray
from mistray.surfaces.host_rays import crossings, first_hit, inside, normals
from mistray.surfaces.surfaces import SurfaceTable


@pytest.mark.parametrize("name", ["cooke_triplet", "newtonian_scatter", "phone_camera", "head_up_display", "rubin"])
def test_first_hits(name) -> None:
    table = SurfaceTable(mistray.load(name), 550.0)
    rng = np.random.default_rng(4)
    n, count = 300, len(table.pieces)
    size = np.ptp(table.vertices[:count], axis=0).max() + max(piece.size for piece in table.pieces)
    # Half of the rays start on a surface, which they may meet again
    last = np.where(np.arange(n) % 2, rng.integers(count, size=n), -1)
    o = table.centre + size * rng.normal(size=(n, 3)) / 2
    for ray in np.flatnonzero(last >= 0):
        (q,) = table.pieces[last[ray]].points(*rng.random((2, 1)))
        o[ray] = q @ table.rotations[last[ray]].T + table.vertices[last[ray]]
    d = table.vertices[rng.integers(count, size=n)] + 0.2 * size * rng.normal(size=(n, 3)) - o
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    nearest, expected = np.full(n, np.inf), np.full(n, -1)
    for k, piece in enumerate(table.pieces):
        for t in crossings(table, k, o, d).T:
            ahead = t > np.where(last == k, piece.self_hit, 0.0)
            hit = ahead & (t < nearest) & inside(table, k, o + t[:, None] * d)
            nearest[hit], expected[hit] = t[hit], k
    surface, p, normal = first_hit(table, o, d, last)
    assert np.count_nonzero(expected >= 0) > n / 3
    assert len(set(expected)) > 5
    assert np.array_equal(surface, expected)
    hit = expected >= 0
    assert np.allclose(p[hit], (o + np.where(hit, nearest, 0)[:, None] * d)[hit], rtol=0, atol=1e-9 * size)
    for k in set(expected[hit]):
        assert np.allclose(normal[surface == k], normals(table, k, p[surface == k]), rtol=0, atol=1e-12)

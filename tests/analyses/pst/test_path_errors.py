"""Standard errors of single paths of a PST, of which one start ray may bring many rays."""

from typing import Any

import numpy as np
import pytest
from oracles.scatter_scenes import beam_xml, placed_xml, scatter_scene, wall_xml

import mistray


@pytest.mark.parametrize("method", [pytest.param("joined", marks=pytest.mark.long), "adjoint", "forward"])
def test_a_path_alone_in_its_class_has_the_error_of_the_class(load_scene: Any, method: str) -> None:
    """The ring lights the rear of the board, and the detector sees the board alone."""
    ring = placed_xml(
        "asphere", "ring", wall_xml(0.5), at=(0.0, 0.0, -1.0), inner_semi_diameter=9.0, semi_diameter=30.0
    )
    board = placed_xml("asphere", "board", wall_xml(0.5), at=(0.0, 0.0, -16.0), semi_diameter=8.0)
    detector = placed_xml("asphere", "detector", pixels=4, semi_diameter=4.0)
    scene = load_scene(scatter_scene(beam_xml(1.0), ring, board, detector))
    found = mistray.pst(scene, [20.0], method=method, rays=4096, seed=1, max_scatters=2, cell_deg=20.0)
    rows = found.path_rows.set_index("scatters")
    assert sorted(rows.index) == [0, 2]
    for scatters, light in ((0, "direct"), (2, "multiple_scatter")):
        value, se = rows.loc[scatters, ["pst_normal", "pst_normal_se"]]
        assert rows.rays[scatters] > 20
        np.testing.assert_allclose((value, se), np.ravel(found.curve(light)), rtol=1e-9)
        assert 0 < se < 0.3 * value

"""Scattered light with a ghost before or after, by both directions and against the light alone.

Behind many surfaces a reflection that nothing has scattered is followed by chance, and a weak one scatters by chance:
both directions must know all of it of each other, or paths are counted too often or too seldom.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from oracles.scatter_scenes import beam_xml, placed_xml, scatter_scene, wall_xml
from oracles.small_scenes import interface_xml

import mistray

PLATES = 6


def between_walls() -> str:
    """Bare plates between a wall that they light from behind, and one that sends light back to them."""
    faces = []
    for k in range(PLATES):
        for name, z, sides in (("front", 2.0 * k, ("air", "1.5")), ("rear", 2.0 * k + 1.0, ("1.5", "air"))):
            bsdf = interface_xml(*sides)
            faces.append(placed_xml("asphere", f"p{k}_{name}", bsdf, at=(0.0, 0.0, z), semi_diameter=40.0))
    length = 2.0 * PLATES - 1.0
    return scatter_scene(
        beam_xml(1.0, at=(0.0, 0.0, -10.0)),
        *faces,
        placed_xml("frustum", "edge", r0=40.0, z0=0.0, r1=40.0, z1=length),
        placed_xml("asphere", "before", wall_xml(0.5), at=(0.0, 0.0, -6.0), semi_diameter=8.0),
        placed_xml("asphere", "detector", at=(0.0, 0.0, 15.0), pixels=4, semi_diameter=4.0),
        placed_xml("asphere", "shield", at=(0.0, 0.0, 15.5), semi_diameter=5.0),
        placed_xml("asphere", "behind", wall_xml(0.5), at=(0.0, 0.0, 20.0), semi_diameter=25.0),
    )


@pytest.mark.long
@pytest.mark.parametrize(("splitting", "rays"), [("split", (400_000, 600_000)), ("one", (2_500_000, 3_000_000))])
def test_ghosts_before_and_after_scatter(
    load_scene: Callable[[str], Any], splitting: str, rays: tuple[int, int]
) -> None:
    """Within 4 of both errors (false alarm 6e-5 each); odds that are wrong for ghosts take 3 to 30 % away."""
    scene = load_scene(between_walls())
    limits = {"max_scatters": 1, "max_reflections": 1, "cell_deg": 10.0, "splitting": splitting}
    runs = [
        mistray.pst(scene, [40.0], method=method, rays=count, seed=1, **limits)
        for method, count in zip(("joined", "adjoint"), rays, strict=True)
    ]
    tables = [run.path_rows.set_index("events")[["pst_normal", "pst_normal_se"]] for run in runs]
    listed = tables[0].index.intersection(tables[1].index)
    for first in ("before", "behind"):
        paths = [events for events in listed if f"{first}:r" in events and ":R" in events]
        assert len(paths) >= 2 * PLATES
        sums = [rows.loc[paths] for rows in tables]
        found = [(rows.pst_normal.sum(), np.linalg.norm(rows.pst_normal_se)) for rows in sums]
        (value, se), (alone, alone_se) = found
        assert 0 < se < 0.015 * value
        assert abs(value - alone) < 4 * np.hypot(se, alone_se)

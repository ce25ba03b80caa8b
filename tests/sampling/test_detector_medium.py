"""The material that a detector stands in: its own word, that of the surfaces it sees, and what contradicts."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from lit_detector import BLACK, lit, meter, square

import mistray
from mistray.errors import MistrayError
from mistray.physics import planck

T = mi.ScalarTransform4f
GLASS = 1.6
BEAM = {"type": "collimated", "radius": 1.0}
DISC = {"type": "asphere", "semi_diameter": 10.0}


def scene(wall: dict[str, Any], detector: dict[str, Any], window: dict[str, Any] | None = None) -> mi.Scene:
    """A black box of 80 mm and a black detector at its end; the other end is a black lid, or a window."""
    lid = {"back": wall["front"]} if "front" in wall else {}
    walls = {
        "lid": {**DISC, "bsdf": {**BLACK, **lid} if window is None else window},
        "tube": {"type": "frustum", "r0": 10.0, "r1": 10.0, "z0": 0.0, "z1": 80.0, "bsdf": {**BLACK, **wall}},
    }
    return lit(BEAM, **walls, detector={**DISC, "z": 80.0, "bsdf": {**BLACK, **detector}, "sensor": meter()})


WINDOW = {"type": "interface", "back": "1.6"}


@pytest.mark.parametrize(
    ("wall", "detector", "window", "index"),
    [
        ({}, {}, None, 1.0),
        ({"front": "1.60"}, {}, None, GLASS),
        ({}, {"front": "1.6"}, None, GLASS),
        ({"front": "1.6"}, {"front": "1.60", "back": "Si"}, None, GLASS),
        ({}, {"back": "Si"}, None, 1.0),
        ({"front": "1.6+0.0001i"}, {}, None, GLASS),
        ({}, {}, WINDOW, GLASS),
    ],
)
def test_inside_of_opaque_walls(wall: dict, detector: dict, window: dict | None, index: float) -> None:
    """Walls on which the detector alone looks hide what it stands in, unless they or the detector say so."""
    r = mistray.thermal(scene(wall, detector, window), 300.0, (8, 12), rays=2000)
    irradiance = r.total_W_mm2.value + r.scene_W_mm2.value + r.lost_W_mm2
    exact = index**2 * np.pi * float(planck.band_radiance(300, 8, 12))  # where all has one temperature, by any ray
    # The window is 1.5 % of what the detector sees; its sky adds noise to the sum, by fewer than 2000 rays 1 %
    assert irradiance == pytest.approx(exact, rel=0.03 if window else 1e-6)


def test_contradictions_name_both_and_walls_alone_are_noted() -> None:
    for there, other in (
        (scene({"front": "1.5"}, {"front": "1.6"}), "'1.5' by surface 'tube'"),
        (scene({}, {"front": "air", "back": "Si"}, WINDOW), "'1.6' by surface 'lid'"),
    ):
        with pytest.raises(MistrayError, match=f"detector 'detector'.* by its front, and in {other}"):
            mistray.thermal(there, rays=2000)
    for wall, detector, named in (({"front": "1.6"}, {}, True), ({}, {"front": "1.6"}, False)):
        found = mistray.pst(scene(wall, detector), [0.0], rays=2000, method="adjoint")
        assert any("'1.6'" in note and "'tube'" in note for note in found.facts["notes"]) == named


@pytest.mark.long
def test_a_solid_telescope_has_one_pst() -> None:
    """A mirror and a painted wall hide the entrance; forward rays need not know the glass. False alarms 1e-4 each."""
    front = {**BLACK, "front": "1.6"}
    disc = {**DISC, "bsdf": {"type": "interface", "back": "1.6"}}
    mirror = {**DISC, "radius": -100.0, "z": 49.0, "bsdf": {**front, "R": 0.9, "mirror": True}}
    paint = {**front, "p": {"type": "paint", "reflectance": 0.1}}
    shapes = {
        "entrance": {**disc, "inner_semi_diameter": 3.0},
        "mirror": mirror,
        "wall": {"type": "frustum", "r0": 10, "z0": 0, "r1": 10, "z1": 48.5, "bsdf": paint},
        "hole": {"type": "frustum", "r0": 0, "z0": -1e-3, "r1": 3, "z1": -1e-3, "bsdf": BLACK},
        "detector": square(2.0, bsdf=front, to_world=T().translate([0, 0, 0.2]).rotate([1, 0, 0], 180)),
    }
    there = lit({"type": "collimated", "radius": 12.0, "to_world": T().translate([0, 0, -5])}, **shapes)
    both = [mistray.pst(there, [0, 20], rays=40_000, method=m, max_scatters=1) for m in ("joined", "forward")]
    for light, at in (("direct", 0), ("stray", 1)):
        (a, e), (b, f) = ((value[at], error[at]) for value, error in (p.curve(light) for p in both))
        assert abs(a - b) < 3.9 * np.hypot(e, f), light

"""Spiders: what they shade, where their faces stand, and what cannot be one."""

from __future__ import annotations

import math

import numpy as np
import pytest

import mistray
from mistray import MistrayError
from mistray.prescription import Coating, Detector, Prescription, Source, spider

KIND = {"vanes": 4, "inner_radius": 20.0, "outer_radius": 100.0, "thickness": 2.0, "depth": 30.0, "z": -50.0}


@pytest.mark.parametrize(("vanes", "offset"), [(4, 0.0), (3, 0.0), (3, 12.0), (1, -5.0)])
def test_it_shades_its_own_area(vanes, offset):
    """A round beam along the axis loses the length of each vane times its thickness; false alarms 6e-5."""
    faces = spider("spider", **(KIND | {"vanes": vanes, "offset": offset}))
    screen = Detector(z=10.0, half_width=90.0, half_height=90.0)
    beam = Source(radius=80.0, z=-200.0)
    plate = Prescription(name="spider", surfaces=(), structures=faces, detector=screen, source=beam)
    t = mistray.trace(plate.to_scene(), rays=400_000, seed=2)
    length = math.sqrt(80.0**2 - offset**2) - 20.0
    share = vanes * length * 2.0 / (math.pi * 80.0**2)
    taken = 1 - sum(row.power_W for row in t.paths) / t.energy.launched_W
    assert abs(taken - share) < 4 * math.sqrt(share / 400_000) + 2e-5  # the end of a vane is round, not straight


def test_faces_are_boxes():
    """The middles of the four faces of a vane stand half a thickness or half a depth from its own middle."""
    faces = spider("s", **(KIND | {"start_deg": 30.0}), coating=Coating(R=0.1))
    assert [face.name for face in faces[:4]] == ["s_1_front", "s_1_rear", "s_1_left", "s_1_right"]
    along = np.array([math.cos(math.radians(30)), math.sin(math.radians(30)), 0.0])
    aside = np.array([-along[1], along[0], 0.0])
    middle = 60.0 * along + [0, 0, -35.0]
    normals = []
    for face, offset in zip(faces, ([0, 0, -15.0], [0, 0, 15.0], aside, -aside), strict=False):
        frame = face.to_world()
        assert frame[:3, 3] == pytest.approx(middle + offset, abs=1e-6)
        assert frame[:3, 0] == pytest.approx(along, abs=1e-9)
        normals.append(np.abs(frame[:3, 2]))
    assert normals == [pytest.approx(v, abs=1e-9) for v in ([0, 0, 1], [0, 0, 1], np.abs(aside), np.abs(aside))]
    assert {face.coating for face in faces} == {Coating(R=0.1)}
    assert len(faces) == 16


def test_what_cannot_be_a_spider():
    for change, named in (
        ({"vanes": 0}, "vanes is 0"),
        ({"thickness": 0.0}, "thickness is 0"),
        ({"inner_radius": 100.0}, "inner_radius is 100"),
        ({"inner_radius": 0.5, "vanes": 4}, "overlap within 1"),
    ):
        with pytest.raises(MistrayError, match=f"spider 's'.*{named}"):
            spider("s", **(KIND | change))

"""Bodies that absorb: light is followed through them where it gets through, whatever the k."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts

import mistray
from mistray.report import main_table


def plate(medium: str, thickness_mm: float, wavelength_nm: float) -> mi.Scene:
    """A plate with its edge in a beam; everything that the faces and the edge do is Fresnel's."""
    face = {"type": "asphere", "semi_diameter": 5.0}
    edge = {"type": "frustum", "r0": 5.0, "z0": 0.0, "r1": 5.0, "z1": thickness_mm}
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 1.0, "wavelength_nm": wavelength_nm},
        face=face | {"bsdf": {"type": "interface", "back": medium}},
        rear=face | {"z": thickness_mm, "bsdf": {"type": "interface", "front": medium}},
        edge=edge | {"bsdf": {"type": "interface", "front": medium, "R": 0.0}},
        detector=scene_dicts.detector(thickness_mm + 5, semi_diameter=20.0),
    )


@pytest.mark.parametrize(
    ("wavelength_nm", "thickness_mm", "field_deg"),
    [(10_000.0, 0.1, 0.0), (13.5, 2e-4, 0.0), (4000.0, 0.02, 0.0), (10_000.0, 0.1, 40.0)],
)
def test_transmittance_of_a_plate(wavelength_nm: float, thickness_mm: float, field_deg: float) -> None:
    """Beer and Lambert times Fresnel for every k, without a jump at any of them; aside the path is longer."""
    inside = np.cos(np.arcsin(np.sin(np.radians(field_deg)) / 1.5))
    settings = {"rays": 100, "max_reflections": 0, "field_deg": field_deg}
    clear = mistray.trace(plate("1.5", thickness_mm, wavelength_nm), **settings).energy.detected_W
    for k in (0.0009, 0.001, 0.0011, 0.005, 0.03) if field_deg == 0 else (0.004,):
        t = mistray.trace(plate(f"1.5+{k}i", thickness_mm, wavelength_nm), **settings)
        beer = np.exp(-4e6 * np.pi * k * thickness_mm / wavelength_nm / inside)
        if field_deg == 0:
            once = 1 - (0.5**2 + k**2) / (2.5**2 + k**2)
            assert t.energy.detected_W / t.energy.launched_W == pytest.approx(once**2 * beer, rel=5e-5), k
        else:
            assert t.energy.detected_W / clear == pytest.approx(beer, rel=5e-5)
        assert abs(t.energy.closure) < 1e-6
        assert t.own_notes == []


def test_a_dark_body_is_opaque_and_says_so() -> None:
    """0.5 mm of a black glass leave e^-57 of the light; the note says so in the report, too."""
    scene = plate("1.5+0.005i", 0.5, 550.0)
    t = mistray.trace(scene, rays=100, max_reflections=0)
    assert t.energy.detected_W == 0
    assert t.energy.absorbed["face"][0] == pytest.approx(0.96 * t.energy.launched_W, rel=1e-3)
    note, lost = t.own_notes
    assert lost == "no light reaches the detector: 'face' takes 96 % of it"
    assert "'face' takes 96 %" in repr(t)
    assert "1.5+0.005i" in note
    assert "0.5 mm" in note
    report = mistray.ghosts(scene, rays=100)
    assert note in report.notes
    assert note in main_table(report)
    assert note in mistray.pst(plate("1.5+0.005i", 0.5, 550.0), field_deg=[0, 10], rays=100).facts["notes"]


def test_metals() -> None:
    """A mirror of aluminium absorbs what it does not reflect, at the surface; a leaf of gold is told of."""
    mirror = {"type": "asphere", "semi_diameter": 5.0, "bsdf": {"type": "interface", "back": "Al", "mirror": True}}
    scene = scene_dicts.load(
        beam={"type": "collimated", "radius": 1.0, "distance": 2.0},
        mirror=mirror,
        detector=scene_dicts.detector(-5, semi_diameter=20.0),
    )
    t = mistray.trace(scene, rays=100)
    n = mistray.materials.complex_index("Al", 550.0)
    R = abs((n - 1) / (n + 1)) ** 2
    assert t.energy.detected_W / t.energy.launched_W == pytest.approx(R, rel=1e-5)
    assert t.energy.absorbed["mirror"][0] / t.energy.launched_W == pytest.approx(1 - R, rel=1e-4)
    assert t.own_notes == []
    leaf = mistray.trace(plate("Au", 1e-4, 550.0), rays=100, max_reflections=0)
    assert leaf.energy.detected_W == 0
    note, lost = leaf.own_notes
    assert lost.startswith("no light reaches the detector: max_reflections cuts")
    assert "Au" in note
    assert "0.0001 mm" in note


def test_what_nothing_closes() -> None:
    """The silicon of a detector is as thick as may be: dark at 550 nm, where its k is below that of a metal."""
    scene = scene_dicts.load(
        beam={"type": "collimated", "radius": 1.0},
        detector=scene_dicts.detector(0, semi_diameter=5.0, bsdf={"type": "interface", "back": "Si"}),
    )
    t = mistray.trace(scene, rays=100)
    n = mistray.materials.complex_index("Si", 550.0)
    assert 1e-3 < n.imag < 0.05
    assert t.energy.detected_W / t.energy.launched_W == pytest.approx(1 - abs((n - 1) / (n + 1)) ** 2, rel=1e-5)
    assert len(t.own_notes) == 1
    assert "Si" in t.own_notes[0]


def test_a_cube_of_triangles() -> None:
    """The bodies of meshes are measured, too: a stock cube of 2 mm, 1.5 + 0.0005i at 550 nm, that is dark."""

    def scene(k: float) -> mi.Scene:
        return scene_dicts.load(
            beam={"type": "collimated", "radius": 0.3},
            cube={"type": "cube", "bsdf": {"type": "interface", "back": "air", "front": f"1.5+{k}i"}},
            detector=scene_dicts.detector(5, semi_diameter=9.0),
        )

    t = mistray.trace(scene(1e-5), rays=100, max_reflections=0)
    assert t.energy.detected_W / t.energy.launched_W == pytest.approx(0.96**2 * np.exp(-0.08 * np.pi / 0.55), rel=1e-4)
    dark = mistray.trace(scene(1e-3), rays=100, max_reflections=0)
    table = dark._runs[0].table
    assert table.bodies.thickness(table.ids.index("cube"))[0] == pytest.approx(2.0, rel=1e-4)
    assert dark.energy.detected_W == 0
    note, lost = dark.own_notes
    assert "cube" in note
    assert lost.startswith("no light reaches the detector: 'cube' takes")

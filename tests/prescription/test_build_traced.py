"""Imported lenses as the renderer traces them: the same image as the table's real rays, and no way out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import mistray
from mistray.prescription import Coating, Decentre, Row, Sequential, to_prescription
from mistray.prescription.sequential_rays import trace

RAYS = 40_000
CLEAR = Coating(R=0.0, T=1.0)
TURN = Decentre(tilt_deg=(45.0, 0.0, 0.0))
TRIPLET = Sequential(
    "triplet",
    (
        Row(1, radius=22.01359, thickness=3.25896, material="1.62041", coating="clear"),
        Row(2, radius=-435.76044, thickness=6.00755, coating="clear"),
        Row(3, radius=-22.21328, thickness=0.99998, material="1.62005", coating="clear"),
        Row(4, radius=20.29192, thickness=2.0, coating="clear"),
        Row(5, stop=True, thickness=2.75041),
        Row(6, radius=79.6836, thickness=2.95208, material="1.62041", coating="clear"),
        Row(7, radius=-18.39533, thickness=42.20778, coating="clear"),
        Row(8, kind="image"),
    ),
    aperture=10.0,
    fields=((0.0, 0.0), (0.0, 14.0), (0.0, 20.0)),
)
NEWTONIAN = Sequential(
    "newtonian",
    (
        Row(1, thickness=1000.0),
        Row(2, radius=-2000.0, conic=-1.0, mirror=True, stop=True, thickness=-800.0),
        Row(3, kind="coordinate_break", decentre=TURN),
        Row(4, mirror=True),
        Row(5, kind="coordinate_break", decentre=TURN, thickness=200.0),
        Row(6, kind="image"),
    ),
    aperture=200.0,
    fields=((0.0, 0.0), (0.0, 0.5)),
)


def beam(prescription, field_deg: float, count: int = 401) -> tuple[np.ndarray, np.ndarray]:
    """A square grid over the source's disc, in its plane across the axis."""
    source = prescription.source
    x, y = np.meshgrid(*[np.linspace(-source.radius, source.radius, count)] * 2)
    inside = np.hypot(x, y) <= source.radius
    positions = np.column_stack([x[inside], y[inside], np.full(inside.sum(), source.z)])
    angle = math.radians(field_deg)
    return positions, np.tile([0.0, math.sin(angle), math.cos(angle)], (len(positions), 1))


@pytest.mark.parametrize("field_deg", [0.0, 14.0])
def test_a_triplet_images_as_its_table_does(field_deg):
    prescription = to_prescription(TRIPLET, coatings={"clear": CLEAR})
    t = mistray.trace(prescription.to_scene(), rays=RAYS, field_deg=field_deg, max_reflections=0)
    (path,) = t.paths
    hits, _ = trace(TRIPLET, *beam(prescription, field_deg))
    clear = {surface.name: surface.semi_diameter for surface in prescription.surfaces} | {
        "S5": prescription.stop.radius
    }
    radii = np.array([clear.get(f"S{row.number}", np.inf) for row in TRIPLET.rows])
    passed = (np.hypot(hits[..., 0], hits[..., 1]) <= radii[:, None]).all(axis=0)
    share = t.energy.detected_W / t.energy.launched_W
    assert share == pytest.approx(passed.mean(), abs=4 * math.sqrt(0.25 / RAYS))
    image = hits[-1][passed]
    spread = image[:, 1].std() / math.sqrt(RAYS)
    assert path.y_mm == pytest.approx(image[:, 1].mean(), abs=5 * spread + 1e-5)
    assert path.x_mm == pytest.approx(0.0, abs=5 * spread + 1e-5)


def test_a_folded_newtonian_images_as_its_table_does():
    prescription = to_prescription(NEWTONIAN)
    t = mistray.trace(prescription.to_scene(), rays=RAYS, field_deg=0.5)
    image = next(path for path in t.paths if path.order == 0)
    hits, _ = trace(NEWTONIAN, *beam(prescription, 0.5))
    # The flat's body shadows the middle; coma makes the mean depend on that a little
    assert math.hypot(image.x_mm, image.y_mm) == pytest.approx(abs(hits[-1, :, 1].mean()), abs=0.01)
    flat = next(surface for surface in prescription.surfaces if surface.name == "S4")
    shadow = flat.semi_diameter**2 * math.cos(math.radians(45)) / 100.0**2
    share = image.power_W / t.energy.launched_W
    assert share == pytest.approx(1 - shadow, abs=0.02)


@pytest.mark.parametrize("field_deg", [0.0, 25.0, 45.0])
def test_no_light_leaves_a_closed_lens(field_deg):
    """Surfaces that transmit all: what enters the front ends in the glass' edges, the barrel or the image plane."""
    prescription = to_prescription(TRIPLET, coatings={"clear": CLEAR})
    front = prescription.surfaces[0]
    source = replace(prescription.source, radius=0.5 * front.semi_diameter, z=front.z)
    scene = replace(prescription, source=source).to_scene()
    t = mistray.trace(scene, rays=20_000, field_deg=field_deg, max_reflections=0)
    assert abs(t.energy.closure) < 1e-5
    assert t.energy.escaped_W == 0.0
    open_lens = to_prescription(TRIPLET, coatings={"clear": CLEAR}, edges="open")
    t = mistray.trace(replace(open_lens, source=source).to_scene(), rays=20_000, field_deg=field_deg, max_reflections=0)
    assert (t.energy.escaped_W > 0.0) == (field_deg > 0.0)


def test_ground_edges_send_light_back():
    """The edges together absorb half of what meets them, and a part of what they send to one another."""
    absorbed = {}
    for edges in ("blackened", "ground"):
        prescription = to_prescription(TRIPLET, coatings={"clear": CLEAR}, edges=edges, beam="front")
        t = mistray.trace(prescription.to_scene(), rays=20_000, field_deg=40.0, max_reflections=1)
        own = {name: watts for name, (watts, _) in t.energy.absorbed.items() if name.startswith("L")}
        assert own["L1_edge"] > 0.0
        absorbed[edges] = sum(own.values())
    assert 0.5 <= absorbed["ground"] / absorbed["blackened"] < 0.9

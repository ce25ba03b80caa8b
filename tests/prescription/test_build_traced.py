"""Imported lenses as the renderer traces them: the same image as the table's real rays, and no way out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from sequential_lenses import BORED, newtonian, triplet

import mistray
from mistray.prescription import Coating, Sequential, to_prescription
from mistray.prescription.sequential.rays import trace

RAYS = 40_000
CLEAR = Coating(R=0.0, T=1.0)


def coated(table: Sequential) -> Sequential:
    """The lens with a coating by name on all that is no mirror."""
    return table.with_rows([row if row.mirror else replace(row, coating="clear") for row in table.rows])


TRIPLET, NEWTONIAN, BORED_MANGIN = coated(triplet()), newtonian(), coated(BORED)


def beam(prescription, field_deg: float, count: int = 201) -> tuple[np.ndarray, np.ndarray]:
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
    prescription = to_prescription(NEWTONIAN, beam="exact")
    t = mistray.trace(prescription.to_scene(), rays=RAYS, field_deg=0.5)
    image = next(path for path in t.paths if path.order == 0)
    hits, _ = trace(NEWTONIAN, *beam(prescription, 0.5))
    # The flat's body shadows the middle; coma makes the mean depend on that a little
    assert math.hypot(image.x_mm, image.y_mm) == pytest.approx(abs(hits[-1, :, 1].mean()), abs=0.01)
    flat = next(surface for surface in prescription.surfaces if surface.name == "flat")
    shadow = flat.semi_diameter**2 * math.cos(math.radians(45)) / 100.0**2
    share = image.power_W / t.energy.launched_W
    assert share == pytest.approx(1 - shadow, abs=0.02)


def test_a_bored_mangin_mirror_images_through_its_field_lens():
    """Light passes the secondary, meets the glass outside of its bore, and comes back through the lens within that."""
    prescription = to_prescription(BORED_MANGIN, coatings={"clear": CLEAR})
    t = mistray.trace(prescription.to_scene(), rays=RAYS, max_reflections=2)
    assert abs(t.energy.closure) < 1e-5
    faces = {surface.name: surface for surface in prescription.surfaces}
    hits, _ = trace(BORED_MANGIN, *beam(prescription, 0.0))
    r = np.hypot(hits[..., 0], hits[..., 1])
    names = ["S2", "S3", "S2", "S5", "S6", "S7"]
    within = [(r[k] > faces[name].inner_semi_diameter) & (r[k] <= faces[name].semi_diameter)
              for k, name in enumerate(names, start=1)]  # fmt: skip
    passed = np.all(within, axis=0) & (r[0] > faces["S5"].semi_diameter)
    image = next(path for path in t.paths if path.order == 0)
    share = passed.mean()
    assert 0.4 < share < 0.8
    assert image.power_W / t.energy.launched_W == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / RAYS))


@pytest.fixture(scope="module")
def closed_and_open():
    """The triplet with walls and without, lit on the middle of its front."""
    scenes = []
    for edges in ("blackened", "open"):
        prescription = to_prescription(TRIPLET, coatings={"clear": CLEAR}, edges=edges)
        front = prescription.surfaces[0]
        source = replace(prescription.source, radius=0.5 * front.semi_diameter, z=front.z)
        scenes.append(replace(prescription, source=source).to_scene())
    return scenes


@pytest.mark.parametrize("field_deg", [0.0, 25.0, 45.0])
def test_no_light_leaves_a_closed_lens(closed_and_open, field_deg):
    """Surfaces that transmit all: what enters the front ends in the glass' edges, the barrel or the image plane."""
    closed, open_ = (mistray.trace(scene, rays=20_000, field_deg=field_deg, max_reflections=0)
                     for scene in closed_and_open)  # fmt: skip
    assert abs(closed.energy.closure) < 1e-5
    assert closed.energy.escaped_W == 0.0
    assert (open_.energy.escaped_W > 0.0) == (field_deg > 0.0)


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

"""Scatter in the bulk of a material: slabs against float64 photons, single scatter in closed form, the books."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import bulk
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from oracles.statistics import z_limit, z_score

import mistray

THICKNESS = 10.0  # mm


def slab_text(material: str) -> str:
    """A slab of 10 mm that does not refract, so wide that its black edge is dark, and a detector that is wider."""
    window = {"R": 0.0, "T": 1.0}
    return scene_text(
        shape_xml("asphere", "front", 0.0, interface_xml("air", material, **window), semi_diameter=300.0),
        shape_xml("asphere", "rear", THICKNESS, interface_xml(material, "air", **window), semi_diameter=300.0),
        shape_xml("frustum", "edge", r0=300.0, r1=300.0, z0=0.0, z1=THICKNESS),
        shape_xml("asphere", "detector", THICKNESS + 0.1, sensor=True, semi_diameter=310.0),
    )


@pytest.mark.long
@pytest.mark.parametrize(("albedo", "g"), [(1.0, 0.0), (1.0, 0.8), (0.7, -0.4)])
@pytest.mark.parametrize("splitting", ["split", "one"])
def test_slab_against_photons(load_scene, albedo: float, g: float, splitting: str) -> None:
    """Transmission of a slab of optical thickness 1.5, many scatters; false alarm 1e-3 for all six cases."""
    per_mm = 0.15
    k = (1 - albedo) * per_mm * 550e-6 / (4 * np.pi)
    scene = load_scene(slab_text(f"1.0+{k:.12g}i scatter={per_mm * albedo:.12g} g={g}"))
    limits = {"max_scatters": 60, "flux_threshold": 1e-12, "max_events": 64}
    trace = mistray.trace(scene, rays=100_000, splitting=splitting, ledger=False, **limits)
    energy = trace.energy
    photons = 1_000_000
    through, back, absorbed = bulk.slab(1.5, albedo, g, 1.0, photons, seed=3)
    assert through + back + absorbed == pytest.approx(1, abs=1e-9)
    measured, se = energy.detected_W / energy.launched_W, energy.detected_se_W / energy.launched_W
    combined = np.hypot(se, np.sqrt(through * (1 - through) / photons))
    assert abs(z_score(measured, through, combined)) < z_limit(6)
    assert abs(energy.closure) < 1e-5
    (taken,) = energy.absorbed_in.values() if albedo < 1 else [(0.0, 0.0)]
    assert taken[0] / energy.launched_W == pytest.approx(absorbed, abs=5 * np.hypot(taken[1], 5e-4))


def test_thin_media_keep_their_digits(load_scene) -> None:
    """An optical thickness of 1e-6 scatters 1e-6 of the light, nearly all of it forward if g = 0.95."""
    scene = load_scene(slab_text("1.0 scatter=1e-7 g=0.95"))
    trace = mistray.trace(scene, rays=100_000)
    row = max(trace.paths.find("(1.0_scatter=1e-7_g=0.95):t"), key=lambda row: row.power_W)
    (direct,) = (row for row in trace.paths if row.kind == "direct")
    assert row.power_W / direct.power_W == pytest.approx(1e-6, rel=0.1)  # float32: 1 - 1e-6 is rounded to 6e-8
    assert row.kind == "single scatter"
    assert row.scatter_1 == "(1.0_scatter=1e-7_g=0.95)"


def test_rays_turn_within_the_medium(load_scene) -> None:
    """Recorded rays have a node inside of the slab, at depths that fall off as exp(-τ)."""
    scene = load_scene(slab_text("1.0 scatter=0.1 g=0.9"))
    trace = mistray.trace(scene, rays=50_000)
    row = max(trace.paths.find("(1.0_scatter=0.1_g=0.9):t"), key=lambda row: row.power_W)
    assert row.path == "TtTA"
    history = trace.history(row.path_id, 400).to_pandas()
    inside = history[history.surface.str.startswith("(")]
    assert len(inside) == 400
    assert set(inside.intercept) == {"RandTran"}
    assert inside.z_mm.between(0, THICKNESS).all()
    # Density of the depth of the one event on the way to the far face; each ray counts with the flux that arrives
    arriving = history.groupby("ray").flux_W.last().to_numpy()
    z = np.linspace(0, THICKNESS, 20001)
    cosines = np.linspace(1e-6, 1, 2001)
    phase = (1 - 0.81) / (1 + 0.81 - 1.8 * cosines) ** 1.5
    leaves = np.array([np.trapezoid(phase * np.exp(-0.1 * (THICKNESS - d) / cosines), cosines) for d in z[::100]])
    density = np.exp(-0.1 * z) * np.interp(z, z[::100], leaves)
    mean = np.trapezoid(z * density, z) / np.trapezoid(density, z)
    spread = np.sqrt(np.trapezoid(z * z * density, z) / np.trapezoid(density, z) - mean**2)
    assert abs(np.average(inside.z_mm, weights=arriving) - mean) < 5 * spread / np.sqrt(400)

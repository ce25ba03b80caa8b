"""What surfaces do with light: Fresnel, ideal coatings, Lambertian walls and rough windows in closed form."""

from __future__ import annotations

import json

import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
from command_line import fails, succeeds
from lit_detector import BLACK, lit, meter

import mistray
from mistray import MistrayError
from mistray.recorders import FluxSplit, SplitRow

N = 1.5
R = ((N - 1) / (N + 1)) ** 2
A, B = 0.02, 0.25
TIS = np.pi * A / (1 + B)  # of ABg scatter with g = 0, which is Lambertian
SHARES = ("absorbed", "specular_reflection", "specular_transmission", "scattered_reflection", "scattered_transmission")
BEAM = {"type": "collimated", "radius": 2.0, "irradiance": 1 / (4 * np.pi)}


def split(bsdf: dict, split_of: str = "sample", tilt: float = 0.0, **settings: object) -> dict[str, SplitRow]:
    """A beam of 1 W on a plane sample, tilted about x, before a black wall and a detector that stands aside."""
    pose = mi.ScalarTransform4d().rotate([1, 0, 0], tilt)
    detector = {"type": "asphere", "semi_diameter": 0.5, "x": 300.0, "z": -300.0, "bsdf": BLACK, "sensor": meter()}
    sample = {"type": "asphere", "semi_diameter": 20.0, "to_world": pose, "bsdf": bsdf}
    scene = lit({**BEAM, "distance": 50.0}, sample=sample, detector=detector)
    found = FluxSplit("split", split_of)
    t = mistray.trace(scene, rays=500, recorders=[found], **settings)
    for row in found.rows:
        ledger = next(one for one in t.surfaces if one.id == row.surface)
        assert row.incident == pytest.approx((ledger.incident_W, ledger.incident_se_W), rel=1e-6, abs=1e-9)
        assert row.absorbed == pytest.approx((ledger.absorbed_W, ledger.absorbed_se_W), rel=1e-6, abs=1e-9)
        assert abs(row.closure) < 1e-6
    return {row.surface: row for row in found.rows}


def interface(*nested: dict, **what: object) -> dict:
    return {"type": "interface", **what} | {f"scatter_{k}": one for k, one in enumerate(nested)}


CASES = {
    "bare glass": (interface(front="air", back=f"{N}"), (0.0, R, 1 - R, 0.0, 0.0)),
    "lossy coating": (interface(R=0.2, T=0.5), (0.3, 0.2, 0.5, 0.0, 0.0)),
    "rough glass": (
        interface({"type": "abg", "A": A, "B": B, "g": 0.0}, front="air", back=f"{N}"),
        (0.0, R * (1 - TIS), (1 - R) * (1 - TIS), R * TIS, (1 - R) * TIS),
    ),
    "rough lossy mirror": (
        interface({"type": "abg", "A": A, "B": B, "g": 0.0, "event": "reflection"}, R=0.8, T=0.0),
        (0.2, 0.8 * (1 - TIS), 0.0, 0.8 * TIS, 0.0),
    ),
}


@pytest.mark.quick
@pytest.mark.parametrize("name", CASES)
def test_a_plane_at_right_angles(name):
    """All rays meet the sample alike: there is no noise. What the limits cut has its share."""
    bsdf, shares = CASES[name]
    row = split(bsdf, max_reflections=0, max_scatters=0)["sample"]
    assert row.incident[0] == pytest.approx(1.0, rel=1e-6)
    for what, share in zip(SHARES, shares, strict=True):
        # The kernel has R of a bare surface in float32, and TIS from a table
        assert getattr(row, what)[0] == pytest.approx(share, rel=1e-5, abs=1e-7), what
        assert getattr(row, what)[1] < 1e-6


@pytest.mark.parametrize("polarization", ["unpolarized", pytest.param("stokes", marks=pytest.mark.long)])
def test_a_tilted_plate_and_total_reflection(polarization):
    """Fresnel's equations at 50°, mean of s and p; from within glass at 50° all light is reflected."""
    cos_i = np.cos(np.radians(50))
    cos_t = np.sqrt(1 - (np.sin(np.radians(50)) / N) ** 2)
    r_s, r_p = ((cos_i - N * cos_t) / (cos_i + N * cos_t)) ** 2, ((N * cos_i - cos_t) / (N * cos_i + cos_t)) ** 2
    row = split(interface(front="air", back=f"{N}"), tilt=50.0, polarization=polarization)["sample"]
    assert row.specular_reflection[0] == pytest.approx((r_s + r_p) / 2, rel=1e-5)
    assert row.specular_transmission[0] == pytest.approx(1 - (r_s + r_p) / 2, rel=1e-5)
    row = split(interface(front=f"{N}", back="air"), tilt=50.0, polarization=polarization)["sample"]
    assert row.specular_reflection[0] == pytest.approx(1.0, rel=1e-6)
    assert row.specular_transmission[0] == 0


@pytest.mark.long
def test_all_surfaces_of_a_barrel_close(capsys):
    """Lenses, edges, painted walls and a hood, with all that comes back."""
    found = FluxSplit("split")
    scene = mistray.load("double_gauss_barrel")
    t = mistray.trace(scene, rays=2000, field_deg=15.0, max_reflections=1, recorders=[found])
    table = found.to_pandas()
    assert list(table.surface) == [row.id for row in t.surfaces]
    parts = sum(table[f"{what}_W"] for what in SHARES)
    np.testing.assert_allclose(parts, table.incident_W, rtol=1e-6, atol=1e-9 * t.energy.launched_W)
    np.testing.assert_allclose(table.incident_W, [row.incident_W for row in t.surfaces], rtol=1e-6)
    np.testing.assert_allclose(table.absorbed_se_W, [row.absorbed_se_W for row in t.surfaces], rtol=1e-5)
    command = ["ghosts", "plate_and_wall", "--rays", "500", "--max-scatters", "1", "--quiet", "--json", "--flux-split"]
    assert "screen" in fails(capsys, *command, "scren")
    found = json.loads(succeeds(capsys, *command, "plate", "screen"))
    rows = pd.DataFrame(found["sections"]["split"]["flux_split"])
    assert set(rows.surface) == {"plate_front", "plate_rear", "plate_edge", "screen"}
    parts = sum(rows[f"{what}_W"] for what in SHARES)
    np.testing.assert_allclose(parts, rows.incident_W, rtol=1e-6, atol=1e-6)
    screen = rows[rows.surface == "screen"].iloc[0]
    assert screen.scattered_reflection_W == pytest.approx(0.2 * screen.incident_W, rel=1e-4)


@pytest.mark.quick
@pytest.mark.long
def test_a_mesh_and_patterns():
    place = mi.ScalarTransform4d().scale(9).translate([0, 0, 2])
    paint = interface({"type": "paint", "reflectance": 0.25}, R=0.0)
    scene = lit(
        BEAM,
        wall={"type": "rectangle", "to_world": place, "bsdf": paint},
        detector={"type": "asphere", "semi_diameter": 0.1, "z": 90.0, "bsdf": BLACK, "sensor": meter()},
        own={"type": "flux_split", "surfaces": "wall"},
    )
    (row,) = mistray.trace(scene, rays=300).recorders["own"].rows
    assert row.scattered_reflection[0] == pytest.approx(0.25, rel=1e-6)
    assert row.absorbed[0] == pytest.approx(0.75, rel=1e-6)
    with pytest.raises(MistrayError, match="wall"):
        mistray.trace(scene, rays=100, recorders=[FluxSplit("other", "wal")])
    with pytest.raises(MistrayError, match="recorded nothing"):
        _ = FluxSplit("other").rows
    number = [sensor.id() for sensor in scene.sensors()].index("own")
    image = np.array(mi.render(scene, sensor=number, integrator=mi.load_dict({"type": "straylight", "rays": 300})))
    np.testing.assert_allclose(image[0, :, 0], [1, 0.75, 0, 0, 0.25, 0], rtol=1e-6, atol=1e-12)

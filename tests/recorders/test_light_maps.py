"""Maps of parts of the light: the ghosts of a window in closed form, and parts that add up to the whole."""

from __future__ import annotations

import json

import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
from command_line import fails, succeeds
from lit_detector import BLACK, lit, square

import mistray
from mistray import MistrayError
from mistray.recorders import SurfaceMaps
from mistray.recorders.path_events import DIRECT, STRAY_KINDS
from mistray.report import read_irradiance

N = 1.5
R = ((N - 1) / (N + 1)) ** 2


def window() -> mi.Scene:
    glass = {"front": {"front": "air", "back": f"{N}"}, "rear": {"front": f"{N}", "back": "air"}}
    surfaces = {
        name: {"type": "asphere", "semi_diameter": 6.0, "z": z, "bsdf": {"type": "interface", **glass[name]}}
        for name, z in (("front", 10.0), ("rear", 12.0))
    }
    plate = {"type": "asphere", "half_width": 8.0, "half_height": 8.0, "z": -5.0, "bsdf": BLACK}
    beam = {"type": "collimated", "radius": 5.0, "irradiance": 1 / (25 * np.pi), "distance": 3.0}
    return lit(beam, **surfaces, plate=plate, detector=square(8.0, 16, z=20.0))


@pytest.mark.quick
def test_ghosts_of_a_window_on_a_plate():
    """R of the front, R (1 - R)² of the rear, and the ghost of three reflections R³ (1 - R)² within the window."""
    t = mistray.trace(window(), rays=2000, max_reflections=3)
    parts = {
        "G(front) & !G(rear)": R,
        "G(rear) & !G(front)": (1 - R) ** 2 * R,
        "G = 3": (1 - R) ** 2 * R**3,
        "ghost": R + (1 - R) ** 2 * (R + R**3),
        "order < 2": R + (1 - R) ** 2 * R,
        "rear -> front": 0.0,
        "all": R + (1 - R) ** 2 * (R + R**3),
    }
    found = t.surface_maps("plate", list(parts), azimuths=5, lengths=4)
    for maps, (text, power) in zip(found, parts.items(), strict=True):
        # The rays carry equal flux, and all of them meet the plate
        assert maps["plate"].power[0] == pytest.approx(power, rel=2e-6, abs=1e-12), text
        assert maps["plate"].absorbed_power[0] == pytest.approx(power, rel=2e-6, abs=1e-12), text
    for wrong in ("power_W > 1", "S(plat)", "ghosts", "kind = ghst"):
        with pytest.raises(MistrayError):
            t.surface_maps("plate", wrong)
    with pytest.raises(MistrayError, match="plat"):
        t.surface_maps("plat")


def test_parts_add_up_to_what_a_recorder_sums():
    """Cell by cell, of light that scatters, at two wavelengths; the recorder sums in the kernel, without the parts."""
    scene = mistray.load("plate_and_wall")
    walls = SurfaceMaps("walls", ["housing*", "screen", "detector"], azimuths=6, lengths=4)
    settings = {"field_deg": 12.0, "wavelength_nm": [480.0, 640.0], "max_reflections": 1}
    t = mistray.trace(scene, rays=6000, recorders=[walls], **settings)
    kinds = [DIRECT, *STRAY_KINDS]
    whole, *parts = t.surface_maps(walls.patterns, ["all", *kinds], azimuths=6, lengths=4)
    assert set(whole) == set(walls.maps)
    for name, one in walls.maps.items():
        for what in ("incident", "absorbed"):
            expected, sums = getattr(one, what), [getattr(maps[name], what) for maps in parts]
            scale = 1e-9 * t.energy.launched_W
            np.testing.assert_allclose(getattr(whole[name], what).value, expected.value, rtol=1e-6, atol=scale)
            np.testing.assert_allclose(getattr(whole[name], what).se, expected.se, rtol=1e-5, atol=scale)
            np.testing.assert_allclose(sum(s.value for s in sums), expected.value, rtol=1e-6, atol=scale)
    by_kind = {kind: maps["detector"].absorbed_power[0] for kind, maps in zip(kinds, parts, strict=True)}
    for kind, power in by_kind.items():
        rows = t.paths.select(kind)
        assert power == pytest.approx(sum(row.power_W for row in rows), rel=1e-6, abs=1e-12), kind


COMMAND = ["ghosts", "plate_and_wall", "--rays", "500", "--max-scatters", "1", "--quiet"]


@pytest.mark.long
def test_the_command_maps_parts_of_the_light(tmp_path, capsys):
    for wrong, word in (("goost", "ghost"), ("S(screeen)", "screen"), ("power_W > 1", "power_W")):
        assert word in fails(capsys, *COMMAND, "--maps", wrong, "--surface-maps", "screen")
    out = tmp_path / "out"
    lights = ["single scatter", "S(plate*) & !G", "stray"]
    more = ["--surface-maps", "screen", "lengths=6", "--formats", "npy", "--json"]
    found = succeeds(capsys, *COMMAND, "--maps", *lights, *more, "--out", out)
    rows = json.loads(found)["sections"]["light"]["light_maps"]
    assert [(row["light"], row["surface"]) for row in rows] == [
        (light, where) for light in lights for where in ("detector", "screen")
    ]
    table = pd.read_csv(out / "light_maps.csv")
    assert (out / "light_maps_0deg.png").stat().st_size > 10_000
    files = ("single_scatter", "single_scatter_screen", "S_plate_G", "S_plate_G_screen", "stray", "stray_screen")
    for name, (_, row) in zip(files, table.iterrows(), strict=True):
        one = read_irradiance(out / f"irradiance_{name}_0deg.npy")
        x0, x1, y0, y1 = one.extent
        power = float(one.irradiance.sum()) * (x1 - x0) * (y1 - y0) / one.irradiance.size
        assert power == pytest.approx(row.power_W, rel=1e-6)
    paths = pd.read_csv(out / "paths.csv")
    own = paths[(paths.kind != DIRECT)].power_W.sum()
    assert table.power_W[4] == pytest.approx(own, rel=1e-6)

"""Scenes whose materials are known in the infrared alone: all is evaluated at the wavelengths that are traced."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from oracles.small_scenes import plates_text, write

import mistray
from mistray.cli import main

# Far more dispersion than germanium has, so that an index of another wavelength shows
BODY = "n(8000)=4.4 n(10000)=4.0 n(12000)=3.6 k=0"
TWO = "n(8000)=2 n(12000)=3 k=0"
INDEX = {8000.0: 4.4, 12000.0: 3.6}


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plane window and its light."""
    light = '<string name="wavelength_nm" value="8000, 10000, 12000"/><string name="weights" value="1, 2, 1"/>'
    text = plates_text(1, index=BODY).replace('<float name="radius"', f'{light}<float name="radius"', 1)
    return write(tmp_path_factory.mktemp("infrared"), text)


def test_each_wavelength_has_its_own_index(scene_file: Path, tmp_path: Path) -> None:
    """What passes a plane window directly is (4n/(n + 1)²)², by Fresnel's equations; nothing is left to chance."""
    scene = mistray.load(scene_file)
    for wavelength, n in INDEX.items():
        t = mistray.trace(scene, rays=500, wavelength_nm=wavelength, max_reflections=0)
        assert t.paths[0].power_W / t.energy.launched_W == pytest.approx((4 * n / (n + 1) ** 2) ** 2, rel=2e-5)
    unlit = mistray.load(write(tmp_path, plates_text(1, index=BODY)))  # its light is taken to be 550 nm
    assert mistray.trace(unlit, rays=500, wavelength_nm=1e4, max_reflections=0).paths[0].power_W > 0
    # Light of 550 nm is what has no index, when it is traced
    with pytest.raises(mistray.MistrayError, match=r"surface '.*550 nm is outside of its 8000 … 12000 nm") as error:
        mistray.trace(scene, rays=500, wavelength_nm=550.0)
    assert "extrapolate" not in str(error.value)
    # Thicknesses in nm are what they are; only those in waves need the index at `design_nm`
    body = {"type": "interface", "coating": {"type": "thinfilm", "layers": f"{BODY} 600, 2.2 1100"}}
    coating = mi.load_dict(body).coating
    assert (coating.indices(8000.0)[0], coating.indices(12000.0)[0]) == pytest.approx((4.4, 3.6))


@pytest.mark.parametrize(("more", "n"), [({}, 2.0), ({"wavelength_nm": 12000.0}, 3.0)])
def test_stock_integrators_take_the_wavelength_of_the_source(more: dict[str, float], n: float) -> None:
    """From within glass the sky has n² of its radiance where the face passes it, and 1 where it reflects the open."""
    scene = scene_dicts.load(
        beam={"type": "collimated", "radius": 3.0, "wavelength_nm": "8000, 12000"},
        sky={"type": "constant", "radiance": 1.0},
        face={"type": "asphere", "semi_diameter": 50.0, "bsdf": {"type": "interface", "back": TWO, **more}},
    )
    look = mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
    film = scene_dicts.film(2, pixel_format="luminance")
    camera = mi.load_dict({"type": "perspective", "fov": 1.0, "to_world": look, "film": film})
    path = mi.load_dict({"type": "path", "max_depth": 2})
    seen = np.array(mi.render(scene, sensor=camera, integrator=path, spp=4096))
    passed = 4 * n / (n + 1) ** 2
    # The mean of 16384 samples has a relative error of 4e-3 at most: it fails by chance in 6e-7 of runs
    assert seen.mean() == pytest.approx(n**2 * passed + 1 - passed, rel=2e-2)


def test_a_lens_of_the_infrared_is_exported(scene_file: Path, tmp_path: Path, capsys: Any) -> None:
    """A body without F, d and C lines goes into a Zemax file with its index at the primary wavelength, and is named."""
    assert main(["export", str(scene_file), "-o", str(tmp_path / "again.zmx")]) == 0
    assert "index at 10000 nm alone" in capsys.readouterr().out
    again = tmp_path / "again.xml"
    assert main(["import", str(tmp_path / "again.zmx"), "-o", str(again)]) == 0
    assert mistray.load(again).shapes()[0].bsdf().indices(8000.0)[1] == pytest.approx(4.0)

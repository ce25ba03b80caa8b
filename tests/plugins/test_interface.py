"""`interface` as a Mitsuba BSDF: its parameters, its errors and its updates."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import pytest

import mistray

pytestmark = pytest.mark.quick


def test_defaults() -> None:
    bsdf = mi.load_dict({"type": "interface"})
    assert (bsdf.front, bsdf.back, bsdf.mirror, bsdf.ideal, bsdf.opaque) == ("air", "air", False, False, False)
    assert mi.load_dict({"type": "interface", "R": 0.3}).opaque
    assert mi.load_dict({"type": "interface", "R": 0.9, "mirror": True}).mirror
    glass = mi.load_dict({"type": "interface", "back": "N-BK7"})
    assert glass.indices(587.5618) == pytest.approx((1.0, 1.5168), abs=1e-5)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"R": 0.6, "T": 0.5}, "interface 'coat': R = 0.6 and T = 0.5"),
        ({"R": float("nan")}, "R is nan"),
        ({"T": 0.5}, "T is given without R"),
        ({"R": 0.1, "table": "x.csv"}, "give R and T or table, not both"),
        ({"back": "N-BK8"}, "material 'N-BK8' is unknown; did you mean N-BK7"),
        ({"front": "0.7"}, "index 0.7"),
        ({"table": "nowhere.csv"}, "coating table 'nowhere.csv': No such file"),
        ({"wavelength_nm": 0.0}, "wavelength_nm is 0"),
        ({"reflectance": 0.1}, "reflectance"),
    ],
)
def test_wrong_values(values: dict[str, Any], words: str) -> None:
    with pytest.raises((mistray.MistrayError, RuntimeError)) as caught:
        mi.load_dict({"type": "interface", "id": "coat", **values})
    assert words in str(caught.value)


def test_update_changes_the_trace() -> None:
    scene = mistray.load("phone_camera")
    params = mi.traverse(scene)
    key = next(k for k in params.keys() if k.startswith("window_front") and k.endswith(".R"))  # noqa: SIM118
    before = mistray.trace(scene, rays=2000, max_reflections=0)
    params[key], params[key[:-1] + "T"] = mi.Float(0.3), mi.Float(0.6)
    params.update()
    after = mistray.trace(scene, rays=2000, max_reflections=0)
    ratio = after.paths[0].power_W / before.paths[0].power_W
    assert ratio == pytest.approx(0.6 / 0.99, rel=1e-6)
    assert after.energy.absorbed["window_front"][0] == pytest.approx(0.1 * after.energy.launched_W, rel=1e-5)


def test_bad_update_leaves_everything() -> None:
    bsdf = mi.load_dict({"type": "interface", "id": "coat", "R": 0.1, "T": 0.8})
    params = mi.traverse(bsdf)
    params["R"] = mi.Float(0.5)
    with pytest.raises(mistray.MistrayError, match=r"interface 'coat': R = 0.5 and T = 0.8"):
        params.update()
    assert (bsdf.R[0], bsdf.T[0]) == pytest.approx((0.1, 0.8))
    params["R"], params["T"] = mi.Float(0.5), mi.Float(0.5)
    params.update()
    assert (bsdf.R[0], bsdf.T[0]) == (0.5, 0.5)

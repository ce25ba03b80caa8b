"""The interface as a Mitsuba BSDF: its parameters, its errors and updates, and shifts of its indices."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts

import mistray
from mistray.surfaces.surfaces import SurfaceTable


@pytest.mark.quick
def test_defaults_and_nested_plugins() -> None:
    bsdf = mi.load_dict({"type": "interface"})
    assert (bsdf.front, bsdf.back, bsdf.mirror, bsdf.ideal, bsdf.opaque) == ("air", "air", False, False, False)
    assert mi.load_dict({"type": "interface", "R": 0.3}).opaque
    assert mi.load_dict({"type": "interface", "R": 0.9, "mirror": True}).mirror
    glass = mi.load_dict({"type": "interface", "back": "N-BK7"})
    assert glass.indices(587.5618) == pytest.approx((1.0, 1.5168), abs=1e-5)
    film, polish = {"type": "thinfilm", "layers": "1.38 99"}, {"type": "abg", "A": 1e-4, "B": 1e-3, "g": 2.0}
    nested = mi.load_dict({"type": "interface", "back": "1.5", "coating": film, "polish": polish})
    keys = list(mi.traverse(nested).keys())
    assert [key for key in keys if "shift" in key and "coating" not in key] == ["n_front_shift", "n_back_shift"]
    assert {key for key in keys if "coating" in key} == {f"coating.{k}" for k in ("thickness_nm", "n_shift", "k_shift")}
    alone = mi.load_dict({"type": "thinfilm", "layers": "1.38 99", "back": "1.5", "n_back_shift": 0.25})
    assert alone.indices(550.0) == (1.0, 1.75)


SHIFT = 0.125  # exact in float32, as are the indices with it
COATINGS: dict[str, dict[str, Any]] = {
    "bare": {},
    "layers": {"coating": {"type": "thinfilm", "layers": "1.38 99, 2.1 60"}},
    "ideal": {"R": 0.04, "T": 0.9},
}


def plate(index: str, coating: dict[str, Any], **shifts: float) -> mi.Scene:
    front, rear = (
        {"type": "interface", side: index, **coating} | {key: x for key, x in shifts.items() if side in key}
        for side in ("back", "front")
    )
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 3.0, "field_deg": 10.0},
        front={"type": "asphere", "radius": 40.0, "semi_diameter": 6.0, "bsdf": front},
        rear={"type": "asphere", "semi_diameter": 6.0, "to_world": scene_dicts.at(6), "bsdf": rear},
        detector=scene_dicts.detector(20.0, semi_diameter=9.0, sensor=scene_dicts.meter(16)),
    )


def traced(scene: mi.Scene) -> mistray.Trace:
    return mistray.trace(scene, rays=3000, seed=2)


@pytest.mark.parametrize("name", COATINGS)
def test_it_is_another_index(name: str) -> None:
    there = traced(plate("1.625+1e-6i", COATINGS[name]))
    given = traced(plate("1.5+1e-6i", COATINGS[name], n_back_shift=SHIFT, n_front_shift=SHIFT))
    np.testing.assert_array_equal(given.irradiance, there.irradiance)
    assert given.energy.detected_W == there.energy.detected_W
    scene = plate("1.5+1e-6i", COATINGS[name])
    params = mi.traverse(scene)
    compiled, seen = [], []
    for value in (0.0, 0.25, SHIFT):
        params["front.bsdf.n_back_shift"] = mi.Float(value)
        params["rear.bsdf.n_front_shift"] = mi.Float(value)
        params.update()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            seen.append(traced(scene).irradiance)
            compiled.append(sum(not k["cache_hit"] for k in dr.kernel_history([dr.KernelType.JIT])))
    np.testing.assert_array_equal(seen[-1], there.irradiance)
    assert np.any(seen[0] != there.irradiance)
    assert compiled[1:] == [0, 0]


def test_two_shifts_are_two_media() -> None:
    scene = plate("N-BK7", {})
    assert SurfaceTable(scene, 550.0).optics.media == ["unknown", "air", "N-BK7"]
    params = mi.traverse(scene)
    params["front.bsdf.n_back_shift"] = mi.Float(SHIFT)
    params.update()
    assert SurfaceTable(scene, 550.0).optics.media == ["unknown", "air", "N-BK7 shift=0.125", "N-BK7"]
    front, rear = (shape.bsdf() for shape in scene.shapes() if shape.id() in ("front", "rear"))
    assert front.indices(500.0)[1] == rear.indices(500.0)[0] + SHIFT
    assert front.complex_indices(500.0)[1] == rear.complex_indices(500.0)[0] + SHIFT


def test_bad_updates_leave_everything() -> None:
    bsdf = mi.load_dict({"type": "interface", "id": "face", "back": "1.5", "R": 0.1, "T": 0.8})
    params = mi.traverse(bsdf)
    for key, value, words in (
        ("R", 0.5, r"interface 'face': R = 0.5 and T = 0.8"),
        ("n_back_shift", float("nan"), r"interface 'face': n_back_shift is nan"),
        ("n_front_shift", [0.1, 0.2], r"give one number"),
        ("n_back_shift", -2.0, r"interface 'face': material '1.5 shift=-2.0': index -0.5"),
    ):
        before, params[key] = np.array(params[key]), mi.Float(value)
        with pytest.raises(mistray.MistrayError, match=words):
            params.update()
        assert bsdf.indices(550.0) == (1.0, 1.5)
        assert (bsdf.R[0], bsdf.T[0]) == pytest.approx((0.1, 0.8))
        np.testing.assert_array_equal(np.array(mi.traverse(bsdf)[key]), before)
    params["R"], params["T"] = mi.Float(0.5), mi.Float(0.5)
    params.update()
    assert (bsdf.R[0], bsdf.T[0]) == (0.5, 0.5)

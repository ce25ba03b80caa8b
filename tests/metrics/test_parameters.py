"""The list of parameters: which there are, their kinds, ranges, tolerances; names that are mistyped."""

import math
from typing import Any

import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
from scene_dicts import BLACK, at, detector, load

import mistray
from mistray._mitsuba_compat import without_scene_update
from mistray.metrics.parameters import KINDS, groups, match, parameters
from mistray.metrics.scene_values import assign, changed

pytestmark = pytest.mark.quick

FILM = {"type": "thinfilm", "id": "AR", "layers": "1.38 100, 2.1+0.01i 60", "n_shift": "0.1, 0", "k_shift": "0, 0.002"}


def scene(**more: Any) -> mi.Scene:
    place = mi.ScalarTransform4d()
    glass = {"type": "interface", "back": "1.5", "coating": {"type": "ref", "id": "AR"}}
    return load(
        AR=FILM,
        polish={"type": "harvey_shack", "rms_nm": 4.0, "l": 0.02},
        beam={"type": "collimated", "radius": 3.0},
        front={"type": "asphere", "radius": 20.0, "conic": -0.5, "a4": 1e-5, "semi_diameter": 5.0, "x": 0.1,
               "bsdf": glass | {"polish": {"type": "ref", "id": "polish"}}},
        rear={"type": "asphere", "semi_diameter": 5.0, "to_world": at(5),
              "bsdf": glass | {"front": "1.5", "back": "air"}},
        ring={"type": "frustum", "r0": 5.0, "r1": 8.0, "z0": 7.0, "z1": 7.0,
              "bsdf": {"type": "interface", "R": 0.05, "wall": {"type": "paint", "reflectance": 0.04}}},
        disc={"type": "frustum", "r0": 2.0, "r1": 0.0, "z0": 8.0, "z1": 8.0,
              "bsdf": {"type": "interface", "R": 0.6, "T": 0.3}},
        tube={"type": "frustum", "r0": 8.0, "r1": 8.0, "z0": 7.0, "z1": 20.0, "bsdf": BLACK},
        mesh={"type": "disk", "to_world": place.translate([0, 20, 0]), "bsdf": {"type": "interface", "R": 0.1}},
        aim={"type": "asphere", "semi_diameter": 1.0, "to_world": at(15),
             "bsdf": {"type": "target", "surfaces": "front"}},
        detector=detector(20, half_width=4.0, half_height=3.0, bsdf={"type": "interface", "R": 0.2}),
        **more,
    )  # fmt: skip


@pytest.fixture(scope="module")
def known() -> dict[str, Any]:
    return parameters(scene())


def test_what_there_is_facts_and_ranges(known: dict[str, Any]) -> None:
    owners: dict[str, set[str]] = {}
    for key in known:
        owner, _, name = key.rpartition(".")
        owners.setdefault(owner, set()).add(name)
    pose = {"x", "y", "z", "tilt_x", "tilt_y", "tilt_z"}
    lens = {"curvature", "conic", "semi_diameter", *pose, *(f"a{order}" for order in range(4, 21, 2))}
    shifts = {"n_front_shift", "n_back_shift"}
    assert owners == {
        "AR": {"thickness_nm", "n_shift", "k_shift"},
        "polish": {"rms_nm", "l", "s"},
        "front": lens,  # no hole
        "rear": lens,
        "front.bsdf": shifts,
        "rear.bsdf": shifts,
        "ring": {"r0", "r1", *pose},  # flat: moved by z
        "ring.bsdf": {"R"},  # opaque: no T, and what is beside it does not matter
        "ring.bsdf.paint": {"reflectance", "l", "s"},  # b0 = 0: a lobe that begins there
        "disc": {"r0", *pose},
        "disc.bsdf": {"R", "T", *shifts},
        "tube": {"r0", "r1", "z0", "z1", *pose},  # R = 0: nothing to follow
        "mesh.bsdf": {"R"},  # a stock shape has no derivatives of its own
        "detector": lens - {"semi_diameter"} | {"half_width", "half_height"},
        "detector.bsdf": {"R"},
    }
    for key, expected in {
        "AR.thickness_nm": ("coating", "nm", [100.0, 60.0], ("front", "rear")),
        "polish.l": ("scatter", "1", [np.float32(0.02)], ("front",)),
        "front.curvature": ("curvature", "1/mm", [0.05], ("front",)),
        "front.a4": ("asphere", "mm^-3", [1e-5], ("front",)),
        "front.x": ("position", "mm", [0.1], ("front",)),
        "ring.tilt_y": ("tilt", "deg", [0.0], ("ring",)),
        "ring.r0": ("rim", "mm", [5.0], ("ring",)),
        "front.bsdf.n_back_shift": ("index", "1", [0.0], ("front",)),
        "ring.bsdf.R": ("share", "1", [np.float32(0.05)], ("ring",)),
    }.items():
        p = known[key]
        assert (p.key, p.name) == (key, key.rpartition(".")[2])
        assert (p.kind, p.unit, p.value.tolist(), p.shapes) == expected
    for key, low, high in (
        ("AR.thickness_nm", 0.0, math.inf),
        ("AR.n_shift", -1.38, math.inf),
        ("ring.bsdf.R", 0.0, 1.0),
        ("ring.r0", 0.0, 8.0),
        ("ring.r1", 5.0, math.inf),
        ("tube.r1", 0.0, math.inf),
        ("front.semi_diameter", 0.0, 20 / math.sqrt(0.5)),
        ("front.curvature", -1 / (5 * math.sqrt(0.5)), 1 / (5 * math.sqrt(0.5))),
        ("front.conic", -math.inf, 15.0),
        ("front.bsdf.n_back_shift", -1.5, math.inf),
    ):
        assert (known[key].low, known[key].high) == pytest.approx((low, high), rel=1e-6), key
    assert known["AR.k_shift"].low == pytest.approx(0.0)  # of the layer without k, though the other has room
    for parameter in known.values():
        assert parameter.kind in KINDS
        assert parameter.tolerance > 0
        assert np.all((parameter.low <= parameter.value) & (parameter.value <= parameter.high))


def test_the_ends_of_ranges_are_those_of_the_plugins() -> None:
    """One step beyond, the plugin refuses; one step inside, it does not."""
    there = scene()
    params = mi.traverse(there)
    known = parameters(there)
    for key in ("front.curvature", "front.conic", "front.semi_diameter", "ring.bsdf.R", "AR.k_shift", "polish.rms_nm"):
        p = known[key]
        for end, sign in ((p.low, -1), (p.high, 1)):
            if not math.isfinite(end) or (key == "front.semi_diameter" and sign < 0):
                continue
            step = 1e-4 * max(1.0, abs(end))
            params[key] = mi.Float(np.full(p.value.shape, end - sign * step))
            params.update()
            params[key] = mi.Float(np.full(p.value.shape, end + sign * step))
            with pytest.raises(mistray.MistrayError):
                params.update()
            params[key] = mi.Float(p.value)
            params.update()


def test_tolerances(known: dict[str, Any]) -> None:
    expected = {
        "AR.thickness_nm": 0.8, "AR.n_shift": 0.01, "polish.rms_nm": 0.8, "polish.s": 0.075,
        "front.curvature": 2 * 3 * 633e-6 / 2 / 25, "front.a4": 5e-4 / 625, "front.x": 0.02, "front.tilt_x": 1 / 60,
        "ring.r0": 0.08, "ring.x": 0.08, "front.bsdf.n_front_shift": 1e-5, "front.bsdf.n_back_shift": 5e-4,
        "disc.bsdf.R": 0.08, "disc.bsdf.T": 0.06,
    }  # fmt: skip
    for key, value in expected.items():
        assert known[key].tolerance == pytest.approx(value, rel=1e-6), key
    # the rim of the conic moves by half a micrometre
    sags = [mi.load_dict({"type": "asphere", "radius": 20.0, "conic": -0.5 + change, "semi_diameter": 5.0,
                          "bsdf": {"type": "interface"}}).sag(np.array(5.0))
            for change in (0.0, known["front.conic"].tolerance)]  # fmt: skip
    assert abs(sags[1] - sags[0]) == pytest.approx(5e-4, rel=0.02)
    # A biconic that is alike in x and y has the tolerances of the asphere for both; 0.1 % of a curvature is more
    both = {"type": "freeform", "radius": 20.0, "conic": -0.5, "curvature_x": 0.05, "conic_x": -0.5}
    both |= {"bsdf": {"type": "interface"}}
    steep = both | {"curvature_x": 1 / 6, "conic_x": 0.0, "half_width": 4.9, "half_height": 4.9}
    twins = parameters(scene(both=both | {"semi_diameter": 5.0}, steep=steep))
    for name in ("curvature", "conic"):
        (wanted,) = {twins[f"both.{name}{axis}"].tolerance for axis in ("", "_x")}
        assert wanted == pytest.approx(known[f"front.{name}"].tolerance, rel=1e-9)
    assert twins["steep.curvature_x"].tolerance == pytest.approx(1e-3 / 6)
    # Its corners lie beyond R_x = 6 mm, its side does not: dz/dk = c³ x⁴/(2 s (1 + s)²), s² = 1 - c² x²
    root = math.sqrt(1 - (4.9 / 6) ** 2)
    slope = 4.9**4 / 6**3 / (2 * root * (1 + root) ** 2)
    assert twins["steep.conic_x"].tolerance == pytest.approx(5e-4 / slope, rel=1e-3)


def test_what_is_kept_or_without_use_and_groups() -> None:
    there = scene(spare=FILM | {"id": "spare"})
    params = mi.traverse(there)
    assert not [key for key in parameters(there) if key.startswith("spare")]
    params.keep(["front.x", "ring.bsdf.R", "AR.thickness_nm"])
    assert set(parameters(there, params)) == {"front.x", "ring.bsdf.R", "AR.thickness_nm"}
    place = mi.ScalarTransform4d()
    side = {"type": "asphere", "semi_diameter": 1.0, "part": "prism", "bsdf": {"type": "interface", "back": "1.7"}}
    known = parameters(
        scene(
            lid={"type": "frustum", "r0": 2.0, "r1": 3.0, "z0": 40.0, "z1": 40.0, "part": "tube",
                 "bsdf": {"type": "interface", "R": 0.1}},
            one=side | {"to_world": place.translate([50, 0, 0])},
            two=side | {"to_world": place.translate([60, 0, 0]).rotate([1, 0, 0], 45)},
        )
    )  # fmt: skip
    air = ["front.front", "rear.back", "disc.front", "disc.back", "one.front", "two.front"]
    assert groups(known) == {
        "air.index": ["{}.bsdf.n_{}_shift".format(*name.split(".")) for name in air],
        "1.5.index": ["front.bsdf.n_back_shift", "rear.bsdf.n_front_shift"],
        "1.7.index": ["one.bsdf.n_back_shift", "two.bsdf.n_back_shift"],
        **{f"tube.{axis}": [f"tube.{axis}", f"lid.{axis}"] for axis in "xyz"},
    }  # the prism's faces point to different sides
    for name, keys in groups(known).items():
        assert len({known[key].kind for key in keys}) == 1, name


def test_what_is_changed_and_restored_has_the_digits_of_the_scene() -> None:
    """Numbers that single precision does not hold."""
    here = scene(lamp={"type": "point_source", "z": -100.1, "half_angle_deg": 0.7})
    before = {key: parameters(here)[key] for key in ("front.x", "lamp.z", "lamp.half_angle_deg", "polish.l")}
    for key, p in before.items():
        with changed(mi.traverse(here), {key: p.value + p.tolerance}):
            assert parameters(here)[key].value == pytest.approx(p.value + p.tolerance, rel=1e-6)
        assert parameters(here)[key].value == p.value


def test_parameters_without_scene_update() -> None:
    """A trace is that of the changed numbers; Mitsuba's triangles follow at the next update of the scene itself."""
    ray = mi.Ray3f(mi.Point3f(0.0, 0.0, -10.0), mi.Vector3f(0.0, 0.0, 1.0))
    here, there = scene(), scene()
    values = {"front.z": parameters(here)["front.z"].value - np.array([0.25])}
    before = float(here.ray_intersect(ray).t[0])
    assign(without_scene_update(mi.traverse(here)), values)
    assign(mi.traverse(there), values)
    assert float(there.ray_intersect(ray).t[0]) == pytest.approx(before - 0.25, abs=1e-5)
    for known in (here, there):
        assert parameters(known)["front.z"].value == pytest.approx(values["front.z"][0])
    tables = [mistray.trace(known, rays=500, seed=1).paths.to_pandas() for known in (here, there)]
    pd.testing.assert_frame_equal(*tables, rtol=1e-6)
    here.parameters_changed([])
    assert float(here.ray_intersect(ray).t[0]) == pytest.approx(before - 0.25, abs=1e-5)


def test_match(known: dict[str, Any]) -> None:
    assert match(known, ["front.x"]) == ["front.x"]
    assert match(known, ["*.r0", "ring.*", "ring.r0"])[:3] == ["ring.r0", "disc.r0", "tube.r0"]
    assert match(known, ["front.a[46]"]) == ["front.a4", "front.a6"]
    assert match(known, ["*"]) == list(known)
    assert match(known, []) == []
    for pattern, message in (
        ("front.curvatur", r"no parameter 'front.curvatur' with a derivative; did you mean front.curvature"),
        ("*.curvatur", r"did you mean \*\.curvature"),
        ("zzz", r"give one of list\(mistray.optimize.parameters\(scene\)\)"),
        ("front.X", "did you mean front.x"),
    ):
        with pytest.raises(mistray.MistrayError, match=message):
            match(known, ["front.x", pattern])

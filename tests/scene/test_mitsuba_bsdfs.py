"""Mitsuba's own BSDFs in a scene: interfaces of the same light, against closed forms and Mitsuba's renderer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
import vectors
from refusals import refused

import mistray

T = mi.ScalarTransform4f
ANGLES = np.radians([0.0, 20.0, 45.0, 60.0, 80.0])
AU_550 = 0.35040883612 + 2.71406310822j  # between the points 546.85 and 553.85 nm of Mitsuba's tables
SPD = Path(mi.__file__).parent / "data" / "ior"


def spectrum(*points: tuple[float, float]) -> dict[str, Any]:
    return {"type": "spectrum", "value": list(points)}


def rgb(*value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": list(value)}


def scene_of(bsdf: dict[str, Any] | None, **beam: Any) -> dict[str, Any]:
    return {
        "type": "scene",
        "beam": {"type": "collimated", "radius": 1.0, **beam},
        "ball": {"type": "sphere", "radius": 3.0, "center": [0.0, 0.0, 10.0], **({"bsdf": bsdf} if bsdf else {})},
        "detector": scene_dicts.detector(30.0, semi_diameter=40.0),
    }


def on_ball(scene: dict[str, Any]) -> Any:
    return next(shape.bsdf() for shape in mistray.load(scene).shapes() if shape.id() == "ball")


def translated(bsdf: dict[str, Any]) -> Any:
    return on_ball(scene_of(bsdf))


def reflectance(bsdf: Any, cosines: np.ndarray) -> np.ndarray:
    """The share of the light that a smooth BSDF reflects, by its own sampling, for light from a side of the normal."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(cosines))
    c = mi.Float(cosines)
    si.wi = mi.Vector3f(dr.sqrt(1 - c * c), 0, c)
    si.t = 1.0
    sample, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(0), mi.Point2f(0.5), True)
    return np.where(np.array(sample.wo.z) * cosines > 0, np.array(weight[0] * sample.pdf), 0.0)


@pytest.mark.quick
@pytest.mark.parametrize(
    ("bsdf", "sides"),
    [
        ({"type": "diffuse"}, "| air, R = 0, T = 0, Paint[reflectance = 0.5, b0 = 0, l = 0.1, s = -2, side back]]"),
        ({"type": "diffuse", "reflectance": 0.0}, "[air | air, R = 0, T = 0]"),
        ({"type": "diffuse", "reflectance": rgb(0.25, 0.25, 0.25)}, "reflectance = 0.25,"),
        ({"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.3}}, "reflectance = 0.3,"),
        ({"type": "diffuse", "reflectance": spectrum((400, 0.0), (700, 0.0))}, "[air | air, R = 0, T = 0]"),
        ({"type": "twosided", "a": {"type": "diffuse"}}, "side both]]"),
        ({"type": "dielectric"}, "[1.504183341 | air, Fresnel]"),
        ({"type": "dielectric", "int_ior": 1.6, "ext_ior": 1.0}, "[1.6 | air, Fresnel]"),
        ({"type": "dielectric", "int_ior": "air", "ext_ior": "bk7"}, "[air | 1.504183341, Fresnel]"),
        ({"type": "dielectric", "int_ior": "diamond", "ext_ior": "water"}, "[2.418330123 | 1.332630861, Fresnel]"),
        ({"type": "conductor"}, "[air | air, R = 1, T = 0]"),
        ({"type": "conductor", "specular_reflectance": 0.9}, "[air | air, R = 0.9, T = 0]"),
        ({"type": "conductor", "material": "Au"}, "[mitsuba/Au | air, Fresnel]"),
        ({"type": "twosided", "a": {"type": "conductor", "material": "Al"}}, "[mitsuba/Al | air, Fresnel]"),
        ({"type": "conductor", "eta": 0.2, "k": 3.1}, "[0.2+3.1i | air, Fresnel]"),
        (
            {"type": "conductor", "eta": spectrum((400, 0.3), (700, 0.4)), "k": 3.0},
            "[n(400)=0.3 n(700)=0.4 k=3 | air, Fresnel]",
        ),
        (
            {"type": "conductor", "eta": 0.3, "k": spectrum((400, 3.0), (700, 4.0))},
            "[n(400)=0.3 n(700)=0.3 k(400)=3 k(700)=4 | air, Fresnel]",
        ),
    ],
)
def test_what_they_become(bsdf: dict[str, Any], sides: str) -> None:
    assert sides in str(translated(bsdf))


def test_paints_on_two_sides_also_of_our_own_surfaces() -> None:
    both = {"type": "twosided", "a": {"type": "diffuse", "reflectance": 0.1}, "b": {"type": "diffuse"}}
    first, second = translated(both).scatter
    assert (first.reflectance, second.reflectance) == pytest.approx((0.1, 0.5))
    assert (first.side, second.side) == ("back", "front")
    # Light comes to an asphere from its front, and the normal points to its back
    scene = scene_of(None) | {"ball": {"type": "asphere", "semi_diameter": 3.0, "bsdf": {"type": "diffuse"}}}
    assert [model.side for model in on_ball(scene).scatter] == ["both"]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    "bsdf",
    [
        {"type": "dielectric"},
        {"type": "dielectric", "int_ior": 1.8, "ext_ior": "water"},
        {"type": "dielectric", "int_ior": "air", "ext_ior": 1.49},
        {"type": "conductor", "eta": 0.2, "k": 3.1},
        {"type": "conductor", "eta": 1.4, "k": 7.6},
        {"type": "conductor"},
    ],
)
def test_reflectance_is_that_of_mitsubas_plugin(bsdf: dict[str, Any], side: float) -> None:
    cosines = side * np.cos(ANGLES)
    ours, theirs = translated(bsdf), mi.load_dict(bsdf)
    if bsdf["type"] == "conductor":  # that of Mitsuba is black from behind
        theirs = mi.load_dict({"type": "twosided", "bsdf": bsdf})
    np.testing.assert_allclose(reflectance(ours, cosines), reflectance(theirs, cosines), atol=3e-6)


@pytest.mark.parametrize("field_deg", [0.0, 30.0, 70.0])
def test_gold_at_an_angle(field_deg: float) -> None:
    """A trace at 550 nm, by the equations of Fresnel and by Mitsuba's function of them."""
    scene = scene_of({"type": "conductor", "material": "Au"}, field_deg=field_deg)
    place = T().translate([0, 0, 10]).rotate([0, 1, 0], 180).scale(50)
    scene["ball"] = {"type": "rectangle", "to_world": place, "bsdf": scene["ball"]["bsdf"]}
    energy = mistray.trace(mistray.load(scene), rays=2000, ledger=False).energy
    c = np.cos(np.radians(field_deg))
    root = np.sqrt(AU_550**2 - 1 + c * c)
    s, p = (c - root) / (c + root), (AU_550**2 * c - root) / (AU_550**2 * c + root)
    exact = 0.5 * (abs(s) ** 2 + abs(p) ** 2)
    assert 1 - energy.absorbed["ball"][0] / energy.launched_W == pytest.approx(exact, abs=2e-6)
    theirs = mi.fresnel_conductor(mi.Float(c), mi.Complex2f(AU_550.real, AU_550.imag))
    assert theirs[0] == pytest.approx(exact, abs=1e-6)


def test_tables_of_a_metal_and_a_slab_of_glass() -> None:
    for name in ("Au", "Cu", "a-C"):
        n, k = (np.loadtxt(SPD / f"{name}.{part}.spd") for part in ("eta", "k"))
        for nm in (400.0, 633.0):
            exact = complex(np.interp(nm, *n.T), np.interp(nm, *k.T))
            assert mistray.materials.complex_index(f"mitsuba/{name}", nm) == pytest.approx(exact, rel=1e-12)
    with pytest.raises(mistray.MistrayError, match=r"Mitsuba has no tables of it; the nearest are .*mitsuba/Cu, "):
        mistray.materials.complex_index("mitsuba/CU", 550.0)
    # A cube whose faces have one `dielectric`: (1 - R)² goes straight through at 25°
    scene = scene_of(None, field_deg=25.0)
    scene["ball"] = {"type": "cube", "to_world": T().translate([0, 0, 10]).scale(9), "bsdf": {"type": "dielectric"}}
    t = mistray.trace(mistray.load(scene), rays=2000, max_reflections=0)
    R = float(mi.fresnel(mi.Float(np.cos(np.radians(25.0))), 1.5046 / 1.000277)[0][0])
    assert t.paths[0].power_W / t.energy.launched_W == pytest.approx((1 - R) ** 2, rel=1e-5)
    assert t.energy.cut["medium"] == 0


@pytest.mark.long
class TestPlate:
    """A diffuse plate under a distant lamp, and a black meter that sees it."""

    E, RHO = 3.0, 0.6

    def scene(self, bsdf: dict[str, Any], turned: float = 180.0) -> dict[str, Any]:
        place = T().translate([0, 0, 20]).rotate([0, 1, 0], turned).scale(5)
        seen = T().translate([30, 0, -40]).rotate([0, 1, 0], -26.565051)
        irradiance = {"type": "spectrum", "value": self.E}
        black = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 0.0}}
        lid = seen.translate([0, 0, -0.1]).scale(2)  # against light on its back, which a trace would count
        return {
            "type": "scene",
            "lamp": {"type": "directional", "direction": [0, 0, 1], "irradiance": irradiance},
            "plate": {"type": "rectangle", "to_world": place, "bsdf": bsdf},
            "meter": black | {"to_world": seen, "sensor": scene_dicts.meter(1)},
            "lid": black | {"to_world": lid},
        }

    def exact(self) -> float:
        """Irradiance of the meter's middle, far away: ρ E/π · A cos θ/d²; the plate's size counts 1 %."""
        return self.RHO * self.E / np.pi * 100.0 * (60 / np.hypot(60, 30)) / (60**2 + 30**2)

    @pytest.mark.parametrize(
        "bsdf",
        [
            {"type": "diffuse", "reflectance": 0.6},
            {"type": "twosided", "a": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.6}}},
            {"type": "diffuse", "reflectance": spectrum((400, 0.3), (550, 0.6), (700, 0.5))},
        ],
    )
    def test_a_trace_agrees_with_mitsubas_renderer(self, bsdf: dict[str, Any]) -> None:
        given = self.scene(bsdf)
        path = mi.load_dict({"type": "path"})
        ours = mistray.load(given)
        t = mistray.trace(ours, rays=200_000, ledger=False)
        found, error = t.energy.detected_W / 4, t.energy.detected_se_W / 4
        assert found == pytest.approx(self.exact(), rel=0.01, abs=4 * error)
        assert error < 0.01 * found
        image = np.mean(mi.render(ours, spp=100_000, integrator=path))
        assert image == pytest.approx(self.exact(), rel=0.06)  # of 2 000 paths
        if "value" not in str(bsdf.get("reflectance", "")):  # three colours of Mitsuba are no wavelength
            theirs = np.mean(mi.render(mi.load_dict(given), spp=100_000, integrator=path))
            assert image == pytest.approx(theirs, rel=1e-4)

    def test_it_is_black_from_behind(self) -> None:
        given = self.scene({"type": "diffuse", "reflectance": 0.6}, turned=0.0)
        assert not np.any(mi.render(mi.load_dict(given), spp=64, integrator=mi.load_dict({"type": "path"})))
        with pytest.warns(mistray.MistrayWarning, match="no light reaches the detector"):
            assert mistray.trace(mistray.load(given), rays=2000).energy.detected_W == 0
        both = self.scene({"type": "twosided", "a": {"type": "diffuse", "reflectance": 0.6}}, turned=0.0)
        energy = mistray.trace(mistray.load(both), rays=200_000, ledger=False).energy
        assert energy.detected_W / 4 == pytest.approx(self.exact(), rel=0.01, abs=energy.detected_se_W)


def test_a_lamp_without_bsdf_is_black_and_mitsubas_own_loaders() -> None:
    scene = scene_of({"type": "dielectric"})
    with refused(r"'dielectric', .*; load the scene by mistray\.load"):
        mistray.trace(mi.load_dict(scene), rays=10)
    scene["beam"] = {"type": "rectangle", "emitter": {"type": "area", "radiance": 1.0}}
    lamp = {shape.id(): shape for shape in mistray.load(scene).shapes()}["beam"]
    assert str(lamp.bsdf()) == "Interface[air | air, R = 0, T = 0]"


REFUSED = {
    "'diffuse', .*with a reflectance that is one number, or nest an 'interface'": [
        None,
        {"type": "diffuse", "reflectance": rgb(0.1, 0.2, 0.3)},
        {"type": "diffuse", "reflectance": {"type": "checkerboard"}},
    ],
    r"'diffuse' \(twosided\), .*load the scene by mistray.load": [
        {"type": "twosided", "a": {"type": "diffuse"}, "b": {"type": "plastic"}}
    ],
    "'dielectric', .*without specular factors": [{"type": "dielectric", "specular_transmittance": 0.5}],
    "'conductor', .*eta and k of a metal": [
        {"type": "conductor", "eta": rgb(0.1, 0.2, 0.3), "k": 3.0},
        {"type": "conductor", "eta": 1.5, "k": 0.01},
        {"type": "conductor", "material": "TiO2"},
        {"type": "conductor", "material": "Au", "specular_reflectance": 0.5},
    ],
    "'thindielectric', .*both faces of the plate": [{"type": "thindielectric"}],
    "'plastic', .*'paint' of b0": [{"type": "plastic"}],
    "'roughplastic', .*'paint' of b0": [{"type": "roughplastic"}],
    "'roughconductor', .*'harvey_shack'": [{"type": "roughconductor"}],
    "'roughdielectric', .*'k_correlation'": [{"type": "roughdielectric"}],
    "'principled', .*'paint'": [{"type": "principled"}],
    "'principledthin', .*'paint'": [{"type": "principledthin"}],
    "'null', .*take the shape out": [{"type": "null"}],
    "'BlendBSDF', .*nest an 'interface'": [
        {"type": "blendbsdf", "weight": 0.5, "a": {"type": "diffuse"}, "b": {"type": "plastic"}}
    ],
}


@pytest.mark.parametrize("words", REFUSED)
def test_others_are_refused_by_name(words: str) -> None:
    for bsdf in REFUSED[words]:
        scene = mistray.load(scene_of(bsdf))  # for pictures it is right
        with pytest.raises(mistray.MistrayError, match=f"^shape 'ball' carries the BSDF {words}[^\n]*$"):
            mistray.trace(scene, rays=10)


@pytest.mark.parametrize(
    ("bsdf", "words"),
    [
        ({"type": "diffuse", "reflectance": 1.5}, "reflectance is 1.5; it must lie between 0 and 1"),
        ({"type": "diffuse", "reflectance": spectrum((400, 0.1), (500, 1.2))}, "reflectance is 1.2; it must lie"),
        ({"type": "conductor", "specular_reflectance": -0.5}, "specular_reflectance is -0.5; it must lie"),
        ({"type": "conductor", "material": "Gold"}, "material 'mitsuba/Gold': Mitsuba has no tables of it; the"),
        ({"type": "dielectric", "int_ior": "glass"}, "Unable to find an IOR value"),
        ({"type": "diffuse", "reflektance": 0.3}, "unknown parameter 'reflektance'"),
    ],
)
def test_mistakes_are_named(bsdf: dict[str, Any], words: str) -> None:
    with refused(words, f"{bsdf['type']} of sphere 'ball'"):
        mistray.load(scene_of(bsdf))


MATERIALS = vectors.text("mitsuba_materials.xml")
ROOM = vectors.text("mitsuba_room.xml")


@pytest.mark.long
def test_a_scene_as_users_of_mitsuba_write_it(tmp_path: Path) -> None:
    """Includes, parameters, shared materials, a file of a spectrum, `lookat`: all is traced, and energy closes."""
    (tmp_path / "materials.xml").write_text(MATERIALS)
    (tmp_path / "white.spd").write_text("# nm r\n360 0.7\n500 0.8\n830 0.9\n")
    (tmp_path / "scene.xml").write_text(ROOM)
    scene = mistray.load(tmp_path / "scene.xml")
    t = mistray.trace(scene, rays=5000)
    assert abs(t.energy.closure) < 1e-6
    assert {path.events for path in t.paths[:2]} == {"board:A", "ball:T ball:T board:A"}
    params = mi.traverse(scene)
    assert (params["black.paint.reflectance"][0], params["glass.n_front_shift"][0]) == (pytest.approx(0.05), 0)
    materials = MATERIALS.partition("\n")[2].removesuffix("</scene>\n")
    older = ROOM.replace("3.0.0", "0.6.0").replace("max_depth", "maxDepth")  # its parameters are in camel case
    (tmp_path / "scene.xml").write_text(older.replace('<include filename="materials.xml"/>', materials))
    assert mistray.trace(mistray.load(tmp_path / "scene.xml"), rays=5000).energy.detected_W == t.energy.detected_W

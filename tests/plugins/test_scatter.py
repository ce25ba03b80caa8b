"""The scatter plugins as parts of a scene: properties, nesting, `mi.traverse`, messages, stock integrators."""

from __future__ import annotations

import dataclasses
import gc
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.statistics import assert_z
from scatter_surfaces import IMPORTANCE, MODELS, context, direction, interaction, surface, vectors, write_table

import mistray
from mistray import MistrayError
from mistray.scatter.kinds import KINDS
from mistray.scene.messages import parameters

T = mi.ScalarTransform4f
# Fields of models that the plugins read from a file or by the names of coefficients
DATA_FIELDS = {"name", "samples", "coefficients", "frequency_1_um", "psd_um4"}
SHAPE = {"type": "asphere", "semi_diameter": 5.0}
BEAM = {"type": "collimated", "radius": 2.0}
DETECTOR = {
    **SHAPE,
    "to_world": T().translate([0, 0, 20]),
    "bsdf": {"type": "interface", "R": 0.0},
    "sensor": {"type": "irradiancemeter", "film": {"type": "hdrfilm", "rfilter": {"type": "box"}}},
}


def xml_of(values: dict[str, Any]) -> str:
    """A nested bsdf as XML."""
    tags = {float: "float", bool: "boolean", str: "string"}
    inside = "".join(
        f'<{tags[type(value)]} name="{key}" value="{str(value).lower() if isinstance(value, bool) else value}"/>'
        for key, value in values.items()
        if key != "type"
    )
    return f'<bsdf type="{values["type"]}">{inside}</bsdf>'


class TestScene:
    @pytest.mark.parametrize("name", MODELS)
    def test_xml_and_dict_are_one_model(self, name: str) -> None:
        by_dict = mi.load_dict({"type": "interface", "back": "1.5", "bsdf": MODELS[name]})
        by_xml = mi.load_string(
            f'<bsdf version="3.0.0" type="interface"><string name="back" value="1.5"/>{xml_of(MODELS[name])}</bsdf>'
        )
        assert str(by_dict) == str(by_xml)
        (model,) = by_dict.scatter
        assert type(model) is KINDS[MODELS[name]["type"]]
        held = vars(model) | dict(getattr(model, "coefficients", ()))
        for key, value in MODELS[name].items():
            if key not in ("type", "file"):
                found = held[key]
                assert found == (pytest.approx(value, rel=1e-6) if isinstance(value, float) else value)

    def test_every_model_has_its_plugin(self, tmp_path: Path) -> None:
        for kind, model in KINDS.items():
            values = write_table(tmp_path) if kind == "tabulated" else MODELS[kind]
            plugin = mi.load_dict(values)
            assert plugin.kind == kind
            assert type(plugin.model) is model
            assert plugin.scatter == (plugin.model,)

    @pytest.mark.parametrize("kind", KINDS)
    def test_the_manual_names_every_property(self, kind: str) -> None:
        fields = {field.name for field in dataclasses.fields(KINDS[kind])} - DATA_FIELDS
        if kind == "particulate":
            fields -= {"relative_to"}  # a share of the specular beam by nature
        assert fields <= set(parameters(kind))

    def test_an_interface_without_scatter(self) -> None:
        bsdf = mi.load_dict({"type": "interface", "back": "1.5"})
        assert bsdf.scatter == ()
        assert bsdf.component_count() == 2

    def test_several_models_with_a_coating(self) -> None:
        models = {"dust": MODELS["particulate"], "polish": MODELS["harvey_shack"], "scratch": MODELS["abg"]}
        bsdf = mi.load_dict(
            {"type": "interface", "back": "1.5", "coat": {"type": "thinfilm", "preset": "bbar3"}, **models}
        )
        assert [type(model).__name__ for model in bsdf.scatter] == ["Particulate", "HarveyShack", "ABg"]
        assert bsdf.film.kind == "thinfilm"
        keys = mi.traverse(bsdf).keys()
        assert {"coating.thickness_nm", "particulate.level", "harvey_shack.rms_nm", "abg.A"} <= set(keys)

    def test_two_of_a_kind_and_a_shared_one(self) -> None:
        scene = mi.load_dict(
            {
                "type": "scene", "polish": MODELS["harvey_shack"],
                "a": {**SHAPE, "bsdf": {"type": "interface", "s": {"type": "ref", "id": "polish"}}},
                "b": {
                    **SHAPE, "to_world": T().translate([0, 0, 5]),
                    "bsdf": {
                        "type": "interface", "s": {"type": "ref", "id": "polish"}, "t": MODELS["abg"],
                        "u": {**MODELS["abg"], "A": 0.001},
                    },
                },
            },
            optimize=False, parallel=False,
        )  # fmt: skip
        first, second = ({shape.id(): shape.bsdf() for shape in scene.shapes()}[name] for name in "ab")
        assert first.scatterers[0] is second.scatterers[0]
        parameters = mi.traverse(scene)
        key = next(key for key in parameters.keys() if key.endswith("abg_2.A"))  # noqa: SIM118
        parameters[key] = mi.Float(0.002)
        parameters.update()
        assert [round(model.A, 6) for model in second.scatter[1:]] == [0.0025, 0.002]
        polish = [key for key in parameters.keys() if key.endswith("rms_nm")]  # noqa: SIM118
        assert len(polish) == 1, "a shared model has one set of parameters"
        parameters[polish[0]] = mi.Float(2.0)
        parameters.update()
        assert (first.scatter[0].rms_nm, second.scatter[0].rms_nm) == (2.0, 2.0)

    def test_particles_of_a_material(self, tmp_path: Path) -> None:
        """The path of a table is relative to the scene, as that of any material."""
        (tmp_path / "dust.csv").write_text("wavelength_nm,n,k\n400,1.6,0.01\n800,1.6,0.01\n", encoding="utf-8")
        (tmp_path / "scene.xml").write_text(
            '<bsdf version="3.0.0" type="particulate"><float name="level" value="300"/>'
            '<string name="particle" value="dust.csv"/></bsdf>',
            encoding="utf-8",
        )
        assert mi.load_file(str(tmp_path / "scene.xml")).model.particle == str(tmp_path / "dust.csv")

    def test_alone(self) -> None:
        """By itself it is an interface with R = 1, or R = 0 where the scatter is absolute."""
        mirror = mi.load_dict({**MODELS["abg"], "back": "1.5", "R": 0.9, "T": 0.05})
        assert set(mi.traverse(mirror).keys()) == {"R", "T", "A", "B", "g", "n_front_shift", "n_back_shift"}
        assert (float(mirror.R[0]), float(mirror.T[0])) == pytest.approx((0.9, 0.05))
        assert mirror.indices(550.0) == (1.0, 1.5)
        for name, reflectance in (("harvey_shack", 1.0), ("paint", 0.0)):
            bsdf = mi.load_dict(MODELS[name])
            assert (float(bsdf.R[0]), float(bsdf.T[0])) == (reflectance, 0.0)
        assert str(mirror) == "ABg[A = 0.0025, B = 0.001, g = 1.8, air | 1.5, R = 0.9, T = 0.05]"

    def test_update_and_refusal(self) -> None:
        bsdf = surface(MODELS["abg"])
        parameters, wi = mi.traverse(bsdf), direction(20.0, True)
        wo = vectors(np.array([[0.5, 0.3, -np.sqrt(1 - 0.34)]]))
        before = float(bsdf.eval(context(IMPORTANCE), interaction(wi, 1), wo)[0][0])
        parameters["abg.A"] = mi.Float(0.005)
        parameters.update()
        assert pytest.approx(0.005) == bsdf.scatter[0].A
        after = float(bsdf.eval(context(IMPORTANCE), interaction(wi, 1), wo)[0][0])
        assert after == pytest.approx(2 * before, rel=1e-5)
        parameters["abg.B"] = mi.Float(-1.0)
        with pytest.raises(MistrayError, match="B is -1"):
            parameters.update()
        assert float(parameters["abg.B"][0]) == pytest.approx(0.001)
        assert pytest.approx(0.001) == bsdf.scatter[0].B
        parameters["abg.B"] = mi.Float(0.001, 0.002)
        with pytest.raises(MistrayError, match="B has 2 entries"):
            parameters.update()

    @pytest.mark.parametrize(
        ("values", "message"),
        [
            ({"type": "abg", "A": 1.0, "B": 0.0, "g": 2.0}, "B is 0; give B > 1e-12"),
            ({"type": "abg", "A": 1.0, "B": 0.1}, "g is missing; give A, B, g"),
            ({"type": "abg", "A": 1.0, "B": 0.1, "g": 2.0, "event": "up"}, "event is 'up'"),
            ({"type": "harvey_shack", "b0": 1.0, "s": 1.0}, "s is 1; it must lie"),
            ({"type": "harvey_shack"}, "neither of b0 and rms_nm given"),
            ({"type": "harvey_shack", "rms_nm": 4.0, "b0": 1.0}, "both of b0 and rms_nm given"),
            ({"type": "k_correlation", "rms_nm": 1.0, "B_um": 1.0, "slope": 1.5}, "slope is 1.5"),
            ({**MODELS["k_correlation"], "theory": "rayleigh_rice_vector", "substrate": "x"}, "substrate is 'x'"),
            ({"type": "particulate", "level": 0.5}, "level is 0.5; it must lie"),
            ({"type": "particulate", "level": 400.0, "coverage_percent": 1.0}, "both of level and"),
            ({"type": "gaussian_lobe", "total": 1.5, "width": 0.1}, "total is 1.5"),
            ({"type": "paint", "reflectance": 1.5}, "reflectance is 1.5"),
            ({"type": "paint", "preset": "flat_blak"}, "did you mean 'flat_black'?"),
            ({"type": "paint", "preset": "flat_black", "reflectance": 0.1}, "preset and reflectance given"),
            ({"type": "tabulated"}, "file is missing"),
            ({"type": "tabulated", "file": "nowhere.bsdf"}, "nowhere.bsdf"),
            ({**MODELS["abg"], "R": 0.5}, "its abg 'model' has R as well; give R at the interface only"),
            ({**MODELS["abg"], "in": MODELS["abg"]}, "a BSDF is nested in it; nest both in an 'interface' instead"),
            ({**MODELS["abg"], "aa": 1.0}, "unknown parameter 'aa' = 1"),
        ],
    )  # fmt: skip
    def test_errors_name_the_shape(self, values: dict[str, Any], message: str) -> None:
        scene = {
            "type": "scene", "beam": BEAM, "detector": DETECTOR,
            "wall": {**SHAPE, "bsdf": {"type": "interface", "model": values}},
        }  # fmt: skip
        with pytest.raises(MistrayError) as caught:
            mistray.load(scene)
        text = str(caught.value)
        assert message in text
        assert "wall" in text
        assert "\n" not in text

    def test_an_impossible_sum(self) -> None:
        """R + T + scatter > 1 is refused when light is to be scattered, by surface and angle."""

        def scatter_light() -> None:
            bsdf = mi.load_dict(
                {"type": "interface", "id": "wall", "R": 0.5, "p": {"type": "paint", "reflectance": 0.6}}
            )
            bsdf.sample(mi.BSDFContext(), interaction(direction(0.0, True), 1), mi.Float(0.5), mi.Point2f(0.5))

        with pytest.raises(
            MistrayError, match=r"interface 'wall', light from the front: at .*° .*more than 1"
        ) as caught:
            scatter_light()
        del caught
        gc.collect()  # Dr.Jit traces every BSDF that is alive, also for other scenes

    def test_nothing_is_transmitted_by_an_opaque_surface(self) -> None:
        bsdf = mi.load_dict({"type": "interface", "R": 0.9, "model": MODELS["abg"]})
        sample, weight = bsdf.sample(
            mi.BSDFContext(), interaction(direction(20.0, True), 1000), dr.linspace(mi.Float, 0, 0.999, 1000),
            mi.Point2f(0.3, 0.4),
        )  # fmt: skip
        assert set(np.array(sample.sampled_component)[np.array(weight)[0] > 0]) == {0, 2}

    def test_events_and_sides(self) -> None:
        wi = {True: direction(20.0, True), False: direction(20.0, False)}
        wo = {side: vectors(np.array([[0.3, 0.2, side * np.sqrt(1 - 0.13)]])) for side in (-1, 1)}
        for event in ("reflection", "transmission"):
            for side in ("front", "back"):
                bsdf = surface({**MODELS["abg"], "event": event, "side": side})
                for from_front, light in wi.items():
                    for z, out in wo.items():
                        value = float(bsdf.eval(context(IMPORTANCE), interaction(light, 1), out)[0][0])
                        reflected = (z < 0) == from_front
                        expected = from_front == (side == "front") and reflected == (event == "reflection")
                        assert (value > 0) == expected


def furnace(bsdf: dict[str, Any], integrator: str = "path") -> mi.Scene:
    return mi.load_dict(
        {
            "type": "scene", "integrator": {"type": integrator, "max_depth": 3}, "sky": {"type": "constant"},
            "ball": {"type": "sphere", "bsdf": bsdf},
            "camera": {
                "type": "perspective", "fov": 20.0, "to_world": T().look_at([0, 0, -5], [0, 0, 0], [0, 1, 0]),
                "film": {
                    "type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"},
                    "pixel_format": "luminance",
                },
            },
        },
        optimize=False, parallel=False,
    )  # fmt: skip


class TestStockIntegrators:
    @pytest.mark.parametrize(
        "name", ["abg", "abg_narrow", "harvey_shack", "k_correlation", "gaussian_lobe", "phong", "rayleigh_rice"]
    )
    def test_white_furnace(self, name: str) -> None:
        """
        A mirror with R = 1 that scatters is invisible in even light, under `path` and at every angle.

        False-alarm probability 1e-3; 2e-4 for the interpolated totals.
        """
        image = np.array(mi.render(furnace(MODELS[name]), spp=512, seed=1))[..., 0]
        assert_z(name, image.mean(), 1.0, image.std(ddof=1) / np.sqrt(image.size), floor=2e-4)
        assert np.all(np.abs(image - 1) < 0.2)

    @pytest.mark.parametrize("reflectance", [0.04, 0.96])
    def test_lambertian_paint_is_a_diffuse_surface(self, reflectance: float) -> None:
        """A Lambertian paint under `path` looks like Mitsuba's own `diffuse`. False-alarm probability 1e-3."""
        images = [
            np.array(mi.render(furnace(bsdf), spp=256, seed=k))[..., 0]
            for k, bsdf in enumerate(
                (
                    {"type": "paint", "reflectance": reflectance},
                    {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}},
                )
            )
        ]
        error = np.sqrt(sum(image.var(ddof=1) / image.size for image in images))
        assert_z("paint", images[0].mean(), images[1].mean(), error, floor=1e-6)

    @pytest.mark.long
    @pytest.mark.parametrize("key", ["abg.A", "abg.B"])
    def test_gradient_of_a_rendering(self, key: str) -> None:
        """`prb` differentiates by the parameters of a nested model: against central differences, same seeds."""
        lamp = {
            "type": "rectangle", "to_world": T().look_at([4, 0, -4], [0, 0, 0], [0, 1, 0]),
            "light": {"type": "area", "radiance": 10.0},
        }  # fmt: skip
        scene = mi.load_dict(
            {
                "type": "scene", "integrator": {"type": "prb", "max_depth": 2}, "lamp": lamp,
                "plate": {
                    "type": "rectangle", "to_world": T().rotate([1, 0, 0], 180),
                    "bsdf": {"type": "interface", "R": 0.9, "s": {"type": "abg", "A": 0.01, "B": 0.05, "g": 2.0}},
                },
                "camera": {
                    "type": "perspective", "fov": 20.0, "to_world": T().look_at([0, 0, -5], [0, 0, 0], [0, 1, 0]),
                    "film": {
                        "type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"},
                        "pixel_format": "luminance",
                    },
                },
            },
            optimize=False, parallel=False,
        )  # fmt: skip
        parameters = mi.traverse(scene)
        full = next(name for name in parameters.keys() if name.endswith(key))  # noqa: SIM118
        at = float(parameters[full][0])

        def brightness(value: float) -> float:
            parameters[full] = mi.Float(value)
            parameters.update()
            return float(dr.mean(mi.render(scene, spp=512, seed=3).array)[0])

        step = 0.02 * at
        expected = (brightness(at + step) - brightness(at - step)) / (2 * step)
        brightness(at)
        dr.enable_grad(parameters[full])
        parameters.update()
        dr.backward(dr.mean(mi.render(scene, parameters, spp=512, seed=3).array))
        got = float(dr.grad(parameters[full])[0])
        assert abs(expected) > 1e-3, "a case that shows nothing"
        assert got == pytest.approx(expected, rel=0.02)

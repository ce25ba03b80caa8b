"""The scatter plugins as parts of a scene: properties, nesting, `mi.traverse`, messages, stock integrators."""

import gc
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from refusals import refused
from scatter_surfaces import IMPORTANCE, MODELS, context, direction, interaction, surface, vectors, write_table

from mistray import MistrayError
from mistray.scatter.kinds import OWN_KINDS

T = mi.ScalarTransform4f
SHAPE = {"type": "asphere", "semi_diameter": 5.0}


class TestScene:
    def test_every_model_has_its_plugin(self, tmp_path: Path) -> None:
        given = [*MODELS.values(), write_table(tmp_path)]
        assert {values["type"] for values in given} == set(OWN_KINDS)
        for values in given:
            plugin = mi.load_dict(values)
            (model,) = plugin.scatter
            assert plugin.model is model
            assert type(model) is OWN_KINDS[values["type"]]
            held = vars(model) | dict(getattr(model, "coefficients", ()))
            for key, value in values.items():
                if key not in ("type", "file"):
                    assert held[key] == (pytest.approx(value, rel=1e-6) if isinstance(value, float) else value)

    def test_two_of_a_kind_and_a_shared_one(self) -> None:
        polish = {"type": "ref", "id": "polish"}
        second = {"type": "interface", "s": polish, "t": MODELS["abg"], "u": {**MODELS["abg"], "A": 0.001}}
        scene = scene_dicts.load(
            polish=MODELS["harvey_shack"],
            a={**SHAPE, "bsdf": {"type": "interface", "s": polish}},
            b={**SHAPE, "z": 5.0, "bsdf": second},
        )
        first, second = ({shape.id(): shape.bsdf() for shape in scene.shapes()}[name] for name in "ab")
        assert first.scatterers[0] is second.scatterers[0]
        parameters = mi.traverse(scene)
        parameters["b.bsdf.abg_2.A"] = mi.Float(0.002)
        polish = [key for key in parameters.keys() if key.endswith("rms_nm")]  # noqa: SIM118
        assert len(polish) == 1, "a shared model has one set of parameters"
        parameters[polish[0]] = mi.Float(2.0)
        parameters.update()
        assert [round(model.A, 6) for model in second.scatter[1:]] == [0.0025, 0.002]
        assert (first.scatter[0].rms_nm, second.scatter[0].rms_nm) == (2.0, 2.0)

    def test_particles_of_a_material(self, tmp_path: Path) -> None:
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

    def test_update_and_refusal(self) -> None:
        bsdf = surface(MODELS["abg"])
        parameters, si = mi.traverse(bsdf), interaction(direction(20.0, True), 1)
        wo = vectors(np.array([[0.5, 0.3, -np.sqrt(1 - 0.34)]]))
        before = float(bsdf.eval(context(IMPORTANCE), si, wo)[0][0])
        parameters["abg.A"] = mi.Float(0.005)
        parameters.update()
        assert float(bsdf.eval(context(IMPORTANCE), si, wo)[0][0]) == pytest.approx(2 * before, rel=1e-5)
        parameters["abg.B"] = mi.Float(-1.0)
        with pytest.raises(MistrayError, match="B is -1"):
            parameters.update()
        assert (float(parameters["abg.B"][0]), bsdf.scatter[0].B) == pytest.approx((0.001, 0.001))
        parameters["abg.B"] = mi.Float(0.001, 0.002)
        with pytest.raises(MistrayError, match="B has 2 entries"):
            parameters.update()

    def test_errors_name_the_shape(self) -> None:
        for values, words in (
            ({"type": "abg", "A": 1.0, "B": 0.1}, "g is missing; give A, B, g"),
            ({"type": "tabulated", "file": "nowhere.bsdf"}, "nowhere.bsdf"),
        ):
            with refused("wall", words):
                scene_dicts.load(wall={**SHAPE, "bsdf": {"type": "interface", "model": values}})

    def test_an_impossible_sum(self) -> None:
        """R + T + scatter > 1 is refused when light is to be scattered, by surface and angle."""
        wall = {"type": "interface", "id": "wall", "R": 0.5, "p": {"type": "paint", "reflectance": 0.6}}

        si = interaction(direction(0.0, True), 1)
        with pytest.raises(MistrayError, match=r"'wall', light from the front: at .*° .*more than 1"):
            mi.load_dict(wall).sample(mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(0.5))
        gc.collect()  # Dr.Jit traces every BSDF that is alive, also for other scenes

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

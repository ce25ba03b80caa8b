"""`thinfilm` alone and nested: parameters, errors, `mi.traverse`, and what a trace sees of it."""

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
import tmm
import vectors
from oracles.small_scenes import write
from refusals import refused

import mistray
from mistray.coatings import Ideal, preset, write_table

SAMPLE = vectors.DATA / "coating_sample.dat"
T = mi.ScalarTransform4f


def load(**values: Any) -> Any:
    return mi.load_dict({"type": "thinfilm", "id": "ar", **values})


class TestParameters:
    def test_presets_shares_and_shifts(self) -> None:
        bsdf = load(preset="bbar3", design_nm=600.0)
        for own, wanted in zip(bsdf.coating.layers, preset("bbar3", 600.0).layers, strict=True):
            assert own.material == wanted.material
            assert own.thickness_nm == pytest.approx(wanted.thickness_nm, rel=1e-7)  # parameters are float32
        mirror = load(preset="protected_al")
        assert (mirror.opaque, mirror.coating.opaque) == (True, True)
        ideal = load(R=0.1, T=0.8)
        assert isinstance(ideal.coating, Ideal)
        np.testing.assert_allclose([ideal.coating.R, ideal.coating.T], [0.1, 0.8], rtol=1e-7)
        assert load(R=0.1).opaque
        bsdf = load(layers="1.38 100, 2.1 50", n_shift="0.01, -0.02", k_shift="0 0.001")
        np.testing.assert_allclose(bsdf.coating.indices(550.0), [1.39, 2.08 + 0.001j], rtol=1e-7)

    def test_files_and_those_beside_the_scene(self, tmp_path: Path) -> None:
        assert load(table=str(write(tmp_path, "wavelength_nm,angle_deg,R,T\n550,0,.1,.9\n", "ar.csv"))).film is None
        zemax, mirror = load(table=f"{SAMPLE}:AR2"), load(table=f"{SAMPLE}:ALUM", opaque=True)
        np.testing.assert_allclose(np.array(zemax.thickness_nm), [99.8185, 0.5 * 550 / 2.05, 10.0], rtol=1e-6)
        assert (zemax.opaque, mirror.opaque) == (False, True)
        assert mirror.coating.layers[-1].thickness_nm > 500
        (tmp_path / "glass.csv").write_text("wavelength_nm,n,k\n500,1.5,0\n600,1.5,0\n")
        (tmp_path / "c.dat").write_text("MATE L\n0.55 1.38 0\nCOAT AR\nL .25\n")
        film = '<bsdf type="interface"><string name="back" value="glass.csv"/><bsdf type="thinfilm">{}</bsdf></bsdf>'
        shapes = "".join(
            f'<shape type="asphere"><float name="semi_diameter" value="1"/>{film.format(recipe)}</shape>'
            for recipe in ('<string name="layers" value="glass.csv 0.25w"/>', '<string name="table" value="c.dat:AR"/>')
        )
        file = write(tmp_path, f'<scene version="3.0.0">{shapes}</scene>')
        one, other = (shape.bsdf() for shape in mi.load_file(str(file), optimize=False, parallel=False).shapes())
        assert one.complex_indices(550.0) == (1 + 0j, 1.5 + 0j)
        assert one.coating.layers[0].thickness_nm == pytest.approx(0.25 * 550 / 1.5)
        assert other.coating.layers[0].index(550.0) == 1.38


@pytest.fixture
def scene() -> mi.Scene:
    def shape(z: float, bsdf: dict[str, Any]) -> dict[str, Any]:
        return {"type": "asphere", "semi_diameter": 5.0, "to_world": scene_dicts.at(z), "bsdf": bsdf}

    shared = {"type": "ref", "id": "ar"}
    film = {"type": "thinfilm", "layers": "1.5+0.01i 100"}
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 2.0},
        ar={"type": "thinfilm", "preset": "bbar3", "id": "ar"},
        front=shape(0, {"type": "interface", "back": "1.5168", "film": shared}),
        rear=shape(4, {"type": "interface", "front": "1.5168", "film": shared}),
        filter=shape(8, {"type": "interface", "film": film}),
        split=shape(12, {"type": "thinfilm", "R": 0.1, "T": 0.8}),
        detector=scene_dicts.detector(20, semi_diameter=5.0),
    )


KEYS = {
    *(f"{owner}.{name}" for owner in ("ar", "filter.bsdf.coating") for name in ("thickness_nm", "n_shift", "k_shift")),
    *(f"{owner}.bsdf.{name}" for owner in ("split", "detector") for name in ("R", "T")),
}


def bsdf_of(scene: mi.Scene, name: str) -> Any:
    return next(shape.bsdf() for shape in scene.shapes() if shape.id() == name)


class TestTraverse:
    def test_keys_and_owners(self, scene: mi.Scene) -> None:
        params = mi.traverse(scene)
        ours = {key for key in params.keys() if key.rsplit(".")[-1] in ("thickness_nm", "n_shift", "k_shift", "R", "T")}  # noqa: SIM118
        assert ours == KEYS
        for key in KEYS:
            assert not params.flags(key) & mi.ParamFlags.NonDifferentiable.value, key
        front, rear = bsdf_of(scene, "front"), bsdf_of(scene, "rear")
        assert front.film is rear.film, "a shared coating is one object"
        params["ar.thickness_nm"] = mi.Float([10.0, 20.0, 30.0])
        params.update()
        for bsdf in (front, rear):
            assert [layer.thickness_nm for layer in bsdf.coating.layers] == [10.0, 20.0, 30.0]
        assert bsdf_of(scene, "split").film is bsdf_of(scene, "split")
        assert bsdf_of(scene, "filter").film is not bsdf_of(scene, "filter")
        assert mi.load_dict({"type": "interface"}).film is None

    def test_the_trace_sees_an_update(self, scene: mi.Scene) -> None:
        """Normal incidence on the shared coating, on both faces: T² times the filter's and the splitter's."""
        params = mi.traverse(scene)

        def transmittance(index: list[complex], thickness: list[float]) -> float:
            return float(tmm.coh_tmm("s", index, [np.inf, *thickness, np.inf], 0, 550.0)["T"])

        for thickness in ([99.63768, 130.95238, 84.355828], [20.0, 60.0, 90.0]):
            params["ar.thickness_nm"] = mi.Float(thickness)
            params.update()
            energy = mistray.trace(scene, rays=2000, max_reflections=0).energy
            window = transmittance([1, 1.38, 2.10, 1.63, 1.5168], thickness) ** 2
            expected = window * transmittance([1, 1.5 + 0.01j, 1], [100]) * 0.8
            assert energy.detected_W / energy.launched_W == pytest.approx(expected, rel=2e-6)

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"ar.thickness_nm": [10.0, -1.0, 30.0]}, r"coating 'ar', layer 2 \(2.10\): thickness_nm is -1"),
            ({"ar.k_shift": [0.0, 0.0, -0.1]}, r"coating 'ar', layer 3 \(1.63\): n = 1.63, k = -0.1 at 550 nm"),
            ({"ar.n_shift": [float("nan")] * 3}, "n_shift is nan"),
            ({"ar.thickness_nm": [1.0, 2.0]}, "thinfilm 'ar': thickness_nm has 2 entries; it must have 3"),
            ({"ar.k_shift": [0.1] * 4, "ar.n_shift": [0.1] * 3}, "k_shift has 4 entries; it must have 3"),
            ({"split.bsdf.R": [0.5]}, r"R = 0.5 and T = 0.8"),
        ],
    )
    def test_impossible_updates_leave_everything(self, scene: mi.Scene, changes: dict[str, Any], words: str) -> None:
        params = mi.traverse(scene)
        before = {key: np.array(params[key]).copy() for key in KEYS}
        coatings = [bsdf_of(scene, name).coating for name in ("front", "split")]
        for key, values in changes.items():
            params[key] = mi.Float(values)
        with refused(words):
            params.update()
        for key, values in before.items():
            np.testing.assert_array_equal(np.array(params[key]), values, err_msg=key)
        assert [bsdf_of(scene, name).coating for name in ("front", "split")] == coatings
        params["ar.thickness_nm"] = mi.Float([10.0, 20.0, 30.0])
        params.update()
        assert bsdf_of(scene, "front").coating.layers[1].thickness_nm == 20.0


class TestTrace:
    @staticmethod
    def energy(bsdf: dict[str, Any], wavelength_nm: float = 550.0) -> Any:
        """A beam along z, a mirror at 30°, a detector in the reflected beam: shares of the light."""
        tilted = {"type": "asphere", "semi_diameter": 10.0, "to_world": T().rotate([1, 0, 0], 30.0), "bsdf": bsdf}
        aside = T().rotate([1, 0, 0], 60.0).translate([0, 0, -30])
        scene = scene_dicts.load(
            beam={"type": "collimated", "radius": 2.0, "distance": 20.0},
            mirror=tilted,
            detector=scene_dicts.detector(0, semi_diameter=10.0, to_world=aside),
        )
        energy = mistray.trace(scene, rays=1000, wavelength_nm=wavelength_nm).energy
        return energy.detected_W / energy.launched_W, energy.absorbed["mirror"][0] / energy.launched_W

    @pytest.mark.parametrize("alone", [True, False])
    def test_a_mirror(self, alone: bool) -> None:
        film = {"type": "thinfilm", "preset": "protected_ag"}
        bsdf = {**film, "mirror": True} if alone else {"type": "interface", "mirror": True, "coating": film}
        expected = preset("protected_ag").response(600.0, 1 + 0j, 1 + 0j, np.cos(np.radians([30.0])), True)
        reflected, absorbed = self.energy(bsdf, 600.0)
        assert reflected == pytest.approx(expected.R.mean(), rel=3e-6)
        assert absorbed == pytest.approx(expected.A.mean(), abs=3e-6)

    def test_tables_and_sides(self, tmp_path: Path) -> None:
        """In 1° steps a table differs by interpolation; an absorbing film reflects another share from behind."""
        film = {"type": "thinfilm", "layers": "2.1+0.3i 20, 1.46 90", "mirror": True}
        file = str(tmp_path / "t.csv")
        write_table(mi.load_dict(film).coating, Path(file), [550.0], np.arange(0.0, 90.5, 1.0), back="air")
        tables = [self.energy({"type": kind, "table": file, "mirror": True})[0] for kind in ("thinfilm", "interface")]
        front, outside, back = (self.energy({**film, "first": first})[0] for first in ("front", "outside", "back"))
        assert tables[0] == tables[1] == pytest.approx(outside, rel=1e-5)
        assert front == outside
        assert abs(front / back - 1) > 0.1

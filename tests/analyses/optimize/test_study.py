"""Studies: what they say, and one clear line for everything that is wrong."""

import copy
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import vectors
from refusals import each_refused, refused

import mistray
from mistray.analyses.optimize.study.study_scene import band, place
from mistray.analyses.optimize.study.terms import KINDS
from mistray.coatings import preset
from mistray.optimize import CoatingGroup, Metric, Moved, Optimizer, path_power, read_study

pytestmark = pytest.mark.quick
ROOT = Path(__file__).parents[3]
GOOD: dict[str, Any] = vectors.toml("good_study.toml")
LIGHT = {"term": [{"kind": "path_power", "goal": "minimise"}]}
EVERYWHERE = {**LIGHT, "coating": [{"surfaces": "all", "preset": "bbar3", "thickness_nm": [10, 200]}]}


def changed(place: str, value: Any) -> dict[str, Any]:
    """The good study with one value set, or removed if it is None."""
    study = copy.deepcopy(GOOD)
    *way, last = place.split(".")
    here: Any = study
    for key in way:
        here = here[int(key)] if key.isdigit() else here.setdefault(key, {})
    if value is None:
        del here[last]
    else:
        here[int(last) if last.isdigit() else last] = value
    return study


@pytest.fixture(scope="module")
def scene() -> Any:
    return mistray.load("cooke_triplet")


class TestReading:
    def test_values_and_defaults(self) -> None:
        study = read_study(GOOD)
        ghosts, transmission, band, layers = study.terms
        assert ghosts.own == {"selection": "ghost"}
        shared = {"field_deg": (0.0, 10.0), "wavelength_nm": (500.0, 600.0), "weights": (1.0, 3.0), "rays": 100}
        assert (ghosts.traced, ghosts.goal, ghosts.weight, ghosts.limit) == (shared, "minimise", 1.0, None)
        assert (transmission.name, transmission.traced) == ("transmission", {**shared, "rays": 50})
        assert (band.limit, band.limit_of_start, band.own) == (None, 0.5, {"low_deg": 20, "high_deg": 80})
        assert "field_deg" not in band.traced, "a PST has angles of its own"
        assert (layers.own, layers.traced) == ({"coatings": ("a",)}, {})
        assert study.optimizer == Optimizer("sqp", steps=5, patience=3, starts=4)
        vanes, paint = study.variables
        assert vanes.parameters == (Moved("vane_*.r0"), Moved("edge.r0", None, -1.0))
        assert (vanes.low, vanes.high, vanes.scale, vanes.each) == (5.0, 9.0, "linear", False)
        assert (paint.name, paint.parameters, paint.scale) == (None, (Moved("paint.A"),), "log")
        a, b = study.coatings
        assert (a.surfaces, a.bounds_nm) == (("L1_front",), ((20.0, 200.0),))
        assert [layer.material for layer in b.start.layers] == ["1.38", "2.10", "1.63"]
        assert b.bounds_nm == ((1.0, 200.0), (2.0, 201.0), (3.0, 202.0))
        # Own wavelengths of a term come without the weights of others
        (term, *_) = read_study(changed("term.0.wavelength_nm", [450, 550, 650])).terms
        assert term.traced == {"field_deg": (0.0, 10.0), "wavelength_nm": (450.0, 550.0, 650.0), "rays": 100}

    def test_starts_methods_short_forms_and_what_the_docs_show(self) -> None:
        """Several starts with coatings, a method for limits with limits, unless the study says."""
        assert read_study(changed("optimizer.starts", 7)).optimizer.starts == 7
        study = changed("term", GOOD["term"][:1])
        assert (read_study(study).optimizer.method, read_study(study).optimizer.patience) == ("lbfgsb", 2)
        del study["coating"]
        assert read_study(study).optimizer.starts == 1
        adam = read_study(changed("optimizer.method", "adam")).optimizer
        assert (adam.method, adam.patience) == ("adam", 10)
        # An entry of a list, a range of wavelengths, a thickness in waves of design_nm
        keys = ["AR.thickness_nm[2]", "vane_[12].r0", "vane_1.r[01]"]
        (group, _) = read_study(changed("variable.0.parameters", keys)).variables
        assert group.parameters == (Moved("AR.thickness_nm", 2), *map(Moved, keys[1:]))
        study = changed("trace.wavelength_nm", {"start": 450, "stop": 500, "step": 12.5})
        del study["trace"]["weights"]
        assert read_study(study).terms[0].traced["wavelength_nm"] == (450.0, 462.5, 475.0, 487.5, 500.0)
        study["coating"][0] |= {"design_nm": 600.0, "layers": "1.5 0.25w"}
        assert read_study(study).coatings[0].start.layers[0].thickness_nm == pytest.approx(100.0)
        text = (ROOT / "docs" / "optimization.md").read_text(encoding="utf-8")
        blocks = re.findall(r"^```toml\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
        assert len(blocks) >= 2
        for block in blocks:
            read_study(tomllib.loads(block))
        example = read_study(ROOT / "examples" / "triplet_ar.toml")
        assert [group.name for group in example.coatings] == ["crown", "flint"]
        for kind in KINDS:
            assert f"| `{kind}` |" in text, kind

    def test_materials_are_sought_beside_the_study(self, tmp_path: Path) -> None:
        (tmp_path / "film.csv").write_text("wavelength_nm,n,k\n400,1.4,0\n700,1.4,0\n")
        file = tmp_path / "study.toml"
        file.write_text(
            '[[term]]\nkind = "path_power"\ngoal = "minimise"\n'
            '[[coating]]\nsurfaces = "all"\nlayers = "film.csv 100"\nthickness_nm = [10, 200]\n'
        )
        layer = read_study(file).coatings[0].start.layers[0]
        assert (layer.material, layer.index(550.0)) == (str(tmp_path / "film.csv"), pytest.approx(1.4))

    def test_functions_as_kinds(self) -> None:
        def dim(scene: Any, *, angle: float, **traced: Any) -> Metric:
            return path_power(scene, **traced)

        study = changed("term.0", {"kind": dim, "goal": "minimise", "angle": 3.0})
        term = read_study(study).terms[0]
        assert (term.kind, term.name, term.own, term.traced["rays"]) == (dim, "dim", {"angle": 3.0}, 100)
        assert read_study(study).fingerprint == read_study(study).fingerprint
        del study["term"][0]["angle"]
        with refused(r"term\[1\]\.angle is missing"):
            read_study(study)

    def test_fingerprint(self) -> None:
        """It does not know how long a search may go, but all else."""
        one = read_study(GOOD).fingerprint
        for key, value in (("steps", 99), ("tolerance", 0.5), ("searches", 2), ("patience", 9)):
            assert read_study(changed(f"optimizer.{key}", value)).fingerprint == one
        others = {"optimizer.seed": 1, "optimizer.starts": 9, "optimizer.step_size": 0.1, "variable.0.high": 10}
        others |= {"coating.0.thickness_nm": [20, 201], "term.0.weight": 2, "trace.rays": 200}
        for key, value in others.items():
            assert read_study(changed(key, value)).fingerprint != one, key


class TestRefusals:
    @pytest.mark.parametrize("row", vectors.toml("study_refusals.toml")["refused"], ids=repr)
    def test_one_line_with_key_and_remedy(self, row: list[Any]) -> None:
        place, *value, message = row
        with refused(f"^study: .*{message}"):
            read_study(changed(place, *value or [None]))

    def test_coatings_that_are_made_in_python(self) -> None:
        """As in a section [[coating]]: a pair of bounds for each layer, around its start."""
        start = preset("mgf2_quarter_wave")
        each_refused(
            (((60.0, 150.0),) * 2, "bounds_nm has 2 pairs for 1 layers; give one for each layer"),
            (((120.0, 200.0),), r"its bounds are 120 … 200 nm, but layer 1 \(1.38\) starts with 99\.\d+ nm"),
            by=lambda *bounds: CoatingGroup("ar", None, start, *bounds),
            pattern="coating 'ar': {}",
        )
        study = read_study(GOOD)
        for key, name in (("term", "ghosts"), ("coating", "a")):
            several = getattr(study, f"{key}s")
            with refused(f"study 'study': {key}.name '{name}' is given twice; give every {key} a name of its own"):
                replace(study, **{f"{key}s": (*several, several[0])})

    def test_files_and_what_may_not_change(self, tmp_path: Path) -> None:
        study, file = changed("term", GOOD["term"][:1]), tmp_path / "study.toml"
        del study["coating"], study["variable"]
        each_refused(
            (study, r"study: variable is missing: nothing may change; add a section"),
            (changed("coating", None), r"term\[4\] of kind 'layer_minimum' is about layers"),
            (file, r"study '.*study\.toml': No such file"),
            by=read_study,
        )
        for text, message in (("[trace]\nrays = = 3\n", ".*line 2.*"), ("[trace]\nrays = 3\n", "term is missing")):
            file.write_text(text)
            with refused(rf"study '.*study\.toml': {message}"):
                read_study(file)


class TestSurfaces:
    def test_all(self, scene: Any) -> None:
        (placed,) = place(scene, read_study(EVERYWHERE))
        assert set(placed.surfaces) == {f"L{k}_{side}" for k in (1, 2, 3) for side in ("front", "rear")}
        pairs = {("air", glass) for glass in ("N-LAK9", "N-SF5")}
        assert set(placed.glasses) == pairs | {pair[::-1] for pair in pairs}

    @pytest.mark.parametrize(
        ("name", "left_out"), [("double_gauss", {"L2_L3", "L4_L5"}), ("phone_camera", {"L1_bevel_2", "detector"})]
    )
    def test_all_are_no_cemented_surfaces_and_no_bevels(self, name: str, left_out: set[str]) -> None:
        scene = mistray.load(name)
        (placed,) = place(scene, read_study(EVERYWHERE))
        assert left_out <= {shape.id() for shape in scene.shapes()}
        assert not left_out & set(placed.surfaces)
        assert {"L1_front", "L1_rear", "L2_front"} <= set(placed.surfaces)

    def test_refusals_and_band(self, scene: Any) -> None:
        for key, value, message in (
            ("1.surfaces", ["L2_front", "L9"], "coating 'b': the scene has no surface 'L9'; choose from L1_front"),
            ("1.surfaces", ["detector"], "coating 'b': surface 'detector' is opaque or a mirror"),
            ("1.surfaces", "all", "coating 'b': surface 'L1_front' has the coating 'a' already"),
            ("0.layers", "unobtainium 100", r"coating 'a': .*layer 1: .*unobtainium"),
        ):
            with refused(message):
                place(scene, read_study(changed(f"coating.{key}", value)))
        # That of the first term which is to be minimised; the scene's own if it names no wavelengths
        assert band(scene, read_study(GOOD)) == ((500.0, 600.0), (0.25, 0.75))
        assert band(scene, read_study({**LIGHT, "coating": GOOD["coating"]})) == ((587.5618,), (1.0,))
        study = changed("term.1.wavelength_nm", [450])
        study["term"][0]["goal"], study["term"][1] = "keep", {**study["term"][1], "goal": "minimise"}
        del study["term"][1]["limit"]
        assert band(scene, read_study(study)) == ((450.0,), (1.0,))

"""Studies: what they say, and one clear line for everything that is wrong."""

import copy
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from refusals import refused

import mistray
from mistray.analyses.optimize.study.study_scene import band, place
from mistray.analyses.optimize.study.terms import KINDS
from mistray.errors import MistrayError
from mistray.optimize import Metric, Moved, Optimizer, path_power, read_study

pytestmark = pytest.mark.quick

ROOT = Path(__file__).parents[3]
GOOD: dict[str, Any] = {
    "trace": {"field_deg": [0, 10], "wavelength_nm": [500, 600], "weights": [1, 3], "rays": 100},
    "term": [
        {"name": "ghosts", "kind": "path_power", "goal": "minimise", "selection": "ghost"},
        {"kind": "transmission", "goal": "at_least", "limit": 0.9, "rays": 50},
        {"kind": "pst_band", "goal": "at_most", "limit_of_start": 0.5, "low_deg": 20, "high_deg": 80},
        {"kind": "layer_minimum", "goal": "at_least", "limit": 10, "coatings": ["a"]},
    ],
    "coating": [
        {"name": "a", "surfaces": ["L1_front"], "layers": "MgF2 0.25w", "thickness_nm": [20, 200]},
        {"name": "b", "surfaces": ["L2_front"], "preset": "bbar3", "thickness_nm": [[1, 200], [2, 201], [3, 202]]},
    ],
    "variable": [
        {"name": "vanes", "parameters": ["vane_*.r0", {"key": "edge.r0", "factor": -1}], "low": 5, "high": 9},
        {"parameters": "paint.A", "low": 1e-4, "high": 1e-2, "scale": "log"},
    ],
    "optimizer": {"steps": 5},
}


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
        assert ghosts.traced == shared
        assert (ghosts.goal, ghosts.weight, ghosts.limit) == ("minimise", 1.0, None)
        assert transmission.name == "transmission"
        assert transmission.traced == {**shared, "rays": 50}
        assert (band.limit, band.limit_of_start, band.own) == (None, 0.5, {"low_deg": 20, "high_deg": 80})
        assert "field_deg" not in band.traced, "a PST has angles of its own"
        assert (layers.own, layers.traced) == ({"coatings": ("a",)}, {})
        assert study.optimizer == Optimizer("sqp", steps=5, patience=3, starts=4)
        vanes, paint = study.variables
        assert vanes.parameters == (Moved("vane_*.r0"), Moved("edge.r0", None, -1.0))
        assert (vanes.low, vanes.high, vanes.scale, vanes.each) == (5.0, 9.0, "linear", False)
        assert (paint.name, paint.parameters, paint.scale) == (None, (Moved("paint.A"),), "log")
        a, b = study.coatings
        assert a.surfaces == ("L1_front",)
        assert [layer.material for layer in b.start.layers] == ["1.38", "2.10", "1.63"]
        assert a.bounds_nm == ((20.0, 200.0),)
        assert b.bounds_nm == ((1.0, 200.0), (2.0, 201.0), (3.0, 202.0))

    def test_own_wavelengths_of_a_term_come_without_the_weights_of_others(self) -> None:
        (term, *_) = read_study(changed("term.0.wavelength_nm", [450, 550, 650])).terms
        assert term.traced == {"field_deg": (0.0, 10.0), "wavelength_nm": (450.0, 550.0, 650.0), "rays": 100}

    def test_starts_and_methods(self) -> None:
        """Several starts with coatings, a method for limits with limits, unless the study says."""
        assert read_study(changed("optimizer.starts", 7)).optimizer.starts == 7
        study = changed("term", GOOD["term"][:1])
        assert (read_study(study).optimizer.method, read_study(study).optimizer.patience) == ("lbfgsb", 2)
        del study["coating"]
        assert read_study(study).optimizer.starts == 1
        adam = read_study(changed("optimizer.method", "adam")).optimizer
        assert (adam.method, adam.patience) == ("adam", 10)

    def test_short_forms(self) -> None:
        """An entry of a list, a range of wavelengths, a thickness in waves of design_nm."""
        (group, _) = read_study(changed("variable.0.parameters", ["AR.thickness_nm[2]", "vane_[12].r0"])).variables
        assert group.parameters == (Moved("AR.thickness_nm", 2), Moved("vane_[12].r0"))
        study = changed("trace.wavelength_nm", {"start": 450, "stop": 500, "step": 12.5})
        del study["trace"]["weights"]
        assert read_study(study).terms[0].traced["wavelength_nm"] == (450.0, 462.5, 475.0, 487.5, 500.0)
        study["coating"][0] |= {"design_nm": 600.0, "layers": "1.5 0.25w"}
        assert read_study(study).coatings[0].start.layers[0].thickness_nm == pytest.approx(100.0)

    def test_the_studies_of_the_docs(self) -> None:
        text = (ROOT / "docs" / "optimization.md").read_text(encoding="utf-8")
        blocks = re.findall(r"^```toml\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
        assert len(blocks) >= 2
        for block in blocks:
            read_study(tomllib.loads(block))
        example = read_study(ROOT / "examples" / "triplet_ar.toml")
        assert [group.name for group in example.coatings] == ["crown", "flint"]

    def test_every_kind_is_in_the_docs(self) -> None:
        text = (ROOT / "docs" / "optimization.md").read_text(encoding="utf-8")
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
        assert layer.material == str(tmp_path / "film.csv")
        assert layer.index(550.0) == pytest.approx(1.4)

    def test_functions_as_kinds(self) -> None:
        def dim(scene: Any, *, angle: float, **traced: Any) -> Metric:
            return path_power(scene, **traced)

        study = changed("term.0", {"kind": dim, "goal": "minimise", "angle": 3.0})
        term = read_study(study).terms[0]
        assert (term.kind, term.name, term.own) == (dim, "dim", {"angle": 3.0})
        assert term.traced["rays"] == 100
        assert read_study(study).fingerprint == read_study(study).fingerprint
        del study["term"][0]["angle"]
        with pytest.raises(MistrayError, match=r"term\[1\]\.angle is missing"):
            read_study(study)

    def test_fingerprint(self) -> None:
        """It does not know how long a search may go, but all else."""
        one = read_study(GOOD).fingerprint
        for key, value in (("steps", 99), ("tolerance", 0.5), ("searches", 2), ("patience", 9)):
            assert read_study(changed(f"optimizer.{key}", value)).fingerprint == one
        others = {"optimizer.seed": 1, "optimizer.starts": 9, "optimizer.step_size": 0.1, "variable.0.high": 10}
        for key, value in (
            others | {"coating.0.thickness_nm": [20, 201], "term.0.weight": 2, "trace.rays": 200}
        ).items():
            assert read_study(changed(key, value)).fingerprint != one, key


class TestRefusals:
    @pytest.mark.parametrize(
        ("place", "value", "message"),
        [
            ("optimiser", {}, "optimiser is unknown; did you mean 'optimizer'?"),
            ("optimizer", 3, r"optimizer is 3; write a section \[optimizer\]"),
            ("term", [], r"term is missing, or all are about layers alone; add a section \[\[term\]\] about light"),
            ("term", {"a": 1}, r"term is no list of sections; write each one as \[\[term\]\]"),
            ("term.0.kind", "path_pwer", r"term\[1\]\.kind is 'path_pwer'; did you mean 'path_power'\?"),
            ("term.0.kind", None, r"term\[1\]\.kind is missing; choose from path_power, ghost_to_signal"),
            ("term.0.weight", 0, r"term\[1\]\.weight is 0; it must lie between 1e-30"),
            ("term.0.limit", 1, r"term\[1\]\.limit has no meaning with goal = \"minimise\"; remove it"),
            ("term.1.limit", None, r"term\[2\]\.limit is missing; with goal = \"at_least\" give limit or"),
            ("term.1.limit_of_start", 1, r"term\[2\]\.limit_of_start is one limit too many; with goal"),
            ("term.1.floor_of_start", 0.1, r"term\[2\]\.floor_of_start has no meaning with goal = \"at_least\""),
            ("term.2.low_deg", None, r"term\[3\]\.low_deg is missing; kind = 'pst_band' needs it"),
            ("term.2.low_deg", 80, r"term\[3\]\.\(kind 'pst_band'\): band from 80 to 80°"),
            ("term.2.low_deg", "x", r"term\[3\]\.\(kind 'pst_band'\): its arguments do not fit: "),
            ("term.3.coatings", ["c"], r"term\[4\]\.coatings names 'c'; choose from a, b"),
            ("term.3.coatings", "a", r"term\[4\]\.coatings is 'a'; give a list of names"),
            ("term.3.rays", 9, r"term\[4\]\.rays is unknown"),
            ("term.1.name", "ghosts", r"term\.name 'ghosts' is given twice"),
            ("trace.seed", 3, "trace\\.seed is unknown"),
            ("trace.rays", 0, r"trace\.rays is 0; it must be a whole number between 1"),
            ("term.2.method", "joined", r"term\[3\]\.method is unknown"),
            ("term.2.cell_deg", 0, r"term\[3\]\.cell_deg is 0; it must lie between 1e-6"),
            ("trace.field_deg", [0, 90], "is 90; it must lie between -90 and 90 degrees, both excluded"),
            ("trace.field_deg", ["x"], r"trace\.field_deg is \['x'\]; give a number or a list"),
            ("trace.field_deg", [float("nan")], "the numbers must be finite"),
            ("trace.wavelength_nm", [500, 500], "give numbers in nm, each once"),
            ("trace.wavelength_nm", {"start": 450, "stop": 500}, r"trace\.wavelength_nm has no step"),
            ("trace.wavelength_nm", {"start": 500, "stop": 450, "step": 5}, "stop must not be below start"),
            ("trace.weights", [1.0], r"trace\.weights has 1 entries for 2 wavelength_nm"),
            ("trace.weights", [1, 0], r"trace\.weights is \[1\.0, 0\.0\]; weights are greater than 0"),
            ("coating.0.name", "", r"coating\[1\]\.name is ''"),
            ("coating.0.surfaces", None, r"coating\[1\]\.surfaces is None; give a list of shape ids"),
            ("coating.0.surfaces", ["x", "x"], r"coating\[1\]\.surfaces is \['x', 'x'\]; name every surface once"),
            ("coating.0.layers", None, r"coating\[1\] has no start design; give layers or preset"),
            ("coating.0.preset", "bbar3", r"coating\[1\] has layers and preset; give layers or preset"),
            ("coating.0.layers", "MgF2", r"coating\[1\]\.layers: .*has no material and thickness"),
            ("coating.1.first", "back", r"coating\[2\]\.first stands beside a preset"),
            ("coating.1.preset", "bbar9", r"coating\[2\]\.preset: coating preset 'bbar9' is unknown"),
            ("coating.1.preset", "protected_al", r"coating\[2\]\.preset is 'protected_al', a mirror"),
            ("coating.0.design_nm", 0, r"coating\[1\]\.design_nm is 0"),
            ("coating.0.thickness_nm", None, r"coating\[1\]\.thickness_nm is missing; give it: least and greatest"),
            ("coating.0.thickness_nm", [-5, 200], "low must be at least 0 and less than high"),
            ("coating.0.thickness_nm", [120, 200], r"but layer 1 \(MgF2\) starts with 99\.\d+ nm; widen the bounds"),
            ("coating.1.thickness_nm", [[1, 200], [1, 200]], "has 2 pairs for 3 layers"),
            ("variable.0.parameters", [], r"variable\[1\]\.parameters is empty; give keys or patterns"),
            ("variable.0.parameters", [3], r"variable\[1\]\.parameters has the entry 3; give text, or"),
            ("variable.0.parameters", [{"key": "x", "factor": 0}], r"parameters\.factor is 0; the parameter would not"),
            ("variable.0.parameters", [{"factor": 2}], r"variable\[1\]\.parameters\.key is missing; it must be text"),
            ("variable.0.high", 4, r"variable\[1\]\.low is 5 and high is 4; low must be less than high"),
            ("variable.0.scale", "log", r"variable\[1\]\.parameters has a factor; with scale = \"log\""),
            ("variable.1.low", 0, r"variable\[2\]\.low is 0; with scale = \"log\" it must be greater than 0"),
            ("variable.0.each", 1, r"variable\[1\]\.each is 1; it must be true or false"),
            ("optimizer.seeds", "fresh", r"optimizer\.seeds is .fresh., which method = \"sqp\" cannot work with"),
            ("optimizer.decay", 0.9, r"optimizer\.decay has no meaning with method = \"sqp\"; remove it"),
            ("optimizer.seed", True, r"optimizer\.seed is True; it must be a whole number"),
        ],
    )
    def test_one_line_with_key_and_remedy(self, place: str, value: Any, message: str) -> None:
        with refused(f"^study: .*{message}"):
            read_study(changed(place, value))

    def test_files_and_what_may_not_change(self, tmp_path: Path) -> None:
        study, file = changed("term", GOOD["term"][:1]), tmp_path / "study.toml"
        del study["coating"], study["variable"]
        with pytest.raises(MistrayError, match=r"study: variable is missing: nothing may change; add a section"):
            read_study(study)
        with pytest.raises(MistrayError, match=r"term\[4\] of kind 'layer_minimum' is about layers"):
            read_study(changed("coating", None))
        with pytest.raises(MistrayError, match=r"study '.*study\.toml': No such file"):
            read_study(file)
        for text, message in (("[trace]\nrays = = 3\n", ".*line 2.*"), ("[trace]\nrays = 3\n", "term is missing")):
            file.write_text(text)
            with pytest.raises(MistrayError, match=rf"study '.*study\.toml': {message}"):
                read_study(file)


class TestSurfaces:
    def test_all(self, scene: Any) -> None:
        (placed,) = place(scene, read_study(EVERYWHERE))
        assert set(placed.surfaces) == {f"L{k}_{side}" for k in (1, 2, 3) for side in ("front", "rear")}
        glasses = ("N-LAK9", "N-SF5")
        assert set(placed.glasses) == {pair for glass in glasses for pair in (("air", glass), (glass, "air"))}

    @pytest.mark.parametrize(
        ("name", "left_out"), [("double_gauss", {"L2_L3", "L4_L5"}), ("phone_camera", {"L1_bevel_2", "detector"})]
    )
    def test_all_are_no_cemented_surfaces_and_no_bevels(self, name: str, left_out: set[str]) -> None:
        scene = mistray.load(name)
        (placed,) = place(scene, read_study(EVERYWHERE))
        assert left_out <= {shape.id() for shape in scene.shapes()}
        assert not left_out & set(placed.surfaces)
        assert {"L1_front", "L1_rear", "L2_front"} <= set(placed.surfaces)

    def test_refusals(self, scene: Any) -> None:
        for key, value, message in (
            ("1.surfaces", ["L2_front", "L9"], "coating 'b': the scene has no surface 'L9'; choose from L1_front"),
            ("1.surfaces", ["detector"], "coating 'b': surface 'detector' is opaque or a mirror"),
            ("1.surfaces", "all", "coating 'b': surface 'L1_front' has the coating 'a' already"),
            ("0.layers", "unobtainium 100", r"coating 'a': .*layer 1: .*unobtainium"),
        ):
            with pytest.raises(MistrayError, match=message):
                place(scene, read_study(changed(f"coating.{key}", value)))

    def test_band(self, scene: Any) -> None:
        """That of the first term which is to be minimised; the scene's own if it names no wavelengths."""
        assert band(scene, read_study(GOOD)) == ((500.0, 600.0), (0.25, 0.75))
        assert band(scene, read_study({**LIGHT, "coating": GOOD["coating"]})) == ((587.5618,), (1.0,))
        study = changed("term.1.wavelength_nm", [450])
        study["term"][0]["goal"], study["term"][1] = "keep", {**study["term"][1], "goal": "minimise"}
        del study["term"][1]["limit"]
        assert band(scene, read_study(study)) == ((450.0,), (1.0,))

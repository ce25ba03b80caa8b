"""Studies: what they say, and one clear line for everything that is wrong."""

from __future__ import annotations

import copy
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

import mistray
from mistray.errors import MistrayError
from mistray.optimize import MetricStudy, Optimizer, read_study
from mistray.optimize.designs import place, spectrum
from mistray.optimize.read_study import COATING_KEYS

ROOT = Path(__file__).parents[2]
GOOD: dict[str, Any] = {
    "metric": {"fields_deg": [0, 10], "wavelength_nm": [500, 600], "weights": [1, 3], "rays": 100},
    "coating": [
        {"name": "a", "surfaces": ["L1_front"], "layers": "MgF2 0.25w", "thickness_nm": [20, 200]},
        {"name": "b", "surfaces": ["L2_front"], "preset": "bbar3", "thickness_nm": [[1, 200], [2, 201], [3, 202]]},
    ],
    "optimizer": {"steps": 5},
}


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
        here[last] = value
    return study


@pytest.fixture(scope="module")
def scene() -> Any:
    return mistray.load("cooke_triplet")


class TestReading:
    def test_values_and_defaults(self) -> None:
        study = read_study(GOOD)
        assert study.metric.fields_deg == (0.0, 10.0)
        assert study.metric.kind == "path_power"
        assert study.metric.paths == "ghost"
        assert study.metric.flux_threshold == 0
        assert study.optimizer.steps == 5
        a, b = study.coatings
        assert a.surfaces == ("L1_front",)
        assert [layer.material for layer in b.start.layers] == ["1.38", "2.10", "1.63"]
        assert a.bounds_nm == ((20.0, 200.0),)
        assert b.bounds_nm == ((1.0, 200.0), (2.0, 201.0), (3.0, 202.0))

    def test_a_range_of_wavelengths(self) -> None:
        study = changed("metric.wavelength_nm", {"start": 450, "stop": 500, "step": 12.5})
        del study["metric"]["weights"]
        assert read_study(study).metric.wavelength_nm == (450.0, 462.5, 475.0, 487.5, 500.0)

    def test_the_file_of_the_example(self) -> None:
        study = read_study(ROOT / "examples" / "triplet_ar.toml")
        assert [group.name for group in study.coatings] == ["crown", "flint"]

    def test_the_studies_of_the_docs(self, scene: Any) -> None:
        text = (ROOT / "docs" / "optimization.md").read_text(encoding="utf-8")
        blocks = re.findall(r"^```toml\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
        assert blocks
        for block in blocks:
            placed = place(scene, read_study(tomllib.loads(block)))
            assert [item.group.name for item in placed] == ["crown", "flint"]

    def test_every_key_is_in_the_docs(self) -> None:
        text = (ROOT / "docs" / "optimization.md").read_text(encoding="utf-8")
        named = set(re.findall(r"^\| `((?:metric|coating|optimizer)\.\w+)` \|", text, re.MULTILINE))
        known = {f"metric.{key}" for key in MetricStudy.__dataclass_fields__}
        known |= {f"optimizer.{key}" for key in Optimizer.__dataclass_fields__}
        known |= {f"coating.{key}" for key in COATING_KEYS}
        assert named == known

    def test_a_thickness_in_waves_is_meant_at_design_nm(self) -> None:
        study = changed("coating.0.design_nm", 600.0)
        study["coating"][0]["layers"] = "1.5 0.25w"
        assert read_study(study).coatings[0].start.layers[0].thickness_nm == pytest.approx(100.0)

    def test_materials_are_sought_beside_the_study(self, tmp_path: Path) -> None:
        (tmp_path / "film.csv").write_text("wavelength_nm,n,k\n400,1.4,0\n700,1.4,0\n")
        file = tmp_path / "study.toml"
        file.write_text('[[coating]]\nsurfaces = "all"\nlayers = "film.csv 100"\nthickness_nm = [10, 200]\n')
        layer = read_study(file).coatings[0].start.layers[0]
        assert layer.material == str(tmp_path / "film.csv")
        assert layer.index(550.0) == pytest.approx(1.4)

    def test_fingerprint(self) -> None:
        """It does not know how long a search may go, but all else."""
        one = read_study(GOOD).fingerprint
        assert read_study(changed("optimizer.steps", 99)).fingerprint == one
        assert read_study(changed("optimizer.tolerance", 0.5)).fingerprint == one
        assert read_study(changed("metric.seed", 1)).fingerprint != one
        assert read_study(changed("coating.0.thickness_nm", [20, 201])).fingerprint != one
        assert read_study(changed("optimizer.starts", 9)).fingerprint != one


class TestRefusals:
    @pytest.mark.parametrize(
        ("place", "value", "message"),
        [
            ("metrics", {}, r"study: metrics is unknown; did you mean 'metric'\?"),
            ("metric", 3, "metric is 3; write a section"),
            ("metric.ray", 3, r"metric\.ray is unknown; did you mean 'rays'\?"),
            ("metric.kind", "power", r"metric\.kind is 'power'; choose from path_power, ghost_to_signal"),
            ("metric.paths", "phantoms", r"metric\.paths is 'phantoms'; use one of all, stray"),
            ("metric.fields_deg", [0, 95], r"metric\.fields_deg is \[0\.0, 95\.0\]; angles lie between -90 and 90"),
            ("metric.fields_deg", "0", r"metric\.fields_deg is '0'; give a number or a list"),
            ("metric.fields_deg", [], r"metric\.fields_deg is \[\]; give a number or a list"),
            ("metric.fields_deg", [float("nan")], "the numbers must be finite"),
            ("metric.wavelength_nm", [500, 500], "give positive wavelengths in nm, each once"),
            ("metric.wavelength_nm", {"start": 450, "stop": 500}, r"metric\.wavelength_nm has no step"),
            ("metric.wavelength_nm", {"start": 500, "stop": 450, "step": 5}, "stop must not be below start"),
            ("metric.wavelength_nm", {"start": 5, "stop": 9, "step": 5, "end": 1}, r"wavelength_nm\.end is unknown"),
            ("metric.weights", [1.0], r"metric\.weights has 1 entries for 2 wavelength_nm"),
            ("metric.weights", [1, 0], r"metric\.weights is \[1\.0, 0\.0\]; weights are greater than 0"),
            ("metric.rays", 0, r"metric\.rays is 0; it must be a number from 1"),
            ("metric.rays", 1.5, r"metric\.rays is 1\.5; it must be a whole number"),
            ("metric.flux_threshold", -1, r"metric\.flux_threshold is -1; it must be a number from 0 to 0\.5"),
            ("metric.seed", True, r"metric\.seed is True; it must be a number"),
            ("coating", [], "coating is missing or no section"),
            ("coating", {"a": 1}, r"coating is missing or no section; add at least one section \[\[coating\]\]"),
            ("coating.1.name", "a", "'a' is given twice"),
            ("coating.0.name", "", r"coating\[1\]\.name is ''"),
            ("coating.0.surface", "all", r"coating\[1\]\.surface is unknown; did you mean 'surfaces'\?"),
            ("coating.0.surfaces", None, r"coating\[1\]\.surfaces is None; give a list of shape ids"),
            ("coating.0.surfaces", ["x", "x"], r"coating\[1\]\.surfaces is \['x', 'x'\]; name every surface once"),
            ("coating.0.layers", None, r"coating\[1\] has no start design; give layers or preset"),
            ("coating.0.preset", "bbar3", r"coating\[1\] has layers and preset; give layers or preset"),
            ("coating.0.layers", "MgF2", r"coating\[1\]\.layers: .*has no material and thickness"),
            ("coating.0.layers", 7, r"coating\[1\]\.layers is 7; it must be text"),
            ("coating.0.first", "top", r"coating\[1\]\.layers: .*first = 'top'"),
            ("coating.1.first", "back", r"coating\[2\]\.first stands beside a preset"),
            ("coating.1.preset", "bbar9", r"coating\[2\]\.preset: coating preset 'bbar9' is unknown"),
            ("coating.1.preset", "protected_al", r"coating\[2\]\.preset is 'protected_al', a mirror"),
            ("coating.0.design_nm", 0, r"coating\[1\]\.design_nm is 0"),
            ("coating.0.thickness_nm", None, r"coating\[1\]\.thickness_nm is None; give \[low, high\]"),
            ("coating.0.thickness_nm", [20, 20], "low must be at least 0 and less than high"),
            ("coating.0.thickness_nm", [-5, 200], "low must be at least 0 and less than high"),
            ("coating.0.thickness_nm", [120, 200], r"but layer 1 \(MgF2\) starts with 99\.\d+ nm; widen the bounds"),
            ("coating.1.thickness_nm", [[1, 200], [1, 200]], "has 2 pairs for 3 layers"),
            ("optimizer.starts", 0, r"optimizer\.starts is 0; it must be a number from 1 to 100"),
            ("optimizer.stepps", 0, r"optimizer\.stepps is unknown; did you mean 'steps'\?"),
        ],
    )
    def test_one_line_with_key_and_remedy(self, place: str, value: Any, message: str) -> None:
        with pytest.raises(MistrayError, match=message) as caught:
            read_study(changed(place, value))
        assert "\n" not in str(caught.value)
        assert str(caught.value).startswith("study: ")

    def test_files(self, tmp_path: Path) -> None:
        file = tmp_path / "study.toml"
        with pytest.raises(MistrayError, match=r"study '.*study\.toml': No such file"):
            read_study(file)
        file.write_text("[metric]\nrays = = 3\n")
        with pytest.raises(MistrayError, match=r"study '.*study\.toml': .*line 2.*; correct the TOML"):
            read_study(file)
        file.write_text("[metric]\nrays = 3\n")
        with pytest.raises(MistrayError, match=r"study '.*study\.toml': coating is missing"):
            read_study(file)


class TestSurfaces:
    def test_all(self, scene: Any) -> None:
        study = read_study({"coating": [{"surfaces": "all", "preset": "bbar3", "thickness_nm": [10, 200]}]})
        (placed,) = place(scene, study)
        assert set(placed.surfaces) == {f"L{k}_{side}" for k in (1, 2, 3) for side in ("front", "rear")}
        assert set(placed.glasses) == {
            ("air", "N-LAK9"),
            ("N-LAK9", "air"),
            ("air", "N-SF5"),
            ("N-SF5", "air"),
        }

    @pytest.mark.parametrize(
        ("name", "left_out"), [("double_gauss", {"L2_L3", "L4_L5"}), ("phone_camera", {"L1_bevel_2", "detector"})]
    )
    def test_all_are_no_cemented_surfaces_and_no_bevels(self, name: str, left_out: set[str]) -> None:
        scene = mistray.load(name)
        study = read_study({"coating": [{"surfaces": "all", "preset": "bbar3", "thickness_nm": [10, 200]}]})
        (placed,) = place(scene, study)
        assert left_out <= {shape.id() for shape in scene.shapes()}
        assert not left_out & set(placed.surfaces)
        assert {"L1_front", "L1_rear", "L2_front"} <= set(placed.surfaces)

    @pytest.mark.parametrize(
        ("surfaces", "message"),
        [
            (["L2_front", "L9"], "coating 'b': the scene has no surface 'L9'; choose from L1_front"),
            (["detector"], "coating 'b': surface 'detector' is opaque or a mirror"),
            (["L1_front"], "coating 'b': surface 'L1_front' has the coating 'a' already"),
            ("all", "coating 'b': surface 'L1_front' has the coating 'a' already"),
        ],
    )
    def test_refusals(self, scene: Any, surfaces: Any, message: str) -> None:
        with pytest.raises(MistrayError, match=message):
            place(scene, read_study(changed("coating.1.surfaces", surfaces)))

    def test_materials(self, scene: Any) -> None:
        study = read_study(changed("coating.0.layers", "unobtainium 100"))
        with pytest.raises(MistrayError, match=r"coating 'a': .*layer 1: .*unobtainium"):
            place(scene, study)

    def test_band(self, scene: Any) -> None:
        assert spectrum(scene, read_study(GOOD).metric) == ((500.0, 600.0), (0.25, 0.75))
        own = read_study({"coating": GOOD["coating"]}).metric
        assert spectrum(scene, own) == ((587.5618,), (1.0,))

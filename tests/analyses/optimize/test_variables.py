"""Variables: shares of the way between bounds, groups that move together, chain rule, and what is refused."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.analyses.optimize.study.variables import Variables, find_variables
from mistray.errors import MistrayError
from mistray.metrics.parameters import Parameter, parameters
from mistray.optimize import read_study

VALUES = {
    "vane_1.r0": [11.0],
    "vane_2.r0": [12.0],
    "vane_3.r0": [14.0],
    "lens_front.curvature": [0.02],
    "lens_rear.curvature": [-0.02],
    "window.z": [0.0],
    "paint.A": [1e-3],
    "polish.A": [4e-3],
    "AR.thickness_nm": [90.0, 120.0, 60.0],
}
UNITS = {"r0": "mm", "curvature": "1/mm", "z": "mm", "A": "1/sr", "thickness_nm": "nm"}
LOWS = {"r0": 0.0, "curvature": -1.0, "z": -1e3, "A": 0.0, "thickness_nm": 0.0}


def known() -> dict[str, Parameter]:
    found = {}
    for key, value in VALUES.items():
        name = key.rsplit(".", 1)[-1]
        found[key] = Parameter(
            key, "rim", UNITS[name], np.array(value), object(), name, ("shape",), 0.1, LOWS[name], 1000.0
        )
    return found


def variables(*sections: dict[str, Any], coatings: dict[str, str] | None = None, **study: Any) -> Variables:
    content = {
        "term": [{"kind": "path_power", "goal": "minimise"}],
        "variable": [{"low": 0, "high": 100, **section} for section in sections],
        **study,
    }
    return find_variables(read_study(content), VALUES, known(), coatings or {})


VANE = "vane_1.r0"


def test_shares_of_the_way() -> None:
    """Linear, and by ratios; dx/dy by a central difference; a plugin may refuse what lies beyond the ends."""
    found = variables({"parameters": "vane_1.r0", "low": 10, "high": 14})
    (variable,) = found.variables
    assert (variable.name, variable.unit) == ("vane_1.r0", "mm")
    assert found.shares([11.0]) == pytest.approx([0.25])
    assert found.values(np.array([0.75])) == pytest.approx([13.0])
    assert found.parameters([13.5]) == {"vane_1.r0": pytest.approx(np.array([13.5]))}
    assert found.stretch([11.0]) == pytest.approx([4.0])
    found = variables({"parameters": ["paint.A"], "low": 1e-4, "high": 1e-2, "scale": "log", "name": "black"})
    assert found.names == ("black",)
    assert found.shares([1e-3]) == pytest.approx([0.5])
    assert found.values(np.array([0.0])) == pytest.approx([1e-4])
    for x in (2e-4, 5e-3):
        y = found.shares([x])
        slope = (found.values(y + 1e-6) - found.values(y - 1e-6)) / 2e-6
        assert found.stretch([x]) == pytest.approx(slope, rel=1e-6)
    found = variables({"parameters": "paint.A", "low": 1e-3, "high": 3e-3, "scale": "log"})
    for y in np.linspace(-0.1, 1.1, 97):
        assert 1e-3 <= found.values(np.array([y]))[0] <= 3e-3
    found = variables({"parameters": "vane_1.r0", "low": 11 + 1e-7, "high": 14})
    assert found.shares(found.start) == pytest.approx([0.0])


class TestGroups:
    def test_by_differences(self) -> None:
        found = variables({"parameters": "vane_*.r0", "low": 10, "high": 20, "name": "vanes"})
        (variable,) = found.variables
        assert [place.label for place in variable.places] == ["vane_1.r0[0]", "vane_2.r0[0]", "vane_3.r0[0]"]
        assert (variable.low, variable.high) == (10.0, 17.0), "the third, 3 mm larger, ends at 20"
        moved = found.parameters([15.5])
        assert [moved[f"vane_{k}.r0"][0] for k in (1, 2, 3)] == pytest.approx([15.5, 16.5, 18.5])
        found = variables({"parameters": "vane_*.r0", "low": 10, "high": 20, "each": True, "name": "vane"})
        assert found.names == ("vane vane_1.r0", "vane vane_2.r0", "vane vane_3.r0")
        assert [v.high for v in found.variables] == [20.0] * 3
        assert variables({"parameters": "vane_*.r0", "each": True}).names == ("vane_1.r0", "vane_2.r0", "vane_3.r0")

    def test_by_ratios_and_factors(self) -> None:
        """Slopes of ratios against central differences; a symmetric lens, whose other surface bends the other way."""
        found = variables({"parameters": ["paint.A", "polish.A"], "low": 1e-4, "high": 1e-2, "scale": "log"})
        (variable,) = found.variables
        assert (variable.low, variable.high) == pytest.approx((1e-4, 2.5e-3))
        assert found.parameters([5e-4])["polish.A"][0] == pytest.approx(2e-3)
        weights = {"paint.A": np.array([3.0]), "polish.A": np.array([7.0])}

        def function(x: float) -> float:
            moved = found.parameters([x])
            return float(sum(weights[key] @ moved[key] for key in weights))

        x, h = 1.5e-3, 1e-6
        assert found.slope(weights, [x])[0] == pytest.approx((function(x + h) - function(x - h)) / (2 * h), rel=1e-9)
        both = ["lens_front.curvature", {"key": "lens_rear.curvature", "factor": -1}]
        found = variables({"parameters": both, "low": 0.01, "high": 0.05})
        moved = found.parameters([0.03])
        assert (moved["lens_front.curvature"][0], moved["lens_rear.curvature"][0]) == pytest.approx((0.03, -0.03))
        slope = found.slope({"lens_front.curvature": np.array([2.0]), "lens_rear.curvature": np.array([5.0])}, [0.03])
        assert slope == pytest.approx([2.0 - 5.0])

    def test_entries_and_layers(self) -> None:
        weights = {"AR.thickness_nm": np.array([1.0, 2.0, 4.0])}
        for name, x, expected, slope in (
            ("AR.thickness_nm[1]", 150.0, [90.0, 150.0, 60.0], 2.0),
            ("AR.thickness_nm", 100.0, [100.0, 130.0, 70.0], 7.0),
        ):
            found = variables({"parameters": name, "low": 50, "high": 200})
            assert found.parameters([x])["AR.thickness_nm"] == pytest.approx(expected)
            assert found.slope(weights, [x]) == pytest.approx([slope])
        apart = variables({"parameters": "AR.thickness_nm", "low": 50, "high": 200, "each": True})
        assert apart.names == tuple(f"AR.thickness_nm[{k}]" for k in range(3))
        # Layers of coatings come first
        coating = {"name": "AR", "surfaces": "all", "layers": "1.38 90, 2.0 120", "thickness_nm": [10.0, 200.0]}
        found = variables({"parameters": "vane_1.r0"}, coatings={"AR": "AR.thickness_nm"}, coating=[coating])
        assert found.names == ("AR.thickness_nm[0]", "AR.thickness_nm[1]", "vane_1.r0")
        assert found.keys == ("AR.thickness_nm", "vane_1.r0")
        assert found.start == pytest.approx([90.0, 120.0, 11.0])


def test_what_belongs_together_in_a_scene() -> None:
    scene = mistray.load("cooke_triplet")
    params = mi.traverse(scene)
    known = parameters(scene, params)

    def keys(name: str) -> set[str]:
        section = {"parameters": name, "low": -0.01, "high": 0.01}
        study = {"term": [{"kind": "path_power", "goal": "minimise"}], "variable": [section]}
        (variable,) = find_variables(read_study(study), params, known, {}).variables
        return {place.key for place in variable.places}

    index = keys("N-SF5.index")
    assert {"L2_front.bsdf.n_back_shift", "L2_rear.bsdf.n_front_shift"} <= index
    assert all(key.startswith("L2") for key in index)
    assert {"L1_front.z", "L1_rear.z"} <= keys("L1.z")
    message = r'variable\[1\]: it changes the index .* write parameters = "N-SF5\.index"'
    with pytest.raises(MistrayError, match=message):
        keys("L2_rear.bsdf.n_front_shift")


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ([{"parameters": "vane_1.r1"}], r"variable\[1\]\.parameters: .*'vane_1\.r1'.*vane_1\.r0"),
        ([{"parameters": "van_*.r0"}], r"variable\[1\]\.parameters: .*'van_\*\.r0'"),
        ([{"parameters": "AR.thickness_nm[3]"}], r"'AR\.thickness_nm' has no entry 3; its entries are 0 to 2"),
        ([{"parameters": VANE, "low": 12}], r"low … high is 12 … 100 mm, but vane_1\.r0\[0\] starts with 11; widen"),
        (
            [{"parameters": {"key": "lens_rear.curvature", "factor": -1}, "low": 0.03, "high": 0.1}],
            r"lens_rear\.curvature\[0\] starts with -0\.02, over its factor 0\.02; widen",
        ),
        ([{"parameters": VANE, "low": -5}], r"-5 … 100 mm, but vane_1\.r0\[0\] lies between 0 and 1000; narrow"),
        ([{"parameters": [VANE, "AR.thickness_nm"]}], "have the units mm, nm; give each unit a variable"),
        (
            [{"parameters": "vane_*.r0", "low": 11, "high": 14}],
            r"its parameters start from 11 to 14, as far apart as low and high; .* or set each = true",
        ),
        ([{"parameters": "window.z", "low": 1e-3, "scale": "log"}], r"window\.z\[0\] starts with 0; widen the bounds"),
        (
            [{"parameters": VANE}, {"parameters": "vane_*.r0", "name": "vanes"}],
            r"'vane_1\.r0' and 'vanes' both move vane_1\.r0\[0\]",
        ),
        ([{"parameters": f"vane_{k}.r0", "name": "x"} for k in (1, 2)], "two variables are called 'x'"),
    ],
)
def test_refusals(sections: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(MistrayError, match=message) as caught:
        variables(*sections)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("study 'study': ")

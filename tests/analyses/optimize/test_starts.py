"""Start designs: minima of the mean square reflectance, and points within the bounds."""

from __future__ import annotations

import numpy as np
import pytest

import mistray
from mistray.analyses.optimize.study.starts import Proxy, minima, starts
from mistray.analyses.optimize.study.study_scene import PlacedDesign, place
from mistray.analyses.optimize.study.variables import Variable, VariablePlace, Variables
from mistray.optimize import read_study


def placed_coating(layers: str, surfaces: list[str], bounds: list[float]) -> PlacedDesign:
    coating = {"name": "AR", "surfaces": surfaces, "layers": layers, "thickness_nm": bounds}
    study = {"term": [{"kind": "path_power", "goal": "minimise"}], "coating": [coating]}
    (placed,) = place(mistray.load("cooke_triplet"), read_study(study))
    return placed


class TestProxy:
    def test_proxy_is_the_mean_square_of_R(self) -> None:
        """Against the coating's own response, from the air on both sides of a lens, whatever side is the front."""
        placed = placed_coating("1.38 90, 2.1 120", ["L1_front", "L1_rear"], [10.0, 200.0])
        proxy = Proxy.of(placed, (500.0, 600.0), (0.25, 0.75))
        stack = placed.stack((90.0, 120.0))
        expected = 0.0
        for nm, weight in ((500.0, 0.25), (600.0, 0.75)):
            n = mistray.materials.complex_index("N-LAK9", nm)
            for from_front, sides in ((True, (1 + 0j, n)), (False, (n, 1 + 0j))):
                answer = stack.response(nm, *sides, np.cos(np.radians([0.0, 15.0, 30.0, 45.0])), from_front)
                expected += weight * np.mean(answer.R.mean(axis=1) ** 2) / 2
        assert proxy(np.array([[90.0, 120.0], [50.0, 50.0]]))[0] == pytest.approx(expected, rel=1e-12)

    def test_minima(self) -> None:
        """Of one layer at one wavelength: odd quarter waves, the one next to the given design among them, each once."""
        placed = placed_coating("1.38 530", ["L1_front"], [20.0, 600.0])
        proxy = Proxy.of(placed, (550.0,), (1.0,))
        found = minima(proxy, placed.group.bounds_nm, np.array([530.0]), seed=0)
        quarter = min(d[0] for d in found)
        assert sorted(round(d[0] / quarter) for d in found) == [1, 3, 5]
        assert np.all(np.diff([proxy(d[None])[0] for d in found]) >= -1e-12)


class TestStarts:
    def variables(self, layers: int = 0) -> Variables:
        params = {"AR.thickness_nm": [90.0] * max(layers, 1), "vane.r0": [12.0]}
        found = [
            Variable(f"d[{k}]", "nm", 10.0, 200.0, "linear", (VariablePlace("AR.thickness_nm", k, 1.0, 90.0),))
            for k in range(layers)
        ]
        radius = Variable("r", "mm", 1.0, 100.0, "log", (VariablePlace("vane.r0", 0, 1.0, 12.0),))
        return Variables(params, [*found, radius])

    def test_latin_hypercube(self) -> None:
        """One point in each of as many equal parts of the way from bound to bound, which is one of ratios here."""
        variables = self.variables()
        given, *others = starts(variables, (), (), (), 9, 3)
        assert (given.name, given.x.tolist()) == ("given", [12.0])
        shares = sorted(float(variables.shares(start.x)[0]) for start in others)
        assert [int(8 * share) for share in shares] == list(range(8))
        again = starts(variables, (), (), (), 9, 3)
        assert [start.x.tolist() for start in again[1:]] == [start.x.tolist() for start in others]

    def test_minima_of_coatings_leave_other_variables(self) -> None:
        placed = placed_coating("1.38 90", ["L1_front"], [10.0, 400.0])
        given, *others = starts(self.variables(1), (placed,), (550.0,), (1.0,), 4, 0)
        assert given.x.tolist() == [90.0, 12.0]
        assert 1 <= len(others) <= 3, "as many as there are minima"
        assert [start.x[1] for start in others] == [12.0] * len(others)
        first = others[0]
        grid = np.linspace(10.0, 400.0, 4001)
        proxy = Proxy.of(placed, (550.0,), (1.0,))
        assert first.x[0] == pytest.approx(grid[np.argmin(proxy(grid[:, None]))], abs=0.2)
        assert first.name == "minimum 1 of the mean square R"

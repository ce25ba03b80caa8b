"""The choice of the width of zones at rims: drawn hits of a known density, and scenes whose derivatives are known."""

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.small_scenes import scene_text, shape_xml, write

import mistray
from mistray.analyses.optimize.tables import report_text
from mistray.gradients.edge_widths import AUTOMATIC, WidthErrors, least_error
from mistray.gradients.edges import kernel
from mistray.optimize import optimize, path_power, sensitivity
from mistray.settings import BATCHES

pytestmark = pytest.mark.quick

HOLE, SHADE, BEAM = 5.0, 5.1, 6.0
EXPECTED = 2 * HOLE / BEAM**2  # of the power through the hole over that of the beam, by the radius of the hole, 1/mm


def drawn(density: Any, expected: float, rng: np.random.Generator) -> np.ndarray:
    """Estimates of density(0) by width, (w, BATCHES, 1): so many hits at 1, within 5 % of a rim of radius 1."""
    delta = AUTOMATIC[0] * rng.random(rng.poisson(expected))
    delta = delta[rng.random(len(delta)) < density(delta)]
    batch = rng.integers(BATCHES, size=len(delta))
    sums = np.zeros((len(AUTOMATIC), BATCHES, 1))
    for k, width in enumerate(AUTOMATIC):
        c = np.where(delta < width, (4 - 6 * delta / width) / width, 0.0) * AUTOMATIC[0] / expected
        np.add.at(sums[k, :, 0], batch, c)
    return sums


class TestWidthErrors:
    def test_kernel(self) -> None:
        """`drawn` has the kernel of the rims, of unit area and without a first moment."""
        x = np.linspace(0.0, 0.4, 40_001)
        k = np.array(kernel(mi.Float64(x), mi.Float64(0.3)))
        np.testing.assert_allclose(k, np.where(x < 0.3, (4 - 6 * x / 0.3) / 0.3, 0.0), atol=1e-9)
        assert np.trapezoid(k, x) == pytest.approx(1.0, rel=1e-4)
        assert np.trapezoid(k * x, x) == pytest.approx(0.0, abs=1e-4)

    @pytest.mark.parametrize("edge", [1.0, 0.03, 0.0166, 0.008], ids=["none", "0.03", "0.0166", "0.008"])
    def test_light_that_ends_beside_a_rim(self, edge: float) -> None:
        """A density of 1 up to some distance: 300 errors have a mean square above 1.2² by chance below 1e-4."""
        rng, off, chosen = np.random.default_rng(1), [], []
        for _ in range(300):
            sums = drawn(lambda d: np.where(d < edge, 1.0, 0.0), 5000.0, rng)
            chosen.append(least_error([sums]))
            off.append((sums[chosen[-1]].sum() - 1) / WidthErrors.of(sums).total()[chosen[-1], 0])
        assert np.sqrt(np.mean(np.square(off))) < 1.2
        if edge == 1.0:  # the widest zone is right, and has the least noise
            assert np.mean(np.array(chosen) == 0) > 0.7


def hole() -> str:
    """A hole in the shadow of a wider one: 0.1 mm beside its rim, 2 % of its radius, there is no light any more."""
    return scene_text(
        shape_xml("frustum", "shade", -5.0, r0=SHADE, z0=0.0, r1=12.0, z1=0.0),
        shape_xml("frustum", "plate", 10.0, r0=HOLE, z0=0.0, r1=12.0, z1=0.0),
        shape_xml("asphere", "detector", 20.0, sensor=True, half_width=20.0, half_height=20.0),
        radius=BEAM,
    )


class TestGradient:
    def test_hole_in_a_beam(self, load_scene) -> None:
        """Errors of 12 seeds break the limit by chance once in 1000; zones of 5 % are off by 0.12, and say so."""
        scene = load_scene(hole())
        off, wide = [], []
        for seed in range(12):
            metric = path_power(scene, "all", rays=40_000, seed=seed)
            found = mistray.gradient(metric, mi.traverse(scene), ["plate.r0"])
            assert found.edge_width in AUTOMATIC[:-1]
            assert found.edge_width < 0.02
            off.append((found.gradient["plate.r0"][0] - EXPECTED) / found.standard_error["plate.r0"][0])
            fixed = mistray.gradient(metric, mi.traverse(scene), ["plate.r0"], edge_width=0.05)
            assert fixed.edge_width == 0.05
            wide.append((fixed.gradient["plate.r0"][0], fixed.standard_error["plate.r0"][0]))
        assert np.sqrt(np.mean(np.square(off))) < 1.65
        value, error = np.mean(wide, axis=0)
        assert value / EXPECTED == pytest.approx(1.12, abs=0.03)
        assert error > 0.1 * EXPECTED

    def test_attributes(self, load_scene) -> None:
        scene = load_scene(hole())
        metric = path_power(scene, "all", rays=4_000)
        found = mistray.gradient(metric, mi.traverse(scene), ["plate.r0", "detector.z"])
        parts = found.edge_batches["plate.r0"]
        check = (parts[found.edge_number + 1] - parts[found.edge_number]).sum(axis=0)
        assert found.edge_check["plate.r0"] == pytest.approx(check)
        assert found.edge_check_se["plate.r0"][0] > 0
        assert abs(found.edge_bias["plate.r0"][0]) >= found.edge_check_se["plate.r0"][0]
        variance = found.covariance(["plate.r0"])[0, 0]
        noise = np.std(found.batches["plate.r0"], ddof=1) * np.sqrt(BATCHES)
        assert variance == pytest.approx(noise**2 + found.edge_bias["plate.r0"][0] ** 2)
        assert found.standard_error["plate.r0"][0] ** 2 >= variance * (1 - 1e-9)
        assert f"{found.edge_width:g}" in str(found)
        assert "detector.z" not in found.edge_check
        for more in ({}, {"edge_width": 0.05}):
            table = sensitivity(metric, keys=["plate.r0"], check=False, **more)
            assert table.edge_width == more.get("edge_width", found.edge_width)
            assert table["plate.r0"].edge_check.se > 0
        assert table["plate.r0"].derivative.se > 0.05 * EXPECTED  # it holds the bias

    def test_render(self, load_scene) -> None:
        """A reverse pass chooses, later ones keep the width; a given one stays."""
        for given in ({}, {"edge_width": 0.1}):
            scene = load_scene(hole())
            params = mi.traverse(scene)
            params.keep(["plate.r0"])
            integrator = mi.load_dict({"type": "straylight", "rays": 20_000, **given})
            assert integrator.edge_width == given.get("edge_width")
            widths = []
            for _ in range(2):
                dr.enable_grad(params["plate.r0"])
                params.update()
                dr.backward(dr.sum(mi.render(scene, params, integrator=integrator).array))
                widths.append(integrator.edge_width)
            assert widths[0] == widths[1] == given.get("edge_width", widths[0])
            assert f"edge_width = {widths[0]}" in str(integrator)
            if not given:
                assert widths[0] in AUTOMATIC[:-1]


def study(**optimizer: Any) -> dict[str, Any]:
    return {
        "trace": {"rays": 4_000},
        "term": [{"name": "light", "kind": "path_power", "selection": "all", "goal": "minimise"}],
        "variable": [{"parameters": "plate.r0", "low": 4.0, "high": 5.05}],
        "optimizer": {"steps": 2, "starts": 1, **optimizer},
    }


@pytest.mark.parametrize("method", ["lbfgsb", "sqp"])
def test_a_study_keeps_its_widths(tmp_path: Path, method: str) -> None:
    scene, file = write(tmp_path, hole()), tmp_path / "state.json"
    first = optimize(scene, study(method=method), steps=1, checkpoint=file, verification_seeds=2)
    name = {"lbfgsb": "merit", "sqp": "light"}[method]
    assert first.edge_widths[name] in AUTOMATIC[:-1]
    more = optimize(scene, study(method=method), checkpoint=file, resume=True, verification_seeds=2)
    assert more.edge_widths == first.edge_widths
    assert f"{first.edge_widths[name]:g} ({name})" in report_text(more)
    if method == "lbfgsb":
        given = optimize(scene, study(edge_width=0.03), verification_seeds=2)
        assert given.edge_widths == {"merit": 0.03}
        assert "given: 0.03" in report_text(given)

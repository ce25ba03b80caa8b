"""The PST backward and forward, two samplings of one integral, on nine scenes with ghosts and scatter: differences over
their errors, a Student t of 31 degrees of freedom, as normal variables; numbers that single rays carry do not enter."""

import importlib
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, norm, t

import mistray
from mistray import Scatter, pst
from mistray.analyses.pst.forward import forward_pst
from mistray.analyses.pst.result import CLASSES, Pst
from mistray.sampling.plane_wave import Entrance
from mistray.settings import Settings

pytestmark = pytest.mark.validation

ANGLES = (0.0, 10.0, 20.0, 40.0, 60.0, 80.0)
DEGREES_OF_FREEDOM = 31
FALSE_ALARM = 1e-3  # of the chi-square test of a scene
LARGEST_ERROR = 0.25  # relative, of a number that is compared
LARGEST_SHARE = 0.1  # of a cell's scattered light in a single ray


@dataclass(frozen=True)
class Case:
    rays: tuple[float, float]  # against the light in all, and with the light at each angle
    limits: dict[str, int]
    numbers: int  # that are good enough to be compared, at least, of six at each of six angles
    dark: tuple[float, ...] = ()  # angles that no light reaches the detector from
    entrance: Entrance | None = None  # the opening of the only tube that light can come through
    sampling: dict[str, Any] = field(default_factory=dict)  # that finds rare light with the light
    polish: dict[str, float] = field(default_factory=dict)  # Harvey-Shack, of all mirrors
    seed: int = 1  # against the light


TWO_AND_ONE, ONE_AND_ONE = ({"max_reflections": most, "max_scatters": 1} for most in (2, 1))
BEYOND = (40.0, 60.0, 80.0)
FINE, ROUGH = {"rms_nm": 5.0, "l": 0.01, "s": -1.5}, {"rms_nm": 10.0, "l": 0.02, "s": -1.5}
OPENING, OFTEN = Entrance((0.0, 0.0, 0.0), 25.2), {"scatter_rays": 4, "scatter_threshold": 1e-3}
CASES = {
    "plate_and_wall": Case((1e6, 3e5), {"max_reflections": 2, "max_scatters": 2}, 20),
    # Light of 20° takes a scatter at the stop and a reflection of 1 % afterwards
    "baffle_tube": Case((2e6, 6e5), TWO_AND_ONE, 6, BEYOND, OPENING, OFTEN, seed=11),
    # With the light few rays carry what comes from 80°: 3e5 rays were 40 % low, with half of their error
    "double_gauss_barrel": Case((1e6, 1.5e6), ONE_AND_ONE, 8),
    # Against the light 0 to 4 of 3e6 rays come from 80°, none of them with seed 1; with it some 3, by aimed rays 12
    "newtonian_scatter": Case((3e6, 2e6), ONE_AND_ONE, 9, seed=2, sampling={"aimed_rays": 4}),
    "ritchey_chretien": Case((2e6, 1e6), ONE_AND_ONE, 12),
    "three_mirror_telescope": Case((4e6, 2e6), ONE_AND_ONE, 16, polish=ROUGH),
    # Light of the far sky comes in by the opening behind the object; beyond 35° it ends on the black housing
    "offner_relay": Case((1e6, 5e5), TWO_AND_ONE, 9, dark=BEYOND, polish=FINE),
    "head_up_display": Case((1e6, 5e5), TWO_AND_ONE, 24, polish=FINE),
    "phone_camera_scatter": Case((2.4e5, 1e5), ONE_AND_ONE, 14),
}
SLOW = ("phone_camera_scatter",)


def polished(name: str, polish: dict[str, float]) -> Any:
    prescription = importlib.import_module(f"mistray.scenes.{name}.prescription").build()
    scatter = (Scatter("harvey_shack", polish, name="polish"),)
    surfaces = tuple(replace(surface, scatter=scatter) for surface in prescription.surfaces)
    return replace(prescription, surfaces=surfaces).to_scene()


def both(name: str, case: Case, method: str) -> tuple[Pst, Pst]:
    scene = polished(name, case.polish) if case.polish else mistray.load(name)
    limits: dict[str, Any] = case.limits | {"flux_threshold": 0.0}
    adjoint = pst(scene, ANGLES, rays=int(case.rays[0]), seed=case.seed, method=method, **limits)
    settings = Settings.of(scene, rays=int(case.rays[1]), seed=2, **limits, **case.sampling)
    return adjoint, forward_pst(scene, adjoint.grid, entrance=case.entrance, settings=settings)


def scores(adjoint: Pst, forward: Pst, light: str) -> tuple[np.ndarray, np.ndarray]:
    """Differences of the values at the angles as normal variables, and which of them can be compared."""
    (a, a_se), (f, f_se) = adjoint.curve(light), forward.curve(light)
    seen = (a > 0) & (f > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = (a - f) / np.hypot(a_se, f_se)
        good = seen & (a_se < LARGEST_ERROR * a) & (f_se < LARGEST_ERROR * f)
    if light != "direct":
        for found in (adjoint, forward):
            assert found.largest_share is not None
            good &= ~(found.largest_share[:, 0] > LARGEST_SHARE)
    return np.sign(z) * norm.isf(t.sf(np.abs(z), DEGREES_OF_FREEDOM)), good


def check(name: str, adjoint: Pst, forward: Pst, case: Case) -> None:
    """Fails where the total differs by more than 3 standard errors, or all classes together by more than chance."""
    dark = np.isin(ANGLES, case.dark)
    for found in (adjoint, forward):
        assert np.all((found.value == 0) == dark), f"{name}, {found.method}: {found.value}"
    total, good = scores(adjoint, forward, "total")
    worst = int(np.argmax(np.where(good, np.abs(total), 0)))
    assert abs(total[worst]) < 3, (
        f"{name} at {ANGLES[worst]:g}°: {adjoint.value[worst]:.4g} ± {adjoint.standard_error[worst]:.1g} against the "
        f"light, {forward.value[worst]:.4g} ± {forward.standard_error[worst]:.1g} with it, "
        f"{total[worst]:.1f} standard errors"
    )
    found = [scores(adjoint, forward, light) for light in CLASSES]
    z = np.concatenate([z[good] for z, good in found])
    assert len(z) + np.count_nonzero(good) >= case.numbers
    probability = chi2.sf(np.sum(z**2), len(z))
    listed = ", ".join(
        f"{light} {angle:g}°: {one:.1f}"
        for light, (z, good) in zip(CLASSES, found, strict=True)
        for angle, one in zip(np.array(ANGLES)[good], z[good], strict=True)
        if abs(one) > 2
    )
    assert probability > FALSE_ALARM, f"{name}: χ² of {len(z)} numbers has the probability {probability:.1e}; {listed}"


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in CASES])
@pytest.mark.parametrize("method", ["joined", "adjoint"])
def test_scenes(name: str, method: str) -> None:
    """In both conventions; by chance a scene fails in 1.6 % (totals) and less than 1 % (classes) of the seeds."""
    case = CASES[name]
    adjoint, forward = both(name, case, method)
    assert (adjoint.method, forward.method) == (method, "forward")
    check(name, adjoint, forward, case)
    check(name, adjoint.to("projected"), forward.to("projected"), case)
    # PST_projected is PST_normal over the mean cosine of the cell
    low, high = np.radians(adjoint.grid.edges_deg).T
    cosine = 0.5 * (np.sin(high) ** 2 - np.sin(low) ** 2) / (np.cos(low) - np.cos(high))
    np.testing.assert_allclose(adjoint.to("projected").value * cosine, adjoint.value, rtol=1e-12)
    for wrong in wrongs(adjoint, cosine):
        with pytest.raises(AssertionError, match=r"standard errors|χ²"):
            check(name, wrong, forward, case)


def wrongs(found: Pst, cosine: np.ndarray) -> list[Pst]:
    """A PST times the cosine of incidence, or with once scattered light of half its strength: neither may pass."""
    half = np.where(np.array(CLASSES) == "single_scatter", 0.5, 1.0)[:, None, None, None]
    result = [replace(found, by_batch=found.by_batch * half)]
    if found.value[-1] > 0:  # light from angles where the cosine matters
        result.append(replace(found, by_batch=found.by_batch * cosine[:, None, None]))
    return result

"""Derivatives of scatter along a path by values, directions, normals, R and T, against closed forms in float64."""

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import vectors
from oracles import scatter_integrals as integrals
from oracles.derivatives import central_differences
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import scene_text, shape_xml
from scatter_forms import FORMS, WAVELENGTH_NM, Form, Light
from tiers import slow_unless

from mistray.errors import MistrayError
from mistray.gradients.scatter_gradient import fixed, scatter_gradient
from mistray.gradients.scatter_replay import ScatterEvent, ScatterReplay
from mistray.kernel.scatter_tables import ScatterTables
from mistray.kernel.scattering import Scattering
from mistray.settings import BATCHES
from mistray.surfaces.surfaces import SurfaceTable

R, T, GLASS = 0.3, 0.4, 1.5
RAYS = BATCHES // 4
# A derivative that is 2 % wrong fails everywhere.
# Largest error as a part of the largest derivative of eight rays; where a table of directions stands beside the radial
# one, or Mie's curves ripple with the level, the issue's
VALUES, COARSE = 2e-3, 1e-2
STEP, TURN = 1e-4, 1e-4  # of values, relative; of directions, rad
Load = Callable[[str], Any]


def table_of(load_scene: Load, *models: str, back: str = str(GLASS)) -> SurfaceTable:
    """A face that scatters, and a detector."""
    face = shape_xml("asphere", "face", 0.0, scattering_xml(models, "air", back, R=R, T=T), semi_diameter=50.0)
    detector = shape_xml("asphere", "detector", 60.0, sensor=True, half_width=10.0, half_height=10.0)
    return SurfaceTable(load_scene(scene_text(face, detector)), WAVELENGTH_NM)


def scattering_of(table: SurfaceTable, backward: bool) -> Scattering:
    return Scattering(ScatterTables(table, {}, backward))


def model_xml(form: Form) -> str:
    return bsdf_xml(form.kind, **form.values, **form.options)


class Rays:
    """Eight rays that a face between air and glass scatters, in a frame at random; `least` is a sine of incidence."""

    def __init__(self, reflect: bool, from_front: bool, least: float) -> None:
        self.reflect, self.from_front = reflect, from_front
        self.n_in, self.n_out = (1.0, GLASS) if from_front else (GLASS, 1.0)
        rng = np.random.default_rng((7, reflect, from_front))
        frame = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        # So far from the normal that light is refracted from either side, along the ray and against it
        sine = rng.uniform(least, 0.6, RAYS) / self.n_in
        most = 0.95 * min(1.0, self.n_in / self.n_out)
        r, psi = 10 ** rng.uniform(-2.0, -0.5, RAYS), rng.uniform(0, 2 * np.pi, RAYS)
        centre = sine if reflect else sine * self.n_in / self.n_out
        beta = np.stack([centre + r * np.cos(psi), r * np.sin(psi)], axis=1)
        beta *= np.minimum(1, most / np.linalg.norm(beta, axis=1))[:, None]
        away = np.sqrt(1 - np.sum(beta**2, axis=1)) * (-1 if reflect else 1)
        self.d = np.column_stack([sine, np.zeros(RAYS), np.sqrt(1 - sine**2)]) @ frame
        self.w = np.column_stack([beta, away]) @ frame
        self.across, self.beside, self.axis = (np.tile(row, (RAYS, 1)) for row in frame)

    def log_flux(self, form: Form, values: dict[str, float], backward: bool, *turns: float) -> np.ndarray:
        """The oracle. Along the light and against it, the flux per étendue n² cos θ dω is the same."""
        d, axis = self.d, self.axis
        if turns:
            a, b, c, e = turns
            d, axis = d + a * self.across + b * self.beside, axis + c * self.across + e * self.beside
            d, axis = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (d, axis))
        share = R if self.reflect else T
        if not backward:
            light = Light(d, self.w, axis, self.reflect, self.from_front, self.n_in, self.n_out)
            return np.log(form.bsdf(values, light, share) * light.cos_s)
        front = self.from_front == self.reflect
        sides = (self.n_in, self.n_out) if self.reflect else (self.n_out, self.n_in)
        light = Light(-self.w, -d, axis if self.reflect else -axis, self.reflect, front, *sides)
        return np.log(form.bsdf(values, light, share) * light.cos_i * (sides[0] / self.n_in) ** 2)

    def event(self, table: SurfaceTable, *turns: mi.Float64, face: str = "face") -> ScatterEvent:
        """The same for the replay."""
        d, axis, across, beside = (mi.Vector3d(v.T.copy()) for v in (self.d, self.axis, self.across, self.beside))
        if turns:
            a, b, c, e = turns
            d, axis = dr.normalize(d + a * across + b * beside), dr.normalize(axis + c * across + e * beside)
        eta, cos_i = mi.Float64(self.n_in / self.n_out), dr.dot(d, axis)
        cos_t = dr.safe_sqrt(1 - dr.square(eta) * (1 - dr.square(cos_i)))
        lanes = dr.arange(mi.UInt32, RAYS) + RAYS * (2 * self.reflect + self.from_front)
        shares = mi.Float64(R), mi.Float64(T)
        flags = mi.Bool(self.reflect), mi.Bool(self.from_front)
        s = mi.UInt32(table.ids.index(face)) + 0 * lanes
        return ScatterEvent(s, lanes, *flags, d, axis, cos_i, cos_t, eta, *shares, lambda front, cos_i: shares)

    @property
    def direction(self) -> mi.Vector3d:
        return mi.Vector3d(self.w.T.copy())

    def by_turns(self, replay: ScatterReplay, table: SurfaceTable) -> tuple[np.ndarray, np.ndarray]:
        """ln f of each ray, and its derivatives by turns of ray and normal."""
        turns = [dr.zeros(mi.Float64, RAYS) for _ in range(4)]
        dr.enable_grad(turns)
        value = replay.log_flux(self.event(table, *turns), self.direction, mi.Bool(True))
        dr.backward(dr.sum(value))
        return np.array(value), np.array([dr.grad(turn) for turn in turns])


def all_rays(form: Form, backward: bool) -> list[Rays]:
    """For events and sides where the model scatters; against a ray that is transmitted, light comes from beyond."""
    # Tables of directions are uniform in the cosine of incidence, and so coarse near the normal: 2 % of the slope there
    least = 0.25 if is_tabled(form) else 0.05
    every = [Rays(reflect, front, least) for reflect in (False, True) for front in (False, True)]
    return [r for r in every if form.scatters(r.reflect, r.from_front != (backward and not r.reflect))]


def by_values(table: SurfaceTable, backward: bool, form: Form, rays: list[Rays]) -> dict[str, dict[Rays, np.ndarray]]:
    """Derivatives of the logarithm of the flux of each ray by the values of the form that the face has."""
    scattering = scattering_of(table, backward)
    replay = ScatterReplay(scattering)
    for some in rays:
        dr.backward(dr.sum(replay.log_flux(some.event(table), some.direction, mi.Bool(True))))
    found = scatter_gradient(table, scattering, replay.derivatives(), lambda _, name: name in differentiable(form))
    parts = {r: slice(first, first + RAYS) for r in rays for first in [RAYS * (2 * r.reflect + r.from_front)]}
    return {name: {some: gradient[part, 0] for some, part in parts.items()} for _, name, gradient in found}


def assert_derivative(found: np.ndarray, expected: np.ndarray, relative: float) -> None:
    """Within a part of the largest; and a number that is wrong by 2 % is seen."""
    largest = np.max(np.abs(expected))
    assert largest > 0
    np.testing.assert_allclose(found, expected, rtol=0, atol=relative * largest)
    assert np.max(np.abs(1.02 * found - expected)) > relative * largest


def difference(function: Callable[[dict[str, float]], np.ndarray], values: dict[str, float], name: str) -> np.ndarray:
    """Central, by one of the values."""
    step = STEP * abs(values[name])
    high, low = (function(values | {name: values[name] + sign * step}) for sign in (1, -1))
    return (high - low) / (2 * step)


def is_tabled(form: Form) -> bool:
    tabled = ("ghs_full", "rayleigh_rice_vector")
    return form.kind in ("paint", "particulate", "polynomial", "psd_table") or form.options.get("theory") in tabled


def limit_of(form: Form) -> float:
    return COARSE if is_tabled(form) else VALUES


def differentiable(form: Form) -> set[str]:
    """Names of values; the theory of all orders knows one slope only."""
    return set(form.values) - ({"slope"} if form.options.get("theory") == "ghs_full" else set())


# Forms whose light differs most by the direction in which it is traced; all others backwards are slow
BACKWARD = ("abg", "paint", "rayleigh_rice", "ghs_full")
DIRECTIONS = [pytest.param(name, False, id=f"{name}-forward") for name in FORMS] + [
    pytest.param(name, True, id=f"{name}-backward", marks=slow_unless(name in BACKWARD)) for name in FORMS
]


@pytest.mark.parametrize(("name", "backward"), DIRECTIONS)
def test_flux_by_values(load_scene: Load, name: str, backward: bool) -> None:
    form = FORMS[name]
    table, rays = table_of(load_scene, model_xml(form)), all_rays(form, backward)
    found = by_values(table, backward, form, rays)
    assert set(found) == differentiable(form)
    for key, derivatives in found.items():
        for some, derivative in derivatives.items():
            expected = difference(lambda values: some.log_flux(form, values, backward), form.values, key)  # noqa: B023
            assert_derivative(derivative, expected, limit_of(form))


@pytest.mark.parametrize("name", FORMS)
def test_flux_by_direction_and_normal(load_scene: Load, name: str) -> None:
    """The direction of departure is held fixed; R and T are constant."""
    form = FORMS[name]
    table = table_of(load_scene, model_xml(form))
    for backward in (False, True):
        replay = ScatterReplay(scattering_of(table, backward))
        for rays in all_rays(form, backward):
            value, found = rays.by_turns(replay, table)

            def log_flux(*turn: float) -> np.ndarray:
                return rays.log_flux(form, form.values, backward, *turn)  # noqa: B023

            np.testing.assert_allclose(value, log_flux(), atol=2 * limit_of(form))
            expected = central_differences(log_flux, [0.0] * 4, [TURN] * 4)
            size = np.linalg.norm(expected, axis=0)
            limit = limit_of(form) * np.maximum(size, 0.1 * np.max(size))
            error = np.linalg.norm(found - expected, axis=0)
            assert np.all(error <= limit), np.max(error / limit)
            assert np.any(np.linalg.norm(1.02 * found - expected, axis=0) > limit)


class TestShares:
    """What stays in the specular beams, and what is absorbed."""

    SINES = np.linspace(0.05, 0.6, RAYS)

    def event(self, table: SurfaceTable, reflect: bool, n_out: float, sines: mi.Float64 | None = None) -> ScatterEvent:
        sine = mi.Float64(self.SINES) if sines is None else sines
        cos_i, cos_t = dr.sqrt(1 - sine * sine), dr.sqrt(1 - dr.square(sine / n_out))
        s, lanes = mi.UInt32(table.ids.index("face")), dr.arange(mi.UInt32, RAYS)
        d, axis = mi.Vector3d(sine, 0, cos_i), mi.Vector3d(0, 0, 1)
        shares = mi.Float64(R), mi.Float64(T)
        flags = mi.Bool(reflect), mi.Bool(True)
        return ScatterEvent(s, lanes, *flags, d, axis, cos_i, cos_t, mi.Float64(1 / n_out), *shares, None)

    def by_values(
        self, table: SurfaceTable, reflect: bool, n_out: float, function: Callable[..., Any], backward: bool = False
    ) -> dict[str, np.ndarray]:
        """Derivatives for eight angles of incidence."""
        scattering = scattering_of(table, backward)
        replay = ScatterReplay(scattering)
        dr.backward(dr.sum(function(replay, self.event(table, reflect, n_out), mi.Bool(True))))
        found = scatter_gradient(table, scattering, replay.derivatives(), lambda *key: fixed(*key) is None)
        return {name: gradient[:RAYS, 0] for _, name, gradient in found}

    @pytest.mark.parametrize("reflect", [True, False], ids=["reflection", "transmission"])
    @pytest.mark.parametrize("name", ["abg", "harvey_shack", "gaussian_lobe"])
    def test_kept_by_values(self, load_scene: Load, name: str, reflect: bool) -> None:
        """ln(1 - TIS) with the TIS by quadrature over the unit disc of direction cosines."""
        form = FORMS[name]
        profiles = {
            "abg": lambda v: integrals.abg(v["A"], v["B"], v["g"]),
            "harvey_shack": lambda v: integrals.harvey_shack(v["b0"], v["l"], v["s"]),
            "gaussian_lobe": lambda v: lambda r: integral_peak(v) * np.exp(-((r / v["width"]) ** 2)),
        }
        table = table_of(load_scene, model_xml(form))
        for backward in (False, True):
            # Of the specular direction; against a ray into the glass light comes out of it
            sines = self.SINES if reflect or backward else self.SINES / GLASS

            def log_kept(values: dict[str, float]) -> np.ndarray:
                profile = profiles[name](values)
                return np.log1p(-np.array([integrals.total_scatter(profile, sine) for sine in sines]))  # noqa: B023

            found = self.by_values(table, reflect, GLASS, ScatterReplay.log_kept, backward)
            assert set(found) == set(form.values)
            for key, derivative in found.items():
                assert_derivative(derivative, difference(log_kept, form.values, key), VALUES)

    def test_absorbed_by_values(self, load_scene: Load) -> None:
        """Absolute scatter takes nothing from the beams: a Lambertian of reflectance ρ leaves 1 - R - T - ρ."""
        table = table_of(load_scene, bsdf_xml("paint", reflectance=0.05))
        found = self.by_values(table, True, GLASS, ScatterReplay.absorbed)
        assert_derivative(found["reflectance"], -np.ones(RAYS), 1e-5)

    def test_kept_by_angle(self, load_scene: Load) -> None:
        """By the sine of incidence, both events; the slope jumps a little at each of the 257 cosines of the table."""
        form = FORMS["abg"]
        table, profile = table_of(load_scene, model_xml(form)), integrals.abg(*form.values.values())
        for reflect in (True, False):
            sine = mi.Float64(self.SINES)
            dr.enable_grad(sine)
            replay = ScatterReplay(scattering_of(table, False))
            dr.backward(dr.sum(replay.log_kept(self.event(table, reflect, GLASS, sine), mi.Bool(True))))

            def log_kept(turn: float) -> np.ndarray:
                sines = (self.SINES + turn) / (1 if reflect else GLASS)  # noqa: B023
                return np.log1p(-np.array([integrals.total_scatter(profile, sine) for sine in sines]))

            (expected,) = central_differences(log_kept, [0.0], [1e-3])
            assert_derivative(np.array(dr.grad(sine)), expected, COARSE)


def integral_peak(values: dict[str, float]) -> float:
    """Of a Gaussian with this total at normal incidence."""
    return values["total"] / (np.pi * values["width"] ** 2 * -np.expm1(-(values["width"] ** -2)))


def test_shares_of_the_coating(load_scene: Load) -> None:
    """d ln f/dR: 1/R where scatter is a share of R, 0 where it is absolute; the same backwards."""
    for name, expected in (("abg", 1 / R), ("abg absolute", 0.0)):
        table = table_of(load_scene, model_xml(FORMS[name]))
        for backward in (False, True):
            replay, rays = ScatterReplay(scattering_of(table, backward)), Rays(True, True, 0.05)
            event, share = rays.event(table), mi.Float64(R) + dr.zeros(mi.Float64, RAYS)
            dr.enable_grad(share)
            event.R, event.coating = share, lambda front, cos_i: (share, mi.Float64(T))  # noqa: B023
            dr.backward(dr.sum(replay.log_flux(event, rays.direction, mi.Bool(True))))
            np.testing.assert_allclose(np.array(dr.grad(share)), expected, rtol=1e-6)


class TestPlugins:
    """Two faces with equal models."""

    ABG = FORMS["abg"]

    def table(self, load_scene: Load, *nested: str) -> SurfaceTable:
        faces = [
            shape_xml("asphere", f"face_{k}", 5.0 * k, scattering_xml([model], R=R, T=T), semi_diameter=50.0)
            for k, model in enumerate(nested)
        ]
        shared = model_xml(self.ABG).replace("<bsdf ", '<bsdf id="polish" ', 1)
        detector = shape_xml("asphere", "detector", 60.0, sensor=True, half_width=10.0, half_height=10.0)
        return SurfaceTable(load_scene(scene_text(shared, *faces, detector)), WAVELENGTH_NM)

    def by_amplitude(self, table: SurfaceTable, *faces: str) -> list[float]:
        """By A of each plugin, of the sum of ln f of the rays at these faces, times A: their number."""
        scattering, rays = scattering_of(table, False), Rays(True, True, 0.05)
        replay = ScatterReplay(scattering)
        for face in faces:
            dr.backward(dr.sum(replay.log_flux(rays.event(table, face=face), rays.direction, mi.Bool(True))))
        found = scatter_gradient(table, scattering, replay.derivatives(), lambda _, name: name == "A")
        return [self.ABG.values["A"] * float(gradient.sum()) for _, _, gradient in found]

    def test_whose_derivative_it_is(self, load_scene: Load) -> None:
        """A shared plugin has the sum; two do not mix, though the kernel has one table; on one face they share."""
        shared, two = '<ref id="polish"/>', [model_xml(self.ABG)] * 2
        for table, faces, expected in (
            (self.table(load_scene, shared, shared), ("face_0", "face_1"), [2 * RAYS]),
            (self.table(load_scene, *two), ("face_1",), [0.0, RAYS]),
            (table_of(load_scene, *two), ("face",), [RAYS / 2, RAYS / 2]),
        ):
            assert self.by_amplitude(table, *faces) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("kind", "name", "values", "why"), vectors.toml("refusals.toml")["values without derivative"])
def test_values_without_derivative(load_scene: Load, kind: str, name: str, values: dict[str, float], why: str) -> None:
    table = table_of(load_scene, bsdf_xml(kind, **values))
    (plugin,) = table.optics.bsdfs[table.ids.index("face")].scatterers
    assert fixed(plugin, name) == why
    scattering = scattering_of(table, False)
    derivatives = ScatterReplay(scattering).derivatives() if scattering.any else {}
    with pytest.raises(MistrayError, match=f"{why}, where it has no derivative"):
        list(scatter_gradient(table, scattering, derivatives, lambda _, key: key == name))
    assert all(fixed(plugin, other) is None for other in values if other in plugin.values and other != name)


def test_ends_of_ranges_and_rays_that_do_not_matter(load_scene: Load) -> None:
    """B = 0 of a Lambertian has a derivative to one side: f = A/(1 + B), d ln f/dB = -1."""
    table = table_of(load_scene, bsdf_xml("abg", A=0.1, B=0.0, g=0.0))
    scattering, rays = scattering_of(table, False), Rays(True, True, 0.05)
    replay = ScatterReplay(scattering)
    dr.backward(dr.sum(replay.log_flux(rays.event(table), rays.direction, mi.Bool(True))))
    ((_, _, gradient),) = scatter_gradient(table, scattering, replay.derivatives(), lambda _, name: name == "B")
    assert gradient.sum() == pytest.approx(-RAYS, rel=1e-4)
    # Lanes that are not active have no value and no derivative, whatever their numbers are
    table = table_of(load_scene, *map(model_xml, (FORMS["paint"], FORMS["ghs"])))
    for backward in (False, True):
        replay, rays = ScatterReplay(scattering_of(table, backward)), Rays(False, True, 0.05)
        turns = [mi.Float64([0.0] * (RAYS - 2) + [np.nan, np.inf]) for _ in range(4)]
        dr.enable_grad(turns)
        active = dr.arange(mi.UInt32, RAYS) < RAYS - 2
        event = rays.event(table, *turns)
        value = replay.log_flux(event, rays.direction, active) + replay.log_kept(event, active)
        dr.backward(dr.sum(value + replay.absorbed(event, active)))
        assert np.all(np.array(value)[-2:] == 0)
        assert all(np.all(np.isfinite(values)) for values in replay.derivatives().values())


@pytest.mark.parametrize("name", ["ghs", "rayleigh_rice_vector", "ghs_full", "particulate"])
def test_directions_without_azimuth_or_slope(load_scene: Load, name: str) -> None:
    """Normal incidence, the specular direction itself, and the plane of incidence: derivatives are finite numbers."""
    table = table_of(load_scene, model_xml(FORMS[name]))
    for backward in (False, True):
        replay, rays = ScatterReplay(scattering_of(table, backward)), Rays(True, True, 0.05)
        angle = np.array([0.0, 0.0, 0.0, 0.3, 0.3, 0.3, 0.3, 0.3])
        out = np.array([0.0, 0.2, -0.2, 0.3, 0.4, 0.2, -0.1, 0.0])
        rays.across, rays.beside, rays.axis = (np.tile(row, (RAYS, 1)) for row in np.eye(3))
        rays.d = np.column_stack([np.sin(angle), np.zeros(RAYS), np.cos(angle)])
        rays.w = np.column_stack([np.sin(out), np.zeros(RAYS), -np.cos(out)])
        _, found = rays.by_turns(replay, table)
        assert np.all(np.isfinite(found))
        # What scatters is the same on both sides of the plane of incidence
        np.testing.assert_allclose(found[[1, 3]], 0, atol=1e-3 * np.max(np.abs(found)))

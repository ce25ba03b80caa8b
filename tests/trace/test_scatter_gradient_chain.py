"""Derivatives of scatter along a path: by the models' values, by directions and normals, by R and T.

The tables, their replay and the chain to the values are held against central differences of closed forms in float64,
`oracles.scatter_forms`, which know nothing of tables. The 32 batches of start rays are 32 directions here, so that each
has a derivative of its own. The limit of the issue is 1e-2; models are smooth and tables are good to 1e-4, so the limits
are lower where nothing speaks against it, and a derivative that is 2 % wrong fails.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.derivatives import central_differences
from oracles.scatter_forms import FORMS, WAVELENGTH_NM, Form, Light
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import scene_text, shape_xml

from mistray.errors import MistrayError
from mistray.trace.ledger import BATCHES
from mistray.trace.scatter_gradient import fixed, scatter_gradient
from mistray.trace.scatter_replay import ScatterEvent, ScatterReplay
from mistray.trace.scatter_tables import ScatterTables
from mistray.trace.scattering import Scattering
from mistray.trace.surfaces import SurfaceTable

R, T, GLASS = 0.3, 0.4, 1.5
VALUES = (
    2e-3  # of the largest of 32 directions; tables to 1e-4, particles with the ripple of Mie's curves in their level
)
GEOMETRY = 5e-3  # of the gradient by direction and normal: the same, and ratios in straight lines between nodes
TOTALS = 2e-3  # straight lines over the angle of incidence
STEP = 1e-3  # relative
TURN = 1e-4  # rad
Load = Callable[[str], Any]


def tables_of(load_scene: Load, *models: str, back: str = str(GLASS), faces: int = 1) -> SurfaceTable:
    """A scene of scattering faces and a detector, at the wavelength of the forms."""
    face = scattering_xml(models, "air", back, R=R, T=T)
    shapes = [shape_xml("asphere", f"face_{k}", 5.0 * k, face, semi_diameter=50.0) for k in range(faces)]
    detector = shape_xml("asphere", "detector", 60.0, sensor=True, half_width=10.0, half_height=10.0)
    return SurfaceTable(load_scene(scene_text(*shapes, detector)), WAVELENGTH_NM)


def scattering_of(table: SurfaceTable, backward: bool) -> Scattering:
    return Scattering(ScatterTables(table.ids, table.optics, {}, backward))


def model_xml(form: Form) -> str:
    return bsdf_xml(form.kind, **form.values, **form.options)


class Rays:
    """32 rays that a face between air and glass scatters: along d, in any frame, towards directions about the lobe."""

    def __init__(self, reflect: bool, from_front: bool) -> None:
        self.reflect, self.from_front = reflect, from_front
        self.n_in, self.n_out = (1.0, GLASS) if from_front else (GLASS, 1.0)
        rng = np.random.default_rng(7)
        # From the normal so far that light is refracted from either side
        sine = rng.uniform(0.05, 0.6, BATCHES) / self.n_in
        frame = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        d = np.stack([sine, np.zeros(BATCHES), np.sqrt(1 - sine**2)], axis=1)
        out = sine if reflect else sine * self.n_in / self.n_out
        r, psi = 10 ** rng.uniform(-2.0, -0.5, BATCHES), rng.uniform(0, 2 * np.pi, BATCHES)
        # Of light that comes back from there something is refracted, too
        most = min(1.0, self.n_in if reflect else self.n_out, self.n_out / self.n_in if not reflect else 1.0)
        beta = np.stack([out + r * np.cos(psi), r * np.sin(psi)], axis=1)
        if not reflect:
            limit = 0.95 * min(1.0, self.n_in / self.n_out)
            beta *= np.minimum(1, limit / np.linalg.norm(beta, axis=1))[:, None]
        beta *= np.minimum(1, 0.95 * most / np.linalg.norm(beta, axis=1))[:, None]
        up = np.sqrt(1 - np.sum(beta**2, axis=1)) * (-1 if reflect else 1)
        self.d, self.w, self.axis = d @ frame, np.column_stack([beta, up]) @ frame, np.tile(frame[2], (BATCHES, 1))
        self.first, self.second = np.tile(frame[0], (BATCHES, 1)), np.tile(frame[1], (BATCHES, 1))

    def turned(self, a: float, b: float, c: float, e: float) -> tuple[np.ndarray, np.ndarray]:
        """Direction of arrival and normal, turned by small angles to either side."""
        d, axis = self.d + a * self.first + b * self.second, self.axis + c * self.first + e * self.second
        return tuple(v / np.linalg.norm(v, axis=1, keepdims=True) for v in (d, axis))

    def log_flux(self, form: Form, values: dict[str, float], backward: bool, *turns: float) -> np.ndarray:
        """The oracle. Against the light the flux per étendue n² cos θ dω is the same for both ways."""
        d, axis = self.turned(*turns) if turns else (self.d, self.axis)
        share = R if self.reflect else T
        if not backward:
            light = Light(d, self.w, axis, self.reflect, self.from_front, self.n_in, self.n_out)
            flux = form.bsdf(values, light, share) * light.cos_s
        else:
            front = self.from_front == self.reflect
            sides = (self.n_in, self.n_out) if self.reflect else (self.n_out, self.n_in)
            light = Light(-self.w, -d, axis if self.reflect else -axis, self.reflect, front, *sides)
            flux = form.bsdf(values, light, share) * light.cos_i * (sides[0] / self.n_in) ** 2
        return np.log(flux)

    def event(self, *turns: mi.Float64) -> ScatterEvent:
        """The same for the replay, with Snell's law by Dr.Jit."""
        vectors = {k: mi.Vector3d(np.ascontiguousarray(getattr(self, k).T)) for k in ("d", "axis", "first", "second")}
        d, axis = vectors["d"], vectors["axis"]
        if turns:
            a, b, c, e = turns
            d = dr.normalize(d + a * vectors["first"] + b * vectors["second"])
            axis = dr.normalize(axis + c * vectors["first"] + e * vectors["second"])
        eta = mi.Float64(self.n_in / self.n_out)
        cos_i = dr.dot(d, axis)
        cos_t = dr.safe_sqrt(1 - dr.square(eta) * (1 - dr.square(cos_i)))
        lanes = dr.arange(mi.UInt32, BATCHES)
        shares = mi.Float64(R), mi.Float64(T)
        return ScatterEvent(
            dr.zeros(mi.UInt32, BATCHES), lanes, mi.Bool(self.reflect), mi.Bool(self.from_front), d, axis, cos_i, cos_t,
            eta, *shares,
        )  # fmt: skip

    @property
    def direction(self) -> mi.Vector3d:
        return mi.Vector3d(np.ascontiguousarray(self.w.T))


def surface_number(table: SurfaceTable) -> int:
    return table.ids.index("face_0")


def on(table: SurfaceTable, event: ScatterEvent) -> ScatterEvent:
    event.s = event.s + surface_number(table)
    return event


def by_values(
    table: SurfaceTable, scattering: Scattering, function: Callable[[ScatterReplay], mi.Float64]
) -> dict[str, np.ndarray]:
    """Derivatives of a function of 32 rays by the values of the one scatter plugin: name → (32,)."""
    replay = ScatterReplay(table, scattering)
    dr.backward(dr.sum(function(replay)))
    found = scatter_gradient(table, scattering, replay.derivatives(), lambda owner, name: fixed(owner, name) is None)
    return {name: gradient[:, 0] for _, name, gradient in found}


def assert_derivative(found: np.ndarray, expected: np.ndarray, relative: float) -> None:
    """Of 32 rays, within a part of the largest."""
    largest = np.max(np.abs(expected))
    assert largest > 0
    np.testing.assert_allclose(found, expected, rtol=0, atol=relative * largest)


def cases(form: Form) -> list[tuple[bool, bool, bool]]:
    """(backward, reflect, from_front) for which the model scatters; particles lie at the front."""
    return [
        (backward, reflect, front)
        for backward in (False, True)
        for reflect in (True, False)
        for front in (True, False)
        if ("reflection" if reflect else "transmission") in form.events
        and not (form.kind == "particulate" and reflect and not front)
    ]


def names(form: Form) -> set[str]:
    """Values that have a derivative: the theory of all orders knows one slope only."""
    return set(form.values) - ({"slope"} if form.options.get("theory") == "ghs_full" else set())


@pytest.mark.parametrize("name", FORMS)
def test_flux_by_values(load_scene: Load, name: str) -> None:
    form = FORMS[name]
    table = tables_of(load_scene, model_xml(form))
    for backward, reflect, front in cases(form):
        rays, scattering = Rays(reflect, front), scattering_of(table, backward)
        event, direction = on(table, rays.event()), rays.direction
        found = by_values(table, scattering, lambda r: r.log_flux(event, direction, mi.Bool(True)))  # noqa: B023
        assert set(found) == names(form)
        for key, derivative in found.items():

            def log_flux(value: float) -> np.ndarray:
                return rays.log_flux(form, form.values | {key: value}, backward)  # noqa: B023

            step = STEP * abs(form.values[key])
            expected = (log_flux(form.values[key] + step) - log_flux(form.values[key] - step)) / (2 * step)
            assert_derivative(derivative, expected, VALUES)
            with pytest.raises(AssertionError):
                assert_derivative(1.02 * derivative, expected, VALUES)


@pytest.mark.parametrize("name", FORMS)
def test_flux_by_direction_and_normal(load_scene: Load, name: str) -> None:
    """The direction of departure is held fixed; R and T are constant."""
    form = FORMS[name]
    table = tables_of(load_scene, model_xml(form))
    for backward, reflect, front in cases(form):
        rays = Rays(reflect, front)
        turns = [dr.zeros(mi.Float64, BATCHES) for _ in range(4)]
        dr.enable_grad(turns)
        replay = ScatterReplay(table, scattering_of(table, backward))
        value = replay.log_flux(on(table, rays.event(*turns)), rays.direction, mi.Bool(True))
        dr.backward(dr.sum(value))
        np.testing.assert_allclose(np.array(value), rays.log_flux(form, form.values, backward), atol=2e-3)
        found = np.array([dr.grad(turn) for turn in turns])

        def log_flux(*turn: float) -> np.ndarray:
            return rays.log_flux(form, form.values, backward, *turn)  # noqa: B023

        expected = central_differences(log_flux, [0.0] * 4, [TURN] * 4)
        difference, size = np.linalg.norm(found - expected, axis=0), np.linalg.norm(expected, axis=0)
        assert np.all(difference <= GEOMETRY * np.maximum(size, 0.1 * np.max(size))), np.max(difference / size)
        assert np.max(np.linalg.norm(1.02 * found - expected, axis=0) / size) > GEOMETRY

"""Plugin `straylight`: the ray tree of mistray as a Mitsuba integrator."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray._mitsuba_compat import peek
from mistray.coatings import LAYER_PARAMETERS
from mistray.errors import MistrayError, errors_of
from mistray.execute.tracer import prepare
from mistray.gradients.coating_gradient import IDEAL_PARAMETERS
from mistray.gradients.edge_widths import least_error, widths_of
from mistray.gradients.frozen_tangent import run_tangent
from mistray.gradients.geometry_gradient import geometry_columns, shape_parameters
from mistray.gradients.parameter_gradient import gathered, without_derivative
from mistray.gradients.run_gradient import run_gradient
from mistray.gradients.table_gradient import GradientRequest
from mistray.light import Light
from mistray.param import documented, fixed, params_of, take
from mistray.plugins.sensors.passing_sensor import PassingSensor
from mistray.ranges import EDGE_WIDTH, FLAG
from mistray.sampling.sources import source_emitters, spectrum_of
from mistray.settings import Settings
from mistray.surfaces.surfaces import SurfaceTable
from mistray.trace.forward import trace

COATING = (*LAYER_PARAMETERS, *IDEAL_PARAMETERS)


@documented
class StrayLight(mi.CppADIntegrator):
    r"""
    Stray-light integrator (:monosp:`straylight`): splits rays at every interface and follows all of them.

    ``mi.render(scene, integrator=…)`` returns the irradiance of the detector as a tensor (height, width, 1) in W/mm²;
    row 0 is at the smallest y of the detector's frame. For a `probe`, `far_field`, `surface_maps` or `flux_split` it
    returns the quantity that this sensor records. The properties are also the defaults of `mistray.trace` for the
    scene, which returns the path table, the energy ledger and standard errors as well.

    .. parameters::

    ``spp`` > 0 of ``mi.render`` requests spp start rays for each pixel of that tensor. Its ``seed`` is added to that of
    the integrator. The detector counts among the surfaces of ``max_events``. Roulette, scatter by chance below
    ``scatter_threshold`` and ``one`` are unbiased. ``allow_all`` stands for the letters "TRIMtrA",
    ``transmit_specular`` for "TIMA", ``reflect_specular`` for "RIMA", and ``halt_all`` for "A". Light is also "stokes"
    where a source is polarised.

    None of these is differentiable. ``dr.backward`` through ``mi.render(scene, params, …)`` gives the derivatives with
    respect to coatings, scatter models, indices, shapes, positions and rims of the scene; `mistray.metrics.parameters`
    lists them. Coatings alone take one reverse run (`mistray.recorders.adjoint`), other parameters a replay of all rays
    (`mistray.gradients.replay`). Branches below ``flux_threshold`` are left out. `mistray.gradient` gives standard
    errors as well. ``dr.forward`` has no derivatives with respect to scatter and none at rims: for more than coatings
    ``edges`` must be false. ``polarization="stokes"`` and parameters of Mitsuba's own shapes raise an error.

    .. code-block:: xml

        <integrator type="straylight">
            <integer name="rays" value="1000000"/>
            <integer name="max_reflections" value="2"/>
        </integrator>

    .. code-block:: python

        {"type": "straylight", "rays": 1_000_000, "flux_threshold": 1e-6}
    """

    owner = "integrator 'straylight'"
    properties = params_of(Settings) | {
        "edges": fixed("bool", FLAG, "include light that rays gain and lose at rims in gradients", True),
        "edge_width": fixed(
            "1",
            EDGE_WIDTH,
            "width of the zones at rims for that, relative to their radii; none: the first reverse pass takes the one "
            "of least error, and later ones keep it",
            None,
        ),
    }

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        given = {f.name: props.get(f.name) for f in fields(Settings) if f.name in props}
        with errors_of(self.owner):
            self.settings = Settings(**given)
        self.edges: bool = take(self, props, "edges")
        self.edge_width: float | None = take(self, props, "edge_width")

    def _settings(self, scene: mi.Scene, sensor: mi.Sensor, seed: mi.UInt32, spp: int) -> Settings:
        """
        Return the integrator's settings with `seed` added and the number of rays that `spp` requests.

        An `spp` of 0 keeps the integrator's own number of rays.
        """
        own = self.settings.resolved(scene)
        rays = spp * _pixels(scene, sensor) if spp else own.rays
        return replace(own, rays=rays, seed=(own.seed + int(mi.UInt32(seed)[0])) % 2**32)

    def _detector(self, sensor: mi.Sensor) -> str | None:
        shape = sensor.get_shape()
        if shape is None:
            raise MistrayError("integrator 'straylight': the sensor is not nested in a shape; use an 'irradiancemeter'")
        return shape.id() or None

    def render(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | int = 0,
        seed: mi.UInt32 = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> mi.TensorXf:
        if not develop:
            raise MistrayError("integrator 'straylight': develop=False is not supported; render with develop=True")
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        wanted = self._settings(scene, sensor, seed, spp)
        values = {f.name: getattr(wanted, f.name) for f in fields(Settings)}
        if isinstance(sensor, PassingSensor):
            recorder: Any = trace(scene, ledger=False, **values).recorders[sensor.name]
            return mi.TensorXf(recorder.image[0][:, :, None])
        result = trace(scene, detector=self._detector(sensor), ledger=False, **values)
        return mi.TensorXf(result.irradiance[:, :, None])

    def render_forward(
        self, scene: mi.Scene, params: Any, sensor: mi.Sensor | int = 0, seed: mi.UInt32 = 0, spp: int = 0
    ) -> mi.TensorXf:
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        tracked = _tracked(scene)
        _check_differentiable(params, tracked)
        kinds = {kind for kind, _ in tracked.values()}
        for kind in sorted(kinds & {"scatter", "source"}):
            raise MistrayError(f"integrator 'straylight' has no forward mode by values of a {kind}; use dr.backward")
        if self.edges and kinds - {"coating"}:
            raise MistrayError(
                "integrator 'straylight': forward mode has no rims; use dr.backward, or set edges=False to "
                "hold visibility as it is"
            )
        tangents = {place: np.array(dr.grad(value), dtype=np.float64) for place, (_, value) in tracked.items()}
        runs = prepare(scene, self._settings(scene, sensor, seed, spp), Light(detector=self._detector(sensor)))
        change = sum(run.unit / run.pixel_area * run_tangent(run, tangents) for run in runs)
        return mi.TensorXf(np.asarray(change)[:, :, None])

    def render_backward(
        self,
        scene: mi.Scene,
        params: Any,
        grad_in: mi.TensorXf,
        sensor: mi.Sensor | int = 0,
        seed: mi.UInt32 = 0,
        spp: int = 0,
    ) -> None:
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        tracked = _tracked(scene)
        _check_differentiable(params, tracked)
        request = GradientRequest(
            rows=any(kind in ("coating", "index") for kind, _ in tracked.values()),
            geometry=geometry_columns(name for (_, name), (kind, _) in tracked.items() if kind == "shape"),
            indices=any(kind == "index" for kind, _ in tracked.values()),
            scatter=any(kind == "scatter" for kind, _ in tracked.values()),
            sources=frozenset(name for (_, name), (kind, _) in tracked.items() if kind == "source"),
            edge_widths=widths_of(self.edge_width) if self.edges else (),
        )
        by_irradiance = np.array(grad_in, dtype=np.float64)[:, :, 0]

        def is_tracked(owner: Any, name: str) -> bool:
            return (id(owner), name) in tracked

        with dr.resume_grad():
            first_order = mi.Float64(0)
            raws = [
                run_gradient(run, None, run.unit * by_irradiance[None] / run.pixel_area, request)
                for run in prepare(
                    scene, self._settings(scene, sensor, seed, spp), Light(detector=self._detector(sensor))
                )
            ]
            inner, rims = gathered(raws, is_tracked)
            at_rims = {place: inner.get(place, 0.0) + sums for place, sums in rims.items() if sums.any()}
            number = least_error(at_rims.values())
            if at_rims:
                self.edge_width = request.edge_widths[number]
            for place, batches in (inner | {place: sums[number] for place, sums in at_rims.items()}).items():
                first_order += dr.sum(mi.Float64(tracked[place][1]) * mi.Float64(batches.sum(axis=0)))
            if dr.grad_enabled(first_order):
                dr.backward(first_order)

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """Expose no parameters to `mi.traverse`: the settings are Python numbers."""

    def to_string(self) -> str:
        inside = ", ".join(f"{f.name} = {getattr(self.settings, f.name)}" for f in fields(Settings))
        inside += f", edges = {self.edges}, edge_width = {self.edge_width}"
        return f"StrayLight[{inside}]"


def _pixels(scene: mi.Scene, sensor: mi.Sensor) -> int:
    """Return the number of pixels of the image that a rendering gives for a sensor."""
    if not isinstance(sensor, PassingSensor):
        width, height = sensor.film().size()
        return int(width) * int(height)
    recorder = sensor.recorder()
    if not sensor.placed:  # it has pixels for each surface
        recorder.lay_out(SurfaceTable(scene, float(spectrum_of(scene, None, None)[0][0])))
    return recorder.image_size


def _tracked(scene: mi.Scene) -> dict[tuple[int, str], tuple[str, mi.Float]]:
    """
    Return kind and value of each scene parameter that carries derivatives, by id() of its plugin and name.

    The kind is "source", "shape", "index", "coating" or "scatter".
    """
    found = {
        (id(emitter), name): ("source", value)
        for emitter in source_emitters(scene)
        for name, value in emitter.parameters.items()
        if dr.grad_enabled(value)
    }
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        film = getattr(bsdf, "film", None)
        groups = [
            ("shape", shape, {name: shape.parameters[name] for name in shape_parameters(shape)}),
            ("index", bsdf, getattr(bsdf, "shifts", {})),
            ("coating", film, {name: getattr(film, name) for name in COATING if hasattr(film, name)}),
            *(("scatter", one, one.values) for one in getattr(bsdf, "scatterers", ())),
        ]
        for kind, owner, values in groups:
            found |= {(id(owner), name): (kind, v) for name, v in values.items() if dr.grad_enabled(v)}
    return found


def _check_differentiable(params: Any, tracked: dict[tuple[int, str], tuple[str, mi.Float]]) -> None:
    """
    Raise `MistrayError` if a value in `params` carries derivatives but is not `tracked`, see `_tracked`.

    Its derivative would silently be 0.
    """
    known = {value.index_ad for _, value in tracked.values()}
    for key in params.keys() if params is not None else ():
        value = peek(params, key)
        if dr.grad_enabled(value) and getattr(value, "index_ad", None) not in known:
            reason = without_derivative(key) or "mistray.metrics.parameters(scene) lists those that it has"
            raise MistrayError(f"integrator 'straylight' has no derivative with respect to '{key}'; {reason}")


mi.register_integrator("straylight", lambda props: StrayLight(props))

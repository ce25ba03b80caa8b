"""Plugin `straylight`: the ray tree as a Mitsuba integrator."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.coatings import LAYER_PARAMETERS
from mistray.errors import MistrayError
from mistray.trace.coating_gradient import IDEAL_PARAMETERS, coating_gradient
from mistray.trace.result import trace
from mistray.trace.settings import Settings
from mistray.trace.tracer import prepare


class StrayLight(mi.CppADIntegrator):
    r"""
    Stray-light integrator (:monosp:`straylight`): splits rays at every interface and follows all of them.

    ``mi.render(scene, integrator=…)`` gives the irradiance of the detector as a tensor (height, width, 1) in W/mm²;
    row 0 is at the smallest y of the detector's frame. The properties are also the defaults of `mistray.trace` for the
    scene, which returns the path table, the energy ledger and standard errors as well.

    ================= ======= ============== ========= =================================================================
    parameter         unit    range          default   meaning
    ================= ======= ============== ========= =================================================================
    rays              1       1 … 4.29e9     1e6       start rays; ``spp`` > 0 asks for spp × pixels instead
    max_reflections   1       ≥ 0            2         reflections along a path, total internal ones and those at
                                                       surfaces declared ``mirror`` not counted
    max_scatters      1       ≥ 0            1         scatter events along a path
    max_optical_      1       ≥ 0            no limit  those at surfaces that transmit
    scatters
    max_random_       1       ≥ 0            no limit  those that are not aimed
    scatters
    max_generations   1       ≥ 0            no limit  reflections and scatter events together
    max_events        1       1 … 64         64        surfaces along a path, the detector included
    scatter_rays      1       1 … 255        1         rays scattered at random at every hit
    aimed_rays        1       0 … 255        1         rays aimed at automatic targets at every hit, in reflection and
                                                       transmission each
    aim               string  auto, targets, auto      aim at automatic targets as well, only at those of the scene,
                              none                     or not at all
    flux_threshold    1       0 … 1          1e-8      smallest flux of an unscattered branch relative to its start ray
    scatter_threshold 1       0 … 1          0.1       below this share of a ray's first flux hits scatter, and branches
                                                       after a scatter go on, by roulette (unbiased)
    splitting         string  split, one     split     follow both children, or one at random
    below_threshold   string  cut, roulette  cut       end weak branches, or play Russian roulette (unbiased)
    seed              1       0 … 2³²-1      0         random numbers; the ``seed`` of ``mi.render`` is added
    ray_control       string  see `Settings` allow_all what surfaces send on: all, transmitted, reflected light, nothing
    polarization      string  unpolarized,   unpolar-  average s and p at every hit, or carry the Stokes vector along
                              stokes         ized
    ================= ======= ============== ========= =================================================================

    None of these is differentiable. ``dr.backward`` through ``mi.render(scene, params, …)`` gives the derivatives by
    the coatings of the scene: ``thickness_nm``, ``n_shift`` and ``k_shift`` of layers, ``R`` and ``T`` of ideal
    coatings. It traces the trees in reverse, see `mistray.trace.adjoint`, and leaves out branches below
    ``flux_threshold``. `mistray.gradient` gives standard errors as well. Forward mode, ``polarization="stokes"`` and
    other parameters raise.

    .. code-block:: xml

        <integrator type="straylight">
            <integer name="rays" value="1000000"/>
            <integer name="max_reflections" value="2"/>
        </integrator>

    .. code-block:: python

        {"type": "straylight", "rays": 1_000_000, "flux_threshold": 1e-6}
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        given = {f.name: props.get(f.name) for f in fields(Settings) if f.name in props}
        try:
            self.settings = Settings(**given)
        except MistrayError as error:
            raise MistrayError(f"integrator 'straylight': {error}") from None

    def _settings(self, sensor: mi.Sensor, seed: mi.UInt32, spp: int) -> Settings:
        """Own settings with the arguments of a call: ``spp`` asks for rays, ``seed`` is added."""
        size = sensor.film().size()
        rays = spp * int(size[0]) * int(size[1]) if spp else self.settings.rays
        return replace(self.settings, rays=rays, seed=(self.settings.seed + int(mi.UInt32(seed)[0])) % 2**32)

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
        wanted = self._settings(sensor, seed, spp)
        values = {f.name: getattr(wanted, f.name) for f in fields(Settings)}
        result = trace(scene, detector=self._detector(sensor), ledger=False, **values)
        return mi.TensorXf(result.irradiance[:, :, None])

    def render_forward(self, scene: mi.Scene, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0) -> mi.TensorXf:
        raise MistrayError("integrator 'straylight' differentiates backward only; use dr.backward, not dr.forward")

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
        _check_differentiable(params)
        runs = prepare(scene, self._settings(sensor, seed, spp), detector=self._detector(sensor))
        by_irradiance = np.array(grad_in, dtype=np.float64)[:, :, 0]
        with dr.resume_grad():
            first_order = mi.Float(0)
            for run in runs:
                by_flux = by_irradiance / run.pixel_area
                for owner, name, batches in coating_gradient(run.table.optics, run.derivatives(by_flux)):
                    value = getattr(owner, name)
                    if dr.grad_enabled(value):
                        first_order += dr.sum(value * mi.Float(batches.sum(axis=0)))
            if dr.grad_enabled(first_order):
                dr.backward(first_order)

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """The settings are Python numbers: nothing to expose."""

    def to_string(self) -> str:
        inside = ", ".join(f"{f.name} = {getattr(self.settings, f.name)}" for f in fields(Settings))
        return f"StrayLight[{inside}]"


def _check_differentiable(params: Any) -> None:
    """Raise if a gradient is asked for that would silently be 0."""
    for key in params.keys() if params is not None else ():
        if key.rsplit(".", 1)[-1] not in (*LAYER_PARAMETERS, *IDEAL_PARAMETERS) and dr.grad_enabled(params[key]):
            raise MistrayError(
                f"integrator 'straylight' has no derivative by '{key}'; coatings have, by "
                f"{', '.join((*LAYER_PARAMETERS, *IDEAL_PARAMETERS))}"
            )


mi.register_integrator("straylight", lambda props: StrayLight(props))

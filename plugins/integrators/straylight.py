"""Plugin `straylight`: the ray tree as a Mitsuba integrator."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import mitsuba as mi

from mistray.errors import MistrayError
from mistray.trace.result import trace
from mistray.trace.settings import Settings


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
    max_events        1       1 … 64         64        surfaces along a path, the detector included
    flux_threshold    1       0 … 1          1e-8      smallest flux of a branch relative to its start ray
    splitting         string  split, one     split     follow both children, or one at random
    below_threshold   string  cut, roulette  cut       end weak branches, or play Russian roulette (unbiased)
    seed              1       0 … 2³²-1      0         random numbers; the ``seed`` of ``mi.render`` is added
    ================= ======= ============== ========= =================================================================

    No parameter is differentiable, and ``dr.backward`` through ``mi.render`` raises: gradients are not there yet.

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
        settings = self.settings
        size = sensor.film().size()
        shape = sensor.get_shape()
        if shape is None:
            raise MistrayError("integrator 'straylight': the sensor is not nested in a shape; use an 'irradiancemeter'")
        rays = spp * int(size[0]) * int(size[1]) if spp else settings.rays
        offset = int(mi.UInt32(seed)[0])
        wanted = replace(settings, rays=rays, seed=(settings.seed + offset) % 2**32)
        values = {f.name: getattr(wanted, f.name) for f in fields(Settings)}
        result = trace(scene, detector=shape.id() or None, ledger=False, **values)
        return mi.TensorXf(result.irradiance[:, :, None])

    def render_forward(self, scene: mi.Scene, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0) -> mi.TensorXf:
        raise MistrayError("integrator 'straylight' has no derivatives yet; render without gradients (dr.suspend_grad)")

    def render_backward(
        self, scene: mi.Scene, params: Any, grad_in: mi.TensorXf, sensor: Any = 0, seed: Any = 0, spp: int = 0
    ) -> None:
        raise MistrayError("integrator 'straylight' has no derivatives yet; render without gradients (dr.suspend_grad)")

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """The settings are Python numbers: nothing to expose."""

    def to_string(self) -> str:
        inside = ", ".join(f"{f.name} = {getattr(self.settings, f.name)}" for f in fields(Settings))
        return f"StrayLight[{inside}]"


mi.register_integrator("straylight", lambda props: StrayLight(props))

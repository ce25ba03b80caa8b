"""Plugin `abg`: the ABg model of scatter."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.abg import ABg as Model


class ABg(Scatterer):
    r"""
    ABg scatter (:monosp:`abg`): BSDF = A/(B + r^g), with r = \|β - β0\|.

    Nested in an ``interface`` it scatters a fraction of the light that this reflects and transmits. By itself it is an
    interface with constant R and T.

    ================= ======= ============ ========== ==========================================================
    parameter         unit    range        default    meaning
    ================= ======= ============ ========== ==========================================================
    A                 1/sr    ≥ 0          required   amplitude (differentiable)
    B                 1       > 1e-12      required   (r of the knee)^g; may be 0 if g = 0
                                                      (differentiable)
    g                 1       ≥ 0          required   slope; 0: Lambertian, reflectance π A/(1 + B)
                                                      (differentiable)
    file              file                 none       entry of an OpticStudio catalogue, ``ABG_DATA.DAT:NAME``,
                                                      instead of A, B, g and ``reference_nm``
    reference_nm      nm      > 0          none       wavelength at which A and B hold; at others the scatter of
                                                      a smooth surface is scaled. None: no dependence on the
                                                      wavelength
    event             string               both       event that scatters: ``reflection``, ``transmission`` or
                                                      ``both``
    side              string               both       side from which light is scattered: ``front``, ``back``,
                                                      ``both``
    relative_to       string               specular   BSDF per unit of R and T (``specular``) or per unit of
                                                      incident light (``incident``), taken from the absorbed
                                                      light
    R                 1       0 … 1        1          by itself only: reflectance (differentiable); by default 0
                                                      with T or with ``relative_to`` ``incident``
    T                 1       0 … 1        0          by itself only: transmittance (differentiable)
    front, back       string               air        by itself only: materials, see ``interface``
    n_front_shift     1       ±            0          by itself only; see ``interface`` (differentiable)
    n_back_shift      1       ±            0          by itself only; see ``interface`` (differentiable)
    mirror            bool                 false      by itself only; see ``interface``
    wavelength_nm     nm      > 0          source     by itself only; see ``interface``
    ================= ======= ============ ========== ==========================================================

    The BSDF is the same for light from both sides and in reflection and transmission. It is reciprocal in reflection if
    R is constant. Source: see `mistray.physics.abg`.

    .. code-block:: xml

        <bsdf type="interface">
            <string name="back" value="N-BK7"/>
            <bsdf type="abg">
                <float name="A" value="2e-5"/><float name="B" value="1e-6"/><float name="g" value="2"/>
            </bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "abg", "A": 0.0025, "B": 0.001, "g": 1.8, "R": 0.95}
    """

    kind = "abg"
    model_type = Model


mi.register_bsdf("abg", lambda props: ABg(props))

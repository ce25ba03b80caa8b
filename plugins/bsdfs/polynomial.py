"""Plugin `polynomial`: a polynomial or binomial fit to measured scatter."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.polynomial import Polynomial as Model


class Polynomial(Scatterer):
    r"""
    Polynomial scatter (:monosp:`polynomial`): log10 BSDF = Σ c (U+W)^i (U W)^j V^k + Σ l V^k log10(1 + d^j T).

    U = \|β\|², W = \|β0\|², V = β·β0 and T = \|β - β0\|². These are the invariants of an isotropic surface, as in
    FRED's Polynomial and Binomial (no j in the first sum). Nested in an ``interface`` it scatters a fraction of the
    light that this reflects and transmits. By itself it is an interface with constant R and T.

    ================= ======= ============ ========== ==========================================================
    parameter         unit    range        default    meaning
    ================= ======= ============ ========== ==========================================================
    c000              1       any          required   log10 of the BSDF at normal incidence along the specular
                                                      direction, 1/sr (differentiable)
    c100, c010, c001  1       any          0          and all others of three digits ijk: coefficients of
                                                      (U+W)^i (U W)^j V^k (differentiable)
    l10, l11          1       any          0          and all others of two digits jk: coefficients of
                                                      V^k log10(1 + d^j T) (differentiable)
    d                 1       > 0          1e4        the Lorentzian part bends at \|β - β0\| = d^(-j/2)
                                                      (differentiable)
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

    It is reciprocal in reflection if R is constant. A fit may rise outside the range that was fitted: examine it up to
    grazing angles with ``mistray bsdf``. Source: see `mistray.physics.polynomial`.

    .. code-block:: xml

        <bsdf type="interface">
            <float name="R" value="0.1"/>
            <bsdf type="polynomial">
                <float name="c000" value="-0.5"/><float name="c100" value="-0.4"/><float name="l10" value="-0.7"/>
            </bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "polynomial", "c000": -0.5, "c100": -0.4, "l10": -0.7, "R": 0.1}
    """

    kind = "polynomial"
    model_type = Model


mi.register_bsdf("polynomial", lambda props: Polynomial(props))

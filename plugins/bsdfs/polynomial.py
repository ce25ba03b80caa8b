"""Plugin `polynomial`: a polynomial or binomial fit to measured scatter."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi

from mistray.param import Param
from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.polynomial import COEFFICIENT
from mistray.scatter.polynomial import Polynomial as Model


class Polynomial(Scatterer):
    r"""
    Polynomial scatter (:monosp:`polynomial`): log10 BSDF = Σ c (U+W)^i (U W)^j V^k + Σ l V^k log10(1 + d^j T).

    The BSDF is in 1/sr. U = \|β\|², W = \|β0\|², V = β·β0 and T = \|β - β0\|², with the direction cosines β and β0
    along the surface of the scattered and of the specular ray. These are the invariants of an isotropic surface, as in
    FRED's Polynomial and Binomial (no j in the first sum). Nested in an ``interface`` it scatters a fraction of the
    light that this reflects and transmits. By itself it is an interface with constant R and T.

    .. parameters::

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
    properties = {
        "c000": Param(doc="log10 of the BSDF at normal incidence along the specular direction, 1/sr"),
        **dict.fromkeys(
            ("c100", "c010", "c001"),
            replace(COEFFICIENT, doc="and all others of three digits ijk: coefficients of (U+W)^i (U W)^j V^k"),
        ),
        **dict.fromkeys(
            ("l10", "l11"),
            replace(COEFFICIENT, doc="and all others of two digits jk: coefficients of V^k log10(1 + d^j T)"),
        ),
    }


mi.register_bsdf("polynomial", lambda props: Polynomial(props))

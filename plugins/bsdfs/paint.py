"""Plugin `paint`: a diffuse surface with an optional glossy lobe."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.paint import Paint as Model


class Paint(Scatterer):
    r"""
    Paint (:monosp:`paint`): BSDF = ρ/π + b0 [1 + (r/l)²]^(s/2) · sqrt(F(θi) F(θs))/F(0), with r = \|β - β0\|.

    The BSDF is in 1/sr, ρ is ``reflectance``, and θi and θs are the angles of incidence and of scatter. β and β0 are
    the direction cosines along the surface of the scattered and of the specular ray. F is the Fresnel reflectance of
    the binder's index n; without n the last factor is 1. The BSDF is absolute, and its light is taken from the absorbed
    light. An ``interface`` around it needs an R that is the specular reflectance, without the scatter, ``R`` = 0 for a
    matt paint. By itself it has R = T = 0.

    .. parameters::

    It is reciprocal, also at grazing incidence. Source: see `mistray.scatter.paint`.

    .. code-block:: xml

        <bsdf type="interface">
            <float name="R" value="0"/>
            <bsdf type="paint"><float name="reflectance" value="0.04"/></bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "paint", "reflectance": 0.03, "b0": 0.5, "l": 0.2, "s": -3.0, "n": 1.5}
    """

    kind = "paint"
    model_type = Model


mi.register_bsdf("paint", lambda props: Paint(props))

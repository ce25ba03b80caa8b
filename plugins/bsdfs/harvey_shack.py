"""Plugin `harvey_shack`: scatter of polished surfaces."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.harvey_shack import HarveyShack as Model


class HarveyShack(Scatterer):
    r"""
    Harvey-Shack scatter (:monosp:`harvey_shack`): BSDF = b0 [1 + (r/l)²]^(s/2), 1/sr, with r = \|β - β0\|.

    β and β0 are the direction cosines along the surface of the scattered and of the specular ray. Nested in an
    ``interface`` it scatters a fraction of the light that this reflects and transmits. By itself it is an interface
    with constant R and T. Exactly one of ``b0`` and ``rms_nm`` determines how much is scattered. With ``rms_nm`` b0
    follows from the indices on both sides, with Δn = 2 n in reflection and the difference of the indices in
    transmission. A surface that is not smooth is refused.

    .. parameters::

    It is reciprocal in reflection if R is constant. Source: see `mistray.physics.harvey_shack`.

    .. code-block:: xml

        <bsdf type="interface">
            <string name="back" value="nd=1.544 Vd=56.1"/>
            <bsdf type="harvey_shack"><float name="rms_nm" value="4"/></bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "harvey_shack", "b0": 0.1099, "l": 0.01, "s": -1.5, "R": 0.95}
    """

    kind = "harvey_shack"
    model_type = Model


mi.register_bsdf("harvey_shack", lambda props: HarveyShack(props))

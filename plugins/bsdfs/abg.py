"""Plugin `abg`: the ABg model of scatter."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.abg import ABg as Model


class ABg(Scatterer):
    r"""
    ABg scatter (:monosp:`abg`): BSDF = A/(B + r^g), 1/sr, with r = \|β - β0\|.

    β and β0 are the direction cosines along the surface of the scattered and of the specular ray. Nested in an
    ``interface`` it scatters a fraction of the light that this reflects and transmits. By itself it is an interface
    with constant R and T.

    .. parameters::

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

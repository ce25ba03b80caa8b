"""Plugin `phong`: the Phong model of scatter."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.phong import Phong as Model


class PhongLobe(Scatterer):
    r"""
    Phong scatter (:monosp:`phong`): BSDF = b0 cos^n α, 1/sr, with the angle α to the specular direction.

    n is ``exponent``. Nested in an ``interface`` it scatters a fraction of the light that this reflects and transmits.
    By itself it is an interface with constant R and T.

    .. parameters::

    It is reciprocal in reflection if R is constant; in transmission it is not. At oblique incidence the horizon cuts
    off part of the lobe. Source: see `mistray.physics.phong`.

    .. code-block:: xml

        <bsdf type="interface">
            <float name="R" value="0.9"/>
            <bsdf type="phong"><float name="b0" value="0.1"/><float name="exponent" value="16"/></bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "phong", "b0": 0.1, "exponent": 16.0, "R": 0.9}
    """

    kind = "phong"
    model_type = Model


mi.register_bsdf("phong", lambda props: PhongLobe(props))

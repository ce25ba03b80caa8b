"""Plugin `gaussian_lobe`: a Gaussian lobe of scatter."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.gaussian import Gaussian as Model


class GaussianLobe(Scatterer):
    r"""
    Gaussian scatter (:monosp:`gaussian_lobe`): BSDF = f0 exp(-(r/w)²), 1/sr, with r = \|β - β0\|.

    β and β0 are the direction cosines along the surface of the scattered and of the specular ray, w is ``width``, and
    f0 follows from ``total``. Nested in an ``interface`` it scatters a fraction of the light that this reflects and
    transmits. By itself it is an interface with constant R and T.

    .. parameters::

    It is reciprocal in reflection if R is constant. Source: see `mistray.physics.gaussian`.

    .. code-block:: xml

        <bsdf type="interface">
            <float name="R" value="0.9"/>
            <bsdf type="gaussian_lobe"><float name="total" value="0.2"/><float name="width" value="0.05"/></bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "gaussian_lobe", "total": 0.2, "width": 0.05, "R": 0.9}
    """

    kind = "gaussian_lobe"
    model_type = Model


mi.register_bsdf("gaussian_lobe", lambda props: GaussianLobe(props))

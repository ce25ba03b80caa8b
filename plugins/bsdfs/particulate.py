"""Plugin `particulate`: scatter by particles on a surface."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.particulate import Particulate as Model


class Particulate(Scatterer):
    r"""
    Contamination (:monosp:`particulate`): Mie scatter by particles whose sizes follow IEST-STD-CC1246.

    Nested in an ``interface`` it scatters a fraction of the transmitted light once, and of the reflected light twice.
    The specular beams lose the extinction. By itself it is an interface with constant R and T. Exactly one of ``level``
    and ``coverage_percent`` determines the number of particles.

    .. parameters::

    It is not reciprocal: it scatters by 1/cos of the angle of incidence up to a limit. Source: see
    `mistray.physics.contamination`.

    .. code-block:: xml

        <bsdf type="interface">
            <string name="back" value="N-BK7"/>
            <bsdf type="particulate"><float name="level" value="400"/></bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "particulate", "coverage_percent": 0.1, "R": 0.95, "T": 0.0}
    """

    kind = "particulate"
    model_type = Model


mi.register_bsdf("particulate", lambda props: Particulate(props))

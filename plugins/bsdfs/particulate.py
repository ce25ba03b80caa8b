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

    ================= ======= ============ ========== ==========================================================
    parameter         unit    range        default    meaning
    ================= ======= ============ ========== ==========================================================
    level             1       ≥ 1          none       cleanliness level, such as 400 (differentiable)
    coverage_percent  %       > 0          none       area that the spheres cover, instead of level
                                                      (differentiable)
    slope             1       > 0          0.926      slope of the size distribution; 0.383 for fallout
                                                      (differentiable)
    particle          string               dust       ``dust``, or a material: ``1.53+0.002i``, a CSV file, …;
                                                      see docs/materials.md
    min_um            um      ≥ 1          1          smallest diameter
    max_um            um      ≤ level      level      largest diameter
    immersion         1       > 0          1          index of the medium around the particles; they lie on the
                                                      side of the surface whose index is nearer to it
    event             string               both       event that scatters: ``reflection``, ``transmission`` or
                                                      ``both``
    side              string               both       side from which light is scattered: ``front``, ``back``,
                                                      ``both``
    R                 1       0 … 1        1          by itself only: reflectance (differentiable); by default 0
                                                      with T
    T                 1       0 … 1        0          by itself only: transmittance (differentiable)
    front, back       string               air        by itself only: materials, see ``interface``
    n_front_shift     1       ±            0          by itself only; see ``interface`` (differentiable)
    n_back_shift      1       ±            0          by itself only; see ``interface`` (differentiable)
    mirror            bool                 false      by itself only; see ``interface``
    wavelength_nm     nm      > 0          source     by itself only; see ``interface``
    ================= ======= ============ ========== ==========================================================

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

"""The glossy part of a paint: how its lobe grows towards grazing angles.

The binder of a paint reflects at its surface as a dielectric of index n does. A lobe whose BSDF is multiplied by
sqrt(F(θi) F(θs))/F(0) then scatters in proportion to F(θi) where it is narrow, and stays reciprocal, because nothing
changes when θi and θs change places.
"""

from __future__ import annotations

from typing import Any

from mistray.physics import fresnel
from mistray.physics._arrays import sqrt


def gain(cos_i: Any, cos_s: Any, n: Any) -> Any:
    """
    Growth of a paint's lobe, sqrt(F(θi) F(θs))/F(0) with the unpolarised Fresnel reflectance F of an index n in air.

    Parameters
    ----------
    cos_i, cos_s : float or array
        Cosines of incidence and of scatter, in [0, 1].
    n : float or array
        Index of the binder, greater than 1.

    Returns
    -------
    float or array
        1 at normal incidence and scatter, 1/F(0) where both are grazing.
    """
    normal = (n - 1) / (n + 1)
    return sqrt(_reflectance(cos_i, n) * _reflectance(cos_s, n)) / (normal * normal)


def _reflectance(cosine: Any, n: Any) -> Any:
    return fresnel.reflectance(cosine, sqrt(fresnel.cos2_refracted(cosine, 1.0, n)), 1.0, n)

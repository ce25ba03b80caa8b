"""Glossy part of a paint: growth of its lobe towards grazing angles.

The binder of a paint reflects at its surface like a dielectric of index n. A lobe whose BSDF is multiplied by
sqrt(F(θi) F(θs))/F(0) then scatters in proportion to F(θi) if it is narrow. It stays reciprocal, because the factor is
symmetric in θi and θs.
"""

from __future__ import annotations

from typing import Any

from mistray.physics import fresnel
from mistray.physics._arrays import sqrt


def gain(cos_i: Any, cos_s: Any, n: Any) -> Any:
    """
    Return the growth of a paint's lobe, sqrt(F(θi) F(θs))/F(0), with the unpolarised reflectance F of index n in air.

    Parameters
    ----------
    cos_i, cos_s : float or array
        Cosines of the angles of incidence and of scatter, in [0, 1].
    n : float or array
        Refractive index of the binder, greater than 1.

    Returns
    -------
    float or array
        Factor of the lobe: 1 at normal incidence and scatter, 1/F(0) if both are grazing.
    """
    normal = (n - 1) / (n + 1)
    return sqrt(_reflectance(cos_i, n) * _reflectance(cos_s, n)) / (normal * normal)


def _reflectance(cosine: Any, n: Any) -> Any:
    return fresnel.reflectance(cosine, sqrt(fresnel.cos2_refracted(cosine, 1.0, n)), 1.0, n)

"""Fresnel lenses, modelled with their real grooves: rings of a lens surface, set back to a plane, and risers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.physics.geometry.sag import conic_end, sag
from mistray.prescription.coating import Coating
from mistray.prescription.model import Structure, Surface
from mistray.prescription.scatter import SCATTER, Scatter
from mistray.ranges import COEFFICIENTS, SIZE_MM

MOST_RINGS = 2000


# More than 8 parameters: those of a surface, of its grooves and of their materials
def fresnel(
    name: str,
    *,
    radius: float,
    semi_diameter: float,
    conic: float = 0.0,
    coefficients: float | Sequence[float] = (),
    groove_mm: float | None = None,
    depth_mm: float | None = None,
    z: float = 0.0,
    front: str = "air",
    back: str = "air",
    coating: Coating | None = None,
    riser: Coating | None = None,
    scatter: Scatter | Sequence[Scatter] = (),
) -> tuple[Surface | Structure, ...]:
    """
    Return the rings and risers of the grooved face of a Fresnel lens.

    Parameters
    ----------
    name : str
        Name of the part; rings are ``<name>_<k>`` from the axis outwards, risers ``<name>_riser_<k>``.
    radius, conic, coefficients
        Radius (mm), conic constant and coefficients of the surface that is cut into rings, as in `Surface`.
    semi_diameter : float
        Clear radius, mm.
    groove_mm, depth_mm : float
        Width of each ring, or depth of each groove, mm; give one of them.
    z : float
        Position of the plane on which the inner edge of each ring lies, mm.
    front, back : str
        Materials on the -z and the +z side.
    coating, riser : Coating or None
        Coatings of the rings and of the risers; ``None``: bare Fresnel interface.
    scatter : Scatter or sequence of Scatter
        Scatter models of the rings.

    Returns
    -------
    tuple of Surface and Structure
        Surfaces for `Prescription.surfaces`, structures for `Prescription.structures`.

    Raises
    ------
    MistrayError
        If not just one of `groove_mm` and `depth_mm` is given, a size is not above 0, the conic ends within the
        semi-diameter, or there are more than 2000 rings or none.

    Examples
    --------
    >>> lens = mistray.prescription.fresnel("fresnel", radius=-25, semi_diameter=20, groove_mm=0.5, back="PMMA")
    >>> len(lens), lens[0].name
    (79, 'fresnel_1')
    """
    owner = f"Fresnel face '{name}'"
    given = {"groove_mm": groove_mm, "depth_mm": depth_mm}
    known = {key: value for key, value in given.items() if value is not None}
    if len(known) != 1:
        raise MistrayError(f"{owner}: {' and '.join(known) or 'no width of its rings'}; give groove_mm or depth_mm")
    SIZE_MM.check_all(owner, semi_diameter=semi_diameter, **known)
    terms = COEFFICIENTS.check("coefficients", coefficients, owner)
    curvature = 0.0 if radius == 0 or math.isinf(radius) else 1 / radius
    if semi_diameter >= conic_end(curvature, conic):
        raise MistrayError(f"{owner}: its conic ends within {semi_diameter:g} mm; reduce the semi-diameter")

    def height(r: Any) -> Any:
        return sag(np.square(r), curvature, conic, terms)

    edges = _edges(owner, height, semi_diameter, groove_mm, depth_mm)
    models = SCATTER.check("scatter", scatter, owner)
    shape: dict[str, Any] = {"radius": radius, "conic": conic, "coefficients": terms, "scatter": models}
    sides: dict[str, Any] = {"front": front, "back": back, "part": name}
    faces: list[Surface | Structure] = []
    for k, (inner, outer) in enumerate(pairwise(edges), start=1):
        start = float(height(inner))
        faces.append(
            Surface(
                f"{name}_{k}", z=z - start, semi_diameter=outer, inner_semi_diameter=inner, coating=coating,
                **shape, **sides,
            )
        )  # fmt: skip
        deep = float(height(outer)) - start
        if outer < semi_diameter and deep:
            # Within a riser of a ring that rises towards +z lies the medium in front, around it the one behind
            within, around = (front, back) if deep > 0 else (back, front)
            faces.append(
                Structure(
                    f"{name}_riser_{k}", outer, z, outer, z + deep, front=within, back=around, coating=riser, part=name
                )
            )
    return tuple(faces)


def _edges(
    owner: str, height: Any, semi_diameter: float, groove_mm: float | None, depth_mm: float | None
) -> list[float]:
    """
    Return the ascending radii at which rings begin and end, mm, from 0 to the clear radius `semi_diameter`, mm.

    All grooves but the last have equal widths `groove_mm`, or equal depths `depth_mm` if that is None. `height` is a
    function from radii, mm, to the sag of the surface, mm. Raise `MistrayError` if there are too many rings or none.
    """
    if groove_mm is not None:
        count = math.ceil(semi_diameter / groove_mm * (1 - 1e-12))
        _count(owner, count)
        return [min(k * groove_mm, semi_diameter) for k in range(count + 1)]
    assert depth_mm is not None
    r = np.linspace(0, semi_diameter, 100_001)
    steps = np.abs(np.diff(height(r)))
    risen = np.concatenate([[0.0], np.cumsum(steps)])
    count = math.ceil(float(risen[-1]) / depth_mm * (1 - 1e-12))
    _count(owner, count)
    inner = np.interp(depth_mm * np.arange(1, count), risen, r)
    return [0.0, *(round(float(v), 9) for v in inner), semi_diameter]


def _count(owner: str, count: int) -> None:
    if not 1 <= count <= MOST_RINGS:
        raise MistrayError(f"{owner}: {count} rings; make them wider or deeper, {MOST_RINGS} at most")

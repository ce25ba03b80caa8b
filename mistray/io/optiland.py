"""Reader of optiland lenses in memory (https://github.com/HarrisonKramer/optiland, checked with 0.6).

optiland keeps the place of every surface in the world, in its lens unit, which is assumed to be mm. The reader takes
the values that optiland computes with, not those that were entered. Each surface is decentred on its own, from a frame
along the world's z axis.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.io.conventions import figure, turns_deg
from mistray.physics.geometry.outline import Outline, OutlineFigure, circle, polygon, rectangle
from mistray.physics.geometry.sag import conic_end
from mistray.physics.sags.terms import sag
from mistray.physics.sags.zernike import LAST_STANDARD, noll_orders, standard
from mistray.prescription.coating import Coating
from mistray.prescription.sequential.materials import same_material
from mistray.prescription.sequential.rays import curvature
from mistray.prescription.sequential.table import (
    ApertureKind,
    Decentre,
    FieldKind,
    Row,
    Sequential,
    Unread,
)

# imageFNO is EFL / EPD, at any distance of the object
_APERTURES: dict[str, ApertureKind] = {
    "EPD": "entrance_pupil_diameter",
    "imageFNO": "f_number",
    "objectNA": "object_na",
    "float_by_stop_size": "stop_diameter",
}
_COATINGS = ("SimpleCoating", "FresnelCoating")  # the others are optiland's own
_FIELDS: dict[str, FieldKind] = {
    "AngleField": "angle_deg",
    "ObjectHeightField": "object_height",
    "ParaxialImageHeightField": "image_height",
    "RealImageHeightField": "image_height",
}


def from_optiland(optic: Any) -> Sequential:
    """
    Read an optiland lens.

    Parameters
    ----------
    optic : optiland.optic.Optic
        Lens of surfaces that refract or reflect.

    Returns
    -------
    Sequential
        Lens in mm; `unread` lists coatings, scatter and apertures without a counterpart.

    Raises
    ------
    MistrayError
        If a surface, the aperture or the fields are of a kind that has no counterpart.
    """
    if not (hasattr(optic, "surfaces") and hasattr(optic, "wavelengths")):
        raise MistrayError(f"from_optiland was given {type(optic).__name__}; give an Optic of optiland 0.6 or later")
    name = str(optic.name or "optiland lens")
    surfaces = list(optic.surfaces)
    wavelengths = tuple(round(1e3 * _float(w.value) * _um(w.unit), 9) for w in optic.wavelengths.wavelengths)
    primary = next((k for k, w in enumerate(optic.wavelengths.wavelengths) if w.is_primary), 0)
    weights = tuple(float(w.weight) for w in optic.wavelengths.wavelengths)
    if len(surfaces) < 3 or not wavelengths or optic.aperture is None:
        raise MistrayError(f"optiland lens '{name}': it needs a surface, a wavelength and an aperture; add them")
    if optic.aperture.ap_type not in _APERTURES:
        raise MistrayError(f"optiland lens '{name}': aperture {optic.aperture.ap_type} has no counterpart; use EPD")
    unread: list[Unread] = []
    notes: list[str] = []
    frames = [surface.geometry.cs.get_effective_transform() for surface in surfaces[1:]]
    places = [np.array([_float(value) for value in shift]) for shift, _ in frames]
    turns = [np.array(turn, dtype=np.float64).reshape(3, 3) for _, turn in frames]
    rows: list[Row] = []
    before = _material(surfaces[0].material_post, wavelengths)
    for number, surface in enumerate(surfaces[1:], 1):
        last = number == len(surfaces) - 1
        place, turn = places[number - 1], turns_deg(turns[number - 1])
        decentre = None
        if place[0] or place[1] or any(turn):
            decentre = Decentre(x=float(place[0]), y=float(place[1]), tilt_deg=turn, returns=True)
        mirror = not last and bool(surface.interaction_model.is_reflective)
        material = before if mirror or last else _material(surface.material_post, wavelengths)
        row = Row(
            number,
            kind="image" if last else "surface",
            label=str(surface.comment or ""),
            **_figure(name, number, surface),
            thickness=0.0 if last else float(places[number][2] - place[2]),
            material=material,
            mirror=mirror,
            coating=_coating_name(surface),
            stop=bool(surface.is_stop) and not last,
            decentre=decentre,
            **_aperture(number, surface, unread),
        )
        rows.append(row)
        before = material
        coating, scatter = (getattr(surface.interaction_model, name, None) for name in ("coating", "bsdf"))
        for what, thing in (
            ("coating", None if type(coating).__name__ in _COATINGS else coating),
            ("scatter", scatter),
        ):
            if thing is not None:
                unread.append(Unread(0, f"surface {number}: {what} {type(thing).__name__}", "optiland's own: not read"))
    if any(row.decentre for row in rows):
        notes.append(
            "each surface has a decentre of its own from the world's z axis; first-order data leave decentres out: "
            "they hold only where light runs along this axis"
        )
    definition = type(optic.fields.field_definition).__name__
    fields = tuple((_float(field.x), _float(field.y)) for field in optic.fields.fields) or ((0.0, 0.0),)
    if definition not in _FIELDS and any(x or y for x, y in fields):
        raise MistrayError(f"optiland lens '{name}': fields of kind {definition} have no counterpart; use angles")
    if definition == "RealImageHeightField":
        notes.append("real image heights are taken as paraxial ones")
    shrinking = tuple((0.0, 0.0, _float(field.vx), _float(field.vy)) for field in optic.fields.fields)
    distance = math.inf if surfaces[0].is_infinite else float(places[0][2] - _float(surfaces[0].geometry.cs.z))
    return Sequential(
        name,
        tuple(rows),
        source=f"optiland lens '{name}'",
        object_distance=distance,
        object_material=_material(surfaces[0].material_post, wavelengths),
        aperture_kind=_APERTURES[optic.aperture.ap_type],
        aperture=_float(optic.aperture.value),
        telecentric=bool(optic.obj_space_telecentric) and math.isfinite(distance),
        field_kind=_FIELDS.get(definition, "angle_deg"),
        fields=fields,
        vignetting=shrinking,
        wavelengths_nm=wavelengths,
        weights=weights,
        primary=primary,
        unread=tuple(unread),
        notes=tuple(notes),
    )


def coatings_of(optic: Any) -> dict[str, Coating]:
    """Return the coatings of a lens that have constant R and T, by the names that its table uses."""
    found = {}
    for surface in list(optic.surfaces)[1:]:
        if name := _coating_name(surface):
            r, t = _shares(surface.interaction_model.coating)
            found[name] = Coating(R=r, T=t or None)
    return found


def _coating_name(surface: Any) -> str:
    """Return a name for a coating with constant R and T; "" for any other."""
    coating = getattr(surface.interaction_model, "coating", None)
    if type(coating).__name__ != "SimpleCoating":
        return ""
    r, t = _shares(coating)
    return f"R = {r!r}, T = {t!r}"


def _shares(coating: Any) -> tuple[float, float]:
    return _float(coating.reflectance), _float(coating.transmittance)


def _figure(name: str, number: int, surface: Any) -> dict[str, Any]:
    """
    Return radius, conic, coefficients and sag of a surface as arguments of `Row`; lengths in mm.

    Raise `MistrayError` if the interaction or the kind of surface has no counterpart.
    """
    geometry = surface.geometry
    what, kind = f"optiland lens '{name}', surface {number}", type(geometry).__name__
    interaction = getattr(surface.interaction_model, "interaction_type", "")
    if interaction != "refractive_reflective":
        raise MistrayError(f"{what}: its interaction '{interaction}' has no counterpart; let it refract or reflect")
    if kind not in _SAGS:
        raise MistrayError(f"{what}: {kind} has no counterpart; use one of {', '.join(_SAGS)}")
    if kind == "EvenAsphere":
        found = figure(_float(geometry.radius), _float(geometry.k), [_float(term) for term in geometry.coefficients])
    else:
        conic = _float(getattr(geometry, "k", 0.0))
        found = {"radius": _float(geometry.radius), "conic": conic} | _SAGS[kind](geometry)
    if kind not in ("Plane", "StandardGeometry"):
        _check(what, kind, geometry, Row(number, **found))
    return found


def _check(what: str, kind: str, geometry: Any, row: Row) -> None:
    """
    Raise `MistrayError` if mistray's sag of `row` differs from optiland's of `geometry`, whose sign conventions vary.

    Both are compared at points of a disc. `what` and `kind` are the surface and its kind, for the message.
    """
    reach = 0.3 * _float(getattr(geometry, "norm_radius", 0.0) or getattr(geometry, "norm_x", 0.0) or 10.0)
    reach = min(reach, 0.3 * abs(row.radius)) if row.radius else reach
    for c, k in ((curvature(row), row.conic), (row.sag.get("curvature_x", 0.0), row.sag.get("conic_x", 0.0))):
        reach = min(reach, 0.5 * conic_end(c, k))
    angle = np.linspace(0.3, 6.2, 12)
    x, y = reach * np.cos(angle) * np.linspace(0.2, 1, 12), reach * np.sin(angle) * np.linspace(0.2, 1, 12)
    ours, theirs = sag(x, y, row.sag_numbers), np.asarray(geometry.sag(x, y), dtype=np.float64)
    worst = float(np.abs(ours - theirs).max())
    if not worst <= _SAME_SAG * max(float(np.abs(theirs).max()), 1e-3 * reach):
        raise MistrayError(f"{what}: optiland's {kind} is another surface by {worst:.2g} mm; use a polynomial")


def _toroid(g: Any) -> dict[str, Any]:
    sweep, radius = _float(g.R_rot), _float(g.R_yz)
    terms = {f"a{2 * i}": _float(a) for i, a in enumerate(np.ravel(g.coeffs_poly_y), 1) if a}
    curvature = 0.0 if not sweep or math.isinf(sweep) else 1 / sweep
    return {"radius": radius, "conic": _float(g.k_yz), "sag": {"toroid_curvature": curvature, **terms}}


def _biconic(g: Any) -> dict[str, Any]:
    return {
        "radius": 1 / _float(g.cy) if _float(g.cy) else math.inf,
        "conic": _float(g.ky),
        "sag": {"curvature_x": _float(g.cx), "conic_x": _float(g.kx)},
    }


def _odd(g: Any) -> dict[str, Any]:
    terms = {f"{'r' if i % 2 else 'a'}{i}": _float(a) for i, a in enumerate(g.coefficients, 1) if _float(a)}
    return {"sag": terms}


def _table(g: Any, name: str) -> dict[str, float]:
    """Return the nonzero coefficients of a polynomial in two orders, by ``name_i_j``, in optiland's units."""
    found = {}
    for i, row in enumerate(g.coefficients):
        for j, value in enumerate(np.ravel(row)):
            if _float(value):
                found[f"{name}_{i}_{j}"] = _float(value)
    return found


def _chebyshev(g: Any) -> dict[str, Any]:
    table = _table(g, "chebyshev")
    return {"sag": table | ({"chebyshev_x": _float(g.norm_x), "chebyshev_y": _float(g.norm_y)} if table else {})}


def _zernike(g: Any) -> dict[str, Any]:
    """
    Return optiland's Zernike terms, in any order and norm, as `Row.sag`, mm, found by comparing values.

    Raise `MistrayError` if a term is beyond the known orders.
    """
    radius = _float(g.norm_radius)
    orders = {noll_orders(j): j for j in range(1, LAST_STANDARD + 1)}
    found: dict[str, float] = {}
    for (n, m), coefficient in zip(g.zernike.indices, np.ravel(g.zernike.coeffs), strict=False):
        amount, order = _float(coefficient), (int(n), int(m))
        if not amount:
            continue
        if order not in orders:
            raise MistrayError(f"optiland's Zernike polynomial {order} is beyond the {LAST_STANDARD} known ones")
        # At one point, where neither the radial part nor its angular part is 0
        rho, phi = 0.93, 0.4 / max(abs(order[1]), 1)
        theirs = _float(g.zernike.get_term(amount, *order, np.array([rho]), np.array([phi])))
        j = orders[order]
        ours = float(standard(np.array(rho * math.cos(phi)), np.array(rho * math.sin(phi)), {j: 1.0}))
        name = f"zernike_{j}"
        found[name] = found.get(name, 0.0) + theirs / ours
    return {"sag": found | ({"zernike_radius": radius} if found else {})}


def _forbes(g: Any) -> dict[str, Any]:
    terms = {f"qbfs_{int(m)}": _float(a) for m, a in g.radial_terms.items() if _float(a)}
    return {"sag": terms | ({"q_radius": _float(g.norm_radius)} if terms else {})}


def _forbes_2d(g: Any) -> dict[str, Any]:
    terms = {}
    for (letter, m, n), value in g.freeform_coeffs.items():
        if not _float(value):
            continue
        name = f"q2d_{'cos' if letter.lower() == 'a' else 'sin'}_{int(m)}_{int(n)}" if m else f"qbfs_{int(n)}"
        terms[name] = _float(value)
    return {"sag": terms | ({"q_radius": _float(g.norm_radius)} if terms else {})}


_SAGS: dict[str, Any] = {
    "Plane": lambda g: {},
    "StandardGeometry": lambda g: {},
    "EvenAsphere": None,
    "OddAsphere": _odd,
    "ToroidalGeometry": _toroid,
    "BiconicGeometry": _biconic,
    "PolynomialGeometry": lambda g: {"sag": _table(g, "xy")},
    "ChebyshevPolynomialGeometry": _chebyshev,
    "ZernikePolynomialGeometry": _zernike,
    "ForbesQNormalSlopeGeometry": _forbes,
    "ForbesQbfsGeometry": _forbes,
    "ForbesQ2dGeometry": _forbes_2d,
}
_SAME_SAG = 1e-9


def _aperture(number: int, surface: Any, unread: list[Unread]) -> dict[str, Any]:
    aperture = surface.aperture
    kind = type(aperture).__name__
    if aperture is None:
        return {}
    outline = _outline(aperture)
    if kind == "RadialAperture" and math.isinf(_float(aperture.r_max)):
        inner = _float(aperture.r_min)
        return {"obscuration": circle(inner)} if inner > 0 else {}
    if outline is not None:
        ring = outline.annulus
        if ring and not ring[1]:
            return {"semi_diameter": ring[0], "semi_diameter_fixed": True}
        return {"aperture": outline}
    unread.append(Unread(0, f"surface {number}: aperture {kind}", "it has no counterpart: nothing is clipped there"))
    return {}


def _outline(aperture: Any) -> Outline | None:
    """Return optiland's aperture as an outline, mm; None if its kind is not known or figures cannot express it."""
    kind = type(aperture).__name__
    x, y = (_float(getattr(aperture, f"offset_{axis}", 0.0)) for axis in "xy")
    if kind in ("RadialAperture", "OffsetRadialAperture"):
        return circle(_float(aperture.r_max), _float(aperture.r_min), x, y)
    if kind == "RectangularAperture":
        x0, x1, y0, y1 = (_float(getattr(aperture, key)) for key in ("x_min", "x_max", "y_min", "y_max"))
        return rectangle((x1 - x0) / 2, (y1 - y0) / 2, (x0 + x1) / 2, (y0 + y1) / 2)
    if kind == "EllipticalAperture":
        return Outline((OutlineFigure("ellipse", "+", x, y, sizes=(_float(aperture.a), _float(aperture.b))),))
    if kind == "PolygonAperture":
        corners = zip(np.asarray(aperture.x, float).ravel(), np.asarray(aperture.y, float).ravel(), strict=True)
        return polygon([(float(u), float(v)) for u, v in corners])
    sign = {"UnionAperture": "+", "IntersectionAperture": "&", "DifferenceAperture": "-"}.get(kind)
    if sign is None:
        return None
    first, second = _outline(aperture.a), _outline(aperture.b)
    if first is None or second is None or len(second.figures) > 1:
        return None
    return Outline((*first.figures, replace(second.figures[0], sign=sign)))


def _material(medium: Any, wavelengths_nm: tuple[float, ...]) -> str:
    name, maker = str(getattr(medium, "name", "")), str(getattr(medium, "reference", None) or "")
    catalogue = str(getattr(medium, "_catalog", None) or "")
    names = [f"{key}/{name}" for key in (maker, catalogue) if key] + [name] if name else []
    return same_material(names, lambda wavelength: _float(medium.n(wavelength / 1e3)), wavelengths_nm)


def _float(value: Any) -> float:
    """Return a number of optiland, which may be an array of one element, as a float."""
    return float(np.asarray(value, dtype=np.float64).reshape(-1)[0])


def _um(unit: str) -> float:
    return {"nm": 1e-3, "um": 1.0, "mm": 1e3, "cm": 1e4, "m": 1e6}[unit]

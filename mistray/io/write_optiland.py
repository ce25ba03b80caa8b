"""Conversion of prescriptions to lenses of optiland, the inverse of `mistray.io.optiland`; checked with 0.6."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np

from mistray.coatings import Stack, coating_from_text, read_coating
from mistray.errors import MistrayError, MistrayWarning
from mistray.io.to_sequential import to_sequential
from mistray.materials import complex_index, refractive_index
from mistray.prescription.model import Prescription, Surface
from mistray.prescription.sequential.table import Row, Sequential
from mistray.ranges import FIELD_DEG

_SAME_INDEX = 2e-6
# Notes about files, and about no loss
_EXPECTED = ("coatings without a name", "structure", "the stop is", "waves in the coating file")
_APERTURES = {"entrance_pupil_diameter": "EPD", "object_na": "objectNA"}


def to_optiland(prescription: Prescription, field_deg: float | Sequence[float] | None = None) -> Any:
    """
    Convert a prescription to an Optic of optiland, with its coatings and clear apertures.

    Parameters
    ----------
    prescription : Prescription
        Prescription with a detector, and with surfaces on one axis in the order of light: planes, conics and even
        aspheres.
    field_deg : float or sequence of float, optional
        Field angles of the Optic along y, degrees. The default is the axis and the angle of the source. Not allowed for
        a near object.

    Returns
    -------
    optiland.optic.Optic
        Lens whose coatings have constant R and T. Layers and tables are evaluated at normal incidence and the primary
        wavelength, with a `MistrayWarning` each. A bare surface gets no coating, since optiland's Fresnel coatings need
        `set_polarization` first. Edges, walls and barrels are left out; so is scatter, with a warning.

    Raises
    ------
    MistrayError
        If optiland is not installed, `field_deg` is given for a near object, or for the reasons of `to_sequential`. It
        is also raised if a surface has no counterpart: a freeform, one off the axis, an outline that is neither a
        circle, a ring nor a rectangle.

    Examples
    --------
    >>> from mistray.scenes.cooke_triplet.prescription import build
    >>> lens = mistray.prescription.to_optiland(build(), field_deg=[0, 10])
    >>> print(f"f = {float(lens.paraxial.f2()):.1f} mm")
    f = 50.0 mm
    """
    lens = to_sequential(prescription)
    optic = _optiland("optic").Optic(lens.name)
    losses = [note for note in lens.notes if not note.startswith(_EXPECTED)]
    surfaces = {surface.name: surface for surface in prescription.surfaces}
    media: dict[str, Any] = {}
    optic.surfaces.add(index=0, thickness=lens.object_distance, material=_medium(lens, lens.object_material, media))
    before, light = lens.object_material, np.array([0.0, 0.0, 1.0])  # light: direction of travel along the axis
    for number, row in enumerate(lens.rows, 1):
        what = f"prescription '{lens.name}', surface '{row.label}'"
        behind = before if row.mirror else row.material
        coating = None
        if row.kind == "surface" and (surface := surfaces.get(row.label)):
            normal = surface.to_world()[:3, 2]
            coating = _coating(what, surface, float(light @ normal) > 0, lens, losses)
            if row.mirror:
                light = light - 2 * (light @ normal) * normal
        optic.surfaces.add(
            index=number,
            comment=row.label,
            is_stop=row.stop,
            material="mirror" if row.mirror else _medium(lens, behind, media),
            thickness=row.thickness,
            aperture=_aperture(what, row),
            coating=coating,
            **_figure(what, row),
        )
        before = behind
    optic.set_aperture(aperture_type=_APERTURES[lens.aperture_kind], value=lens.aperture)
    optic.fields.set_type("angle" if lens.field_kind == "angle_deg" else "object_height")
    if field_deg is not None and lens.field_kind != "angle_deg":
        raise MistrayError(f"prescription '{lens.name}': field_deg is for distant objects; leave it out")
    angles = [] if field_deg is None else FIELD_DEG.check_each("field_deg", field_deg)
    for x, y in [(0.0, angle) for angle in angles] or lens.fields:
        optic.fields.add(x=x, y=y)
    for place, (nm, weight) in enumerate(zip(lens.wavelengths_nm, lens.weights, strict=True)):
        optic.wavelengths.add(value=nm / 1e3, is_primary=place == lens.primary, weight=weight)
    for loss in losses:
        warnings.warn(f"to_optiland, '{lens.name}': {loss}", MistrayWarning, stacklevel=2)
    return optic


def _optiland(module: str) -> Any:
    try:
        return import_module(f"optiland.{module}")
    except ImportError as error:
        raise MistrayError(f"to_optiland needs optiland ({error}); pip install optiland") from None


def _figure(what: str, row: Row) -> dict[str, Any]:
    if row.kind == "coordinate_break" or row.decentre is not None:
        raise MistrayError(f"{what} stands off the axis or is tilted; to_optiland takes surfaces on one axis")
    if set(row.sag) - {"a2"}:
        raise MistrayError(f"{what} is a freeform ({', '.join(row.sag)}); to_optiland takes conics and even aspheres")
    shape = {"radius": row.radius, "conic": row.conic}
    terms = [float(row.sag.get("a2", 0.0)), *row.coefficients]
    return shape | ({"surface_type": "even_asphere", "coefficients": terms} if any(terms) else {})


def _aperture(what: str, row: Row) -> Any:
    if row.kind == "image":
        return None  # a detector of optiland has no edge that stops light
    physical = _optiland("physical_apertures")
    if row.aperture is None:
        return None if row.semi_diameter is None else physical.RadialAperture(r_max=row.semi_diameter)
    ring, sides = row.aperture.annulus, row.aperture.sides
    if ring:
        return physical.RadialAperture(r_max=ring[0], r_min=ring[1])
    if sides is None:
        raise MistrayError(f"{what}: its outline is not a circle, ring or rectangle; to_optiland has no other")
    return physical.RectangularAperture(x_min=-sides[0], x_max=sides[0], y_min=-sides[1], y_max=sides[1])


def _medium(lens: Sequential, material: str, media: dict[str, Any]) -> Any:
    """
    Return an optiland material: a constant index, optiland's own if it agrees at all wavelengths, or mistray's.

    `media` keeps the materials made so far, by their strings.
    """
    if material not in media:
        media[material] = _new_medium(lens, material)
    return media[material]


def _new_medium(lens: Sequential, material: str) -> Any:
    lines = lens.wavelengths_nm
    indices = [refractive_index(material, nm) for nm in lines]
    materials = _optiland("materials")
    if material == "air" or len(set(indices)) == 1:
        return materials.IdealMaterial(n=indices[0])
    maker, _, glass = material.split()[0].rpartition("/")
    try:
        known = materials.Material(glass, reference=maker.lower() or None)
        theirs = [float(np.ravel(known.n(nm / 1e3))[0]) for nm in lines]
        if np.allclose(theirs, indices, rtol=0, atol=_SAME_INDEX):
            return known
    except (ValueError, KeyError, FileNotFoundError):
        pass  # it does not know the name
    return _table(materials, material)


def _table(materials: Any, material: str) -> Any:
    def of(wavelength_um: Any, part: str) -> Any:
        lines, places = np.unique(wavelength_um, return_inverse=True)  # rays by the thousand have one wavelength
        values = np.array([getattr(complex_index(material, round(1e3 * float(um), 9)), part) for um in lines])
        return values[np.reshape(places, np.shape(wavelength_um))]

    base: Any = materials.BaseMaterial

    class MistrayMaterial(base):
        """Optiland material whose refractive index comes from mistray, because optiland has no equal one."""

        def _calculate_n(self, wavelength: Any, **_: Any) -> Any:
            return of(wavelength, "real")

        def _calculate_k(self, wavelength: Any, **_: Any) -> Any:
            return of(wavelength, "imag")

    medium = MistrayMaterial()
    medium.name = material
    return medium


def _coating(what: str, surface: Surface, from_front: bool, lens: Sequential, losses: list[str]) -> Any:
    """
    Return an optiland coating with constant R and T; None for a bare surface.

    `from_front` says that light meets the surface from its front, and `what` names it. Losses of detail are added to
    `losses`.
    """
    kinds, coating = _optiland("coatings"), surface.coating
    if coating is None:
        return None
    if coating.R is not None:
        return kinds.SimpleCoating(transmittance=coating.T or 0.0, reflectance=coating.R)
    nm = lens.wavelengths_nm[lens.primary]
    front, back = (complex_index(side, nm) for side in (surface.front, surface.back))
    text = coating.preset or coating.layers or coating.table or ""
    if coating.table is not None:
        answer = read_coating(text, coating.design_nm, coating.mirror)
    else:
        answer = coating_from_text(text, coating.design_nm)
    if isinstance(answer, Stack):
        shifts = [given or [0.0] * len(answer.layers) for given in (coating.n_shift, coating.k_shift)]
        layers = [replace(layer, n_shift=n, k_shift=k) for layer, n, k in zip(answer.layers, *shifts, strict=True)]
        answer = replace(answer, layers=tuple(layers), first=coating.first)
    found = answer.response(nm, front, back, np.ones(1), from_front)
    r, t = float(found.R.mean()), float(found.T.mean())
    losses.append(f"{what}: coating '{coating.name or text}' becomes R = {r:.4g}, T = {t:.4g}, as at {nm:g} nm")
    return kinds.SimpleCoating(transmittance=t, reflectance=r)

"""Reader of ray-optics models (https://github.com/mjhoptics/ray-optics, checked with 0.9).

The sequential model is a list of interfaces with gaps between them, in the system unit. Decentres follow CODE V, see
`read_codev`. The focus shift is a defocus: it adds to the thickness before the image.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

from mistray.errors import MistrayError
from mistray.io.codev.rows import CodevSurface, rows_of
from mistray.io.conventions import figure, object_na, squeezed
from mistray.materials.mate import shown
from mistray.physics.geometry.outline import Outline, OutlineFigure, circle
from mistray.prescription.sequential.materials import same_material
from mistray.prescription.sequential.table import ApertureKind, FieldKind, Row, Sequential, Unread
from mistray.read_file import require_file

_UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1e3, "in": 25.4, "inches": 25.4, "ft": 304.8}
_MODES = {"decenter": "", "dec and return": "DAR", "reverse": "REV", "bend": "BEN"}
_FIELDS: dict[tuple[str, str], FieldKind] = {
    ("object", "angle"): "angle_deg",
    ("object", "height"): "object_height",
    ("image", "height"): "image_height",
    ("image", "real height"): "image_height",
}
_INFINITE = 1e9
_MODES_OF_LIGHT = ("transmit", "reflect", "dummy", "phantom")  # phantom: a coordinate break of a Zemax file
_FIGURES = {"Rectangular": "rectangle", "Elliptical": "ellipse"}


def read_rayoptics(path: str | Path) -> Sequential:
    """
    Read a model that ray-optics has saved.

    Parameters
    ----------
    path : str or Path
        The .roa file.

    Returns
    -------
    Sequential
        Lens as returned by `from_rayoptics`.

    Raises
    ------
    MistrayError
        If ray-optics is missing or cannot open the file, or for the reasons of `from_rayoptics`.
    """
    path = Path(path)
    require_file(path, "lens")
    try:
        from rayoptics.gui.roafile import open_roa  # without Qt, which rayoptics.environment imports
    except ImportError as error:
        raise MistrayError(
            f"ray-optics file '{path.name}': it is read by ray-optics, which cannot be imported ({error}); run: pip "
            "install rayoptics"
        ) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = open_roa(str(path))
    except Exception as error:  # whatever ray-optics meets in a file of somebody else's
        reason = " ".join(f"{type(error).__name__} {error}".split())
        raise MistrayError(
            f"ray-optics file '{path.name}': ray-optics cannot open it ({shown([reason])}); save it there anew"
        ) from None
    return replace(from_rayoptics(model), source=f"ray-optics file {path.name}")


def from_rayoptics(model: Any) -> Sequential:
    """
    Read a ray-optics model.

    Parameters
    ----------
    model : rayoptics.optical.opticalmodel.OpticalModel
        Model of spheres, conics, polynomials of r and toroids that refract or reflect.

    Returns
    -------
    Sequential
        Lens in mm and degrees.

    Raises
    ------
    MistrayError
        If an interface, the pupil or the fields have no counterpart.
    """
    try:
        sequence, specs, system = (model[key] for key in ("seq_model", "optical_spec", "system_spec"))
    except (KeyError, TypeError):
        kind = type(model).__name__
        raise MistrayError(f"from_rayoptics was given {kind}; give an OpticalModel of ray-optics") from None
    name = str(system.title or "ray-optics model")
    what = f"ray-optics model '{name}'"
    unit = _UNITS_MM.get(str(system.dimensions).strip().lower(), 0.0)
    if not unit:
        raise MistrayError(f"{what}: unit '{system.dimensions}' is unknown; it is one of {', '.join(_UNITS_MM)}")
    spectrum, view = specs["wvls"], specs["fov"]
    wavelengths = tuple(float(value) for value in spectrum.wavelengths)
    materials = [_material(gap.medium, wavelengths) for gap in sequence.gaps]
    unread: list[Unread] = []
    notes: list[str] = []
    rows: list[Row] = []
    before, last = materials[0], len(sequence.ifcs) - 1
    shift = float(getattr(specs["focus"], "focus_shift", 0.0))
    for number, interface in enumerate(sequence.ifcs[1:], 1):
        surface = _surface(f"{what}, interface {number}", interface)
        if number < last:
            surface.thickness = float(sequence.gaps[number].thi) + (shift if number == last - 1 else 0.0)
            surface.material = materials[number]
        else:
            surface.mode, surface.mirror, surface.material = "", False, before
        more = _apertures(number, interface, unit, unread) if number < last else {"kind": "image"}
        if interface.interact_mode == "phantom" and number < last:
            more = {"kind": "coordinate_break"}
        stop = number == sequence.stop_surface and number < last
        new = rows_of(surface, number, unit_mm=unit, before=before, unread=unread, stop=stop, **more)
        rows += new[:1] if number == last else new
        before = new[-1].material
        if surface.mode == "BEN" and surface.moves["A"] and surface.moves["B"]:
            notes.append(f"interface {number}: ray-optics bends the axis by the turn twice, here it is reflected")
    if shift:
        notes.append(f"the focus shift of {shift * unit:g} mm is added to the last thickness")
    key = view.key
    if key not in _FIELDS:
        raise MistrayError(f"{what}: fields of kind {key} have no counterpart; use object angles")
    factor = 1.0 if _FIELDS[key] == "angle_deg" else unit
    if key[1] == "real height":
        notes.append("real image heights are taken as paraxial ones")
    vignetting = tuple(squeezed(f.vux, f.vlx, f.vuy, f.vly) for f in view.fields)
    distance = float(sequence.gaps[0].thi)
    lens = Sequential(
        name,
        tuple(rows),
        source=what,
        object_distance=math.inf if abs(distance) >= _INFINITE else distance * unit,
        object_material=materials[0],
        field_kind=_FIELDS[key],
        fields=tuple((float(f.xv) * factor, float(f.yv) * factor) for f in view.fields),
        vignetting=vignetting,
        wavelengths_nm=wavelengths,
        weights=tuple(map(float, [*spectrum.spectral_wts, *[1.0] * len(wavelengths)]))[: len(wavelengths)],
        primary=int(spectrum.reference_wvl),
        unread=tuple(unread),
    )
    kind, value = _pupil(what, lens, specs["pupil"], unit)
    return replace(lens, aperture_kind=kind, aperture=value, notes=tuple(notes))


def _pupil(what: str, lens: Sequential, pupil: Any, unit: float) -> tuple[ApertureKind, float]:
    key, value = tuple(pupil.key), float(pupil.value)
    distant = math.isinf(lens.object_distance)
    if key == ("object", "epd"):
        return "entrance_pupil_diameter", value * unit
    if key == ("object", "NA"):
        return "object_na", value
    if key in (("image", "f/#"), ("image", "NA")):
        na = 1 / (2 * value) if key[1] == "f/#" else value  # both with the index at the image
        return ("f_number", 1 / (2 * na)) if distant else ("object_na", object_na(lens, na))
    raise MistrayError(f"{what}: pupil of kind {key} has no counterpart; use ('object', 'epd')")


def _surface(what: str, interface: Any) -> CodevSurface:
    """
    Return shape, mode (refract or reflect) and decentres of an interface, in the model's units.

    Raise `MistrayError` if its shape or mode has no counterpart, or the surface diffracts.
    """
    profile: Any = getattr(interface, "profile", interface)  # a thin lens has none
    kind = type(profile).__name__
    if kind not in ("Spherical", "Conic", "EvenPolynomial", "RadialPolynomial", "YToroid"):
        raise MistrayError(f"{what}: {kind} has no counterpart; use a conic, a polynomial of r or a YToroid")
    if getattr(interface, "phase_element", None) is not None:
        raise MistrayError(f"{what}: diffracting surfaces are not traced; remove its phase element")
    if interface.interact_mode not in _MODES_OF_LIGHT:
        raise MistrayError(f"{what}: its mode '{interface.interact_mode}' has no counterpart; it transmits or reflects")
    terms = [float(a) for a in getattr(profile, "coefs", ())]
    curvature = float(profile.cv)
    found = figure(1 / curvature if curvature else math.inf, float(getattr(profile, "cc", 0.0)), [0.0])
    extra: dict[str, float] = {}
    if kind == "EvenPolynomial":
        found = figure(found["radius"], found["conic"], terms)
        extra = {name.upper(): value for name, value in found["sag"].items()}
    elif kind == "RadialPolynomial":
        extra = {f"{'R' if i % 2 else 'A'}{i}": a for i, a in enumerate(terms, 1) if a}
    elif kind == "YToroid":
        found["coefficients"] = terms[1:]
        extra = {"A2": terms[0]} if terms and terms[0] else {}
    surface = CodevSurface(
        0,
        curvature=0.0 if math.isinf(found["radius"]) else 1 / found["radius"],
        conic=found["conic"],
        coefficients=dict(enumerate(found["coefficients"])),
        kind="YTO" if kind == "YToroid" else "ODD" if extra else "",
        curvature_x=float(getattr(profile, "cR", 0.0)),
        extra=extra,
        mirror=interface.interact_mode == "reflect",
        label=str(interface.label or ""),
    )
    if interface.decenter:
        move = interface.decenter
        surface.mode = _MODES[move.dtype]
        surface.moves = dict(zip("XYZABC", (float(value) for value in (*move.dec, *move.euler)), strict=True))
    return surface


def _apertures(number: int, interface: Any, unit: float, unread: list[Unread]) -> dict[str, Any]:
    """
    Return the intersection of the clear apertures, mm, as arguments of `Row`.

    Without clear apertures it is the round, centred edge of the body, if there is one. Apertures that are left out go
    to `unread`.
    """
    result: dict[str, Any] = {}
    edges = getattr(interface, "edge_apertures", ())
    clear = getattr(interface, "clear_apertures", ())
    for aperture in edges:
        centred = not (aperture.x_offset or aperture.y_offset)
        if not clear and not result and centred and type(aperture).__name__ == "Circular":
            result = {"semi_diameter": float(aperture.radius) * unit}
        else:
            reason = "the edge of the body; edges are generated from clear apertures"
            unread.append(Unread(0, f"interface {number}: edge {type(aperture).__name__}", reason))
    shown: Outline | None = None
    for aperture in clear:
        kind = type(aperture).__name__
        x, y = float(aperture.x_offset) * unit, float(aperture.y_offset) * unit
        angle = float(aperture.rotation)
        if kind == "Circular":
            outline = circle(float(aperture.radius) * unit, x=x, y=y)
        elif kind in _FIGURES:
            sizes = (float(aperture.x_half_width) * unit, float(aperture.y_half_width) * unit)
            outline = Outline((OutlineFigure(_FIGURES[kind], "+", x, y, angle, sizes),))
        else:
            reason = "it has no counterpart: nothing is clipped by it"
            unread.append(Unread(0, f"interface {number}: aperture {kind}", reason))
            continue
        shown = (
            outline if shown is None else Outline((*shown.figures, *(replace(f, sign="&") for f in outline.figures)))
        )
    if shown is not None and shown.annulus:
        return {"semi_diameter": shown.annulus[0], "semi_diameter_fixed": True}
    if shown is not None:
        result["aperture"] = shown
    return result


def _material(medium: Any, wavelengths_nm: tuple[float, ...]) -> str:
    name, maker = str(medium.name()), str(medium.catalog_name() or "")
    return same_material([f"{maker}/{name}", name], lambda wavelength: float(medium.rindex(wavelength)), wavelengths_nm)

"""Reader of the optical surfaces of a scene file, for export; the scene itself is not loaded.

It reads shapes of type `asphere` and `freeform` whose `interface` transmits light or is a mirror, the detector, the
aperture stop, and the source, also in scenes that the file includes. The stop is the frustums whose ``part`` is
``stop``; the source is `collimated` or `point_source`, and of others the wavelengths are read. Everything else is
structure, of which only the names are returned.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.files.sag_grid import read_sag_grid
from mistray.materials import resolved, shifted
from mistray.named_values import number_of
from mistray.physics.geometry.outline import outline_of
from mistray.physics.geometry.pose import fixed_angles_deg, moved, rotation
from mistray.physics.geometry.sag import trimmed
from mistray.physics.polarization.state import jones_numbers
from mistray.physics.sags.grid import Grid
from mistray.physics.sags.terms import GRID, RADII, length_power
from mistray.prescription import Coating, Detector, ObjectPoint, Prescription, Source, Stop, Surface
from mistray.prescription.model import MAX_COEFFICIENTS
from mistray.prescription.scatter import Scatter
from mistray.prescription.spectral import DEFAULT_NM, Spectral
from mistray.scatter.kinds import KINDS
from mistray.scene.files import with_includes
from mistray.scene.load import find
from mistray.scene.recoat import COATED
from mistray.scene.xml_file import Element, filled, is_true

_SHIFTS = ("x", "y", "z", "tilt_x", "tilt_y", "tilt_z")
_COEFFICIENTS = tuple(f"a{2 * place}" for place in range(2, 2 + MAX_COEFFICIENTS))
_OPTICAL = ("asphere", "freeform")
_STOP_PART = "stop"
_PIXELS = (1, 1)
_WIDE = 1e9  # mm: radius of a beam that fills any lens


def read_optics(source: str | Path) -> tuple[Prescription, tuple[str, ...]]:
    """
    Read the optical surfaces of a scene.

    Parameters
    ----------
    source : str or Path
        A scene XML file or the name of a shipped scene.

    Returns
    -------
    prescription : Prescription
        Surfaces in the order of the file, stop, detector and source, without other structure. Its provenance is a note
        on a source of another kind, which becomes a beam of the same wavelengths; "" if there is none.
    left_out : tuple of str
        Names of the shapes that are not in `prescription`.

    Raises
    ------
    MistrayError
        If the file is missing or broken, has two sources or two detectors, or holds a value that is not understood.
    """
    path = find(source)
    return _Reader(path, str(source)).read()


def light_nm(path: Path) -> tuple[float, ...]:
    """
    Return the wavelengths, nm, of the first source of a scene file, or the ends of the band of its own emission.

    The result is empty if there is no source, or it states no wavelengths. Raise `MistrayError` as `read_optics` does.
    """
    reader = _Reader(path, "")
    return next((reader.lines(element) for element in reader.file.root.children if element.tag == "emitter"), ())


class _Reader:
    def __init__(self, path: Path, name: str) -> None:
        self.file = with_includes(path)
        self.name = Path(name).stem if Path(name).suffix else name

    def read(self) -> tuple[Prescription, tuple[str, ...]]:
        surfaces: list[Surface] = []
        left_out: list[str] = []
        stop: list[Element] = []
        detector: Detector | None = None
        light: Source | ObjectPoint | None = None
        others: list[Element] = []
        for element in self.file.root.children:
            kind = element.values.get("type")
            if element.tag == "emitter" and kind in ("collimated", "point_source"):
                if light is not None:
                    raise MistrayError(f"scene '{self.file.path}': it has two sources; remove one to export")
                light = self._source(element) if kind == "collimated" else self._object_point(element)
            elif element.tag == "emitter":
                others.append(element)
            if element.tag != "shape":
                continue
            label = element.values.get("id", kind or "shape")
            if kind in _OPTICAL and any(child.tag == "sensor" for child in element.children):
                if detector is not None:
                    raise MistrayError(
                        f"scene '{self.file.path}': detectors '{detector.name}' and '{label}'; a lens has one image, "
                        "remove one to export"
                    )
                detector = self._detector(element, label)
            elif kind in _OPTICAL and (surface := self._surface(element, label)) is not None:
                surfaces.append(surface)
            elif kind == "frustum" and self.file.values(element).get("part") == _STOP_PART:
                stop.append(element)
            else:
                left_out.append(label)
        note = ""
        if others and light is None:
            light = Source(radius=_WIDE, **self._any_light(others[0]))
            note = f"the source, '{others[0].values.get('type')}', is left out but for its wavelengths"
        prescription = Prescription(
            name=self.name,
            surfaces=tuple(surfaces),
            stop=self._stop(stop),
            detector=detector,
            source=light,
            provenance=note,
        )
        return prescription, tuple(left_out)

    def _any_light(self, element: Element) -> dict[str, Any]:
        """Return the wavelengths or the spectrum of any source as arguments of `Spectral`."""
        given = self.spectral("source", self.file.values(element))
        if given["spectrum"] is None:  # the scene's own emission has a band alone
            given |= {"wavelength_nm": self.lines(element) or DEFAULT_NM, "band_nm": None, "bands": None}
        return given

    def lines(self, element: Element) -> tuple[float, ...]:
        """Return the wavelengths of a source, nm, or the ends of the band of the scene's own emission; () without."""
        values = self.file.values(element)
        light = self.spectral("source", values)
        if light["spectrum"] is not None:
            return tuple(map(float, Spectral(**light).light.wavelengths_nm))
        return light["wavelength_nm"] if "wavelength_nm" in values else light["band_nm"] or ()

    def _number(self, where: str, values: Mapping[str, str], key: str, default: float | None = None) -> float:
        if key not in values and default is not None:
            return default
        number = number_of(values.get(key, ""))
        if number is None:
            found = f"is '{values[key]}'" if key in values else "is missing"
            raise MistrayError(f"scene '{self.file.path}', {where}: {key} {found}; give a number")
        return number

    def _surface(self, element: Element, label: str) -> Surface | None:
        """
        Return an optical surface; None for a shape that neither reflects as a mirror nor transmits light.

        It is also None if the BSDF is neither an ``interface`` nor a ``thinfilm`` by itself, or the shape is mechanics.
        """
        if is_true(self.file.values(element).get("mechanics", "")):
            return None
        found = self.file.surface(element)
        if found is None or found[1].values.get("type") not in COATED:
            return None
        values = self.file.values(found[1])
        mirror = is_true(values.get("mirror", ""))
        coating, opaque = self._coating(found[1], values)
        if opaque and not mirror:
            return None
        form = self._form(element, label) | self._media(label, values) | {"scatter": self._scatter(label, found[1])}
        return Surface(label, **form, coating=coating, mirror=mirror)

    def _scatter(self, label: str, bsdf: Element) -> tuple[Scatter, ...]:
        """Return the scatter models of a surface from its BSDF; a value that is no number raises `MistrayError`."""
        found = []
        for model in filter(None, map(self.file.meant, bsdf.children)):
            if (kind := model.values.get("type", "")) in KINDS:
                given: dict[str, Any] = dict(self.file.values(model))
                for child in model.children:
                    name = child.values.get("name", "")
                    if child.tag in ("float", "integer"):
                        number = self._number(f"shape '{label}', {kind}", given, name)
                        given[name] = int(number) if child.tag == "integer" else number
                    elif child.tag == "boolean":
                        given[name] = is_true(given[name])
                found.append(Scatter(kind, given))
        return tuple(found)

    def _media(self, label: str, values: Mapping[str, str]) -> dict[str, Any]:
        """
        Return the materials on the sides of a surface, from the values of its BSDF, as arguments of `Surface`.

        Shifts of their indices are included. One that is no number raises `MistrayError`.
        """
        found: dict[str, Any] = {}
        for side in ("front", "back"):
            shift = self._number(f"shape '{label}'", values, f"n_{side}_shift", 0.0)
            found[side] = shifted(resolved(values.get(side, "air"), self.file.beside), shift)
        return found

    def _coating(self, element: Element, values: Mapping[str, str]) -> tuple[Coating | None, bool]:
        """Return the coating of a BSDF, None for a bare surface, and whether it transmits no light."""
        if element.values["type"] == "interface" and ("R" in values or "table" in values):
            coating = Coating(**self._recipe("an interface", values))
            return coating, coating.blocks(self.file.beside)
        for film in (element, *map(self.file.meant, element.children)):
            if film is not None and film.values.get("type") == "thinfilm":
                values = self.file.values(film)
                coating = Coating(**self._recipe("a thinfilm", values), name=film.values.get("id"))
                return coating, coating.blocks(self.file.beside)
        return None, False

    def _recipe(self, where: str, values: Mapping[str, str]) -> dict[str, Any]:
        """
        Return the values of a `thinfilm` or `interface` that define its coating, as arguments of `Coating`.

        R and T are fractions of the incident light. A value of them that is no number raises `MistrayError`.
        """
        recipe: dict[str, Any] = {key: values[key] for key in ("preset", "layers", "table", "first") if key in values}
        recipe |= {"mirror": True} if is_true(values.get("opaque", "")) else {}
        recipe |= {key: self._numbers(where, values, key) for key in ("n_shift", "k_shift") if key in values}
        return recipe | {key: self._number(where, values, key) for key in ("R", "T", "design_nm") if key in values}

    def _form(self, element: Element, label: str) -> dict[str, Any]:
        """
        Return shape, clip and placement of a surface as arguments of `Surface`; lengths in mm.

        A value that is no number raises `MistrayError`.
        """
        where = f"shape '{label}'"
        values = self.file.values(element)
        radius = self._number(where, values, "radius", 0.0)
        if curvature := self._number(where, values, "curvature", 0.0):
            radius = 1 / curvature
        form: dict[str, Any] = {
            "radius": radius or math.inf,
            "conic": self._number(where, values, "conic", 0.0),
            "coefficients": trimmed(self._number(where, values, key, 0.0) for key in _COEFFICIENTS),
        }
        for key in ("semi_diameter", "inner_semi_diameter", "half_width", "half_height"):
            if key in values:
                form[key] = self._number(where, values, key)
        if element.values["type"] == "freeform":
            form |= self._freeform(where, values)
        pose = self._to_world(element, where)
        return form | _placed(moved(pose, *(self._number(where, values, key, 0.0) for key in _SHIFTS)))

    def _freeform(self, where: str, values: Mapping[str, str]) -> dict[str, Any]:
        """Return what a `freeform` has beside an `asphere` as arguments of `Surface`: sag, outline and direction."""
        number = partial(self._number, where, values)
        terms = {key for key in values if length_power(key) is not None} - {"curvature", "conic", *_COEFFICIENTS}
        sag: dict[str, Any] = {key: number(key) for key in sorted(terms)}
        for key, curvature in RADII.items():
            if key in values and key != "radius":
                sag[curvature] = 1 / (number(key) or math.inf)
        if GRID in values:
            path = self.file.beside(values[GRID])
            sag[GRID] = Grid.of_values(*read_sag_grid(path), path)
        outline = outline_of(values, number, f"scene '{self.file.path}', {where}")
        return {"sag": sag, "outline": outline, "meets": values.get("meets", "both")}

    def _detector(self, element: Element, label: str) -> Detector:
        found = self.file.surface(element)
        coated = found is not None and found[1].values.get("type") in COATED
        values = self.file.values(found[1]) if found is not None and coated else {}
        return Detector(label, **self._form(element, label), **self._media(label, values), pixels=_PIXELS)

    def _to_world(self, element: Element, where: str) -> np.ndarray:
        pose = np.eye(4)
        for transform in (child for child in element.children if child.tag == "transform"):
            for step in transform.children:
                values = {key: filled(text, self.file.defaults) for key, text in step.values.items()}
                pose = self._step(step.tag, values, where) @ pose
        return pose

    def _step(self, tag: str, values: Mapping[str, str], where: str) -> np.ndarray:
        result = np.eye(4)
        if tag == "translate":
            vector = values.get("value", "").replace(",", " ").split()
            places = {**dict(zip("xyz", vector, strict=False)), **values}
            result[:3, 3] = [self._number(where, places, axis, 0.0) for axis in "xyz"]
            return result
        axes = [axis for axis in range(3) if self._number(where, values, "xyz"[axis], 0.0)]
        if tag == "rotate" and len(axes) == 1:
            sense = math.copysign(1.0, float(values["xyz"[axes[0]]]))
            result[:3, :3] = rotation(axes[0], sense * self._number(where, values, "angle"))
            return result
        raise MistrayError(
            f"scene '{self.file.path}', {where}: its to_world has <{tag}>; write rotations about x, y or z and "
            "translations"
        )

    def _stop(self, elements: list[Element]) -> Stop | None:
        if not elements:
            return None
        values = [self.file.values(element) for element in elements]
        where = f"the aperture stop (part '{_STOP_PART}')"
        radii = [self._number(where, row, key) for row in values for key in ("r0", "r1")]
        shifts = [self._number(where, row, "z", 0.0) for row in values]
        places = [
            self._number(where, row, key) + z for row, z in zip(values, shifts, strict=True) for key in ("z0", "z1")
        ]
        poses = [self._to_world(element, where) for element in elements]
        if any(not np.array_equal(pose, np.eye(4)) for pose in poses):
            raise MistrayError(f"scene '{self.file.path}', {where}: it is moved by to_world; put its place into z0, z1")
        for row, key in itertools.product(values, ("x", "y", "tilt_x", "tilt_y")):
            if self._number(where, row, key, 0.0):
                raise MistrayError(
                    f"scene '{self.file.path}', {where}: its {key} is {row[key]}; leave it out to export"
                )
        outer = max(radii)
        return Stop(min(radii), min(places), max(places), outer, outer)

    def _source(self, element: Element) -> Source | None:
        where, values = "source", self.file.values(element)
        names = ("radius", "half_width", "half_height", "pupil_area")
        sizes: dict[str, Any] = {key: self._number(where, values, key) for key in names if key in values}
        return Source(**sizes, **_placed(self._to_world(element, where)), **self._light(where, values))

    def _object_point(self, element: Element) -> ObjectPoint:
        where, values = "source", self.file.values(element)
        distance = -self._number(where, values, "z", 0.0)
        if not distance > 0:
            raise MistrayError(f"scene '{self.file.path}', source: its z is {-distance:g}; an object lies at z < 0")
        pose = self._to_world(element, where)
        pose[:3, 3] += pose[:3, :2] @ [self._number(where, values, axis, 0.0) for axis in "xy"]
        cone = self._number(where, values, "half_angle_deg", 180.0)
        return ObjectPoint(distance=distance, half_angle_deg=cone, **_placed(pose), **self._light(where, values))

    def _light(self, where: str, values: Mapping[str, str]) -> dict[str, Any]:
        """
        Return field, spectrum and polarisation of a source as arguments of `Source`.

        A value that is not of numbers raises `MistrayError`.
        """
        angle = "polarization_deg"
        return {
            "field_deg": self._number(where, values, "field_deg", 0.0),
            "azimuth_deg": self._number(where, values, "azimuth_deg", 0.0),
            **self.spectral(where, values),
            "stokes": self._numbers(where, values, "stokes"),
            "jones": jones_numbers(where, values["jones"]) if "jones" in values else None,
            angle: self._number(where, values, angle) if angle in values else None,
        }

    def spectral(self, where: str, values: Mapping[str, str]) -> dict[str, Any]:
        """Return the wavelengths or the spectrum of a source as arguments of `Spectral`, or raise as `_light` does."""
        return {
            "wavelength_nm": self._numbers(where, values, "wavelength_nm") or DEFAULT_NM,
            "weights": self._numbers(where, values, "weights"),
            "spectrum": self.file.beside(values["spectrum"]) if "spectrum" in values else None,
            "band_nm": self._numbers(where, values, "band_nm"),
            "bands": int(self._number(where, values, "bands")) if "bands" in values else None,
        }

    def _numbers(self, where: str, values: Mapping[str, str], key: str) -> tuple[float, ...] | None:
        if key not in values:
            return None
        return tuple(self._number(where, {key: word}, key) for word in values[key].replace(",", " ").split())


def _placed(pose: np.ndarray) -> dict[str, Any]:
    """
    Return position x, y, z (mm) and `tilt_deg`, tilts about the world's x, y and z in degrees, of a 4 × 4 pose matrix.

    See `Placed`.
    """
    tilt = tuple(round(angle, 10) + 0.0 for angle in fixed_angles_deg(pose[:3, :3]))
    return {"x": float(pose[0, 3]), "y": float(pose[1, 3]), "z": float(pose[2, 3]), "tilt_deg": tilt}

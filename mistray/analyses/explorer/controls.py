"""Controls of the live explorer: coatings of parts, scene parameters, field and wavelength."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mistray.coatings import PRESETS, CoatingModel, coating_from_text, fitted_preset
from mistray.errors import MistrayError, nearest
from mistray.metrics.parameters import Parameter, match, parameters
from mistray.prescription.by_text import BARE
from mistray.prescription.geometry import is_gas
from mistray.ranges import ANYTHING, ByName, Range
from mistray.scene.coat import faces_of
from mistray.scene.read_optics import light_nm
from mistray.scene.xml_file import SceneFile
from mistray.surfaces.surfaces import solid_shapes

AS_IT_IS = "as it is"
NEAR_LIGHT = 0.5, 2.0  # centre of a preset's band by the middle of the light: others are not offered
COATING, LAYERS, NUMBER, FIELD, WAVELENGTH = "coating", "layers", "number", "field", "wavelength"
LAYERS_PERCENT = Range(50.0, 200.0, unit="%")
SPAN = 4.0  # by which numbers known by their order of magnitude may be multiplied and divided
SAME_MM = 1e-9  # radii that are one
NEAR = 0.1  # share of a length by which it may change
WAVELENGTHS = 0.7, 1.3  # of that of the scene
MOST = 40  # controls of numbers that are there without being requested
# Numbers of scatter models that say how much light is scattered
AMOUNTS = ("A", "b0", "coverage_percent", "level", "reflectance", "rms_nm", "scale", "total")
RIMS = re.compile(r"vane|baffle|stop|hood|shade|iris|aperture", re.IGNORECASE)
VALUES = str | float
NEW = ByName(ANYTHING, "{'L1.z': 0.1}")


@dataclass(frozen=True)
class Control:
    """
    Choice or slider of the live explorer, which sets a quantity of the scene.

    Attributes
    ----------
    name : str
        Name such as "coating L1", "layers", "detector.bsdf.R", "vane radius", "field", "wavelength".
    kind : {"coating", "layers", "number", "field", "wavelength"}
        Kind of quantity that it sets.
    start : str or float
        Value in the scene; "as it is" for a coating, 100 % for layers.
    label, unit : str
        Label on the page and unit of the value.
    choices : tuple of str
        Choices of a coating; empty for a slider.
    low, high : float
        Ends of a slider, in `unit`; 0 for a coating.
    log : bool
        Whether a slider is logarithmic.
    surfaces : tuple of str
        Ids of the shapes that the control acts on; empty for field and wavelength.
    bodies : tuple of str
        For a coating: the material of the body that each surface bounds.
    parameter : Parameter or None
        For a number: the scene parameter, the first if several move; None for other kinds.
    keys : tuple of str
        For a number: keys of the scene parameters that are all set to its value.
    """

    name: str
    kind: str
    start: VALUES
    label: str
    unit: str = ""
    choices: tuple[str, ...] = ()
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    surfaces: tuple[str, ...] = ()
    bodies: tuple[str, ...] = ()
    parameter: Parameter | None = None
    keys: tuple[str, ...] = ()

    def coatings(self, choice: str) -> dict[str, CoatingModel]:
        """
        Return the coating that a choice other than "as it is" means for each surface, by shape id.

        A preset is fitted to the material of the body that the surface bounds.
        """
        on = {body: _coating(choice, body) for body in set(self.bodies)}
        return {surface: on[body] for surface, body in zip(self.surfaces, self.bodies, strict=True)}

    def check(self, value: Any) -> VALUES:
        """
        Return a value after a check, clipped to the ends of a slider.

        Raises
        ------
        MistrayError
            If it is not one of the choices, or not a number between `low` and `high`.
        """
        if self.choices:
            if not isinstance(value, str) or value not in self.choices:
                raise MistrayError(f"control '{self.name}' is {value!r:.80}; choose from {', '.join(self.choices)}")
            return value
        slack = 1e-9 * max(abs(self.low), abs(self.high))
        number = Range(self.low - slack, self.high + slack, unit=self.unit).check(f"control '{self.name}'", value)
        return min(max(float(number), self.low), self.high)

    def plain(self) -> dict[str, Any]:
        """Return the control as JSON-serialisable values for the page."""
        shown = ("name", "kind", "label", "unit", "start", "choices", "low", "high", "log", "surfaces", "way")
        return {name: getattr(self, name) for name in shown}

    @property
    def way(self) -> str:
        """Method by which estimates follow a change: "exact", "held rays" (traced), "first order", "grid" (fields)."""
        if self.kind in (COATING, LAYERS):
            return "exact"
        if self.kind == NUMBER:
            assert self.parameter is not None
            return {"share": "exact", "scatter": "exact"}.get(self.parameter.kind, "first order")
        return "grid" if self.kind == FIELD else "held rays"


def controls_of(
    path: Path,
    scene: Any,
    field_deg: Sequence[float],
    wavelength_nm: Sequence[float],
    patterns: Iterable[str] | None = None,
) -> dict[str, Control]:
    """
    Return the controls of a scene, by name.

    Parameters
    ----------
    path : Path
        Scene file.
    scene : mi.Scene
        Loaded scene.
    field_deg : sequence of float
        Field angles, degrees; the first is the initial one. A single angle makes no control.
    wavelength_nm : sequence of float
        Wavelengths of the light, nm; several make no control.
    patterns : iterable of str, optional
        Keys or patterns of parameters, see docs/parameters.md, instead of the default selection. Those of several
        values make no control.

    Raises
    ------
    MistrayError
        If a pattern matches no parameter with respect to which a trace can be differentiated, or a number has no room
        to move.
    """
    found = [*_coatings(path, scene), *_numbers(scene, patterns)]
    if len(field_deg) > 1:
        low, high = min(field_deg), max(field_deg)
        found.append(Control("field", FIELD, float(field_deg[0]), "field angle", "deg", low=low, high=high))
    if len(wavelength_nm) == 1:
        nm = float(wavelength_nm[0])
        low, high = (round(share * nm, 3) for share in WAVELENGTHS)
        found.append(Control("wavelength", WAVELENGTH, nm, "wavelength", "nm", low=low, high=high))
    return {control.name: control for control in found}


def checked(controls: Mapping[str, Control], values: Mapping[str, Any]) -> dict[str, VALUES]:
    """Return the values of some controls after checks; raise `MistrayError` for an unknown control or invalid value."""
    found = {}
    for name, value in NEW.check("values", values).items():
        if name not in controls:
            raise MistrayError(f"there is no control '{str(name)[:80]}'; {nearest(str(name), controls)}")
        found[name] = controls[name].check(value)
    return found


def coatings_of(controls: Mapping[str, Control], state: Mapping[str, VALUES]) -> dict[str, str]:
    """Return the names of coatings that a state of the controls puts on surfaces instead of their own, by shape id."""
    return {
        surface: str(state[name])
        for name, one in controls.items()
        if one.kind == COATING and state[name] != AS_IT_IS
        for surface in one.surfaces
    }


def _coatings(path: Path, scene: Any) -> list[Control]:
    """
    Return a choice of coatings for the clear surfaces of each part, and a slider for the thickness of all layers.

    Without clear surfaces there are no such controls.
    """
    shapes = {str(shape.id()): shape for shape in solid_shapes(scene)}
    parts: dict[str, dict[str, str]] = {}
    file = SceneFile(path)
    for face in faces_of(file):
        shape = shapes.get(face.name)
        if shape is None or face.fault or face.opaque or face.mirror or face.cemented or shape.bsdf().opaque:
            continue
        if len(set(shape.bsdf().materials)) > 1:  # an aperture in air has nothing to coat
            body = next((material for material in shape.bsdf().materials[::-1] if not is_gas(material)), "air")
            parts.setdefault(face.part or face.name, {})[face.name] = body
    if not parts:
        return []
    light = light_nm(path)
    found = [
        Control(f"coating {part}", COATING, AS_IT_IS, part, choices=_choices(set(on.values()), light),
                surfaces=tuple(on), bodies=tuple(on.values()))
        for part, on in parts.items()
    ]  # fmt: skip
    low, high = LAYERS_PERCENT.low, LAYERS_PERCENT.high
    every = tuple(name for names in parts.values() for name in names)
    return [
        *found,
        Control("layers", LAYERS, 100.0, "thickness of all layers", "%", low=low, high=high, surfaces=every),
    ]


def _choices(bodies: Iterable[str], light: Sequence[float]) -> tuple[str, ...]:
    """
    Return the names of coatings offered for a part: as it is, bare, and presets that suit it.

    A preset suits it if its band is near the light, wavelengths in nm, and it reduces the reflectance of all `bodies`,
    materials, enough. Without wavelengths all bands suit it.
    """
    found = [AS_IT_IS, BARE]
    for name, design in PRESETS.items():
        middle = (min(light) + max(light)) / 2 if light else design.design_nm
        if design.metal is not None or not NEAR_LIGHT[0] < design.design_nm / middle < NEAR_LIGHT[1]:
            continue
        with contextlib.suppress(MistrayError):  # one that leaves too much is not offered
            for body in bodies:
                _coating(name, body)
            found.append(name)
    return tuple(found)


def _coating(choice: str, body: str) -> CoatingModel:
    """Return the coating that a choice means on a body of some material in air, fitted as `mistray coat` does."""
    if choice in PRESETS and not is_gas(body):
        return fitted_preset(choice, body).stack
    return coating_from_text(choice)


def _numbers(scene: Any, patterns: Iterable[str] | None) -> list[Control]:
    known = parameters(scene)
    if patterns is not None:
        return [_number(key, (known[key],)) for key in match(known, patterns) if known[key].value.size == 1]
    rims = _apertures(known.values())
    detectors = {shape.id() for shape in scene.shapes() if shape.is_sensor()}
    others = [_number(key, (one,)) for key, one in known.items() if _is_offered(one, detectors)]
    return [*others, *rims][:MOST]


def _apertures(known: Iterable[Parameter]) -> list[Control]:
    """Return a slider for the clear radius, mm, of each vane, stop or baffle; rims that meet there move together."""
    parts: dict[str, list[Parameter]] = {}
    for one in known:
        if one.kind == "rim" and one.name in ("r0", "r1") and any(RIMS.search(name) for name in one.shapes):
            parts.setdefault(one.owner.part or one.shapes[0], []).append(one)
    found = []
    for part, rims in parts.items():
        least = min(float(one.value[0]) for one in rims)
        inner = tuple(one for one in rims if abs(float(one.value[0]) - least) <= SAME_MM)
        if least > 0:
            found.append(_number(f"{part} radius", inner))
    return found


def _is_offered(one: Parameter, detectors: set[str]) -> bool:
    """
    True if a parameter gets a slider of its own by default: nonzero R of an opaque detector, or amount of scatter.

    `detectors` are the ids of the surfaces that are detectors. For rims see `_apertures`.
    """
    if one.value.size > 1 or not one.value[0]:
        return False
    if one.kind == "share":
        return one.name == "R" and bool(one.owner.opaque) and not detectors.isdisjoint(one.shapes)
    return one.kind == "scatter" and one.name in AMOUNTS


def _number(name: str, moved: tuple[Parameter, ...]) -> Control:
    one = moved[0]
    start = float(one.value[0])
    if one.kind == "share":
        low, high, log = max(one.low, 1e-4), min(one.high, 1.0), True
    elif one.kind == "scatter" and one.name in AMOUNTS and start > 0:
        low, high, log = start / SPAN, start * SPAN, True
    else:
        reach = max(NEAR * abs(start), 5 * one.tolerance)
        low, high, log = start - reach, start + reach, False
    if len(moved) == 1:  # of rims that move together each bounds the others
        low, high = max(low, one.low), min(high, one.high)
    low, high = min(low, start), max(high, start)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise MistrayError(f"control '{name}' has no room to move: {low:g} … {high:g} {one.unit}; leave it out")
    unit = "" if one.unit == "1" else one.unit
    surfaces = tuple(dict.fromkeys(shape for each in moved for shape in each.shapes))
    return Control(name, NUMBER, start, name, unit, low=low, high=high, log=log and low > 0, surfaces=surfaces,
                   parameter=one, keys=tuple(each.key for each in moved))  # fmt: skip

"""Variables of a study: values between bounds, each of which changes one or several scene parameters."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mistray.analyses.optimize.study.model import DesignStudy, Moved, VariableGroup
from mistray.errors import MistrayError, errors_of
from mistray.metrics.bodies import Body, bodies
from mistray.metrics.parameters import Parameter, groups, match
from mistray.metrics.scene_values import assign
from mistray.surfaces.gradient_columns import POSE, ROTATION

MOTION_STEP = 1e-3  # mm or degrees, of central differences of what bodies do to their surfaces
TWICE = "is moved twice, by another factor or about another pivot; leave one out"
ROUNDING = 1e-6  # of the range, by which a start may lie outside of the bounds: parameters have single precision


@dataclass(frozen=True)
class VariablePlace:
    """
    Entry of a scene parameter that a variable of a study changes, with its factor and start value.

    Attributes
    ----------
    key : str
        Key of the parameter.
    entry : int
        Index of the entry.
    factor : float
        Change of the entry over that of the variable; not used with the scale "log".
    start : float
        Value of the entry at the start, in the unit of the parameter.
    """

    key: str
    entry: int
    factor: float
    start: float

    @property
    def label(self) -> str:
        """Key with the index of the entry, such as "key[0]"."""
        return f"{self.key}[{self.entry}]"


@dataclass(frozen=True)
class Motion:
    """
    Displacement (mm) or tilt (degrees) of a body that a variable controls.

    Attributes
    ----------
    body : Body
        Body that moves.
    name : str
        Name of the displacement or tilt, such as "tilt_x".
    factor : float
        Change of the displacement or tilt per change of the variable.
    """

    body: Body
    name: str
    factor: float

    @property
    def label(self) -> str:
        """Name of the displacement or tilt in a study, such as "L6.tilt_x"."""
        return f"{self.body.part}.{self.name}"


@dataclass(frozen=True)
class Variable:
    """
    Value between bounds that moves parameters or bodies of a scene.

    Its value x is that of the first place over its factor. With the scale "linear" a place becomes
    p = p_start + factor (x - x_start), with "log" p = p_start x / x_start. If only bodies move, x is their
    displacement or tilt from their place in the scene, over the factor.

    Attributes
    ----------
    name : str
        Name of the variable.
    unit : str
        Unit of x.
    low, high : float
        Bounds of x, in `unit`.
    scale : {"linear", "log"}
        Scale on which x moves its places, see above.
    places : tuple of VariablePlace
        Entries of parameters that move.
    motions : tuple of Motion
        Displacements and tilts of bodies.
    """

    name: str
    unit: str
    low: float
    high: float
    scale: str
    places: tuple[VariablePlace, ...]
    motions: tuple[Motion, ...] = ()

    @property
    def start(self) -> float:
        """Value of the variable at the start, in its unit; 0 if only bodies move."""
        return self.places[0].start / self.places[0].factor if self.places else 0.0

    @property
    def targets(self) -> tuple[VariablePlace | Motion, ...]:
        """All that the variable changes: entries of parameters, then displacements and tilts of bodies."""
        return (*self.places, *self.motions)

    def value(self, y: float) -> float:
        """Return the value, in `unit`, at a fraction y, 0 … 1, of the way from low to high bound; y is clipped."""
        y = min(max(y, 0.0), 1.0)
        x = self.low * (self.high / self.low) ** y if self.scale == "log" else self.low + y * (self.high - self.low)
        return min(max(x, self.low), self.high)

    def share(self, x: float) -> float:
        """Return the fraction of the way from low to high bound at which the value x lies; it is clipped to 0 … 1."""
        if self.scale == "log":
            share = math.log(x / self.low) / math.log(self.high / self.low)
        else:
            share = (x - self.low) / (self.high - self.low)
        return min(max(share, 0.0), 1.0)

    def stretch(self, x: float) -> float:
        """Return dx/dy at a value x, both in `unit`; y is the fraction of the way from low to high bound."""
        return x * math.log(self.high / self.low) if self.scale == "log" else self.high - self.low

    def moved(self, x: float) -> Iterator[tuple[VariablePlace, float, float]]:
        """Yield each parameter entry with its value at x, in its unit, and the derivative of this with respect to x."""
        for place in self.places:
            if self.scale == "log":
                yield place, place.start * x / self.start, place.start / self.start
            else:
                yield place, place.start + place.factor * (x - self.start), place.factor


class Variables:
    """
    All variables of a study in a scene.

    Parameters
    ----------
    params : mi.SceneParameters
        ``mi.traverse(scene)``.
    variables : sequence of Variable
        Variables, in the order of their values.

    Attributes
    ----------
    variables : tuple of Variable
        Variables, in the order of their values.
    keys : tuple of str
        Keys of the parameters that the variables move.
    start : (n,) float64
        Values of the variables in the scene, in their units.
    """

    def __init__(self, params: Any, variables: Sequence[Variable]) -> None:
        self.variables = tuple(variables)
        moved = [place.key for v in variables for place in v.places]
        moved += [key for v in variables for motion in v.motions for key in motion.body.keys]
        self.keys = tuple(dict.fromkeys(moved))
        self._given = {key: np.ravel(np.array(params[key], dtype=np.float64)) for key in self.keys}
        self.start = np.array([v.start for v in variables])

    def __len__(self) -> int:
        return len(self.variables)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables, in the order of their values."""
        return tuple(v.name for v in self.variables)

    def values(self, y: np.ndarray) -> np.ndarray:
        """Return the values of the variables, (n,), for fractions, (n,), of the way from low to high bound."""
        return np.array([v.value(float(share)) for v, share in zip(self.variables, y, strict=True)])

    def shares(self, x: Sequence[float] | np.ndarray) -> np.ndarray:
        """
        Return the fractions of the way from low to high bound, (n,), for values (n,), clipped to 0 … 1.

        Between the bounds it is the inverse of `values`.
        """
        return np.array([v.share(float(value)) for v, value in zip(self.variables, x, strict=True)])

    def parameters(self, x: Sequence[float] | np.ndarray) -> dict[str, np.ndarray]:
        """
        Return the values of the changed parameters, (entries,) float64, by key, from the variables `x`, (n,).

        Entries that no variable moves are as in the scene.
        """
        result = {key: value.copy() for key, value in self._given.items()}
        for variable, value in zip(self.variables, x, strict=True):
            for place, moved, _ in variable.moved(float(value)):
                result[place.key][place.entry] = moved
        for key, change in self._of_bodies(np.asarray(x, dtype=np.float64)).items():
            result[key][0] += change
        return result

    def _of_bodies(self, x: np.ndarray) -> dict[str, float]:
        """
        Return the changes of surface positions, mm, and tilts, degrees, by key, from the motion of bodies.

        `x`, (n,), are the variables.
        """
        amounts: dict[tuple[str, tuple[float, ...]], tuple[Body, dict[str, float]]] = {}
        for variable, value in zip(self.variables, x, strict=True):
            for motion in variable.motions:
                place = motion.body.part, tuple(motion.body.pivot)
                _, own = amounts.setdefault(place, (motion.body, {}))
                own[motion.name] = own.get(motion.name, 0.0) + motion.factor * (value - variable.start)
        found: dict[str, float] = {}
        for body, own in amounts.values():
            for key, change in body.moved(own).items():
                found[key] = found.get(key, 0.0) + change
        return found

    def apply(self, params: Any, x: Sequence[float] | np.ndarray) -> None:
        """
        Set parameters of a scene to the values that follow from variables `x`, (n,).

        `params` is ``mi.traverse`` of that scene or an equal one.
        """
        assign(params, self.parameters(x))

    def slope(self, gradient: Mapping[str, np.ndarray], x: Sequence[float] | np.ndarray) -> np.ndarray:
        """
        Return the derivatives of a result with respect to the variables, from those with respect to scene parameters.

        Parameters
        ----------
        gradient : mapping
            Key of a parameter → derivatives with respect to its entries, (entries,); a missing key counts as 0.
        x : (n,) float
            Values of the variables.

        Returns
        -------
        (n,) float64
            Derivatives per unit of each variable.
        """
        result = np.zeros(len(self))
        for k, (variable, value) in enumerate(zip(self.variables, x, strict=True)):
            for place, _, by_x in variable.moved(float(value)):
                if place.key in gradient:
                    result[k] += by_x * gradient[place.key][place.entry]
            if variable.motions:
                step = MOTION_STEP * np.eye(len(self))[k]
                more, less = (self._of_bodies(x + way * step) for way in (1, -1))
                for key in more:
                    if key in gradient:
                        result[k] += (more[key] - less[key]) / (2 * MOTION_STEP) * gradient[key][0]
        return result

    def stretch(self, x: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return dx/dy, (n,), at values x, (n,); y are the fractions of the way from low to high bound."""
        return np.array([v.stretch(float(value)) for v, value in zip(self.variables, x, strict=True)])


def find_variables(
    study: DesignStudy, params: Any, known: Mapping[str, Parameter], coatings: Mapping[str, str]
) -> Variables:
    """
    Return the variables of a study: every layer of its coatings, then those of the sections ``[[variable]]``.

    Parameters
    ----------
    study : DesignStudy
        Study of the design.
    params : mi.SceneParameters
        Parameters of the scene, ``mi.traverse(scene)``.
    known : mapping of str to Parameter
        Parameters of the scene that can be differentiated, by key.
    coatings : mapping of str to str
        Name of a coating of the study → key of its thicknesses.

    Raises
    ------
    MistrayError
        If a key does not exist, a start lies outside its bounds, bounds exceed the range of the parameter, two
        variables have one name or move the same parameter, or there is no variable. Also for the reasons of `_of_group`
        and `_check_indices`.
    """
    found: list[Variable] = []
    for group in study.coatings:
        key = coatings[group.name]
        for k, (layer, (low, high)) in enumerate(zip(group.start.layers, group.bounds_nm, strict=True)):
            place = VariablePlace(key, k, 1.0, layer.thickness_nm)
            found.append(Variable(f"{group.name}.thickness_nm[{k}]", "nm", low, high, "linear", (place,)))
    together, rigid = (groups(known), bodies(known)) if study.variables else ({}, {})
    for number, section in enumerate(study.variables, start=1):
        where = f"study '{study.name}': variable[{number}]"
        of_section = _of_group(section, known, together, rigid, where)
        _check_indices(of_section, known, together, where)
        found += of_section
    if not found:
        raise MistrayError(f"study '{study.name}': there is no variable; add a section [[variable]] or [[coating]]")
    names: set[str] = set()
    owners: dict[tuple[str, int], str] = {}
    for variable in found:
        if variable.name in names:
            raise MistrayError(f"study '{study.name}': two variables are called '{variable.name}'; rename one")
        names.add(variable.name)
        moved = [(place.key, place.entry, place.label) for place in variable.places]
        moved += [(motion.label, -1, motion.label) for motion in variable.motions]
        for key, entry, label in moved:
            other = owners.setdefault((key, entry), variable.name)
            if other != variable.name:
                raise MistrayError(
                    f"study '{study.name}': variables '{other}' and '{variable.name}' both move {label}; "
                    "take it out of one"
                )
    return Variables(params, found)


def _check_indices(
    variables: Sequence[Variable], known: Mapping[str, Parameter], together: Mapping[str, list[str]], where: str
) -> None:
    """
    Raise `MistrayError` if a variable changes a material's index on some sides only, because light would stop there.

    For the arguments see `_of_group`.
    """
    for variable in variables:
        moved = {place.key for place in variable.places}
        for name, keys in together.items():
            left = [key for key in keys if key not in moved]
            if known[keys[0]].kind == "index" and left and len(left) < len(keys):
                raise MistrayError(
                    f"{where}: it changes the index of a material at some surfaces, but not {left[0]}; write "
                    f'parameters = "{name}"'
                )


def _of_group(
    group: VariableGroup,
    known: Mapping[str, Parameter],
    together: Mapping[str, list[str]],
    rigid: Mapping[str, Body],
    where: str,
) -> list[Variable]:
    """
    Return the variables of one section ``[[variable]]``: one, or one for each parameter.

    `known` are the parameters by key, `together` the keys of each of `groups`, `rigid` the bodies by part, and `where`
    is the beginning of messages.

    Raises
    ------
    MistrayError
        If a key is unknown, a pivot is given for something else than a tilt, units differ, the scale is "log" for a
        body, or the same is moved twice by other factors or about other pivots.
    """
    places: dict[tuple[str, int], tuple[VariablePlace, Parameter]] = {}
    motions: list[Motion] = []
    bodies_moved: dict[str, Moved] = {}
    for moved in group.parameters:
        motion = None if moved.key in together or moved.key in known else _motion(moved, rigid, where)
        if motion is not None:
            if moved.key not in bodies_moved:
                motions.append(motion)
            if bodies_moved.setdefault(moved.key, moved) != moved:
                raise MistrayError(f"{where}.parameters: {motion.label} {TWICE}")
            continue
        if moved.pivot is not None:
            raise MistrayError(f"{where}.parameters: '{moved.key}' is not a tilt of a body, it has no pivot; remove it")
        for place, parameter in _places(moved, known, together, where):
            if places.setdefault((place.key, place.entry), (place, parameter))[0] != place:
                raise MistrayError(f"{where}.parameters: {place.label} {TWICE}")
    units = {parameter.unit for _, parameter in places.values()}
    units |= {"deg" if motion.name in ROTATION else "mm" for motion in motions}
    if len(units) > 1 and not group.each:
        raise MistrayError(
            f"{where}: its parameters have the units {', '.join(sorted(units))}; give each unit a variable of its own"
        )
    if motions and group.scale == "log":
        raise MistrayError(f'{where}: {motions[0].label} starts with 0; scale = "log" takes numbers above 0')
    items: list[tuple[VariablePlace, Parameter] | Motion] = [*places.values(), *motions]
    return [_variable(members, group, where) for members in ([[item] for item in items] if group.each else [items])]


def _variable(
    members: Sequence[tuple[VariablePlace, Parameter] | Motion], group: VariableGroup, where: str
) -> Variable:
    """
    Return one variable that changes the given entries and bodies together, within the bounds of its section.

    `where` is the beginning of messages.

    Raises
    ------
    MistrayError
        If a start lies outside its bounds, or bounds exceed the range of a parameter.
    """
    places = [item for item in members if not isinstance(item, Motion)]
    motions = tuple(item for item in members if isinstance(item, Motion))
    if places:
        first, parameter = places[0]
        low, high = _bounds(places, group, where)
        label, unit = first.label if parameter.value.size > 1 else first.key, parameter.unit
    else:
        low, high = group.low, group.high
        label, unit = motions[0].label, "deg" if motions[0].name in ROTATION else "mm"
        if not low <= 0 <= high:
            raise MistrayError(f"{where}: low … high is {low:g} … {high:g} {unit}; {label} starts with 0, widen it")
    name = f"{group.name} {label}" if group.each and group.name else (group.name or label)
    return Variable(name, unit, low, high, group.scale, tuple(place for place, _ in places), motions)


def _motion(moved: Moved, rigid: Mapping[str, Body], where: str) -> Motion | None:
    """Return the motion that a key such as "L6.tilt_x" names, or None; for `rigid` and `where` see `_of_group`."""
    part, _, name = moved.key.rpartition(".")
    if part not in rigid or name not in POSE:
        return None
    body = rigid[part]
    if moved.pivot is not None:
        with errors_of(f"{where}.parameters"):
            body = body.about(moved.pivot)
    return Motion(body, name, moved.factor)


def _places(
    moved: Moved, known: Mapping[str, Parameter], together: Mapping[str, list[str]], where: str
) -> Iterator[tuple[VariablePlace, Parameter]]:
    with errors_of(f"{where}.parameters"):
        keys = together.get(moved.key) or match(known, [moved.key])
    for key in keys:
        values = np.ravel(known[key].value)
        if moved.entry is not None and moved.entry >= len(values):
            raise MistrayError(
                f"{where}.parameters: '{key}' has no entry {moved.entry}; its entries are 0 to {len(values) - 1}"
            )
        for entry in range(len(values)) if moved.entry is None else [moved.entry]:
            yield VariablePlace(key, entry, moved.factor, float(values[entry])), known[key]


def _bounds(
    members: Sequence[tuple[VariablePlace, Parameter]], group: VariableGroup, where: str
) -> tuple[float, float]:
    """
    Return the bounds of x between which each parameter, divided by its factor, stays within the group's bounds.

    `where` is the beginning of messages.

    Raises
    ------
    MistrayError
        If the bounds exceed the range of a parameter, a start lies outside them, or no common range is left.
    """
    slack = ROUNDING * (group.high - group.low)
    for place, parameter in members:
        ends = sorted((place.factor * group.low, place.factor * group.high))
        if ends[0] < parameter.low or ends[1] > parameter.high:
            raise MistrayError(
                f"{where}: low … high is {group.low:g} … {group.high:g} {parameter.unit}, but {place.label} lies "
                f"between {parameter.low:g} and {parameter.high:g}; narrow the bounds"
            )
        if not group.low - slack <= place.start / place.factor <= group.high + slack:
            factor = "" if place.factor == 1 else f", over its factor {place.start / place.factor:g}"
            raise MistrayError(
                f"{where}: low … high is {group.low:g} … {group.high:g} {parameter.unit}, but {place.label} starts "
                f"with {place.start:g}{factor}; widen the bounds or change the scene"
            )
    relative = [place.start / place.factor for place, _ in members]
    if group.scale == "log":
        if min(relative) <= 0:
            place = members[int(np.argmin(relative))][0]
            raise MistrayError(f'{where}: {place.label} is {place.start:g}; scale = "log" takes numbers above 0')
        ratios = [value / relative[0] for value in relative]
        low, high = group.low / min(ratios), group.high / max(ratios)
    else:
        apart = [value - relative[0] for value in relative]
        low, high = group.low - min(apart), group.high - max(apart)
    # A group that fills its bounds, and a start that differs from a bound by its rounding
    if not low < high:
        raise MistrayError(
            f"{where}: its parameters start from {min(relative):g} to {max(relative):g}, as far apart as low and high; "
            "widen the bounds so that they can move together, or set each = true"
        )
    return low, high

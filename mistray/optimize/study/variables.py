"""Variables of a study: numbers between bounds, each of which moves one or several parameters of the scene."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.optimize.parameters import Parameter, groups, match
from mistray.optimize.scene_values import assign
from mistray.optimize.study.model import Moved, Study, VariableGroup

ROUNDING = 1e-6  # of the range, by which a start may lie outside of the bounds: parameters have single precision


@dataclass(frozen=True)
class Place:
    """
    One number of the scene that a variable moves.

    Attributes
    ----------
    key : str
    entry : int
    factor : float
    start : float
        Its value at the start.
    """

    key: str
    entry: int
    factor: float
    start: float

    @property
    def label(self) -> str:
        """The key with the number of the entry."""
        return f"{self.key}[{self.entry}]"


@dataclass(frozen=True)
class Variable:
    """
    A number between bounds.

    Its value x is that of the first place over its factor. With the scale "linear" a place becomes
    p = p_start + factor (x - x_start), with "log" p = p_start x / x_start.

    Attributes
    ----------
    name : str
    unit : str
    low, high : float
        Bounds of x, in `unit`.
    scale : {"linear", "log"}
    places : tuple of Place
    """

    name: str
    unit: str
    low: float
    high: float
    scale: str
    places: tuple[Place, ...]

    @property
    def start(self) -> float:
        """Its value at the start."""
        return self.places[0].start / self.places[0].factor

    def value(self, y: float) -> float:
        """The value at a share of the way from bound to bound."""
        y = min(max(y, 0.0), 1.0)
        x = self.low * (self.high / self.low) ** y if self.scale == "log" else self.low + y * (self.high - self.low)
        return min(max(x, self.low), self.high)

    def share(self, x: float) -> float:
        """The share of the way from bound to bound at which x lies, 0 … 1."""
        if self.scale == "log":
            share = math.log(x / self.low) / math.log(self.high / self.low)
        else:
            share = (x - self.low) / (self.high - self.low)
        return min(max(share, 0.0), 1.0)

    def stretch(self, x: float) -> float:
        """dx/dy."""
        return x * math.log(self.high / self.low) if self.scale == "log" else self.high - self.low

    def moved(self, x: float) -> Iterator[tuple[Place, float, float]]:
        """Places with their values and d value/dx."""
        for place in self.places:
            if self.scale == "log":
                yield place, place.start * x / self.start, place.start / self.start
            else:
                yield place, place.start + place.factor * (x - self.start), place.factor


class Variables:
    """
    The variables of a study in a scene.

    Parameters
    ----------
    params : mi.SceneParameters
        ``mi.traverse(scene)``.
    variables : sequence of Variable

    Attributes
    ----------
    variables : tuple of Variable
    keys : tuple of str
        Keys of the parameters that they move.
    start : (n,) float64
        The values in the scene.
    """

    def __init__(self, params: Any, variables: Sequence[Variable]) -> None:
        self.variables = tuple(variables)
        self._params = params
        self.keys = tuple(dict.fromkeys(place.key for v in variables for place in v.places))
        self._given = {key: np.ravel(np.array(params[key], dtype=np.float64)) for key in self.keys}
        self.start = np.array([v.start for v in variables])

    def __len__(self) -> int:
        return len(self.variables)

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(v.name for v in self.variables)

    def values(self, y: np.ndarray) -> np.ndarray:
        """Values at shares of the way from bound to bound, (n,) → (n,)."""
        return np.array([v.value(float(share)) for v, share in zip(self.variables, y, strict=True)])

    def shares(self, x: Sequence[float] | np.ndarray) -> np.ndarray:
        """The other way round."""
        return np.array([v.share(float(value)) for v, value in zip(self.variables, x, strict=True)])

    def parameters(self, x: Sequence[float] | np.ndarray) -> dict[str, np.ndarray]:
        """Keys of the parameters that move → values, (entries,) float64; other entries are as in the scene."""
        result = {key: value.copy() for key, value in self._given.items()}
        for variable, value in zip(self.variables, x, strict=True):
            for place, moved, _ in variable.moved(float(value)):
                result[place.key][place.entry] = moved
        return result

    def apply(self, x: Sequence[float] | np.ndarray) -> None:
        """Set the parameters of the scene."""
        assign(self._params, self.parameters(x))

    def slope(self, gradient: Mapping[str, np.ndarray], x: Sequence[float] | np.ndarray) -> np.ndarray:
        """
        Derivatives by the variables.

        Parameters
        ----------
        gradient : mapping
            Key of a parameter → derivatives by its entries, (entries,); a key that is missing counts as 0.
        x : (n,) float

        Returns
        -------
        (n,) float64
        """
        result = np.zeros(len(self))
        for k, (variable, value) in enumerate(zip(self.variables, x, strict=True)):
            for place, _, by_x in variable.moved(float(value)):
                if place.key in gradient:
                    result[k] += by_x * gradient[place.key][place.entry]
        return result

    def stretch(self, x: Sequence[float] | np.ndarray) -> np.ndarray:
        """dx/dy, y being the share of the way from bound to bound, (n,)."""
        return np.array([v.stretch(float(value)) for v, value in zip(self.variables, x, strict=True)])


def find_variables(study: Study, params: Any, known: Mapping[str, Parameter], coatings: Mapping[str, str]) -> Variables:
    """
    The variables of a study: every layer of its coatings, and what the sections ``[[variable]]`` name.

    Parameters
    ----------
    study : Study
    params : mi.SceneParameters
    known : mapping of str to Parameter
        The parameters of the scene that have a derivative.
    coatings : mapping of str to str
        Name of a coating of the study → key of its thicknesses.

    Raises
    ------
    MistrayError
        If a key does not exist, a start lies outside of the bounds, bounds go beyond what the parameter can be, two
        variables move the same parameter, or there is none at all.
    """
    found: list[Variable] = []
    for group in study.coatings:
        key = coatings[group.name]
        for k, (layer, (low, high)) in enumerate(zip(group.start.layers, group.bounds_nm, strict=True)):
            place = Place(key, k, 1.0, layer.thickness_nm)
            found.append(Variable(f"{group.name}.thickness_nm[{k}]", "nm", low, high, "linear", (place,)))
    together = groups(known) if study.variables else {}
    for number, section in enumerate(study.variables, start=1):
        where = f"study '{study.name}': variable[{number}]"
        of_section = _of_group(section, known, together, where)
        _check_indices(of_section, known, together, where)
        found += of_section
    if not found:
        raise MistrayError(f"study '{study.name}': there is no variable; add a section [[variable]] or [[coating]]")
    names: dict[str, int] = {}
    owners: dict[tuple[str, int], str] = {}
    for variable in found:
        if variable.name in names:
            raise MistrayError(f"study '{study.name}': two variables are called '{variable.name}'; rename one")
        names[variable.name] = 1
        for place in variable.places:
            other = owners.setdefault((place.key, place.entry), variable.name)
            if other != variable.name:
                raise MistrayError(
                    f"study '{study.name}': variables '{other}' and '{variable.name}' both move {place.label}; "
                    "take it out of one"
                )
    return Variables(params, found)


def _check_indices(
    variables: Sequence[Variable], known: Mapping[str, Parameter], together: Mapping[str, list[str]], where: str
) -> None:
    """Raise if a variable changes a material on some of its sides only: light is stopped where two sides disagree."""
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
    group: VariableGroup, known: Mapping[str, Parameter], together: Mapping[str, list[str]], where: str
) -> list[Variable]:
    """The variables of one section."""
    places: dict[tuple[str, int], tuple[Place, Parameter]] = {}
    for moved in group.parameters:
        for place, parameter in _places(moved, known, together, where):
            places.setdefault((place.key, place.entry), (place, parameter))
    units = {parameter.unit for _, parameter in places.values()}
    if len(units) > 1 and not group.each:
        raise MistrayError(
            f"{where}: its parameters have the units {', '.join(sorted(units))}; give each unit a variable of its own"
        )
    variables = []
    for members in [[item] for item in places.values()] if group.each else [list(places.values())]:
        low, high = _bounds(members, group, where)
        first = members[0][0]
        label = first.label if members[0][1].value.size > 1 else first.key
        name = f"{group.name} {label}" if group.each and group.name else (group.name or label)
        variables.append(
            Variable(name, members[0][1].unit, low, high, group.scale, tuple(place for place, _ in members))
        )
    return variables


def _places(
    moved: Moved, known: Mapping[str, Parameter], together: Mapping[str, list[str]], where: str
) -> Iterator[tuple[Place, Parameter]]:
    try:
        keys = together.get(moved.key) or match(known, [moved.key])
    except MistrayError as error:
        raise MistrayError(f"{where}.parameters: {error}") from None
    for key in keys:
        values = np.ravel(known[key].value)
        if moved.entry is not None and moved.entry >= len(values):
            raise MistrayError(
                f"{where}.parameters: '{key}' has no entry {moved.entry}; its entries are 0 to {len(values) - 1}"
            )
        for entry in range(len(values)) if moved.entry is None else [moved.entry]:
            yield Place(key, entry, moved.factor, float(values[entry])), known[key]


def _bounds(members: Sequence[tuple[Place, Parameter]], group: VariableGroup, where: str) -> tuple[float, float]:
    """Bounds of x that keep every parameter over its factor between those of the group."""
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

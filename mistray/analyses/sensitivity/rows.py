"""Rows of a sensitivity table: parameters of the scene, indices of materials, and parts that move as a whole."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mistray.analyses.sensitivity.changes import ParameterChange, Ranges, best_together, single_changes
from mistray.analyses.sensitivity.proposals import structure
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.gradients.coating_gradient import SHIFTS
from mistray.gradients.edge_widths import EQUAL, WidthErrors
from mistray.metrics.bodies import Body, bodies
from mistray.metrics.gradient import Gradient
from mistray.metrics.parameters import SHAPE_KINDS, Parameter
from mistray.metrics.scene_values import accepts
from mistray.recorders.sampled import Sampled
from mistray.settings import BATCHES
from mistray.surfaces.gradient_columns import DISPLACEMENT, POSE
from mistray.toolkit.rows import column

INDEX = "index"
SHARES = (1.0, 0.999, 0.9, 0.5, 0.1)  # of the way to a bound that its model may refuse


@dataclass(frozen=True)
class Line:
    """
    Row of a sensitivity table before evaluation: a parameter, or several that change together.

    Attributes
    ----------
    label : str
        Key of a single parameter, such as ``AR.thickness_nm[1]``, with the index of the entry if there are several. Of
        parameters that change together a name such as ``index of N-BK7`` or ``barrel.z``.
    parameter : Parameter
        First parameter, whose kind, unit, value and range are those of all.
    entry : int
        Index of the entry.
    keys : tuple of str
        Keys of all parameters of the line that can be differentiated.
    silent : tuple of str
        Keys that change along but have no derivative: indices next to opaque surfaces.
    slopes : mapping of str to float
        For a body that is displaced or tilted: change of each parameter of its surfaces, by key, over that of the line,
        to first order. Empty if all of `keys` change by the same amount.
    """

    label: str
    parameter: Parameter
    entry: int
    keys: tuple[str, ...]
    silent: tuple[str, ...] = ()
    slopes: Mapping[str, float] = field(default_factory=dict)

    @property
    def value(self) -> float:
        """Present value of the entry, in the unit of the parameter."""
        return float(np.ravel(self.parameter.value)[self.entry])

    @property
    def moved(self) -> Mapping[str, float]:
        """Change of each differentiable parameter, by key, when the value of the line changes by 1."""
        return self.slopes or dict.fromkeys(self.keys, 1.0)


@dataclass(frozen=True)
class SensitivityRow:
    """
    Parameter and its effect on the metric; standard errors include the bias by boundary zones at rims.

    `value`, `low`, `high`, `tolerance` and `to_value` are in `unit`. `change` is that of ln(metric) per tolerance, and
    `to_factor` is above 1 if `to_value` lowers the metric.
    """

    line: Line
    label: str = column("label of its line, see `Line`", head="parameter")
    keys: tuple[str, ...] = column("keys that it stands for; several of a material")
    entry: int = column("number of the entry of the parameter")
    kind: str = column("kind of the parameter, see `mistray.metrics.parameters.Parameter`")
    unit: str = column("unit of the value")
    value: float = column("value in the scene", digits=".5g")
    low: float = column("lower end of the physical range")
    high: float = column("upper end of the physical range")
    derivative: Estimate = column("d metric / d value", head="derivative [of the metric, per unit]")
    tolerance: float = column("manufacturing tolerance", head="tolerance [unit]", digits=".5g")
    change: Estimate = column(
        "d ln(metric) per tolerance, with the error of the metric in it", percent=True, head="change [% per tolerance]"
    )
    edge_check: Estimate = column(
        "difference of `change` with half the width of the zone at rims; NaN where rims do not count",
        percent=True,
        head="half edge width [% per tolerance]",
    )
    free: bool = column("whether it may be changed to lower the metric")
    to_value: float = column("value that would lower it by the factor requested, or the bound; its own if it is held")
    to_factor: float = column("times that the metric is smaller there, by the model")
    reached: bool = column("whether that is the factor requested")
    share: Estimate | None = column(
        "share of the variance", None, percent="shown", head="share [% of variance]", empty="in a group"
    )


def lines_of(scene: Any, params: Any, known: Mapping[str, Parameter], chosen: Iterable[str]) -> list[Line]:
    """
    Return the lines of some parameters; those that change together for physical reasons share one.

    Indices of one material are one line, on whatever side of whatever surface: one melt, or the air around. This is
    necessary because a trace takes a surface whose material differs from that of the ray for a gap. Surfaces of one
    part that are not optics move as a whole along each direction. If the part has no optics, they tilt as a whole too.
    These are barrels, stops and lens edges; moved alone they would leave gaps.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    params : mi.SceneParameters
        Parameters of the scene, ``mi.traverse(scene)``.
    known : mapping of str to Parameter
        Parameters that can be differentiated, by key.
    chosen : iterable of str
        Keys; if one of a line is chosen, all are.
    """
    sides: dict[str, list[str]] = {}
    for key in params.keys():  # noqa: SIM118  SceneParameters iterates over pairs
        material = _material(params, key)
        if material is not None:
            sides.setdefault(material, []).append(key)
    whole = _bodies(scene, known)
    lines: dict[str, Line] = {}
    for key in chosen:
        parameter = known[key]
        if parameter.kind == INDEX:
            material = str(_material(params, key))
            keys = sides[material]
            active = tuple(k for k in keys if k in known)
            silent = tuple(k for k in keys if k not in known)
            lines.setdefault(f"index of {material}", Line(f"index of {material}", parameter, 0, active, silent))
        elif key in whole:
            line = whole[key]
            lines.setdefault(line.label, line)
        else:
            for entry in range(np.size(parameter.value)):
                label = key if np.size(parameter.value) == 1 else f"{key}[{entry}]"
                lines[label] = Line(label, parameter, entry, (key,))
    return list(lines.values())


def _bodies(scene: Any, known: Mapping[str, Parameter]) -> dict[str, Line]:
    """Return table lines that move mechanical surfaces together, by the key of each position or tilt in them."""
    rigid = structure(scene)
    shapes = {shape.id(): shape for shape in scene.shapes()}
    optics = {getattr(shape, "part", None) for shape in shapes.values() if shape.id() not in rigid}
    found: dict[tuple[Any, ...], list[str]] = {}
    for key, parameter in known.items():
        if parameter.kind != "position":
            continue
        shape = shapes[parameter.shapes[0]]
        if shape.id() in rigid or shape.mechanics:
            axis = shape.base[:3, DISPLACEMENT.index(parameter.name)]
            found.setdefault((shape.part, parameter.name, *np.round(axis, 9).tolist()), []).append(key)
    result: dict[str, Line] = {}
    for (part, name, *_), keys in found.items():
        if len(keys) > 1:
            label = f"edges of {part}.{name}" if part in optics else f"{part}.{name}"
            taken = sum(label == line.label for line in {id(line): line for line in result.values()}.values())
            line = Line(f"{label} ({taken + 1})" if taken else label, known[keys[0]], 0, tuple(keys))
            result |= dict.fromkeys(keys, line)
    for body in bodies(known).values():
        if body.part not in optics:
            result |= {key: line for line in motion_lines(body, known) for key in line.keys}
    return result


def motion_lines(body: Body, known: Mapping[str, Parameter]) -> list[Line]:
    """Return table lines for the displacements (mm) and tilts (degrees) of a body whose surfaces move together."""
    lines = []
    for name in POSE:
        keys = tuple(f"{surface}.{name}" for surface in body.frames)
        lines.append(Line(f"{body.part}.{name}", known[keys[0]], 0, keys, slopes=body.slopes(name)))
    return lines


def _material(params: Any, key: str) -> str | None:
    """Return the material of the side to which the index shift with a key belongs; None for other keys."""
    owner, name = params.properties[key][2], key.rsplit(".", 1)[-1]
    if name not in SHIFTS or not hasattr(owner, "coating"):
        return None
    return str((owner.front, owner.back)[SHIFTS.index(name)])


def whole_values(params: Any, lines: Sequence[Line]) -> dict[str, np.ndarray]:
    """Return the present values of all parameters that some table lines change, by key, in their units."""
    keys = dict.fromkeys(key for line in lines for key in (*line.moved, *line.silent))
    return {key: np.ravel(np.array(params[key], dtype=np.float64)) for key in keys}


def shifted_values(
    values: Mapping[str, np.ndarray], lines: Sequence[Line], numbers: Sequence[float]
) -> dict[str, np.ndarray]:
    """
    Return parameter values as in `whole_values`, with each line at its value in `numbers`, in its unit.

    For a line that moves a body, `Line.slopes` convert its change to changes of the single parameters.
    """
    result = {key: value.copy() for key, value in values.items()}
    for line, number in zip(lines, numbers, strict=True):
        change = number - line.value
        for key, slope in {**line.moved, **dict.fromkeys(line.silent, 1.0)}.items():
            result[key][line.entry] += slope * change
    return result


@dataclass(frozen=True)
class LineNumbers:
    """
    Values, derivatives and effects of all lines of a sensitivity table, (n,) float64 each.

    Attributes
    ----------
    lines : list of Line
        Lines of the table.
    ranges : Ranges
        Values, physical ranges, tolerances, d ln(metric) / d value.
    derivative, derivative_se : float64
        d metric / d value and its standard error, per unit of the line.
    edge_check, edge_check_se : float64
        Change of d ln(metric) per tolerance with half the width of the zone at rims; NaN if rims have no effect.
    change_batches : (b, n) float64
        d ln(metric) per tolerance from each batch of start rays, or group of batches, including the effect of the batch
        on the metric in the denominator; their sum is the total.
    """

    lines: list[Line]
    ranges: Ranges
    derivative: np.ndarray
    derivative_se: np.ndarray
    edge_check: np.ndarray
    edge_check_se: np.ndarray
    change_batches: np.ndarray

    @classmethod
    def of(cls, found: Gradient, lines: list[Line], tolerances: Sequence[float]) -> LineNumbers:
        """
        Return the values, derivatives and effects of lines, summed from the gradient of their keys.

        Parameters
        ----------
        found : Gradient
            Gradient with all keys of the lines.
        lines : list of Line
            Lines of the table.
        tolerances : sequence of float
            Tolerance of each line, in its unit.

        Raises
        ------
        MistrayError
            If a derivative is not finite.
        """

        def summed(values: Mapping[str, np.ndarray]) -> list[np.ndarray]:
            parts = ([slope * values[key][..., one.entry] for key, slope in one.moved.items()] for one in lines)
            return [np.asarray(sum(own)) for own in parts]

        batches = np.stack(summed(found.batches), axis=-1)
        derivative = batches.sum(axis=0)
        wrong = [line.label for line, value in zip(lines, derivative, strict=True) if not np.isfinite(value)]
        if wrong:
            raise MistrayError(f"the derivative with respect to '{wrong[0]}' is not finite; leave it out")
        tolerance = np.array(tolerances)
        # Lines of several keys have one width, so that what their rims do together is compared, not one by one
        widths = {key: found.edge_batches.get(key, parts[None]) for key, parts in found.batches.items()}
        shape = max(map(len, found.edge_batches.values()), default=2), BATCHES
        at_rims = WidthErrors.of(np.stack([np.broadcast_to(part, shape) for part in summed(widths)], axis=-1))
        met = [not found.edge_batches.keys().isdisjoint(line.moved) for line in lines]
        bias, check, check_se = (
            values[found.edge_number] for values in (at_rims.bias, at_rims.check, at_rims.check_se)
        )
        # The metric and its derivative come from the same start rays: what they have in common cancels
        relative = Sampled.of(batches.T, EQUAL).over(Sampled(np.array(found.value), found.value_noise))
        ranges = Ranges(
            np.array([line.value for line in lines]),
            np.array([line.parameter.low for line in lines]),
            np.array([line.parameter.high for line in lines]),
            tolerance,
            relative.value,
            np.hypot(relative.se, bias / found.value),
        )
        per = np.where(met, tolerance / found.value, np.nan)
        changes = relative.by_batch.T * tolerance
        total = at_rims.total()[found.edge_number]
        return cls(lines, ranges, derivative, total, check * per, check_se * per, changes)

    def reachable(self, free: set[str], reach: float) -> Ranges:
        """
        Return the parameters' ranges limited to `reach` tolerances about their values; R and T are not limited.

        Parameters not in `free` stay at their value.
        """
        shares = [line.parameter.kind == "share" for line in self.lines]
        farthest = np.where(shares, np.inf, reach * self.ranges.tolerance)
        farthest[[not set(line.keys) <= free for line in self.lines]] = 0.0
        value = self.ranges.value
        low, high = np.maximum(self.ranges.low, value - farthest), np.minimum(self.ranges.high, value + farthest)
        return replace(self.ranges, low=low, high=high)

    def accepted(self, params: Any, ranges: Ranges, check: Callable[[], object]) -> Ranges:
        """
        Return the ranges cut to ends that the models of a scene accept.

        A bound of one parameter may be refused because of others, such as a reflectance of 0 for a paint that has no
        other scatter. The wavelength may rule it out as well, such as that of a roughness. The range then ends before
        the bound: at the first of `SHARES` of the way that is accepted, or at the present value if none is.

        Parameters
        ----------
        params : mi.SceneParameters
            Parameters of the scene, ``mi.traverse(scene)``.
        ranges : Ranges
            Values, ranges and slopes of the parameters.
        check : callable
            Raises `MistrayError` if the scene in its current state cannot be traced.
        """
        low, high = ranges.low.copy(), ranges.high.copy()
        for k, line in enumerate(self.lines):
            if line.parameter.kind in SHAPE_KINDS:
                continue
            values, here = whole_values(params, [line]), float(ranges.value[k])
            for ends in (low, high):
                if ends[k] == here or not np.isfinite(ends[k]):
                    continue
                steps = [here + share * (ends[k] - here) for share in SHARES]
                good = (end for end in steps if accepts(params, shifted_values(values, [line], [end]), check))
                ends[k] = next(good, here)
        return replace(ranges, low=low, high=high)

    def together(
        self, params: Any, ranges: Ranges, factor: float, check: Callable[[], object]
    ) -> tuple[ParameterChange, ...]:
        """
        Return `best_together` of those changes that the models of a scene accept together.

        Values that are possible alone may be impossible together, such as the level and the slope of dust. The least
        change without which the others are accepted is left out then, and the best of all but it are sought. The
        arguments are those of `accepted`.
        """

        def fit(changes: Sequence[ParameterChange]) -> bool:
            lines = [self.lines[change.number] for change in changes]
            values = shifted_values(whole_values(params, lines), lines, [change.value for change in changes])
            return accepts(params, values, check)

        while (found := best_together(ranges, factor)) and not fit(found):
            without = (one for one in reversed(found) if fit([other for other in found if other is not one]))
            held = np.arange(len(self.lines)) == next(without, found[-1]).number
            low, high = (np.where(held, ranges.value, ends) for ends in (ranges.low, ranges.high))
            ranges = replace(ranges, low=low, high=high)
        return found

    def rows(self, free: set[str], reachable: Ranges, factor: float) -> list[SensitivityRow]:
        """
        Return a table row per line, in order, each with the value that alone would lower the metric by `factor`.

        `free` are the keys that may be changed; that value lies within the ranges of `reachable`.
        """
        r = self.ranges
        change, change_se = r.slope * r.tolerance, r.slope_se * r.tolerance
        alone = single_changes(reachable, factor)
        return [
            SensitivityRow(
                line=line,
                label=line.label,
                keys=line.keys,
                entry=line.entry,
                kind=line.parameter.kind,
                unit=line.parameter.unit,
                value=float(r.value[k]),
                low=float(r.low[k]),
                high=float(r.high[k]),
                derivative=Estimate(float(self.derivative[k]), float(self.derivative_se[k])),
                tolerance=float(r.tolerance[k]),
                change=Estimate(float(change[k]), float(change_se[k])),
                edge_check=Estimate(float(self.edge_check[k]), float(self.edge_check_se[k])),
                free=set(line.keys) <= free,
                to_value=alone[k].value,
                to_factor=alone[k].factor,
                reached=alone[k].reached,
            )
            for k, line in enumerate(self.lines)
        ]

"""Configurations: states of one scene that differ in the values of some of its parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from mistray._mitsuba_compat import holds_numbers, peek
from mistray.errors import MistrayError, nearest_parameters
from mistray.ids import check_id, fits
from mistray.metrics.bodies import Body, bodies
from mistray.metrics.parameters import Parameter, groups, parameters
from mistray.prescription import Structure
from mistray.ranges import ANYTHING, ByName, OfType, Several, several, shown
from mistray.surfaces.gradient_columns import POSE

BLOCK = Several(OfType(Structure, "must be a mistray.Structure, or several"), least=0)
AS_IT_IS = "as it is"
"""Name of the configuration in which nothing is changed."""


@dataclass(frozen=True)
class Configuration:
    """
    State of a scene that differs from the original in some parameters, surfaces or parts.

    Attributes
    ----------
    name : str
        Name of the configuration.
    values : mapping of str to float or sequence of float
        Parameters and their values in their units: keys of ``mi.traverse(scene)``, names of groups such as
        ``N-BK7.index`` and ``L1.z``, see `mistray.optimize.groups`, or patterns of both with ``*``, ``?`` and ``[…]``.
        A single value stands for all entries of a parameter. That of a group is for its first key, from which the
        others keep their differences. If two name the same key, the later one holds. The displacement or tilt of a part
        that is no group, such as ``L1.tilt_x``, is added to the positions and tilts of its surfaces, see
        `mistray.optimize.bodies`.
    paint, coat : mapping
        Paint and coatings as in `mistray.coat`, by names or patterns of surfaces or parts; for `sweep_pst`.
    block : sequence of Structure
        Structures to add: vanes, rings, tubes; for `sweep_pst`.

    Examples
    --------
    >>> coated = mistray.sweeps.Configuration("coated", {"L2.z": -0.1}, coat={"L1": "bbar3"})
    >>> coated.rebuilds  # coatings change the scene, numbers do not
    True
    """

    name: str
    values: Mapping[str, float | Sequence[float]] = field(default_factory=dict)
    paint: Mapping[str, str | float] = field(default_factory=dict)
    coat: Mapping[str, str] = field(default_factory=dict)
    block: Sequence[Structure] = ()

    def __post_init__(self) -> None:
        owner = f"configuration '{self.name}'"
        for name, example in (
            ("values", "{'L1.z': 0.1}"),
            ("paint", "{'barrel': 'flat_black'}"),
            ("coat", "{'L1': 'bbar3'}"),
        ):
            ByName(ANYTHING, example).check(name, getattr(self, name), owner)
        object.__setattr__(self, "block", BLOCK.check("block", self.block, owner))

    @property
    def rebuilds(self) -> bool:
        """True if the configuration changes paint, coatings or structures, so that the scene must be rebuilt."""
        return bool(self.paint or self.coat or self.block)


@dataclass(frozen=True)
class Resolved:
    """
    Configuration with its names resolved to parameter keys of a scene.

    Attributes
    ----------
    name : str
        Name of the configuration.
    values : dict of str to (entries,) float64
        Values by key of ``mi.traverse(scene)``, rounded as the scene stores them.
    units : dict of str to str
        Units by key, if known.
    """

    name: str
    values: dict[str, npt.NDArray[np.float64]]
    units: dict[str, str]


Given = Mapping[str, Mapping[str, Any]] | Configuration | Sequence[Configuration] | None


def as_configurations(given: Given) -> list[Configuration]:
    """
    Return a list of configurations, from any of the forms in which a user may give them.

    Parameters
    ----------
    given : mapping of str to mapping, Configuration, sequence of Configuration, or None
        Configurations, or name → values; None stands for one configuration without changes.

    Raises
    ------
    MistrayError
        If there is none, an entry is no configuration, a name is impossible, or two have the same name.
    """
    if given is None:
        return [Configuration(AS_IT_IS, {})]
    if isinstance(given, Mapping):
        found: list[Any] = [Configuration(str(name), values) for name, values in given.items()]
    else:
        found = several(given)
    if not found:
        raise MistrayError("configurations is empty; give at least one, or leave it out")
    for one in found:
        if not isinstance(one, Configuration):
            raise MistrayError(f"configurations: {shown(one)} is none; give a mapping from names to {{key: value}}")
    names = [one.name for one in found]
    for name in names:
        check_id(name, "configuration")
        if names.count(name) > 1:
            raise MistrayError(f"configuration '{name}' is given twice; give each a name of its own")
    return found


def resolve(scene: Any, params: Any, given: Sequence[Configuration]) -> list[Resolved]:
    """
    Return configurations with their parameter names resolved to keys of a scene.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    params : mi.SceneParameters
        ``mi.traverse(scene)``.
    given : sequence of Configuration
        Configurations to resolve.

    Raises
    ------
    MistrayError
        If a key does not exist or is not numeric, or a value is not finite or has the wrong number of entries.
    """
    known = parameters(scene, params) if any(one.values for one in given) else {}
    together, rigid = groups(known), bodies(known)
    return [_resolved(one, params, known, together, rigid) for one in given]


def _resolved(
    given: Configuration,
    params: Any,
    known: Mapping[str, Parameter],
    together: Mapping[str, list[str]],
    rigid: Mapping[str, Body],
) -> Resolved:
    values: dict[str, npt.NDArray[np.float64]] = {}
    motions: dict[str, dict[str, float]] = {}
    for name, value in given.values.items():
        part, _, motion = name.rpartition(".")
        if part in rigid and motion in POSE and name not in params and name not in together:
            (amount,) = _numbers(given.name, name, value, peek(params, rigid[part].keys[0]))
            motions.setdefault(part, {})[motion] = float(amount)
            continue
        named = [*together, *(f"{p}.{m}" for p in rigid for m in POSE)]
        for key, first in _keys(given.name, name, params, named, together).items():
            values[key] = _numbers(given.name, key, value, peek(params, key))
            if key != first:
                apart = known[key].value - known[first].value
                values[key] = _numbers(given.name, key, values[key] + apart, peek(params, key))
    for part, amounts in motions.items():
        for key, change in rigid[part].moved(amounts).items():
            now = values.get(key, known[key].value)
            values[key] = _numbers(given.name, key, now + change, peek(params, key))
    return Resolved(given.name, values, {key: known[key].unit for key in values if key in known})


def _keys(
    configuration: str, name: str, params: Any, named: Sequence[str], together: Mapping[str, list[str]]
) -> dict[str, str]:
    """Return the keys that a name stands for, each with the key of which the number is: of a group its first."""
    if name in params:
        return {name: name}
    if name in together:
        return dict.fromkeys(together[name], together[name][0])
    keys = list(params.keys())
    found = {key: key for key in keys if fits(key, name) and holds_numbers(peek(params, key))}
    for group, members in together.items():
        if fits(group, name):
            found |= {key: members[0] for key in members if key not in found}
    if not found:
        hint = nearest_parameters(name, [*keys, *named])
        raise MistrayError(f"configuration '{configuration}': the scene has no parameter '{name}'; {hint}")
    return found


def _numbers(configuration: str, key: str, value: Any, now: Any) -> npt.NDArray[np.float64]:
    where = f"configuration '{configuration}': parameter '{key}'"
    if not holds_numbers(now):
        raise MistrayError(f"{where} is not a number but {type(now).__name__}; change another one")
    try:
        numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError):
        raise MistrayError(f"{where} is {value!r}; give a number, or one for each of its entries") from None
    entries = len(now)
    if numbers.ndim != 1 or len(numbers) not in (1, entries):
        raise MistrayError(f"{where}: {numbers.size} numbers are given; it has {entries}")
    if not np.all(np.isfinite(numbers)):
        raise MistrayError(f"{where} is {numbers.tolist()}; it must be finite")
    return np.array(type(now)(np.broadcast_to(numbers, entries)), dtype=np.float64)

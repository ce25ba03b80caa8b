"""Traces that metrics need, one per field angle, each made once even if several metrics share it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from mistray.light import Light
from mistray.metrics.changes.first_surfaces import Entering, FirstLight
from mistray.metrics.observation import Observation
from mistray.notes import Note
from mistray.trace import Settings, trace
from mistray.trace.host.polarization_choice import unpolarized_notes


@dataclass(frozen=True)
class TraceView:
    """
    Arguments of one trace that a metric needs, usually at one field angle.

    Attributes
    ----------
    arguments : dict
        Arguments of `mistray.trace`.
    """

    arguments: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> tuple[Any, ...]:
        """Hashable key, equal for traces with equal arguments, which give equal results."""
        given = {name: value for name, value in self.arguments.items() if value is not None}
        return type(self), sorted_arguments(given)

    @property
    def light(self) -> dict[str, Any]:
        """Wavelengths, nm, and weights of the trace by the names of its arguments; None for those of the sources."""
        return {name: self.arguments.get(name) for name in ("wavelength_nm", "weights")}

    def observe(self, scene: Any, times: float, changes: Mapping[str, Any]) -> Any:
        """
        Trace the scene with `times` the rays that it would have, and return the `Observation`.

        `changes` replace arguments, except "paths".

        Polarisation "auto" is resolved by the sources alone, without a pilot. Raise as `mistray.trace` does.
        """
        changes = {name: value for name, value in changes.items() if name != "paths"}  # a trace always has them
        arguments = self._arguments(scene, times, changes)
        # The polarisation of the gradient's trace, without a pilot: a search and its verification use the same light
        arguments["polarization"] = Settings.of(scene, polarization=arguments.get("polarization")).polarization
        return Observation(trace(scene, **arguments))

    def _arguments(self, scene: Any, times: float, changes: Mapping[str, Any]) -> dict[str, Any]:
        arguments = {**self.arguments, **changes}
        if times != 1:
            arguments["rays"] = max(round(times * self._rays(scene, arguments.get("rays"))), 1)
        return arguments

    def rays(self, scene: Any) -> int:
        """Return the number of start rays of the trace: that of its arguments, else the default of the scene."""
        return self._rays(scene, self.arguments.get("rays"))

    def _rays(self, scene: Any, given: int | None) -> int:
        return self._usual_rays(scene) if given is None else Settings.of(scene, rays=given).rays

    def _usual_rays(self, scene: Any) -> int:
        return Settings.of(scene).rays


def seen_unpolarized(scene: Any, views: Sequence[TraceView]) -> list[Note]:
    """Return notes if Stokes vectors would change the results of some traces; else none. See `unpolarized_notes`."""
    names = {one.name for one in fields(Settings)}
    beams: list[Light] = []
    settings: dict[str, Any] = {}
    for view in views:
        given = {name: value for name, value in view.arguments.items() if value is not None}
        settings |= {name: value for name, value in given.items() if name in names}
        light = Light.of(given)
        angles = [None] if "field_deg" not in given else np.atleast_1d(given["field_deg"]).tolist()
        beams += [replace(light, field_deg=angle) for angle in angles]
    return unpolarized_notes(scene, beams, **settings)


def added_light(one: Mapping[str, FirstLight], other: Mapping[str, FirstLight]) -> dict[str, FirstLight]:
    """Return the light of two independent traces added up, by place, such as "field 5 deg", and first surface."""
    return {**one, **{place: one[place].plus(light) if place in one else light for place, light in other.items()}}


def light_since(before: Mapping[str, FirstLight], after: Mapping[str, FirstLight]) -> dict[str, tuple[Entering, ...]]:
    """
    Return light, as fractions, whose first surface met no light before a change, by place, such as "field 5 deg".

    Places that have no such light, or that were not traced before, are left out.
    """
    found = {place: light.since(before[place]) for place, light in after.items() if place in before}
    return {place: entering for place, entering in found.items() if entering}


def sorted_arguments(arguments: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return arguments as a sorted, hashable tuple of (name, value), for comparison."""
    return tuple(sorted((name, _plain(value)) for name, value in arguments.items()))


def _plain(value: Any) -> Any:
    """Return a value in a comparable form: arrays, lists and ranges as tuples."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple | range):
        return tuple(map(_plain, value))
    return value

"""Traces of a ghost analysis: one for each field angle, and the reference on axis."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import mitsuba as mi

from mistray.execute.wavelength_choice import chosen_wavelengths
from mistray.light import Light
from mistray.surfaces.surfaces import require_one, solid_shapes
from mistray.time_budget import TimeShares, coarse_first, is_limited
from mistray.trace import PolarizationChoice, Settings, Trace, trace
from mistray.trace.host.polarization_choice import chosen_polarization

NOMINAL_FIELD_DEG = 0.0

Progress = Callable[[float, float], None]


class FieldTraces:
    """
    Traces of fields one after the other, in equal shares of a time budget; finished traces survive an interrupt.

    If the budget is too short for all fields, some are left out, and the traced ones are spread over all of them.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    arguments : mapping
        Arguments of `mistray.trace` at every field.
    progress : callable or None
        Called with the number of fields done, parts of one included, and of all fields; None: nothing is called.

    Raises
    ------
    MistrayError
        If the scene has several detectors, and the arguments name none.

    Attributes
    ----------
    traces : dict of float to Trace
        Traces by field angle, degrees, in the order in which the fields were requested.
    nominal : Trace or None
        Trace of the field on axis, the reference of all others; without reflections and scatter if it was not
        requested. None until it is traced.
    at_extra : bool
        Whether an additional trace is running: of the reference, or of a finished field with more rays.
    traced_again : list of float
        Field angles traced again with more rays, degrees.
    not_traced : list of float
        Field angles not traced for lack of time, degrees.
    """

    def __init__(self, scene: Any, arguments: Mapping[str, Any], progress: Progress | None) -> None:
        if "detector" not in arguments and isinstance(scene, mi.Scene):
            require_one([shape.id() for shape in solid_shapes(scene) if shape.is_sensor()])
        self._scene, self._arguments, self._progress = scene, arguments, progress
        self.traces: dict[float, Trace] = {}
        self.nominal: Trace | None = None
        self.at_extra = False
        self.traced_again: list[float] = []
        self.not_traced: list[float] = []
        self._wanted: dict[float, float | None] = {}  # field angle → as it was requested

    def trace(self, wanted: Sequence[float | None], finish: Callable[[float], None]) -> None:
        """
        Trace the requested fields, the one on axis first, because a report after an interrupt needs it.

        Parameters
        ----------
        wanted : sequence of float or None
            Field angles, degrees; None: that of the scene's source.
        finish : callable
            Called with the angle of each traced field, degrees, to use the rest of its share of a time budget. It is
            not called without a budget, nor before the field on axis is traced.
        """
        count = len(wanted)
        ordered = coarse_first(wanted) if is_limited() else wanted
        order = sorted(ordered, key=lambda angle: angle != NOMINAL_FIELD_DEG)
        shares = TimeShares(count)
        if None not in wanted and NOMINAL_FIELD_DEG not in wanted:
            shares = TimeShares(count + 1)
            with shares.one():
                self._trace_yardstick()
        for done, field in enumerate(order):
            if self.traces and not shares.enough():
                break
            part = _part(self._progress, done, count)
            with shares.one():
                found = trace(self._scene, field_deg=field, progress=part, **self._arguments)
                angle = float(found.settings["field_deg"])
                self.traces[angle], self._wanted[angle] = found, field
                if angle == NOMINAL_FIELD_DEG:
                    self.nominal = found
                if is_limited() and self.nominal is not None:
                    finish(angle)
        if None not in wanted:
            given = [angle for angle in wanted if angle is not None]
            self.not_traced = [angle for angle in given if angle not in self.traces]
            self.traces = {angle: self.traces[angle] for angle in given if angle in self.traces}
        elif self.nominal is None:
            with shares.one():
                self._trace_yardstick()

    def trace_again(self, rays: Mapping[float, int]) -> None:
        """
        Replace the traces of some fields by new ones with other numbers of start rays.

        Parameters
        ----------
        rays : mapping of float to int
            Start rays by field angle, degrees.
        """
        self.at_extra = True
        finished = len(self.traces)
        for done, (field, count) in enumerate(rays.items(), start=finished):
            part = _part(self._progress, done, finished + len(rays))
            arguments = {**self._arguments, "rays": count}
            found = trace(self._scene, field_deg=self._wanted[field], progress=part, **arguments)
            self.traces[field] = found
            self.traced_again.append(field)
            if field == NOMINAL_FIELD_DEG:
                self.nominal = found
        self.at_extra = False

    def _trace_yardstick(self) -> None:
        """Trace the direct image on axis, to which all fields are compared, if that field was not requested."""
        bare = {**self._arguments, "max_reflections": 0, "max_scatters": 0}
        self.at_extra = True
        self.nominal = trace(self._scene, field_deg=NOMINAL_FIELD_DEG, **bare)
        self.at_extra = False


def one_for_fields(scene: mi.Scene, wanted: Sequence[float | None], arguments: Mapping[str, Any]) -> PolarizationChoice:
    """
    Return one polarisation mode for the traces of several fields, see `mistray.trace.host.polarization_choice`.

    `wanted` are the fields of `FieldTraces.trace`, and `arguments` those of `FieldTraces`.
    """
    given = arguments.get("polarization")
    if isinstance(given, PolarizationChoice):
        return given
    light = Light.of(arguments)
    known = {f.name for f in fields(Settings)}
    settings = Settings.unresolved(scene, **{name: value for name, value in arguments.items() if name in known})
    return chosen_polarization(scene, settings, [replace(light, field_deg=field) for field in wanted])


def fewer_wavelengths(scene: mi.Scene, wanted: Sequence[float | None], arguments: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return trace arguments with fewer wavelengths, nm, if the time is too short for all; else an empty dict.

    `wanted` are the fields of `FieldTraces.trace`, and `arguments` those of `FieldTraces`.
    """

    def timed(**few: Any) -> None:
        _ = trace(scene, field_deg=wanted[0], **{**arguments, **few}).irradiance  # the sum of an image of each

    found = chosen_wavelengths(scene, Light.of(arguments), timed, len(wanted))
    return {"wavelength_nm": found, "weights": None} if found else {}


def _part(progress: Progress | None, done: int, fields: int) -> Callable[[int, int], None] | None:
    """
    Return a progress callback for one trace, which reports it as part of the progress of all fields.

    `done` of `fields` fields are finished before it. The result is None without `progress`.
    """
    if progress is None:
        return None
    return lambda rays, of: progress(done + rays / of, fields)

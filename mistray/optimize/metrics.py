"""What is to be small or large: numbers computed from traces, and their derivatives by every detected flux."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.trace import PathRow, Trace, trace
from mistray.trace.path_events import DIRECT, STRAY_KINDS

Selection = str | Callable[[PathRow], bool]


class Observation:
    """
    One trace as a metric sees it: powers of paths and the detector's image as differentiable Dr.Jit arrays.

    Parameters
    ----------
    result : Trace
        At one field angle.

    Attributes
    ----------
    trace : Trace
        The numbers themselves, not differentiable.
    irradiance : (height · width,) mi.Float64
        W/mm², row by row, row 0 at the smallest y.
    """

    def __init__(self, result: Trace) -> None:
        self.trace = result
        self._rows = list(result.paths)
        self._powers = mi.Float64([row.power_W for row in self._rows] or [0.0])
        self.irradiance = mi.Float64(np.ascontiguousarray(result.irradiance.ravel()))
        dr.enable_grad(self._powers, self.irradiance)

    @property
    def launched_W(self) -> float:
        """Flux of the sources, W."""
        return self.trace.energy.launched_W

    def power(self, selection: Selection) -> mi.Float64:
        """
        Power of some paths together, W.

        Parameters
        ----------
        selection : str or callable
            A `kind` of the path table ("direct", "ghost", "structure", …), "stray" (all but "direct"), "all", the
            events of one path as in its `events`, or a function of a `PathRow`.

        Raises
        ------
        MistrayError
            If the text is neither a kind nor the events of a path.
        """
        indices = [k for k, row in enumerate(self._rows) if _matches(selection, row)]
        if not indices:
            if isinstance(selection, str) and selection not in KINDS and ":" not in selection:
                raise MistrayError(f"selection '{selection}' is no kind of path; use one of {', '.join(KINDS)}")
            return mi.Float64(0.0)
        return dr.sum(dr.gather(mi.Float64, self._powers, mi.UInt32(indices)))

    def derivatives(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the metric by the irradiance of each pixel and by the power of each path, after backward."""
        height, width = self.trace.irradiance.shape
        return (
            np.broadcast_to(np.array(dr.grad(self.irradiance)), height * width).reshape(height, width),
            np.broadcast_to(np.array(dr.grad(self._powers)), max(len(self._rows), 1))[: len(self._rows)],
        )


KINDS = ("all", "stray", DIRECT, *STRAY_KINDS)


def _matches(selection: Selection, row: PathRow) -> bool:
    if not isinstance(selection, str):
        return bool(selection(row))
    if selection == "all":
        return True
    if selection == "stray":
        return row.kind != DIRECT
    return selection in (row.kind, row.events)


@dataclass(frozen=True)
class Metric:
    """
    A number computed from traces of one scene at one or more field angles.

    Attributes
    ----------
    scene : mi.Scene
    function : callable
        Takes a list of `Observation`, one for each field, and returns a Dr.Jit scalar made from their `power` and
        `irradiance` with smooth functions.
    fields_deg : tuple of float or None
        Field angles, degrees; None: the source's own.
    wavelength_nm, weights
        As for `mistray.trace`.
    settings : dict
        Further arguments of `mistray.trace`: rays, max_reflections, flux_threshold, seed, …
    unit : str
        Unit of the value, for tables.
    """

    scene: Any
    function: Callable[[list[Observation]], Any]
    fields_deg: tuple[float, ...] | None = None
    wavelength_nm: float | Sequence[float] | None = None
    weights: Sequence[float] | None = None
    settings: Any = None
    unit: str = ""

    def observe(self, **changes: Any) -> list[Observation]:
        """Trace all fields; `changes` replace some of the settings."""
        settings = {**(self.settings or {}), **changes}
        fields: Sequence[float | None] = (None,) if self.fields_deg is None else self.fields_deg
        return [
            Observation(
                trace(
                    self.scene,
                    field_deg=angle,
                    wavelength_nm=self.wavelength_nm,
                    weights=self.weights,
                    **settings,
                )
            )
            for angle in fields
        ]

    def evaluate(self, observations: list[Observation]) -> Any:
        """The metric as a Dr.Jit scalar of type ``mi.Float64`` that depends on the observations."""
        with dr.resume_grad():
            value = mi.Float64(self.function(observations))
        if dr.width(value) != 1:
            raise MistrayError(f"the metric's function returned {dr.width(value)} values; it must return one number")
        return value

    def value(self, **changes: Any) -> float:
        """The metric's value; `changes` replace some of the settings, for example ``seed=1``."""
        return float(dr.detach(self.evaluate(self.observe(**changes)))[0])


def path_power(scene: Any, selection: Selection = "ghost", **traced: Any) -> Metric:
    """
    Detected power of some paths, mean over the fields, in units of the launched power.

    Parameters
    ----------
    scene : mi.Scene
    selection : str or callable
        See `Observation.power`.
    **traced
        `fields_deg`, `wavelength_nm`, `weights` of `Metric`, and arguments of `mistray.trace`.
    """

    def function(observations: list[Observation]) -> Any:
        return sum(o.power(selection) / o.launched_W for o in observations) / len(observations)

    return _metric(scene, function, traced, "W/W")


def ghost_to_signal(scene: Any, selection: Selection = "ghost", **traced: Any) -> Metric:
    """Power of the ghosts (or of another selection) over that of the direct image, mean over the fields."""

    def function(observations: list[Observation]) -> Any:
        return sum(o.power(selection) / o.power("direct") for o in observations) / len(observations)

    return _metric(scene, function, traced, "1")


def image_metric(scene: Any, function: Callable[[Any], Any], **traced: Any) -> Metric:
    """
    A smooth function of the detector's irradiance, mean over the fields.

    Parameters
    ----------
    scene : mi.Scene
    function : callable
        Takes the irradiance as ``mi.Float64`` (height · width, W/mm²) and returns a Dr.Jit scalar.
    **traced
        As for `path_power`.
    """

    def mean(observations: list[Observation]) -> Any:
        return sum(function(o.irradiance) for o in observations) / len(observations)

    return _metric(scene, mean, traced, "")


def _metric(scene: Any, function: Callable[[list[Observation]], Any], traced: dict[str, Any], unit: str) -> Metric:
    if "field_deg" in traced:
        raise MistrayError(f"metric: field_deg = {traced['field_deg']}; give fields_deg instead of field_deg")
    own = {key: traced.pop(key) for key in ("fields_deg", "wavelength_nm", "weights") if key in traced}
    if own.get("fields_deg") is not None:
        own["fields_deg"] = tuple(float(angle) for angle in np.atleast_1d(own["fields_deg"]))
    return Metric(scene, function, settings=traced, unit=unit, **own)

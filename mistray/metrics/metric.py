"""
Metrics to be minimised or maximised: numbers computed from traces, and their derivatives.

Derivatives are those with respect to every detected flux, from which others follow by the chain rule.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError, nearest
from mistray.gradients.edge_widths import EQUAL
from mistray.known_arguments import known_arguments
from mistray.metrics.observation import NORM, Observation, Selection, smooth_maximum, smooth_minimum, texts_of
from mistray.metrics.views import TraceView
from mistray.notes import quiet
from mistray.ranges import FIELD_DEG, POSITIVE, WAVELENGTHS_NM, WEIGHTS, Range, check_fields
from mistray.recorders.path_events import DIRECT
from mistray.recorders.sampled import Sampled
from mistray.settings import BATCHES
from mistray.trace import trace
from mistray.trace.check_paths import check_paths

AXIS_DEG = 0.0
STEP_DEG = Range(0.0, 45.0, above=True, below=True, unit="degrees", remedy="give a small angle, 0.5 say")
SMALLEST_STEP_DEG, LARGEST_STEP_DEG = 0.02, 0.5  # between the fields of a slope
SEEDS_APART = 1000  # between the seed of a gradient and the first that is independent of it


@known_arguments
@dataclass(frozen=True)
class Metric:
    """
    Scalar figure of merit computed from traces of one scene at one or more field angles, with derivatives.

    Attributes
    ----------
    scene : mi.Scene
        Scene to trace.
    function : callable
        Function of a list of `Observation`, one for each field. It returns a Dr.Jit scalar made from their `power`,
        `moments`, `map` and `irradiance` with smooth functions.
    field_deg : tuple of float or None
        Field angles, degrees, also given as a list or one number; None for the source's own.
    wavelength_nm, weights
        Vacuum wavelengths, nm, and their weights, as for `mistray.trace`.
    settings : dict
        Further arguments of `mistray.trace`: rays, max_reflections, flux_threshold, seed, ….
    unit : str
        Unit of the value, for tables; "" if it is not stated.
    name : str
        Name for messages and tables.
    times : float
        Factor that multiplies the number of rays in all traces.

    Examples
    --------
    >>> def ghosts(views):
    ...     return views[0].power("ghost") / views[0].launched_W
    >>> metric = mistray.Metric(mistray.load("cooke_triplet"), ghosts, settings={"rays": 5000})
    >>> print(f"{metric.value():.4f}")
    0.0042
    """

    scene: Any
    function: Callable[[list[Any]], Any]
    field_deg: tuple[float, ...] | None = None
    wavelength_nm: float | Sequence[float] | None = WAVELENGTHS_NM.field(None)
    weights: float | Sequence[float] | None = WEIGHTS.field(None)
    settings: Any = None
    unit: str = ""
    name: str = "metric"
    times: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "field_deg", _angles(self.field_deg))
        check_fields(self, "metric")

    @property
    def views(self) -> list[TraceView]:
        """Traces that the metric needs, one for each field angle, in the order of the observations."""
        light = {"wavelength_nm": self.wavelength_nm, "weights": self.weights}
        fields: Sequence[float | None] = (None,) if self.field_deg is None else self.field_deg
        return [TraceView({**(self.settings or {}), **light, "field_deg": angle}) for angle in fields]

    def observe(self, times: float = 1.0, **changes: Any) -> list[Any]:
        """
        Return the traces of all fields of the metric as observations that Dr.Jit can differentiate.

        Parameters
        ----------
        times : float
            Factor that multiplies the number of rays.
        **changes
            Settings to replace, for example ``seed=1``.

        Returns
        -------
        list of Observation or PstObservation
            Observations, one for each view.

        Raises
        ------
        MistrayError
            If `times` is not above 0, or a setting is not allowed.
        """
        POSITIVE.check("times", times)
        with quiet():
            return [view.observe(self.scene, times * self.times, changes) for view in self.views]

    @property
    def independent_seed(self) -> int:
        """Random seed for traces that verify a gradient, independent of the gradient's own seeds."""
        return int((self.settings or {}).get("seed") or 0) + SEEDS_APART

    def with_rays_times(self, times: float) -> Metric:
        """Return a copy that traces `times` the rays of the settings, without pilot results of this metric."""
        return replace(self, times=times)

    def evaluate(self, observations: list[Any]) -> Any:
        """
        Return the metric as a Dr.Jit scalar of type ``mi.Float64`` that depends on the observations.

        Derivatives of previous values are cleared in the observations.

        Raises
        ------
        MistrayError
            If the function returns more than one number, one that is not finite, or one that Dr.Jit cannot
            differentiate.
        """
        for observation in observations:
            observation.clear()
        with dr.resume_grad():
            value = mi.Float64(self.function(observations))
        if dr.width(value) != 1:
            raise MistrayError(f"the metric's function returned {dr.width(value)} values; it must return one number")
        if not dr.grad_enabled(value):
            raise MistrayError(
                f"the {self.name} does not depend on the traces; let its function work on Dr.Jit numbers and Python's, "
                "as a NumPy number times one of Dr.Jit is an array of NumPy"
            )
        number = float(dr.detach(value)[0])
        if not np.isfinite(number):
            raise MistrayError(
                f"the {self.name} is {number:g}; something it divides by is 0: choose other fields or paths, or trace "
                "more rays"
            )
        return value

    def differentiate(self, observations: list[Any]) -> tuple[float, Sampled]:
        """
        Return the metric's value and its noise by batch, in its unit; see `Observation.noise`.

        Afterwards the observations hold the derivatives of the value. Raise `MistrayError` as `evaluate` does.
        """
        value = self.evaluate(observations)
        dr.backward(value, flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)  # no path at all: nothing to differentiate
        noise = sum((observation.noise() for observation in observations), Sampled.of(np.zeros(BATCHES), EQUAL))
        return float(dr.detach(value)[0]), noise

    def value(self, times: float = 1.0, **changes: Any) -> float:
        """Trace the scene and return the metric's value, in its unit; the arguments are those of `observe`."""
        return float(dr.detach(self.evaluate(self.observe(times, **changes)))[0])


def log(metric: Metric) -> Metric:
    """
    Return a metric, the natural logarithm of another, whose derivatives are relative.

    Evaluation raises `MistrayError` if the value of that metric is not above 0.

    Examples
    --------
    >>> ghosts = mistray.optimize.path_power(mistray.load("cooke_triplet"), "ghost", rays=5000)
    >>> print(f"{mistray.optimize.log(ghosts).value():.2f} = ln {ghosts.value():.4f}")
    -5.48 = ln 0.0042
    """

    def function(observations: list[Any]) -> Any:
        value = mi.Float64(metric.function(observations))
        if not float(dr.detach(value)[0]) > 0:
            raise MistrayError(f"the {metric.name} is {float(dr.detach(value)[0]):g}; its logarithm does not exist")
        return dr.log(value)

    return replace(metric, function=function, unit="1", name=f"logarithm of the {metric.name}")


def path_power(scene: Any, selection: Selection = "ghost", **traced: Any) -> Metric:
    """
    Return a metric: the detected power of some paths over the launched power, mean over the fields, W/W.

    For an imported lens, whose beam is wider than its aperture, the launched power is that in the aperture, see
    `Trace.pupil_W`.

    Parameters
    ----------
    scene : mi.Scene
        Scene to trace.
    selection : str, sequence of str or callable
        Paths, see `Observation.power`.
    **traced
        Arguments `field_deg`, `wavelength_nm` and `weights` of `Metric`, and arguments of `mistray.trace`.

    Raises
    ------
    MistrayError
        If the scene cannot have such paths, or an argument is unknown; when it is evaluated, if one is not allowed.

    Examples
    --------
    >>> scene = mistray.load("cooke_triplet")
    >>> ghosts = mistray.optimize.path_power(scene, "ghost", rays=5000)
    >>> print(f"{ghosts.value():.4f} of the light comes as ghosts")
    0.0042 of the light comes as ghosts
    >>> one = mistray.optimize.path_power(scene, "L2_front -> L1_rear", rays=5000)
    >>> print(f"{one.value():.1e} by one path")
    6.4e-04 by one path
    """
    return _of_paths(scene, selection, lambda o: o.power(selection) / o.pupil_W, traced, "W/W", "path power")


def ghost_to_signal(scene: Any, selection: Selection = "ghost", **traced: Any) -> Metric:
    """
    Return a metric: the power of ghosts, or of other paths, over that of the direct image, mean over the fields.

    If there is no direct light at a field, evaluation raises `MistrayError`. Parameters are those of `path_power`.

    Examples
    --------
    >>> metric = mistray.optimize.ghost_to_signal(mistray.load("cooke_triplet"), field_deg=[0, 10], rays=5000)
    >>> print(f"{metric.value():.3f}")
    0.018
    """
    name = "ghost-to-signal ratio"
    return _of_paths(scene, selection, lambda o: o.power(selection) / _signal(o, name), traced, "1", name)


def image_metric(scene: Any, function: Callable[[Any], Any], **traced: Any) -> Metric:
    """
    Return a metric: a smooth function of the detector's irradiance, mean over the fields.

    Parameters
    ----------
    scene : mi.Scene
        Scene to trace.
    function : callable
        Function of the irradiance, ``mi.Float64`` (height · width, W/mm²), that returns a Dr.Jit scalar.
    **traced
        Keywords of `path_power`.

    Examples
    --------
    >>> import drjit as dr
    >>> metric = mistray.optimize.image_metric(mistray.load("cooke_triplet"), dr.mean, rays=5000)
    >>> print(f"{metric.value():.4f} W/mm²")
    0.0582 W/mm²
    """
    return _mean(scene, lambda o: function(o.irradiance), traced, "", "image metric")


def peak_irradiance(scene: Any, selection: Selection = "ghost", *, norm: float = NORM, **traced: Any) -> Metric:
    """
    Return a metric: the smooth maximum over pixels of the irradiance of some paths, W/mm², mean over the fields.

    It is (Σ E^p)^(1/p) over the pixels, see `smooth_maximum`. It depends on the size of the pixels. It exceeds the true
    maximum the more, the more noise the pixels have.

    Parameters
    ----------
    scene : mi.Scene
        Scene to trace.
    selection : str, sequence of str or callable
        Paths whose irradiance is added, see `Observation.power`. Other paths than "all" need a second trace of the same
        rays.
    norm : float
        Exponent p ≥ 1.
    **traced
        Keywords of `path_power`.

    Raises
    ------
    MistrayError
        As for `path_power`; when it is evaluated, if `norm` is below 1.

    Examples
    --------
    >>> metric = mistray.optimize.peak_irradiance(mistray.load("cooke_triplet"), "ghost", rays=5000)
    >>> print(f"{metric.value():.2f} {metric.unit}")
    0.07 W/mm2
    """
    return _of_paths(scene, selection, lambda o: o.peak(selection, norm), traced, "W/mm2", "peak irradiance")


def ghost_rms_irradiance(scene: Any, selection: Selection = "ghost", *, norm: float = NORM, **traced: Any) -> Metric:
    """
    Return a metric: the RMS irradiance P / (π r²) of the brightest ghost, W/mm², mean over the fields.

    P is the power of a path, and r its RMS radius, as in the ghost table. The metric is the smooth maximum over the
    single paths of a selection. A single path gives its own value; a selection without paths gives 0. Paths of less
    than 30 rays are left out. See `Observation.moments_of_each` and `smooth_maximum`.

    Parameters
    ----------
    scene : mi.Scene
        Scene to trace.
    selection : str, sequence of str or callable
        Paths, see `Observation.power`.
    norm : float
        Exponent p ≥ 1; 1 for the sum over the paths.
    **traced
        Keywords of `path_power`.

    Raises
    ------
    MistrayError
        As for `path_power`; when it is evaluated, if `norm` is below 1, or no path has 30 rays.

    Examples
    --------
    >>> metric = mistray.optimize.ghost_rms_irradiance(mistray.load("cooke_triplet"), rays=5000)
    >>> print(f"{metric.value():.1e} {metric.unit}")
    6.3e-04 W/mm2
    """
    return _of_paths(
        scene,
        selection,
        lambda o: _brightest(o, selection, norm),
        traced,
        "W/mm2",
        "RMS irradiance of the ghosts",
    )


def ghost_focus(scene: Any, selection: Selection = "ghost", *, norm: float = NORM, **traced: Any) -> Metric:
    """
    Return a metric: the RMS radius of the ghost with the sharpest focus, mm, mean over the fields; large is good.

    It is the smooth minimum over the single paths of a selection; a single path gives its own RMS radius. Parameters
    and errors are those of `ghost_rms_irradiance`, but a selection without paths raises `MistrayError` on evaluation.

    Examples
    --------
    >>> metric = mistray.optimize.ghost_focus(mistray.load("cooke_triplet"), rays=5000)
    >>> print(f"{metric.value():.1f} {metric.unit}")
    8.3 mm
    """
    return _of_paths(
        scene,
        selection,
        lambda o: smooth_minimum(o.moments_of_each(selection).rms_radius, norm),
        traced,
        "mm",
        "RMS radius of the ghosts",
    )


def rms_spot(scene: Any, **traced: Any) -> Metric:
    """
    Return a metric: the RMS radius of the direct image about its centroid, all wavelengths, mm, mean over fields.

    If there is no direct light at a field, evaluation raises `MistrayError`. Keywords are those of `path_power`.

    Examples
    --------
    >>> metric = mistray.optimize.rms_spot(mistray.load("cooke_triplet"), field_deg=[0, 10], rays=5000)
    >>> print(f"{1000 * metric.value():.0f} µm")
    14 µm
    """
    return _mean(scene, lambda o: o.moments(DIRECT).rms_radius, traced, "mm", "RMS spot")


def transmission(scene: Any, **traced: Any) -> Metric:
    """
    Return a metric: the power of the direct image over the launched power, mean over the fields, W/W.

    Losses at the stop and the rims are included. A beam wider than the entrance pupil gives a smaller value. The
    exception is a source that declares which part the unmoved stop passes (`Trace.pupil_W`), as that of an imported
    lens does. A pupil that is larger at a field off the axis gives a larger value. Keywords are those of `path_power`.

    Examples
    --------
    >>> metric = mistray.optimize.transmission(mistray.load("cooke_triplet"), rays=5000)
    >>> print(f"{metric.value():.2f} of a beam that is wider than the lens")
    0.22 of a beam that is wider than the lens
    """
    return _mean(scene, lambda o: o.power(DIRECT) / o.pupil_W, traced, "W/W", "transmission")


def relative_illumination(scene: Any, *, step_deg: float | None = None, **traced: Any) -> Metric:
    """
    Return a metric: the relative illumination of the image of a uniform scene, mean over the fields, dimensionless.

    By conservation of étendue it is Φ(θ) Ω(θ) / (Φ(0) Ω(0)) at the field angle θ; a field on the axis counts as 1. Φ is
    the power of the direct image for beams of equal irradiance. Ω is the solid angle from which an area of the image
    collects, sin θ dθ / (r dr). Distances r and slopes dr/dθ are those of the centroids of direct images, so that
    distortion is included. The beam must fill the entrance pupil at every field, and the image must be centred on the
    axis of the source.

    Parameters
    ----------
    scene : mi.Scene
        Scene to trace.
    step_deg : float, optional
        Step for the slope, degrees. Two more angles are traced, this step and twice this step nearer to the axis, or on
        either side for the slope on the axis. None: a tenth of the smallest field off the axis, 0.02° … 0.5°, within
        the field. The error of the slope is about step² d³r/dθ³ / 3.
    **traced
        Keywords of `path_power`, with `field_deg`; the axis is traced as well.

    Raises
    ------
    MistrayError
        If no field is off the axis, or the step is out of range.

    Examples
    --------
    >>> metric = mistray.optimize.relative_illumination(mistray.load("cooke_triplet"), field_deg=10, rays=20_000)
    >>> print(f"{metric.value():.2f}, cos⁴: {np.cos(np.radians(10)) ** 4:.2f}")
    0.94, cos⁴: 0.94
    """
    name = "relative illumination"
    fields = _angles(traced.get("field_deg")) or ()
    off_axis = [angle for angle in fields if angle != AXIS_DEG]
    if not off_axis:
        raise MistrayError("relative illumination needs field_deg off the axis, 15 or (10, 15) say")
    if step_deg is None:
        nearest = min(map(abs, off_axis))  # no step leads out of the field
        step_deg = min(LARGEST_STEP_DEG, max(nearest / 10, min(nearest, SMALLEST_STEP_DEG)))
    STEP_DEG.check("step_deg", step_deg)
    inwards = [(angle, -math.copysign(step_deg, angle)) for angle in off_axis]
    angles = [AXIS_DEG, AXIS_DEG - step_deg, AXIS_DEG + step_deg]
    angles += [angle + k * step for angle, step in inwards for k in range(3)]

    def function(observations: list[Observation]) -> Any:
        axis, before, behind = observations[:3]
        scale = _distance(before, behind) / math.radians(2 * step_deg)
        signal = _signal(axis, name) / (scale * scale)
        groups = [observations[k : k + 3] for k in range(3, len(observations), 3)]
        light = sum(group[0].power(DIRECT) * _solid_angle(axis, group) for group in groups)
        return (len(fields) - len(off_axis) + light / signal) / len(fields)

    return _metric(scene, function, {**traced, "field_deg": angles}, "1", name)


def _distance(a: Observation, b: Observation) -> Any:
    """Return the distance between the centroids of two direct images, mm."""
    first, second = a.moments(DIRECT), b.moments(DIRECT)
    return _length(first.x - second.x, first.y - second.y)


def _length(x: Any, y: Any) -> Any:
    return dr.sqrt(x * x + y * y)


def _solid_angle(axis: Observation, group: list[Observation]) -> Any:
    """
    Return the collecting solid angle per image area, sr/mm², from direct images of four fields.

    `axis` is the field on the axis. `group` holds the field itself and two more in equal steps towards the axis.
    """
    centre, here, near, nearer = (o.moments(DIRECT) for o in (axis, *group))
    x, y = (3 * getattr(here, k) - 4 * getattr(near, k) + getattr(nearer, k) for k in "xy")
    difference = _length(x, y)
    along = ((here.x - centre.x) * x + (here.y - centre.y) * y) / difference
    slope = difference / (2 * math.radians(abs(group[0].field_deg - group[1].field_deg)))
    return math.sin(math.radians(abs(group[0].field_deg))) / (along * slope)


def require_known(given: Iterable[str], known: Iterable[str]) -> None:
    """Raise `MistrayError` for the first keyword that is not among the known ones."""
    names = list(known)
    for key in given:
        if key not in names:
            raise MistrayError(f"metric: there is no setting '{key}'; {nearest(key, names)}")


def _brightest(observation: Observation, selection: Selection, norm: float) -> Any:
    """
    Return the smooth maximum of the RMS irradiance, W/mm², over the selected paths; 0 if there are none.

    `norm` is the exponent p. Raise `MistrayError` as `moments_of_each` and `smooth_maximum` do.
    """
    if not len(observation.chosen(selection)):
        return observation.power(selection)
    return smooth_maximum(observation.moments_of_each(selection).rms_irradiance, norm)


def _signal(observation: Observation, name: str) -> Any:
    """
    Return the power of the direct image, W, by which the metric `name` divides.

    Raise `MistrayError` if it is 0.
    """
    power = observation.power(DIRECT)
    if not float(dr.detach(power)[0]) > 0:
        raise MistrayError(
            f"the {name} is nan: no direct light at field {observation.field_deg:g}°; choose fields within the field "
            "of view"
        )
    return power


def _of_paths(
    scene: Any,
    selection: Selection,
    number: Callable[[Observation], Any],
    traced: dict[str, Any],
    unit: str,
    name: str,
) -> Metric:
    """
    Return a metric of selected paths: the mean over fields of `number`, see `_mean` for the other parameters.

    Raise `MistrayError` if the scene cannot have such paths.
    """
    check_paths(scene, texts_of(selection))
    return _mean(scene, number, traced, unit, name)


def _mean(scene: Any, number: Callable[[Observation], Any], traced: dict[str, Any], unit: str, name: str) -> Metric:
    """
    Return a metric: the mean over the field angles of `number`, a function of each field's observation.

    `traced` are the keywords of `path_power`; `unit` and `name` are attributes of the metric.
    """

    def function(observations: list[Any]) -> Any:
        return sum(number(o) for o in observations) / len(observations)

    return _metric(scene, function, traced, unit, name)


def _metric(scene: Any, function: Callable[[list[Any]], Any], traced: dict[str, Any], unit: str, name: str) -> Metric:
    own = _own(traced)
    settings = {key: value for key, value in traced.items() if key not in own}
    known = [key for key in inspect.signature(trace).parameters if key != "scene"]
    require_known(settings, known)
    return Metric(scene, function, settings=settings, unit=unit, name=name, **own)


def _angles(field_deg: float | Sequence[float] | None) -> tuple[float, ...] | None:
    """
    Return one or several field angles, degrees, as a tuple; None stays None.

    An angle out of range raises `MistrayError`.
    """
    return None if field_deg is None else tuple(FIELD_DEG.check_each("field_deg", field_deg, "metric"))


def _own(traced: dict[str, Any]) -> dict[str, Any]:
    """Return field angles, wavelengths and weights in `traced`, by attribute of `Metric`; None for one not given."""
    return {key: traced.get(key) for key in ("field_deg", "wavelength_nm", "weights")}

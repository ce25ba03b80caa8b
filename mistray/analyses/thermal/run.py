"""Thermal self-emission: the irradiance that warm optics and structure put on their own detector.

Kirchhoff's law: a surface emits at each angle as much of a blackbody's radiance as it absorbs there, 1 - R - T -
scatter. A backward trace finds the share of the detector's view that each surface absorbs, with all reflections
and scatter on the way. Times π L of a blackbody at the surface's temperature it is the irradiance (E. Fest, Stray Light
Analysis and Control, SPIE Press 2013, chapter 3). Where everything has one temperature the sum is that of a blackbody.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.analyses.thermal.narcissus import ZONES, NarcissusReturn, Returned, mean_returns, returns
from mistray.analyses.thermal.netd import netd_budget
from mistray.analyses.thermal.request import ThermalRequest
from mistray.analyses.thermal.result import Emitter, ThermalReport
from mistray.analyses.thermal.spectrum import BAND_ERROR, DISPERSIVE, TracedBand, band_weights, traced_wavelengths
from mistray.analyses.thermal.sums import (
    Key,
    emission,
    imaged_share,
    per_kelvin,
    ratio,
    total,
    weighted_sum,
    with_band_error,
)
from mistray.errors import MistrayError
from mistray.estimate import UNKNOWN, Estimate
from mistray.execute.seen import Seen, see
from mistray.execute.wavelength_choice import TIMED_RAYS, WavelengthChoice, in_time
from mistray.ids import fits
from mistray.light import Light
from mistray.messages import Message, fewer_rays
from mistray.notes import Note
from mistray.percent import percent_text
from mistray.time_budget import share, within
from mistray.toolkit.analysis import analysis
from mistray.trace import Settings
from mistray.trace.host.polarization_choice import unpolarized_notes

if TYPE_CHECKING:
    import mitsuba as mi

RAYS, RETURN_RAYS = 200_000, 50_000
IMAGE_ONLY = {"max_reflections": 0, "max_scatters": 0}
LOST_WARNING = 0.01  # of the detector's view

Progress = Callable[[int, int], None]


def run(
    scene: mi.Scene, request: ThermalRequest, *, progress: Progress | None = None, seconds: float | None = None
) -> ThermalReport:
    """
    Return the irradiance on the detector by thermal emission, for every surface and medium.

    E = π ∫ L_B(λ, T) emission(λ) dλ, where the emission holds n² of the medium before the detector. Between wavelengths
    it is interpolated linearly, beyond them it is that of the nearest. The detector is cooled by the id of its shape.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    request : ThermalRequest
    progress : callable, optional
        Called with (traces done, traces in all); those of narcissus by one reflection are not counted.
    seconds : float, optional
        Time for all traces, s, in equal shares; each ends with the rays that it has, and a note reports it. None: no
        limit.

    Raises
    ------
    MistrayError
        If a value is out of range, a name fits no surface, part or material, the wavelengths do not ascend, or a
        material or coating is not known at one of them. Without wavelengths: at an end or the middle of the band.

    Examples
    --------
    >>> found = mistray.thermal(mistray.load("cassegrain"), 293, (8, 12), wavelengths_um=10, rays=5000)
    >>> print(f"{mistray.report.with_error(found.total_W_mm2)} W/mm²")
    1.0700e-04 ± 1.7e-07 W/mm²
    >>> found.emitters[0].name
    'inner_baffle_wall'
    """
    temperature_K, (low, high), settings = request.temperature_K, request.band_um, request.settings
    rules = request.temperatures or {}
    outside = temperature_K if request.scene_K is None else request.scene_K
    detector, noise = request.detector, request.noise
    _check_names(scene, rules)
    kelvins = [temperature_K, outside, *rules.values()]
    chosen = Settings.without_sources(scene, **settings)
    runs: tuple[list[Seen], list[Seen]] = ([], [])
    # The third of a wavelength is what the cold detector sees by one reflection
    times = len(runs) + any(kelvin < temperature_K for kelvin in rules.values())

    def look(wave: float, rays: int, **more: Any) -> Seen:
        return see(scene, rays, wavelength_nm=1e3 * wave, detector=detector, **{**settings, **more})

    with within(seconds):
        traced = traced_wavelengths(scene, request.wavelengths_um, (low, high), kelvins)
        most = in_time(traced.wavelengths_um, partial(look, rays=TIMED_RAYS), times)
        every = [1e3 * wave for wave in traced.wavelengths_um]
        lines = WavelengthChoice.of(every, [1.0] * len(every), most)
        if lines.left_out_nm:
            traced = traced_wavelengths(scene, np.divide(lines.wavelengths_nm, 1e3).tolist(), (low, high), kelvins)
        waves = traced.wavelengths_um
        # More wavelengths than three share the rays of three: the error of the integral is about the same
        each = request.rays or min(RAYS, DISPERSIVE * RAYS // len(waves))
        traces = times * len(waves)
        for done, ((number, wave), (which, limits)) in enumerate(
            itertools.product(enumerate(waves), enumerate(({}, IMAGE_ONLY)))
        ):
            # Wavelengths are independent; both traces of one start the same rays, so that differences have less noise
            with share(1 / (traces - done)):
                runs[which].append(look(wave, each, **limits, seed=(chosen.seed + number) % 2**32))
            if progress is not None:
                progress(done + 1, len(runs) * len(waves))
    report = _report(*runs, traced, (low, high), temperature_K, outside, rules, settings)
    if noise is not None:
        warm = _temperatures(runs[0], temperature_K, rules)
        report = replace(report, netd=netd_budget(noise, runs, warm, outside, traced, (low, high)))
    light = Light(wavelength_nm=[1e3 * wave for wave in waves], detector=detector)
    report.notes.extend(unpolarized_notes(scene, [light], **settings))
    planned = len(runs) * len(waves) * each
    if report.facts["rays"] < 0.99 * planned:  # batches are of one size, so that a few rays may be left out
        report.notes.append(fewer_rays(report.facts["rays"], planned))
    report.notes.extend(lines.notes("between those that are traced the optics are interpolated"))
    report.facts.update(lines.facts)
    return _with_returns(report, scene, runs, chosen, rules, min(each, RETURN_RAYS))


thermal = analysis("thermal", ThermalRequest, run)


def _with_returns(
    report: ThermalReport,
    scene: mi.Scene,
    runs: tuple[list[Seen], list[Seen]],
    chosen: Settings,
    rules: Mapping[str, float],
    rays: int,
) -> ThermalReport:
    """
    Return the report with the narcissus of a cold detector by one reflection, by surface and zone of the detector.

    The report stays as it is if the detector is not colder than the system, or does not see itself. `runs` are those of
    `netd_budget`, `chosen` the settings, `rules` map name patterns to K, and `rays` is the number per wavelength.
    """
    if report.detector_K >= report.temperature_K or not report.self_view.value:
        return report
    waves = report.wavelengths_um
    by_id = {name: k for (kind, name), k in _temperatures(runs[0], report.temperature_K, rules).items()
              if kind == "surface"}  # fmt: skip
    weights = {k: np.pi * band_weights(k, report.band_um, waves) for k in {*by_id.values(), report.temperature_K}}
    slopes = np.pi * band_weights(report.scene_K, report.band_um, waves, derivative=True)
    found = []
    for number, wave in enumerate(waves):
        missing = {
            name: float((weights[report.temperature_K] - weights[k])[number])
            for name, k in by_id.items()
            if k < report.temperature_K
        }
        seed = (chosen.seed + number) % 2**32
        found.append(returns(scene, report.detector, wave, rays, seed, chosen, missing, float(slopes[number])))
    return replace(
        report,
        returned=_returned(report, found, runs),
        zones_mm=tuple(np.mean([one.zones_mm for one in found], axis=0).tolist()),
    )


def _check_names(scene: mi.Scene, rules: Mapping[str, float]) -> None:
    """Raise `MistrayError` for a name that fits no surface, part or material, before anything is traced."""
    names, parts = set(), set()
    for shape in scene.shapes():
        parts.add(str(getattr(shape, "part", shape.id())))
        names |= {shape.id(), *(str(getattr(shape.bsdf(), side, "")).strip() for side in ("front", "back"))}
    for pattern in rules:
        if not any(fits(name, pattern) for name in names | parts):
            raise MistrayError(
                f"temperatures: no surface, part or material is called '{pattern}'; parts are "
                + ", ".join(sorted(parts))
            )


def _temperatures(seen: Sequence[Seen], default_K: float, rules: Mapping[str, float]) -> dict[Key, float]:
    """
    Return the temperature, K, of every emitter, by kind and name.

    `rules` map name patterns to K; the last that fits holds.
    """
    names: dict[Key, tuple[str, ...]] = {("surface", row.id): (row.id, row.part) for row in seen[0].rows}
    names.setdefault(("surface", seen[0].detector), (seen[0].detector,))
    for one in seen:
        for material in one.media:
            key = "medium", material
            names[key] = (*names.get(key, ()), *one.named[material])
    found = dict.fromkeys(names, default_K)
    for pattern, kelvin in rules.items():
        fitting = (key for key, titles in names.items() if any(fits(title, pattern) for title in titles))
        found |= dict.fromkeys(fitting, kelvin)
    return found


def _emitter(key: Key, kelvin: float, weights: np.ndarray, seen: Sequence[Seen]) -> Emitter:
    """
    Return the row of a surface or medium, by kind and name, at the temperature `kelvin`, K.

    `weights` are its spectral weights times π, W/mm², one for each traced wavelength; `seen` are the views at these.
    """
    kind, name = key
    by_batch = [emission(one, key) for one in seen]
    # Of what is at 0 K the emission is the plain mean over the wavelengths
    spectrum = weights / weights.sum() if weights.any() else np.full(len(weights), 1 / len(weights))
    part, hits, share = "", 0, UNKNOWN
    if kind == "surface":
        rows = [row for one in seen for row in one.rows if row.id == name]
        part, hits = rows[0].part, sum(row.hits for row in rows)
        share = Estimate(
            sum(row.share for row in rows) / len(rows), math.hypot(*(row.share_se for row in rows)) / len(rows)
        )
    return Emitter(
        name, part, kind, kelvin, hits, share, weighted_sum(spectrum, by_batch), weighted_sum(weights, by_batch)
    )


def _report(
    seen: Sequence[Seen],
    image: Sequence[Seen],
    traced: TracedBand,
    band: tuple[float, float],
    default_K: float,
    scene_K: float,
    rules: Mapping[str, float],
    settings: Mapping[str, Any],
) -> ThermalReport:
    """
    Return the report from the traces of the whole view and of the image alone, one each for each traced wavelength.

    `band` is in µm, `default_K` is the temperature of everything without a rule, and `rules` map name patterns to K.
    """
    waves, kelvin = traced.wavelengths_um, _temperatures(seen, default_K, rules)
    weights = {k: np.pi * band_weights(k, band, waves) for k in {*kelvin.values(), default_K, scene_K}}
    known = partial(with_band_error, bound=traced.error)
    emitters = [_emitter(key, k, weights[k], seen) for key, k in kelvin.items()]
    emitters = [
        replace(e, emission=known(e.emission), irradiance_W_mm2=known(e.irradiance_W_mm2))
        for e in emitters
        if e.hits or e.kind == "medium"
    ]
    # Surfaces of one trace share its rays: the error of their sum is that of sums by batch
    warmth = [
        np.sum([weights[k][number] * emission(one, key) for key, k in kelvin.items()], axis=0)
        for number, one in enumerate(seen)
    ]
    detector = seen[0].detector
    imaged = [weight * imaged_share(one) for weight, one in zip(weights[scene_K], image, strict=True)]
    image_irradiance = known(total(imaged))
    whole = known(total(warmth))
    if whole.value > 0:
        emitters = [replace(e, percent=100 * e.irradiance_W_mm2.value / whole.value) for e in emitters]
    return ThermalReport(
        emitters=sorted(emitters, key=lambda e: -e.irradiance_W_mm2.value),
        total_W_mm2=whole,
        scene_W_mm2=known(weighted_sum(weights[scene_K], [one.escaped[2] for one in seen])),
        image_W_mm2=image_irradiance,
        to_image=known(ratio(warmth, imaged)),
        lost_W_mm2=float(weights[default_K] @ [one.lost[0] for one in seen]),
        self_view=next((e.emission for e in emitters if (e.kind, e.name) == ("surface", detector)), Estimate(0.0, 0.0)),
        nitd_K=known(_nitd(seen, image, kelvin, weights, default_K, per_kelvin(image, scene_K, band, waves))),
        temperature_K=default_K,
        detector_K=kelvin["surface", detector],
        scene_K=scene_K,
        band_um=band,
        wavelengths_um=waves,
        band_error=traced.error,
        detector=detector,
        facts={
            "rays": sum(one.rays for one in (*seen, *image)),
            "seconds": sum(one.seconds for one in (*seen, *image)),
            "detector_area_mm2": seen[0].detector_area_mm2,
            "settings": {key: value for key, value in settings.items() if value is not None},
        },
        notes=_notes(seen, image, traced, band),
    )


def _nitd(
    seen: Sequence[Seen],
    image: Sequence[Seen],
    kelvin: Mapping[Key, float],
    weights: Mapping[float, np.ndarray],
    housing_K: float,
    rise: Sequence[np.ndarray],
) -> Estimate:
    """
    Return the narcissus-induced temperature difference, K: positive where cold surfaces take light from the detector.

    It is NaN if nothing is colder than the housing, or no scene is seen. `seen` and `image` are the views of everything
    and of the image alone, one for each traced wavelength. `kelvin` holds the temperature of each emitter, K, `weights`
    by temperature the spectral weights times π, (wavelengths,), W/mm², and `rise` is the result of `per_kelvin`.
    """
    cold = {key: k for key, k in kelvin.items() if k < housing_K}
    other = {key: k for key, k in cold.items() if key != ("surface", seen[0].detector)}
    if not cold:
        return UNKNOWN

    def missing(number: int, one: Seen, pieces: Mapping[Key, float]) -> np.ndarray:
        parts = ((weights[housing_K] - weights[k])[number] * emission(one, key) for key, k in pieces.items())
        return sum(parts, np.zeros_like(one.escaped[2]))

    # However the detector sees itself; a cold shield only where it is not seen directly
    returned = [
        missing(number, everything, cold) - missing(number, direct, other)
        for number, (everything, direct) in enumerate(zip(seen, image, strict=True))
    ]
    return ratio(returned, rise)


def _returned(
    report: ThermalReport, found: Sequence[Returned], runs: tuple[list[Seen], list[Seen]]
) -> list[NarcissusReturn]:
    """
    Return the light that each surface reflects back to the detector, the strongest first.

    `found` holds the result of `returns` at each wavelength, `runs` is that of `netd_budget`.
    """
    emitted, nothing = [one.emission for one in found], np.zeros_like(found[0].scene)
    housing, own = (
        np.pi * band_weights(kelvin, report.band_um, report.wavelengths_um)
        for kelvin in (report.temperature_K, report.detector_K)
    )
    rise = total(per_kelvin(runs[1], report.scene_K, report.band_um, report.wavelengths_um))
    emissions, missing = mean_returns(emitted, housing / housing.sum()), mean_returns(emitted, housing - own)
    parts = {row.id: row.part for row in runs[0][0].rows}
    known = partial(with_band_error, bound=report.band_error)
    rows = []
    for name in dict.fromkeys(name for one in found for name in one.cold):
        back = [one.cold.get(name, nothing) for one in found]
        zones = [known(ratio([one[zone] for one in back], [one.scene[zone] for one in found])) for zone in range(ZONES)]
        whole = known(ratio([one.mean(axis=0) for one in back], [one.scene.mean(axis=0) for one in found]))
        own_share, own_part = (sums.get(name, Estimate(0.0, 0.0)) for sums in (emissions, missing))
        rows.append(
            NarcissusReturn(
                name, parts.get(name, ""), known(own_share), known(own_part.over(rise)), whole, tuple(zones)
            )
        )
    return sorted(rows, key=lambda row: -row.with_shield_K.value)


def _notes(seen: Sequence[Seen], image: Sequence[Seen], traced: TracedBand, band: tuple[float, float]) -> list[Note]:
    """
    Return notes on the reliability of the results, such as wavelengths that are too few.

    `seen` and `image` are the views of everything and of the image alone at the traced wavelengths, `band` is in µm.
    """
    waves = traced.wavelengths_um
    notes = list(dict.fromkeys(note for one in seen for note in one.notes))
    if traced.error > BAND_ERROR:
        notes.append(Message.BAND_ERROR.note(count=len(waves), error=percent_text(traced.error)))
    if math.isnan(traced.error):
        notes.append(Message.BAND_UNKNOWN.note())
    lost = max(one.lost[0] / one.whole for one in seen)
    if lost > LOST_WARNING:
        notes.append(Message.VIEW_CUT.note(share=percent_text(lost)))
    if not any(imaged_share(one).any() for one in image):
        notes.append(Message.NO_SCENE_SEEN.note())
    if waves[0] < band[0] or waves[-1] > band[1]:
        notes.append(Message.BAND_OUTSIDE.note(wavelengths=", ".join(f"{w:g}" for w in waves)))
    return notes

"""Thermal self-emission: the irradiance that warm optics and structure put on their own detector.

Kirchhoff's law: a surface emits at each angle as much of a blackbody's radiance as it absorbs there, 1 - R - T -
scatter. A backward trace finds how much of what the detector sees each surface absorbs, with all reflections
and scatter on the way; times π L of a blackbody of the surface's temperature it is the irradiance (E. Fest, Stray Light
Analysis and Control, SPIE Press 2013, chapter 3). Where everything has one temperature the sum is that of a blackbody.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.analysis.estimate import UNKNOWN, Estimate
from mistray.analysis.thermal.narcissus import ZONES, NarcissusReturn, Returned, mean_returns, returns
from mistray.analysis.thermal.netd import DetectorNoise, Netd, netd_budget
from mistray.analysis.thermal.spectrum import BAND_ERROR, DISPERSIVE, TracedBand, band_weights, traced_wavelengths
from mistray.analysis.thermal.sums import (
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
from mistray.execute.seen import Seen, see
from mistray.execute.wavelength_choice import TIMED_RAYS, WavelengthChoice, in_time
from mistray.ids import fits
from mistray.light import Light
from mistray.messages import Message, fewer_rays
from mistray.notes import Note, warns
from mistray.percent import percent_text
from mistray.ranges import TEMPERATURE_K, WAVELENGTH_UM
from mistray.scene.check import require_scene
from mistray.time_budget import share, within
from mistray.trace import Settings
from mistray.trace.polarization_choice import unpolarized_notes

if TYPE_CHECKING:
    import mitsuba as mi
    import pandas as pd

RAYS, RETURN_RAYS = 200_000, 50_000
IMAGE_ONLY = {"max_reflections": 0, "max_scatters": 0}
LOST_WARNING = 0.01  # of the detector's view

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Emitter:
    """
    A surface or a medium and what it puts on the detector.

    Attributes
    ----------
    name : str
        Surface id, or the material of a medium.
    part : str
        Part that a surface belongs to; "" for a medium.
    kind : {"surface", "medium"}
    temperature_K : float
    hits : int
        Rays that met a surface.
    share : Estimate
        n² times the mean share of the detector's view that meets a surface; more than n² where rays meet it repeatedly.
    emission : Estimate
        n² times the mean share that it absorbs, weighted with the spectrum of its temperature: a projected solid angle
        over π, times the emissivity. n is the index before the detector.
    irradiance_W_mm2 : Estimate
    """

    name: str
    part: str
    kind: str
    temperature_K: float
    hits: int
    share: Estimate
    emission: Estimate
    irradiance_W_mm2: Estimate


@dataclass(frozen=True, kw_only=True)
class ThermalReport:
    """
    Thermal light on the detector; irradiances are in W/mm² in the band and do not depend on what the detector absorbs.

    Attributes
    ----------
    emitters : list of Emitter
        All that emit, the strongest first; the detector itself where it sees itself.
    total_W_mm2 : Estimate
        Irradiance by all of them.
    scene_W_mm2 : Estimate
        Irradiance by a blackbody around the system at `scene_K`, by all paths.
    image_W_mm2 : Estimate
        The part of it that makes the image: by the sequences of the design, or, where there are none, all light that is
        neither scattered nor reflected but at mirrors.
    to_image : Estimate
        Self-emission over the irradiance of the imaged scene; NaN where none is seen.
    lost_W_mm2 : float
        Irradiance that a blackbody at `temperature_K` would add by the paths that were not followed.
    self_view : Estimate
        Emission of the detector in its own view (narcissus).
    nitd_K : Estimate
        Narcissus: change of the scene's temperature that would take as much light from the detector as the view of all
        that is colder than `temperature_K` by way of ghosts and scatter, the detector first of all, at `scene_K`; see
        `mistray.physics.planck.narcissus_nitd`. NaN where no scene is seen or nothing is colder.
    temperature_K, detector_K, scene_K : float
    band_um : (float, float)
    wavelengths_um : tuple of float
        Wavelengths at which the optics were traced.
    band_error : float
        Bound of the relative error of integrals over the band by these wavelengths; over √3 it is a part of the errors
        of means and integrals over the band. NaN where the optics are not known all over the band.
    detector : str
    returned : list of NarcissusReturn
        Surfaces by which the cold detector sees itself and its shield, the strongest first; empty if it does not see
        itself or is not colder than the rest.
    zones_mm : tuple of float
        Distances from the middle of the detector that bound the zones of `NarcissusReturn.by_zone_K`; empty like
        `returned`.
    netd : Netd or None
        Noise-equivalent temperature difference, if the noise of the detector is given.
    facts : dict
        Plain values: rays, seconds, settings.
    notes : list of Note
        Notes on what a reader must know.
    """

    emitters: list[Emitter]
    total_W_mm2: Estimate
    scene_W_mm2: Estimate
    image_W_mm2: Estimate
    to_image: Estimate
    lost_W_mm2: float
    self_view: Estimate
    nitd_K: Estimate
    temperature_K: float
    detector_K: float
    scene_K: float
    band_um: tuple[float, float]
    wavelengths_um: tuple[float, ...]
    band_error: float
    detector: str
    returned: list[NarcissusReturn] = field(default_factory=list)
    zones_mm: tuple[float, ...] = ()
    netd: Netd | None = None
    facts: dict[str, Any] = field(default_factory=dict)
    notes: list[Note] = field(default_factory=list)

    def by_part(self) -> dict[str, Estimate]:
        """
        Irradiance by part, and by medium in brackets, W/mm², the strongest first.

        Errors of surfaces of one part are added, because rays of one trace share them: a bound.
        """
        sums: dict[str, Estimate] = {}
        for emitter in self.emitters:
            name = emitter.part if emitter.kind == "surface" else f"({emitter.name})"
            before = sums.get(name, Estimate(0.0, 0.0))
            more = emitter.irradiance_W_mm2
            sums[name] = Estimate(before.value + more.value, before.se + more.se)
        return dict(sorted(sums.items(), key=lambda item: -item[1].value))

    def to_pandas(self) -> pd.DataFrame:
        """One row for each emitter; columns ``_se`` are standard errors, ``percent`` is of the total."""
        import pandas as pd

        total = self.total_W_mm2.value
        rows = [
            {
                "name": e.name, "part": e.part, "kind": e.kind, "temperature_K": e.temperature_K, "hits": e.hits,
                "share": e.share.value, "share_se": e.share.se,
                "emission": e.emission.value, "emission_se": e.emission.se,
                "irradiance_W_mm2": e.irradiance_W_mm2.value, "irradiance_W_mm2_se": e.irradiance_W_mm2.se,
                "percent": 100 * e.irradiance_W_mm2.value / total if total > 0 else math.nan,
            }
            for e in self.emitters
        ]  # fmt: skip
        columns = ["name", "part", "kind", "temperature_K", "hits", "share", "share_se", "emission", "emission_se",
                   "irradiance_W_mm2", "irradiance_W_mm2_se", "percent"]  # fmt: skip
        return pd.DataFrame(rows, columns=columns)


# More than 8 parameters: the keywords of a call, each with a default and used one by one
@warns
def thermal(
    scene: mi.Scene,
    temperature_K: float = 293.0,
    band_um: tuple[float, float] = (8.0, 12.0),
    *,
    temperatures: Mapping[str, float] | None = None,
    scene_K: float | None = None,
    wavelengths_um: float | Sequence[float] | None = None,
    detector: str | None = None,
    noise: DetectorNoise | None = None,
    rays: int | None = None,
    progress: Progress | None = None,
    seconds: float | None = None,
    **settings: Any,
) -> ThermalReport:
    """
    Irradiance on the detector by thermal emission, for every surface and medium.

    E = π ∫ L_B(λ, T) emission(λ) dλ, where the emission holds n² of the medium before the detector. Between wavelengths
    it is interpolated linearly, beyond them it is that of the nearest.

    Parameters
    ----------
    scene : mi.Scene
    temperature_K : float
        Of everything that `temperatures` does not name, K, ≥ 0.
    band_um : (float, float)
        Band of the detector, µm.
    temperatures : mapping of str to float, optional
        Name of a surface, part or material, with the wildcards ``*`` and ``?``, → temperature, K. The last that fits
        holds. The detector is cooled by its own name.
    scene_K : float, optional
        Temperature of the blackbody around the system; by default `temperature_K`.
    wavelengths_um : float or sequence of float, optional
        Where the optics are traced, ascending. By default the middle of the band where nothing depends on the
        wavelength, else as many as tell the integral over the band to 1 %, see `traced_wavelengths`.
    detector : str, optional
    noise : DetectorNoise, optional
        Of a pixel; with it the report has `netd`.
    rays : int, optional
        Of each trace; by default 200 000, of more than three wavelengths 600 000 over their number. There are two for
        each wavelength: of everything, and of the image.
    progress : callable, optional
        Called with the traces done and their number.
    seconds : float, optional
        Time for all traces, in equal shares; each ends with the rays that it has, and a note says so.
    **settings
        Fields of `mistray.trace.Settings`.

    Raises
    ------
    MistrayError
        If a temperature or the band is out of range, a name fits no surface, part or material, or a material is not
        known in the band.
    """
    require_scene(scene, "thermal")
    low, high = (float(v) for v in band_um)
    rules = {pattern: float(kelvin) for pattern, kelvin in (temperatures or {}).items()}
    outside = float(temperature_K if scene_K is None else scene_K)
    for name, kelvin in (("temperature_K", temperature_K), ("scene_K", outside)):
        TEMPERATURE_K.check(name, kelvin)
    for name, kelvin in rules.items():
        TEMPERATURE_K.check(f"temperature of '{name}'", kelvin)
    for end in (low, high):
        WAVELENGTH_UM.check("band_um", end)
    if low >= high:
        raise MistrayError(f"band_um is {low:g} to {high:g}; give the shorter wavelength first")
    _check_names(scene, rules)
    kelvins = [float(temperature_K), outside, *rules.values()]
    chosen = Settings.without_sources(scene, **settings)
    runs: tuple[list[Seen], list[Seen]] = ([], [])
    # The third of a wavelength is what the cold detector sees by one reflection
    times = len(runs) + any(kelvin < temperature_K for kelvin in rules.values())

    def look(wave: float, rays: int, **more: Any) -> Seen:
        return see(scene, rays, wavelength_nm=1e3 * wave, detector=detector, **{**settings, **more})

    with within(seconds):
        traced = traced_wavelengths(scene, wavelengths_um, (low, high), kelvins)
        most = in_time(traced.wavelengths_um, partial(look, rays=TIMED_RAYS), times)
        every = [1e3 * wave for wave in traced.wavelengths_um]
        lines = WavelengthChoice.of(every, [1.0] * len(every), most)
        if lines.left_out_nm:
            traced = traced_wavelengths(scene, np.divide(lines.wavelengths_nm, 1e3).tolist(), (low, high), kelvins)
        waves = traced.wavelengths_um
        # More wavelengths than three share the rays of three: the error of the integral is about the same
        each = rays or min(RAYS, DISPERSIVE * RAYS // len(waves))
        traces = times * len(waves)
        for done, ((number, wave), (which, limits)) in enumerate(
            itertools.product(enumerate(waves), enumerate(({}, IMAGE_ONLY)))
        ):
            # Wavelengths are independent; both traces of one start the same rays, so that differences have less noise
            with share(1 / (traces - done)):
                runs[which].append(look(wave, each, **limits, seed=(chosen.seed + number) % 2**32))
            if progress is not None:
                progress(done + 1, len(runs) * len(waves))
    report = _report(*runs, traced, (low, high), float(temperature_K), outside, rules, settings)
    if noise is not None:
        warm = _temperatures(runs[0], float(temperature_K), rules)
        report = replace(report, netd=netd_budget(noise, runs, warm, outside, traced, (low, high)))
    light = Light(wavelength_nm=[1e3 * wave for wave in waves], detector=detector)
    report.notes.extend(unpolarized_notes(scene, [light], **settings))
    planned = len(runs) * len(waves) * each
    if report.facts["rays"] < 0.99 * planned:  # batches are of one size, so that a few rays may be left out
        report.notes.append(fewer_rays(report.facts["rays"], planned))
    report.notes.extend(lines.notes("between those that are traced the optics are interpolated"))
    report.facts.update(lines.facts)
    return _with_returns(report, scene, runs, chosen, rules, min(each, RETURN_RAYS))


def _with_returns(
    report: ThermalReport,
    scene: mi.Scene,
    runs: tuple[list[Seen], list[Seen]],
    chosen: Settings,
    rules: Mapping[str, float],
    rays: int,
) -> ThermalReport:
    """The report with what a cold detector sees of itself and of all that is cold by one reflection."""
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
    """Refuse a name that fits no surface, part or material, before anything is traced."""
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
    """Temperature of everything that emits, by kind and name."""
    names: dict[Key, tuple[str, ...]] = {("surface", row.id): (row.id, row.part) for row in seen[0].rows}
    names.setdefault(("surface", seen[0].detector), (seen[0].detector,))
    names |= {("medium", material): (material,) for one in seen for material in one.media}
    found = dict.fromkeys(names, default_K)
    for pattern, kelvin in rules.items():
        fitting = (key for key, titles in names.items() if any(fits(title, pattern) for title in titles))
        found |= dict.fromkeys(fitting, kelvin)
    return found


def _emitter(key: Key, kelvin: float, weights: np.ndarray, seen: Sequence[Seen]) -> Emitter:
    """Sum the emission of a surface or a medium; `weights` are those of its temperature, times π."""
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
    """The report of the traces at the wavelengths, of everything and of the image."""
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
    return ThermalReport(
        emitters=sorted(emitters, key=lambda e: -e.irradiance_W_mm2.value),
        total_W_mm2=known(total(warmth)),
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
        notes=_notes(seen, image_irradiance, traced, band),
    )


def _nitd(
    seen: Sequence[Seen],
    image: Sequence[Seen],
    kelvin: Mapping[Key, float],
    weights: Mapping[float, np.ndarray],
    housing_K: float,
    rise: Sequence[np.ndarray],
) -> Estimate:
    """Temperature difference by what is colder than the housing and seen by way of ghosts or scatter."""
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
    """List the light that each surface sends back to the detector, the strongest first."""
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


def _notes(seen: Sequence[Seen], image: Estimate, traced: TracedBand, band: tuple[float, float]) -> list[Note]:
    """List the notes on what a reader must know."""
    waves = traced.wavelengths_um
    notes = list(dict.fromkeys(note for one in seen for note in one.notes))
    if traced.error > BAND_ERROR:
        notes.append(Message.BAND_ERROR.note(count=len(waves), error=percent_text(traced.error)))
    if math.isnan(traced.error):
        notes.append(Message.BAND_UNKNOWN.note())
    lost = max(one.lost[0] for one in seen)
    view = sum(row.emission for row in seen[0].rows) + seen[0].escaped[0] + seen[0].lost[0]
    if lost > LOST_WARNING * view:
        notes.append(Message.VIEW_CUT.note(share=percent_text(lost / view)))
    if image.value <= 0:
        notes.append(Message.NO_SCENE_SEEN.note())
    if waves[0] < band[0] or waves[-1] > band[1]:
        notes.append(Message.BAND_OUTSIDE.note(wavelengths=", ".join(f"{w:g}" for w in waves)))
    return notes

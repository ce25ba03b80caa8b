"""
Choice of the polarisation mode of a trace with `polarization` "auto".

The mean of s and p at every hit is wrong to second order in the diattenuation D = (Rs - Rp)/(Rs + Rp): after two
reflections the flux of unpolarised light is 1 + D₁ D₂ cos 2φ times that of the means, with φ between the planes of
incidence. A pilot of few rays on the host, see `mistray.trace.host.both_ways`, measures the change for the paths that a
table shows. Stokes vectors are used where it is more than `LEAST_CHANGE`.
"""

from __future__ import annotations

import hashlib
import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from mistray.cache.remembered import remembered
from mistray.coatings import Ideal
from mistray.errors import MistrayError
from mistray.events import REFLECTED, kind_of, place_of
from mistray.execute.scene_task import fingerprint
from mistray.execute.tracer import Run, prepare
from mistray.light import AS_THE_SCENE, Light
from mistray.messages import Message
from mistray.notes import Note
from mistray.sampling.importance_targets import signature, source_facts
from mistray.sampling.source import SceneSource
from mistray.sampling.sources import scene_sources, source_emitters, spectrum
from mistray.settings import Settings, polarized_sources
from mistray.surfaces.optics import MIRROR
from mistray.surfaces.surfaces import SurfaceTable
from mistray.trace.history import spread
from mistray.trace.host.both_ways import Arrivals, follow, started

LEAST_CHANGE = 0.01  # relative change of a printed number from which on Stokes vectors are used
SURE = 2.0  # standard errors by which a change must exceed that, for the pilot to end early
ROUNDS = (96, 640)  # start rays of a beam; the second number in doubt
MOST_HITS = 40_000  # largest number of hits of surfaces in the pilot of a beam
NOTED = 3  # beams of an unpolarised result that are tested for a note
MOST_RUNS = 8  # sources and wavelengths that are tested, spread over all
LISTED, LEAST_HITS = 8, 4  # stray paths by power and by RMS irradiance that are compared, and branches of each
FEWEST = 4  # start rays of a run
PROBED = np.linspace(0.0, 1.0, 17)[1:]  # cosines at which a coating is tested for a difference between s and p
SAME = 1e-9  # difference of R or T between s and p that is due to rounding
LEAST_SHARE = 0.01  # share of the direct light from which on a direct path is compared
# Round numbers whose multiples of powers of ten are the field angles, degrees, at which a single beam is tested
SERIES = (1, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.8, 2, 2.2, 2.5, 2.7, 3, 3.5, 4, 4.5, 5, 5.5, 6, 6.5, 7, 7.5, 8, 9, 10)
SMALLEST_DEG, LARGEST_DEG = 1e-3, 80.0  # field angles beyond which each is tested itself

_known: dict[str, list[Arrivals]] = {}


@dataclass(frozen=True)
class PolarizationChoice:
    """
    Polarisation mode of a trace, and the reason for it.

    Attributes
    ----------
    mode : {"unpolarized", "stokes"}
        Value of `polarization`.
    reason : str
        Reason for the mode, as a phrase.
    change : float
        Relative change of the flux of a listed path, or of the stray light, by Stokes vectors instead of the means of s
        and p, the largest in size. It is above 0 if Stokes vectors give more flux, 0 where nothing polarises, and NaN
        if it was not measured.

    Examples
    --------
    >>> choice = mistray.trace.PolarizationChoice("stokes", "as a measurement with a polariser")
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000, polarization=choice)
    >>> t.settings["polarization_reason"]
    'as a measurement with a polariser'
    """

    mode: str
    reason: str
    change: float = math.nan

    def __str__(self) -> str:
        return words_of(self.facts)

    @property
    def facts(self) -> dict[str, Any]:
        """
        Mode, reason and relative change of flux by Stokes vectors, as entries for `settings`.

        The change is left out if it was not measured.
        """
        change = {} if math.isnan(self.change) else {"polarization_change": self.change}
        return {"polarization": self.mode, "polarization_reason": self.reason, **change}


def words_of(settings: Mapping[str, Any]) -> str:
    """Return a line with the polarisation mode of a trace and the reason for it, from its settings."""
    return f"polarization: {settings['polarization']} ({settings['polarization_reason']})"


def chosen_polarization(
    scene: Any,
    settings: Settings,
    beams: Sequence[Light] = (AS_THE_SCENE,),
    runs_of: Callable[[Settings, Light], list[Run]] | None = None,
) -> PolarizationChoice:
    """
    Return the polarisation mode for traces of several beams, one mode for all; with "auto" a pilot decides.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    settings : Settings
        Settings with `polarization` "auto"; any other mode is returned as it is.
    beams : sequence of Light
        Light of each trace. `MOST_RUNS` of their sources and wavelengths are tested, spread over all. A single one is
        tested at the field angles of `SERIES` on both sides of its own.
    runs_of : callable, optional
        Function that prepares the runs of settings and light; by default `mistray.execute.tracer.prepare`.
    """
    # Cases that need no trace
    if settings.polarization != "auto":
        return PolarizationChoice(settings.polarization, "as given")
    if names := polarized_sources(scene):
        return PolarizationChoice("stokes", f"source '{names[0]}' is polarised")
    coatings = (getattr(shape.bsdf(), "coating", None) for shape in scene.shapes())
    if all(coating is None or isinstance(coating, Ideal) for coating in coatings):  # needs neither tables nor targets
        return PolarizationChoice("unpolarized", "no surface tells s from p", 0.0)

    # Coatings of the surfaces that a run holds
    settings, runs_of = replace(settings, polarization="unpolarized"), runs_of or partial(prepare, scene)
    lights = [_with_few_wavelengths(beam) for beam in _spread(beams, MOST_RUNS)]
    runs = [(_at(light, len(beams) > 1), run) for light in lights for run in runs_of(settings, light)]
    tables = {id(run.table): run.table for _, run in runs}
    if not any(remembered(table.kept, "polarizes", partial(_polarizes, table)) for table in tables.values()):
        return PolarizationChoice("unpolarized", "no surface tells s from p", 0.0)

    # A single beam is tested at the angles of the series beside it, so that traces at many angles share their pilots
    beside = _beside(lights[0]) if len(beams) == 1 else []

    def pilot() -> list[Arrivals]:
        prepared = [(_at(light), run) for light in beside for run in runs_of(settings, light)]
        return _pilot(_spread(prepared or runs, MOST_RUNS))

    def tested() -> list[Arrivals]:
        lit = [
            (_at(light), replace(run, source=source))
            for light in beside
            for (_, run), source in zip(runs, _sources(scene, light), strict=True)
        ]
        return remembered(_known, _facts(scene, _spread(lit or runs, MOST_RUNS)), pilot)

    # Pilot, unless the same light was tested before. A single table stands for all surfaces, and the attributes of
    # mistray's own sources for their start rays
    own = all(type(emitter).__module__.startswith("mistray.plugins.") for emitter in scene.emitters())
    if own and len(tables) == 1:
        given = {name: value for name, value in vars(settings).items() if name not in ("rays", "seed")}
        key = repr((given, beside or lights, len(beams) > 1, source_facts(scene)))
        rows = remembered(remembered(runs[0][1].table.kept, "pilots", dict), key, tested)
    else:
        rows = tested()
    largest = max(rows, key=lambda row: abs(row.change), default=Arrivals(name="no path"))
    if abs(largest.change) > LEAST_CHANGE:
        return PolarizationChoice("stokes", f"Stokes vectors change {largest.words}", largest.change)
    return PolarizationChoice(
        "unpolarized", f"Stokes vectors change {largest.words}, and a pilot finds no more", largest.change
    )


def unpolarized_notes(
    scene: Any, beams: Sequence[Light] = (AS_THE_SCENE,), polarization: str | None = None, **settings: Any
) -> list[Note]:
    """
    Return a note if Stokes vectors would change a result that was computed for unpolarised light.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    beams : sequence of Light
        Beams as for `chosen_polarization`; the first, the last and one between are tested.
    polarization : str, optional
        Mode that was requested; a mode other than "auto" needs no note. None: that of the scene.
    **settings
        Other attributes of `mistray.trace.Settings`.

    Returns
    -------
    list of Note
        One note, or none. There is none, too, where the sources of the scene cannot send such light.

    Raises
    ------
    MistrayError
        If a setting is unknown or not allowed.
    """
    chosen = Settings.unresolved(scene, polarization=polarization, **settings)
    if chosen.polarization != "auto" or not source_emitters(scene):
        return []
    try:
        found = chosen_polarization(scene, chosen, _spread(beams, NOTED))
    except MistrayError:  # the result needs no light of the sources, and its angles may be out of their range
        return []
    if not abs(found.change) > LEAST_CHANGE or found.mode != "stokes":
        return []
    return [Message.POLARIZATION.note(reason=found.reason)]


def _pilot(runs: Sequence[tuple[str, Run]]) -> list[Arrivals]:
    """
    Return the flux, W, of the main paths from a few rays, both with the mean of s and p and with Stokes vectors.

    `runs` are pairs of the words for the field of a beam, such as " at 10 deg" or "", and a run of its light.
    """
    found: dict[tuple[Any, ...], Arrivals] = {}
    listed: list[Arrivals] = []
    own = [sum(1 for where, _ in runs if where == field) for field, _ in runs]
    hits, beams = 0, len(dict.fromkeys(field for field, _ in runs))
    for number, count in enumerate(ROUNDS, start=1):
        before = hits
        for (field, run), share in zip(runs, own, strict=True):
            arrivals, traced = follow(run, max(FEWEST, count // share))
            hits += traced
            for one in arrivals:
                # Light of all wavelengths of a source is one path
                key = field, run.source.name, one.path
                found[key] = found[key].plus(one) if key in found else replace(one, name=_name(one, run.table) + field)
        listed = []
        for field in dict.fromkeys(field for field, _ in runs):
            listed += _listed(field, [row for (where, *_), row in found.items() if where == field])
        # End early if the answer is certain, or if the next round would take too long
        sure = any(abs(row.change) - SURE * row.error > LEAST_CHANGE for row in listed)
        doubtful = any(abs(row.change) > LEAST_CHANGE for row in listed)
        if sure or not doubtful or number == len(ROUNDS):
            break
        if hits + (hits - before) * ROUNDS[number] / count > MOST_HITS * beams:
            break
    return listed


def _facts(scene: Any, runs: Sequence[tuple[str, Run]]) -> str:
    """Return a hash of everything `_pilot` depends on: surfaces, coatings, scatter, settings and start rays."""
    digest = hashlib.sha256()
    tables = {_of_table(run): (run.table, run.scattering) for _, run in runs}
    digest.update(fingerprint(tables.values()).encode())
    for table, _ in tables.values():
        digest.update(signature(table, scene, table.detectors).encode())
        digest.update(repr([hash(one.coating) for one in table.interfaces]).encode())
    for field, run in runs:
        facts = field, run.source.name, *_of_table(run), replace(run.settings, rays=1, seed=0)
        digest.update(repr(facts).encode())
        start, unit = started(run, ROUNDS[0])
        for values in (start.o, start.d, start.mean, unit):
            digest.update(np.array(values).tobytes())
    return digest.hexdigest()


def _of_table(run: Run) -> tuple[float, tuple[int, ...]]:
    """Return what tells the surface table of a run from others of the scene: its wavelength, nm, and detectors."""
    return run.table.wavelength_nm, tuple(run.table.detectors)


def _at(light: Light, several: bool = True) -> str:
    """Return the field angle of a light for messages; it is empty for the only one, and if the source has its own."""
    return f" at {light.field_deg:g} deg" if several and light.field_deg is not None else ""


def _beside(light: Light) -> list[Light]:
    """
    Return the light at the angles of `SERIES` next below and above its field angle.

    The list is empty where the angle itself is to be tested: it is in the series, or too small, too large or unknown.
    """
    angle = abs(light.field_deg or 0.0)
    if not SMALLEST_DEG <= angle <= LARGEST_DEG:
        return []
    decade = 10.0 ** math.floor(math.log10(angle))
    k = bisect_right(SERIES, angle / decade * (1 + SAME))
    beside = [decade * SERIES[k - 1], decade * SERIES[min(k, len(SERIES) - 1)]]
    if math.isclose(angle, beside[0], rel_tol=SAME):
        return []
    return [replace(light, field_deg=math.copysign(each, light.field_deg or 0.0)) for each in beside]


def _sources(scene: Any, light: Light) -> list[SceneSource]:
    """Return the sources of the scene at the field angle and wavelengths of a light, not aimed at an aperture."""
    return scene_sources(scene, light.field_deg, light.azimuth_deg, light.wavelength_nm, light.weights)


def _listed(field: str, rows: Sequence[Arrivals]) -> list[Arrivals]:
    """
    Return the light of a beam that decides the choice: direct paths, strongest ghosts, and all stray light together.

    `rows` are all its paths, and `field` the words for its field, see `_pilot`.
    """
    direct = [row for row in rows if not row.stray]
    whole = sum(row.mean for row in direct)
    ghosts = [row for row in rows if row.stray and not row.scattered and row.hits >= LEAST_HITS]
    by_power = sorted(ghosts, key=lambda row: -row.mean)[:LISTED]
    by_irradiance = sorted(ghosts, key=lambda row: -row.mean / max(row.spread, 1e-9) ** 2)[:LISTED]
    total = Arrivals(name=f"the stray light{field}")
    for row in rows:
        total = total.plus(row) if row.stray else total
    return [*(row for row in direct if row.mean > LEAST_SHARE * whole), *by_power, *by_irradiance, total]


def _name(found: Arrivals, table: SurfaceTable) -> str:
    """
    Return the name of a path without scatter for messages: the direct light, or a ghost with its reflecting surfaces.

    Surfaces of total reflection and mirrors are not named.
    """
    if not found.reflections:
        return "the direct light"
    words = table.optics.host_words
    places = [place_of(code) for code in found.path if kind_of(code) == REFLECTED]
    return f"the ghost {' → '.join(table.ids[k] for k in places if not words[k] & MIRROR)}"


def _polarizes(table: SurfaceTable) -> bool:
    """True if R or T of any coating in the table differs between s and p at one of the cosines `PROBED`."""
    for surface, interface in enumerate(table.interfaces):
        for side in (True, False) if not isinstance(interface.coating, Ideal) else ():
            found = table.optics.response(surface, side, PROBED)
            if max(np.ptp(found.R, axis=1).max(), np.ptp(found.T, axis=1).max()) > SAME:
                return True
    return False


def _with_few_wavelengths(beam: Light) -> Light:
    """
    Return the light reduced to at most `MOST_RUNS` wavelengths spread over its spectrum.

    Light without wavelengths of its own, or with few, is returned unchanged.
    """
    if beam.wavelength_nm is None:
        return beam
    nm, shares = spectrum(beam.wavelength_nm, beam.weights)
    if len(nm) <= MOST_RUNS:
        return beam
    numbers = _spread(range(len(nm)), MOST_RUNS)
    return replace(beam, wavelength_nm=nm[numbers].tolist(), weights=shares[numbers].tolist())


def _spread(given: Sequence[Any], most: int) -> list[Any]:
    """Return at most `most` evenly spaced items of a list, its first and last included."""
    return [given[k] for k in spread(len(given), most)]

"""Critical, illuminated and common objects of an optical system.

A *critical* object is one that the detector sees: rays from the detector backwards, which surfaces only
transmit, meet it. An *illuminated* object is one that light from outside reaches in the same way. What is both can send
light to the detector by a single scatter event. The surfaces of the design path are always both; they are listed apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from mistray.analyses.objects.patches import meet
from mistray.analyses.objects.places import Places
from mistray.analyses.objects.rows import LISTS, SceneObject, StraightShot, both_views, describe, strongest
from mistray.analyses.objects.view import SIDES, RayView
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.kernel.scatter_tables import ScatterTables
from mistray.kernel.scattering import Scattering
from mistray.light import Light
from mistray.messages import Message, fewer_rays
from mistray.notes import Note, warns
from mistray.ranges import FIELD_DEG, PART
from mistray.sampling.sources import field_axes, spectrum_of
from mistray.scene.check import require_scene
from mistray.settings import RAY_CONTROLS, Settings
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.optics import OPAQUE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.thin_gaps import thin_gaps
from mistray.time_budget import share, within
from mistray.trace.host.ray_sources import DetectorView, DiskSource, RaySource, Surroundings
from mistray.trace.host.single_rays import ChainTracer
from mistray.trace.polarization_choice import unpolarized_notes

if TYPE_CHECKING:
    import pandas as pd

HALF_ANGLE_DEG = 20.0
THRESHOLD = 1e-6
ESTIMATED = 0.5  # of the time of a source: for the products of what it meets and what the detector sees
SHOTS_TOLD = 4  # ways past the optics that a warning names
USED_SETTINGS = ("rays", "max_events", "seed", "ray_control")
Progress = Callable[[float, float], None]


@dataclass(frozen=True, eq=False)
class _Traced:
    """Views of a search, with the table and the places that they were made with."""

    table: SurfaceTable
    places: Places
    detector: DetectorView
    critical: RayView
    illuminated: list[RayView]
    unpolarized: list[Note]  # what Stokes vectors would change


class Objects:
    """
    Result of `objects`.

    Attributes
    ----------
    scene : mi.Scene
    critical : list of SceneObject
        Objects that the detector sees, the strongest first, optics left out.
    illuminated : list of SceneObject
        Objects that light from outside reaches; of several source angles the mean.
    common : list of CommonObject
        Objects in both lists, in the order of the light: by the gap of the design path in which the detector sees them,
        then by flux. Places that are lit and places that are seen overlap.
    apart : list of CommonObject
        Objects in both lists that are lit in one place and seen in another.
    optics : list of CommonObject
        The surfaces of the design path, in its order: common by design. What was not met has 0 rays.
    straight_shots : list of StraightShot
        Views of the outside past the optics, the strongest first.
    field_deg : tuple of float
        Source angles; empty where the source is a cone or a disc.
    facts : dict
        How it was computed, plain values.
    """

    def __init__(self, scene: mi.Scene, traced: _Traced, field_deg: Sequence[float], facts: dict[str, Any]) -> None:
        self.scene, self._traced, self.facts = scene, traced, facts
        self.field_deg = tuple(float(angle) for angle in field_deg)
        table, places = traced.table, traced.places
        threshold = float(facts["threshold"])
        # A surface that transmits is one object for both of its sides
        opaque = (table.optics.host_words & OPAQUE) != 0
        numbers = [k for k in range(SIDES * table.count) if opaque[k // SIDES] or k % SIDES == 0]
        seen = {k: self._row(k, [traced.critical]) for k in numbers}
        lit = {k: self._row(k, traced.illuminated) for k in numbers}
        self.critical = strongest([row for row in seen.values() if not row.optic and row.power > threshold])
        self.illuminated = strongest([row for row in lit.values() if not row.optic and row.power > threshold])
        both = [k for k in numbers if not seen[k].optic and min(seen[k].power, lit[k].power) > threshold]
        both.sort(key=lambda k: (_gap(k, [traced.critical]), -seen[k].power * lit[k].power))
        meeting = {k for k in both if any(self._meet(k, view) for view in traced.illuminated)}
        self.common = [both_views(seen[k], lit[k]) for k in both if k in meeting]
        self.apart = [both_views(seen[k], lit[k]) for k in both if k not in meeting]
        self._numbers = {(row.id, row.side): k for k, row in seen.items()}
        steps = places.path.steps if places.path is not None else ()
        on_path = dict.fromkeys(self._side_met(step.surface, step.from_front) for step in steps)
        self.optics = [both_views(seen[k], lit[k]) for k in on_path]
        self.straight_shots = self._straight_shots()

    def _side_met(self, surface: int, from_front: bool) -> int:
        opaque = bool(self._traced.table.optics.host_words[surface] & OPAQUE)
        return SIDES * surface + (opaque and not from_front)

    def _row(self, number: int, views: Sequence[RayView]) -> SceneObject:
        table, places = self._traced.table, self._traced.places
        surface, back = divmod(number, SIDES)
        opaque = bool(table.optics.host_words[surface] & OPAQUE)
        gap = _gap(number, views)
        met = any(view.hits[number] for view in views)
        along = np.array([view.along[number] for view in views])
        known = along[np.isfinite(along)]
        powers = [view.power(number) for view in views]
        part = table.parts[surface]
        return SceneObject(
            id=table.ids[surface],
            part=part,
            side=("back" if back else "front") if opaque else "both",
            space=table.spaces[surface],
            between=places.between(gap) if met else "",
            stop=places.against_stop(part, gap, float(known.mean()) if known.size else np.nan) if met else "",
            optic=bool(places.optics[surface]),
            rays=int(sum(view.hits[number] for view in views)),
            power=float(np.mean([power for power, _ in powers])),
            power_se=float(np.sqrt(sum(se**2 for _, se in powers)) / len(views)),
        )

    def _meet(self, number: int, view: RayView) -> bool:
        """Whether places of an object that are lit and places that are seen overlap."""
        lit, seen = view.samples(number), self._traced.critical.samples(number)
        return meet(self._traced.table, number // SIDES, lit.point, seen.point)

    def _straight_shots(self) -> list[StraightShot]:
        table, path = self._traced.table, self._traced.places.path
        design = [step.surface for step in path.steps[:-1]] if path is not None else []
        found = []
        for way in self._traced.critical.ways_out():
            order = way.surfaces[::-1]
            if way.total or (design and list(order) == design):
                continue
            found.append(
                StraightShot(
                    surfaces=tuple(table.ids[s] for s in order),
                    missed=tuple(table.ids[s] for s in design if s not in order),
                    beside=tuple(table.ids[s] for s in order if s not in design),
                    rays=way.rays,
                    share=way.share,
                    share_se=way.share_se,
                    field_deg=way.field_deg,
                )
            )
        return found

    @property
    def stop(self) -> str:
        """Part that is the aperture stop; "" where there is none that the rays could tell."""
        found = self._traced.places.stop
        return found.part if found is not None else ""

    @property
    def source_text(self) -> str:
        """The source of the light in words."""
        if self.field_deg:
            angles = ", ".join(f"{angle:g}" for angle in self.field_deg)
            return f"a distant source at {angles}°{' each' if len(self.field_deg) > 1 else ''}"
        return str(self.facts["source"])

    @property
    def notes(self) -> list[Note]:
        """Notes on what a reader must know before trusting the lists; empty if all is well."""
        found: list[Note] = []
        if self._traced.places.path is None:
            found.append(Message.NO_OPTICS.note())
        threshold = float(self.facts["threshold"])
        shots = [shot for shot in self.straight_shots if shot.share > threshold]
        for shot in shots[:SHOTS_TOLD]:
            low, high = shot.field_deg
            found.append(Message.OUTSIDE_SEEN.note(way=describe(shot), share=shot.share, low=low, high=high))
        if len(shots) > SHOTS_TOLD:
            found.append(Message.MORE_OUTSIDE.note(count=len(shots) - SHOTS_TOLD))
        if not self._traced.critical.ways_out():
            found.append(Message.CLOSED_IN.note())
        rays, planned = self.facts["rays"], self.facts["rays_planned"]
        if rays < planned:
            found.append(fewer_rays(rays, planned))
        found += thin_gaps(self._traced.table)
        lost = max(view.lost for view in (self._traced.critical, *self._traced.illuminated))
        if lost > threshold:
            found.append(Message.VIEW_LOST.note(share=lost))
        return [*found, *self._traced.unpolarized]

    def estimates(self) -> pd.DataFrame:
        """
        First-order light of every common object and every optic by the product Φ · BSDF · π GCF.

        Returns
        -------
        DataFrame
            One row for each source angle and object; see `mistray.analyses.objects.estimates.product_estimates`.
        """
        from mistray.analyses.objects.estimates import product_estimates

        traced = self._traced
        wanted = [*self.common, *(row for row in self.optics if row.id != self.facts["detector"])]
        numbers = [self._numbers[row.id, row.side] for row in wanted]
        angles: Sequence[float] = self.field_deg or [np.nan]
        return product_estimates(
            traced.table, traced.detector.area, traced.critical, traced.illuminated, angles, numbers, wanted
        )

    def illumination(self, id: str, side: str = "front") -> list[Estimate]:
        """Flux on an object for 1 W/mm² across the beam, W, at each source angle (or for the whole source)."""
        number = self._numbers.get((id, side), self._numbers.get((id, "both")))
        if number is None:
            raise MistrayError(f"'{id}' has no side '{side}', or there is no such shape; see Objects.illuminated")
        return [Estimate(*view.area(number)) for view in self._traced.illuminated]

    def to_pandas(self, which: str = "common") -> pd.DataFrame:
        """One of the lists, such as "critical" or "common", as a DataFrame with a column for each attribute."""
        import pandas as pd

        if which not in LISTS:
            raise MistrayError(f"to_pandas: there is no list '{which}'; use {', '.join(LISTS)}")
        rows = [asdict(row) for row in getattr(self, which)]
        return pd.DataFrame(rows, columns=[f.name for f in fields(LISTS[which])])


def _gap(number: int, views: Sequence[RayView]) -> int:
    """Gap of the design path in which most rays meet an object."""
    return int(np.argmax(np.sum([view.in_gap[number] for view in views], axis=0)))


# More than 8 parameters: the keywords of a call, each with a default and used one by one
@warns
def objects(
    scene: mi.Scene,
    *,
    rays: int | None = None,
    half_angle_deg: float | None = None,
    field_deg: float | Sequence[float] | None = None,
    azimuth_deg: float = 0.0,
    source: DiskSource | None = None,
    view_half_angle_deg: float = 90.0,
    wavelength_nm: float | None = None,
    detector: str | None = None,
    stop: str | None = None,
    threshold: float = THRESHOLD,
    ray_control: str = "transmit_specular",
    total_reflection: bool = True,
    progress: Progress | None = None,
    seconds: float | None = None,
    **settings: Any,
) -> Objects:
    """
    Find the objects that the detector sees, those that light from outside reaches, and those that are both.

    Parameters
    ----------
    scene : mi.Scene
    rays : int, optional
        Start rays from the detector, and from the source (at each angle). Default: those of the scene's integrator,
        else 1e6.
    half_angle_deg : float, optional
        The outside sends light of the same radiance from all directions within this angle of the axis. Default: 20.
    field_deg : float or sequence of float, optional
        Field angles of a distant source instead, degrees.
    azimuth_deg : float
        Of that source.
    source : DiskSource, optional
        A Lambertian disc instead.
    view_half_angle_deg : float
        Rays leave the detector within this angle of its normal.
    wavelength_nm : float, optional
        Default: the first of the scene's source, else 550 nm.
    detector : str, optional
        If the scene has several.
    stop : str, optional
        Part or shape that is the aperture stop. Default: what ends the on-axis beam.
    threshold : float
        Flux, W for each W that starts, that an object must get to count. One ray is 1/rays.
    ray_control : str
        What light may do at a surface, which sends on one child, see `mistray.trace.Settings`; with "allow_all" one is
        drawn by chance.
    total_reflection : bool
        Follow rays in total reflection.
    progress : callable, optional
        Called now and then with (part done, parts in all).
    seconds : float, optional
        Time after which the rays end, those from the detector and those at each angle in equal shares; a warning says
        how many there are.
    **settings
        max_events and seed of `mistray.trace.Settings`.

    Returns
    -------
    Objects

    Raises
    ------
    MistrayError
        For arguments out of range, more than one kind of source, a scene without detector, or an unknown stop.
    """
    began = time.perf_counter()
    require_scene(scene, "objects")
    unknown = set(settings) - set(USED_SETTINGS)
    if unknown:
        raise MistrayError(
            f"unknown argument {', '.join(sorted(unknown))} of objects; light is neither split nor scattered here, so "
            "that of the settings of a trace only max_events and seed matter"
        )
    chosen = Settings.without_sources(scene, rays=rays, ray_control=ray_control, **settings)
    PART.check("threshold", threshold)
    kinds = {"half_angle_deg": half_angle_deg, "field_deg": field_deg, "source": source}
    given = [name for name, value in kinds.items() if value is not None]
    if len(given) > 1:
        raise MistrayError(f"{' and '.join(given)} are given; the source of the light is one of them")
    wavelength = float(spectrum_of(scene, wavelength_nm, None)[0][0])
    table = SurfaceTable(scene, wavelength, detector)
    intersector = Intersector(table)
    scattering = {backward: Scattering(ScatterTables(table, {}, backward=backward)) for backward in (False, True)}

    def tracer(mirrors: np.ndarray, backward: bool = False, allowed: str = chosen.allowed) -> ChainTracer:
        return ChainTracer(
            table, intersector, scattering[backward], allowed, mirrors, chosen.max_events, total_reflection
        )

    def marginal(mirrors: np.ndarray) -> ChainTracer:
        """For the stop, which is where it is whatever light may do, and where chance has no place."""
        return tracer(mirrors, allowed=RAY_CONTROLS["transmit_specular"])

    axes = field_axes(scene)
    angles = [] if field_deg is None else FIELD_DEG.check_each("field_deg", field_deg)
    sources: list[RaySource] = [Surroundings.direction(table, axes, angle, azimuth_deg) for angle in angles]
    if source is not None:
        sources = [source]
    elif not sources:
        sources = [Surroundings.cone(table, axes, HALF_ANGLE_DEG if half_angle_deg is None else half_angle_deg)]
    places = Places(table, scene, marginal, stop)
    light = axes[:, 2] if places.path is None else places.path.steps[-1].before
    view = DetectorView(table, light, view_half_angle_deg)
    parts = 1 + len(sources)

    def part(number: int) -> Callable[[int, int], None] | None:
        return (lambda done, of: progress(number + done / of, parts)) if progress else None

    def followed(k: int, start: RaySource, backward: bool = False) -> RayView:
        with share(1 / (parts + ESTIMATED - k)):
            follow = tracer(places.mirrors, backward)
            return RayView(follow, places, start, chosen.rays, chosen.seed + k, backward, axes[:, 2], part(k))

    with within(seconds, began):
        critical = followed(0, view, backward=True)
        illuminated = [followed(k, one) for k, one in enumerate(sources, start=1)]
    light_of_source = Light(wavelength_nm=wavelength, detector=detector)
    beams = [replace(light_of_source, field_deg=angle, azimuth_deg=azimuth_deg) for angle in angles]
    unpolarized = unpolarized_notes(
        scene, beams or [light_of_source], ray_control=chosen.ray_control, max_events=chosen.max_events
    )
    fewest = min(int(one.rays.sum()) for one in (critical, *illuminated))
    facts = {
        "rays": fewest,
        "rays_planned": chosen.rays,
        "source": "; ".join(one.name for one in sources),
        "azimuth_deg": float(azimuth_deg),
        "view_half_angle_deg": float(view_half_angle_deg),
        "wavelength_nm": wavelength,
        "detector": table.ids[table.detector],
        "detector_area_mm2": view.area,
        "threshold": float(threshold),
        "ray_control": chosen.ray_control,
        "total_reflection": total_reflection,
        "max_events": chosen.max_events,
        "seed": chosen.seed,
        "variant": mi.variant(),
    }
    return Objects(scene, _Traced(table, places, view, critical, illuminated, unpolarized), angles, facts)

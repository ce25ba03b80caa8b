"""Search for the critical, illuminated and common objects of an optical system.

A *critical* object is one that the detector sees: backward rays from the detector, which surfaces only transmit, meet
it. An *illuminated* object is one that light from outside reaches in the same way. An object that is both can send
light to the detector by a single scatter event. The surfaces of the design path are always both; they are listed apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import mitsuba as mi
import numpy as np

from mistray.analyses.objects.places import Places
from mistray.analyses.objects.request import ObjectsRequest, refuse_second
from mistray.analyses.objects.result import Objects
from mistray.analyses.objects.view import RayView
from mistray.kernel.scatter_tables import ScatterTables
from mistray.kernel.scattering import Scattering
from mistray.light import Light
from mistray.sampling.sources import field_axes, spectrum_of
from mistray.settings import RAY_CONTROLS, Settings
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.surfaces import SurfaceTable
from mistray.time_budget import share, within
from mistray.toolkit.analysis import analysis
from mistray.trace.host.polarization_choice import unpolarized_notes
from mistray.trace.host.ray_sources import DetectorView, DiskSource, RaySource, Surroundings
from mistray.trace.host.single_rays import ChainTracer

HALF_ANGLE_DEG = 20.0
ESTIMATED = 0.5  # of the time of a source: for the products of what it meets and what the detector sees
Progress = Callable[[float, float], None]


def run(
    scene: mi.Scene,
    request: ObjectsRequest,
    *,
    source: DiskSource | None = None,
    progress: Progress | None = None,
    seconds: float | None = None,
) -> Objects:
    """
    Find the objects that the detector sees, those that light from outside reaches, and those that are both.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    request : ObjectsRequest
    source : DiskSource, optional
        Lambertian disc as the source, at any place, with optional holes in disc and cone; None: the source of
        `request`.
    progress : callable, optional
        Called from time to time with (parts done, parts in all). A part is the rays from the detector, or those of one
        source.
    seconds : float, optional
        Time limit, s, shared equally by the rays from the detector and those of each source. A part of it is kept for
        the scatter estimates. A warning reports the number of rays traced.

    Returns
    -------
    Objects

    Raises
    ------
    MistrayError
        If an argument is out of range, there is more than one kind of source, the scene has no detector, or the stop is
        unknown.

    Examples
    --------
    >>> found = mistray.objects(mistray.load("cassegrain"), rays=2000)
    >>> [seen.id for seen in found.critical[:3]]
    ['inner_baffle_wall', 'inner_baffle_vane_5', 'inner_baffle_vane_4']
    >>> [both.id for both in found.common]
    ['secondary_baffle']
    """
    began = time.perf_counter()
    if source is not None:
        refuse_second(request, "source", "half_angle_deg", "field_deg", "disc_mm")
    detector = request.light.get("detector")
    chosen = Settings.without_sources(scene, rays=request.rays, ray_control=request.ray_control, **request.settings)
    wavelength = float(spectrum_of(scene, request.wavelength_nm, None)[0][0])
    table = SurfaceTable(scene, wavelength, detector)
    intersector = Intersector(table)
    scattering = {backward: Scattering(ScatterTables(table, {}, backward=backward)) for backward in (False, True)}

    def tracer(mirrors: np.ndarray, backward: bool = False, allowed: str = chosen.allowed) -> ChainTracer:
        return ChainTracer(
            table, intersector, scattering[backward], allowed, mirrors, chosen.max_events, request.total_reflection
        )

    def marginal(mirrors: np.ndarray) -> ChainTracer:
        """Return the tracer that finds the stop: surfaces only transmit, but those in `mirrors`, (s,) bool, reflect."""
        return tracer(mirrors, allowed=RAY_CONTROLS["transmit_specular"])

    axes = field_axes(scene)
    sources = [source] if source is not None else _sources(request, table, axes)
    places = Places(table, scene, marginal, request.stop)
    light = axes[:, 2] if places.path is None else places.path.steps[-1].before
    view = DetectorView(table, light, request.view_half_angle_deg)
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
    angles = request.field_deg or ()
    light_of_source = Light(wavelength_nm=wavelength, detector=detector)
    beams = [replace(light_of_source, field_deg=angle, azimuth_deg=request.azimuth_deg) for angle in angles]
    unpolarized = unpolarized_notes(
        scene, beams or [light_of_source], ray_control=chosen.ray_control, max_events=chosen.max_events
    )
    facts = {
        "rays": min(int(one.rays.sum()) for one in (critical, *illuminated)),
        "rays_planned": chosen.rays,
        "source": "; ".join(one.name for one in sources),
        "azimuth_deg": float(request.azimuth_deg),
        "view_half_angle_deg": float(request.view_half_angle_deg),
        "wavelength_nm": wavelength,
        "detector": table.ids[table.detector],
        "detector_area_mm2": view.area,
        "threshold": float(request.threshold),
        "ray_control": chosen.ray_control,
        "total_reflection": request.total_reflection,
        "max_events": chosen.max_events,
        "seed": chosen.seed,
        "variant": mi.variant(),
    }
    return Objects(scene, table, places, view, critical, illuminated, angles, facts, unpolarized)


objects = analysis("objects", ObjectsRequest, run)


def _sources(request: ObjectsRequest, table: SurfaceTable, axes: np.ndarray) -> Sequence[RaySource]:
    """Return the sources of light from outside: one distant source per angle, a disc, or a cone of directions."""
    if request.field_deg is not None:
        return [Surroundings.direction(table, axes, angle, request.azimuth_deg) for angle in request.field_deg]
    half_angle_deg = HALF_ANGLE_DEG if request.half_angle_deg is None else request.half_angle_deg
    if request.disc_mm is not None:
        z, radius = request.disc_mm
        return [DiskSource((0.0, 0.0, z), radius, half_angle_deg)]
    return [Surroundings.cone(table, axes, half_angle_deg)]

"""Images of points with stray light, from one trace per field with scatter and ghosts."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.analyses.image.line_image import direction_of
from mistray.analyses.image.request import ImageRequest
from mistray.analyses.image.result import FieldImage, ImageQuality
from mistray.analyses.image.run import run as image_quality
from mistray.analyses.transfer.image_spread import CLASSES, DIRECT, ImageSpread
from mistray.analyses.transfer.pixels import PixelResponse
from mistray.analyses.transfer.request import TransferRequest
from mistray.analyses.transfer.result import AZIMUTHS, FieldTransfer, Transfer
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.execute.tracer import RunSums
from mistray.light import Light
from mistray.metrics.ghost_ranking import direct_image, stray_to_direct
from mistray.metrics.stray_metric import StrayMetric
from mistray.percent import percent_text
from mistray.recorders.design_sequences import DesignKeys, DesignSequences
from mistray.recorders.sampled import sum_of_runs
from mistray.recorders.tallies import ABSORBED_HERE, CUTS, ESCAPED
from mistray.sampling.design.search import design_sequences, traced_tables
from mistray.sampling.sources import field_of, scene_sources
from mistray.surfaces.surfaces import SurfaceTable
from mistray.toolkit.analysis import analysis
from mistray.trace import PolarizationChoice, Settings, Trace, trace
from mistray.trace.host.polarization_choice import chosen_polarization

FINEST = 1e-3  # of the Airy diameter: radius of the innermost disc
LOW, HIGH = 49, 40  # frequencies from the size of the detector on, evenly in their logarithm; and evenly to the cut-off
NEAR = 0.05  # of the cut-off, where the ones begin and the others end
SMEARED = 3e-7  # of the size of a system: what float32 makes of the place of a ray
COARSE = 0.1  # cycles of the finest frequency, from which on a note says so
EXTENDED = 0.01  # share of direct light beyond the rays of its image, from which on the source is no point

Progress = Callable[[int, int], None]


def run(
    scene: mi.Scene,
    request: TransferRequest,
    *,
    quality: ImageQuality | None = None,
    progress: Progress | None = None,
    seconds: float | None = None,
) -> Transfer:
    """
    Return images of points with stray light: scatter and ghost transfer functions, MTF, PSF and energy balance.

    The direct image is that of `mistray.image_quality`. One trace of each field, with ghosts and scatter, gives the
    light on the detector by class and by position about the direct image. Definitions and limits:
    docs/transfer_functions.md.

    Parameters
    ----------
    scene : mi.Scene
        Scene with one source, as for `mistray.image_quality`.
    request : TransferRequest
    quality : ImageQuality, optional
        Image quality of the same scene, if known already; it then sets fields, wavelengths and detector.
    progress : callable, optional
        Called with (fields done, fields in all).
    seconds : float, optional
        Time of each trace, s, which then ends with the rays that it has, and leaves out wavelengths if it is too short
        for all of four or more; their light counts at the nearest that is traced. None: no limit.

    Returns
    -------
    Transfer

    Raises
    ------
    MistrayError
        If `mistray.image_quality` or `mistray.trace` raises it, the direct image of a field misses the detector, or the
        detector's table ends too early. Also if the scene has several sources, or several detectors of which none is
        chosen, or the request has fields or light beside `quality`.

    Examples
    --------
    >>> (field,) = mistray.transfer(mistray.load("cooke_triplet"), rays=5000, frequencies_per_mm=[10, 20, 40])
    >>> {name: round(share.value, 3) for name, share in field.shares.items()}
    {'direct': 0.981, 'ghosts': 0.019, 'scatter': 0.0, 'diffraction': 0.0}
    >>> field.without_stray().round(2), field.composite().value.round(2)
    (array([0.84, 0.55, 0.16]), array([0.83, 0.54, 0.16]))
    """
    began = time.monotonic()
    pixels = None
    if request.pixel_mm or request.diffusion_mm is not None or request.detector_table:
        pixels = PixelResponse(request.pixel_mm or 0.0, request.diffusion_mm or 0.0, request.detector_table)
    names = list(dict.fromkeys(source.name for source in scene_sources(scene)))
    if len(names) > 1:
        raise MistrayError(f"the scene has {len(names)} sources, {', '.join(names)}; keep one, whose point is imaged")
    image: dict[str, Any] = {"field_deg": request.field_deg, "field_mm": request.field_mm, "light": request.light}
    if quality is None:
        found = image_quality(scene, ImageRequest(**image))
    else:
        given = [name for name, value in {**image, **request.light}.items() if value and name != "light"]
        if given:
            raise MistrayError(f"quality and {given[0]} are given; the former has its own, leave out one of the two")
        found = quality
    table, *others = traced_tables(scene, [float(nm) for nm in found.wavelengths_nm], found.facts["detector"])
    design = design_sequences(scene, table, *others)
    extent = table.film()[2]
    frequencies = _frequencies(found, extent, request.frequencies_per_mm)
    if pixels is not None:
        pixels.at(frequencies, np.zeros(len(frequencies)))  # refuses a table that ends too early before any trace
    mode = _one_mode(scene, found, table.ids[table.detector], request.settings)
    fields = []
    for number, point in enumerate(found):
        if progress:
            progress(number, len(found))
        how = {**request.settings, "polarization": mode, "seconds": seconds}
        fields.append(_field(scene, found, point, table, design, frequencies, pixels, how))
    if progress:
        progress(len(found), len(found))
    used = fields[0][1].settings
    facts = {
        name: used[name] for name in ("rays", "seed", "max_reflections", "max_scatters", "wavelength_nm", "weights")
    }
    facts |= mode.facts | {"seconds": round(time.monotonic() - began, 3)}
    results = tuple(one for one, _ in fields)
    notes = (*found.notes, *(f"{one.name}: {text}" for one in results for text in one.notes))
    return Transfer(results, facts, tuple(dict.fromkeys(notes)))


transfer = analysis("transfer", TransferRequest, run)


def _one_mode(scene: mi.Scene, found: ImageQuality, detector: str, settings: Mapping[str, Any]) -> PolarizationChoice:
    """Return one polarisation mode for the traces of all fields, see `mistray.trace.host.polarization_choice`."""
    nm, weights = found.wavelengths_nm.tolist(), found.weights.tolist()
    fields = [field_of(scene, image.field_mm) if found.near else image.field_deg for image in found]
    beams = [Light(field, image.azimuth_deg, nm, weights, detector) for field, image in zip(fields, found, strict=True)]
    return chosen_polarization(scene, Settings.unresolved(scene, **settings), beams)


# More than 8 parameters would be one too many: what a field is traced with
def _field(
    scene: mi.Scene,
    quality: ImageQuality,
    image: FieldImage,
    table: SurfaceTable,
    design: DesignSequences,
    frequencies: np.ndarray,
    pixels: PixelResponse | None,
    settings: dict[str, Any],
) -> tuple[FieldTransfer, Trace]:
    """
    Return the image of a field with its stray light, and its trace.

    `quality` holds all fields and `image` this one; `table` and `design` are those of the scene, `frequencies` in 1/mm.
    `settings` are keywords of `mistray.trace`.

    Raises
    ------
    MistrayError
        If no direct light of the field meets the detector.
    """
    frame = _detector_axes(table)
    centroid = image.centroid_mm
    axes = np.array([[image.axes[:, :2] @ direction_of(azimuth) @ side for side in frame] for azimuth in AZIMUTHS])
    origin = image.image_mm + np.array([image.axes[:, :2] @ centroid @ side for side in frame])
    x0, x1, y0, y1 = table.film()[2]
    last = 1.01 * float(
        np.hypot(max(abs(x0 - origin[0]), abs(x1 - origin[0])), max(abs(y0 - origin[1]), abs(y1 - origin[1])))
    )
    nu = np.concatenate([frequencies[:, None] * direction for direction in axes])
    airy = image.airy_diameter_mm()
    point = float(origin[0]), float(origin[1])
    spread = ImageSpread("image spread", point, FINEST * airy, last, nu, DesignKeys(design, table.detector))
    where: dict[str, Any] = {"field_mm": image.field_mm} if quality.near else {"field_deg": image.field_deg}
    t = trace(
        scene,
        **where,
        azimuth_deg=image.azimuth_deg,
        wavelength_nm=quality.wavelengths_nm.tolist(),
        weights=quality.weights.tolist(),
        detector=table.ids[table.detector],
        recorders=[spread],
        **settings,
    )
    direct = spread.rings(DIRECT)
    if not direct.total().value > 0:
        x, y = image.image_mm
        raise MistrayError(
            f"{image.name}: no direct light meets the detector; its image lies at ({x:.4g}, {y:.4g}) mm, the detector "
            f"at x {x0:.4g} … {x1:.4g}, y {y0:.4g} … {y1:.4g} mm; choose a field within it"
        )
    glare = StrayMetric.of(
        "gsr", stray_to_direct(t.paths, direct_image(t.paths)), facts={"field_deg": t.settings["field_deg"]}
    )
    resolution = SMEARED * 2 * float(np.linalg.norm(image.point_mm - table.centre))
    notes = _notes(image, spread, resolution, float(frequencies[-1]))
    books = _books(spread, t)
    return FieldTransfer(image, spread, books, frequencies, pixels, glare, axes, origin, resolution, notes), t


def _books(spread: ImageSpread, t: Trace) -> dict[str, Estimate]:
    """Return the balance of the launched light: the fraction that ends at each destination, with standard errors."""
    launched, table = t.energy.launched_W, t.runs[0].table

    def share(value: float | np.ndarray, se: float | np.ndarray) -> Estimate:
        return Estimate(float(value) / launched, float(se) / launched)

    found = {name: share(*spread.rings(k).total().with_se) for k, name in enumerate(CLASSES)}
    # What ends at several places shares start rays: the error of a sum comes from that of the batches
    walls = [i for i in table.listed if i not in table.detectors]
    parts: dict[str, Callable[[RunSums], np.ndarray]] = {
        "absorbed_by_surfaces": lambda sums: sums.surfaces[walls, ABSORBED_HERE],
        "absorbed_in_media": lambda sums: sums.media[1:],
        "escaped": lambda sums: sums.channels[[ESCAPED]],
        "cut": lambda sums: sums.channels[[*CUTS.values()]],
    }
    return found | {
        name: share(*sum_of_runs([part(run.sums).sum(axis=0) for run in t.runs], t.runs))
        for name, part in parts.items()
    }


def _notes(image: FieldImage, spread: ImageSpread, resolution: float, finest: float) -> tuple[str, ...]:
    """
    Return remarks on the reliability of a field's results; empty if there is none.

    `resolution` is that of `FieldTransfer`, mm, and `finest` the highest frequency, 1/mm.
    """
    notes = []
    direct = spread.rings(DIRECT)
    if resolution * finest > COARSE:
        notes.append(
            f"rays are traced in float32, whose places are good to some {resolution:.1g} mm in a system of this size: "
            "stray light is resolved no finer than that"
        )
    size = 2 * image.spot_radius_mm() + image.airy_diameter_mm() + 4 * resolution
    beyond = float(direct.value[spread.edges_mm[:-1] > size].sum() / direct.total().value)
    if beyond > EXTENDED:
        notes.append(
            f"{percent_text(beyond)} of the direct light falls beside the image of the point; the source is not a "
            "point, and transfer functions are those of its image"
        )
    return tuple(notes)


def _frequencies(
    quality: ImageQuality, extent: tuple[float, float, float, float], given: Sequence[float] | None
) -> np.ndarray:
    """
    Return the spatial frequencies of the transfer functions, 1/mm: those given, or a set up to the cut-off.

    `extent` holds x0, x1, y0 and y1 of the detector, mm.
    """
    if given is not None:
        return np.array(given)
    cut = max(image.cut_off_per_mm(azimuth) for image in quality for azimuth in AZIMUTHS)
    x0, x1, y0, y1 = extent
    first = min(0.1 / float(np.hypot(x1 - x0, y1 - y0)), 0.1 * NEAR * cut)
    low = np.geomspace(first, NEAR * cut, LOW)
    return np.concatenate([[0.0], low, np.linspace(NEAR * cut, cut, HIGH)[1:]])


def _detector_axes(table: SurfaceTable) -> np.ndarray:
    """Return the x and y axes of the detector as unit vectors in world coordinates, (2, 3)."""
    from mistray.sampling.outlines import outline

    opening = outline(table.shapes[table.detector])
    return np.array([side / np.linalg.norm(side) for side in (opening.u, opening.v)])

"""Public names of the analyses, re-exported: ghosts, point source transmittance, thermal emission, whole studies."""

# Written by tests/stubs.py from what the functions are when they run

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import pandas as pd

from mistray.analyses.ghosts.field_summary import FieldSummary as FieldSummary
from mistray.analyses.ghosts.path_analysis import path_analysis as path_analysis
from mistray.analyses.ghosts.result import GhostReport as GhostReport
from mistray.analyses.image.line_image import LineImage as LineImage
from mistray.analyses.image.line_image import PointSpread as PointSpread
from mistray.analyses.image.result import FieldImage as FieldImage
from mistray.analyses.image.result import ImageQuality as ImageQuality
from mistray.analyses.objects.result import Objects as Objects
from mistray.analyses.pst.first_level import FirstLevel as FirstLevel
from mistray.analyses.pst.progress import PstProgress
from mistray.analyses.pst.result import Pst as Pst
from mistray.analyses.study.result import Study as Study
from mistray.analyses.thermal.request import DetectorNoise
from mistray.analyses.thermal.result import ThermalReport as ThermalReport
from mistray.analyses.transfer.result import FieldTransfer as FieldTransfer
from mistray.analyses.transfer.result import Transfer as Transfer
from mistray.analyses.transfer.surface import SurfaceTransfer as SurfaceTransfer
from mistray.estimate import Estimate as Estimate
from mistray.metrics.ghost_ranking import DirectImage as DirectImage
from mistray.scatter.lobe import LobeModel
from mistray.scatter.rough_surface import RoughSurface
from mistray.toolkit.irradiance import MapStatistics as MapStatistics
from mistray.toolkit.irradiance import log10_image as log10_image
from mistray.toolkit.irradiance import mirror_asymmetry as mirror_asymmetry
from mistray.toolkit.irradiance import statistics as statistics
from mistray.trace.host.ray_sources import DiskSource as DiskSource

__all__ = [
    "DirectImage",
    "DiskSource",
    "Estimate",
    "FieldImage",
    "FieldSummary",
    "FieldTransfer",
    "FirstLevel",
    "GhostReport",
    "ImageQuality",
    "LineImage",
    "MapStatistics",
    "Objects",
    "PointSpread",
    "Pst",
    "Study",
    "SurfaceTransfer",
    "ThermalReport",
    "Transfer",
    "critical_rays",
    "first_level",
    "ghosts",
    "image_quality",
    "log10_image",
    "mirror_asymmetry",
    "objects",
    "path_analysis",
    "pst",
    "statistics",
    "study",
    "thermal",
    "transfer",
    "transfer_of_bsdf",
    "transfer_of_spectrum",
]

def critical_rays(
    scene: mi.Scene,
    field_deg: float | Iterable[float] | None = None,
    wavelength_nm: float | Iterable[float] | None = None,
    azimuth_deg: float | None = None,
    rim: int = 8,
    rays: int = 4000,
) -> pd.DataFrame:
    r"""
    Return the ray nearest to the centre of the image-forming light, and the outermost rays around it, node by node.

    What is nearest or outermost is decided by the points where the rays first meet a surface, seen along the light.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    field_deg : float | Iterable[float], optional
        Field angles, degrees (that of the scene). > -90 … < 90 degrees.
    wavelength_nm : float | Iterable[float], optional
        Wavelengths, nm (those of the scene). 10 … 1e7 nm.
    azimuth_deg : float, optional
        Azimuth of the field, degrees (that of the scene). -360 … 360 degrees.
    rim : int, optional
        Rays round the rim, at equal angles about the beam. 1 … 100000.
    rays : int, optional
        Start rays at each field; the rim is found to about 1/√rays. 1 … 4294967295.

    Returns
    -------
    DataFrame
        field_deg (degrees), name ("centre", "rim 0°", …), and the columns of `mistray.trace.RayHistory.to_pandas`;
        positions in float64, mm. Rims count about the direction of the light, from the scene's x axis; for light along
        +z towards y. There are rim + 1 rays per field, source and wavelength, fewer if one ray is the outermost in two
        directions.

    Raises
    ------
    MistrayError
        If no light of a field forms an image, and for all reasons for which `mistray.trace` does.

    Examples
    --------
    >>> table = mistray.analysis.critical_rays(mistray.load("cooke_triplet"), 10, rays=2000, rim=4)
    >>> table.name.unique().tolist()
    ['centre', 'rim 0°', 'rim 90°', 'rim 180°', 'rim 270°']
    >>> ends = table.groupby("name").last()
    >>> print(f"the centre of the beam arrives at y = {ends.y_mm['centre']:.1f} mm")
    the centre of the beam arrives at y = 8.8 mm
    """

def first_level(
    scene: mi.Scene,
    field_deg: float | Iterable[float] = range(0, 81, 2),
    *,
    method: str = "joined",
    convention: str = "normal",
    azimuths_deg: float | Iterable[float] | None = None,
    cell_deg: float | None = None,
    azimuth_cell_deg: float | None = None,
    rays: int | None = None,
    relative_error: float | None = None,
    error_up_to_deg: float | None = None,
    paths: bool = True,
    map_pixels: int = 0,
    next_order: bool = False,
    limits: Mapping[str, Mapping[str, Any]] | None = None,
    progress: Callable[[str, Any], None] | None = None,
    seconds: float | None = None,
    wavelength_nm: float | Iterable[float] | None = None,
    weights: float | Iterable[float] | None = None,
    detector: str | None = None,
    max_reflections: int | None = None,
    max_generations: int | None = None,
    max_events: int | None = None,
    max_consecutive: int | None = None,
    max_segments: int | None = None,
    flux_threshold: float | None = None,
    cut_below: Any | None = None,
    cut_below_W: Any | None = None,
    splitting: str | None = None,
    below_threshold: str | None = None,
    seed: int | None = None,
    ray_control: str | None = None,
    polarization: str | None = None,
    max_scatters: int | None = None,
    max_optical_scatters: int | None = None,
    max_random_scatters: int | None = None,
    scatter_rays: int | None = None,
    aimed_rays: int | None = None,
    aim: str | None = None,
    scatter_threshold: float | None = None,
) -> FirstLevel:
    r"""
    Compute the PST for sets of limits, by default: scatter once without ghosts, ghosts off, scatter off, all light.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    field_deg : float | Iterable[float], optional
        Field angles, degrees, ascending, each the middle of a cell over which the PST is averaged; negative ones
        are at the opposite azimuth. -90 … 90 degrees.
    method : {"joined", "adjoint", "forward"}, optional
        Both directions at once, rays from the detector alone, or beams of each angle.
    convention : {"normal", "projected"}, optional
        E_det/E_⊥ across the beam, or E_det/(E_⊥ cos θ).
    azimuths_deg : float | Iterable[float], optional
        Azimuths of a map, degrees, from +y towards -x; without them the mean over all. -360 … 360 degrees.
    cell_deg : float, optional
        Width of the cells of field angle, degrees; without it 2, or the distance of two angles. 1e-6 … 90 degrees.
    azimuth_cell_deg : float, optional
        And of azimuth, degrees; without it the distance of two azimuths. 1e-6 … 360 degrees.
    rays : int, optional
        Start rays in all, or for each angle (forward), with a relative error the most; without it 4e6, forward 2e5.
        1 … 4294967295.
    relative_error : float, optional
        Standard error over the PST at every angle, for which a pilot estimates the rays. 1e-5 … < 1.
    error_up_to_deg : float, optional
        Largest field angle at which that error is required, degrees. 0 … 90 degrees.
    paths : bool, optional
        Keep the strongest paths of each angle.
    map_pixels : int, optional
        Longer side of maps of the detector for each angle, pixels; 0: none. 0 … 4096.
    next_order : bool, optional
        Refused: it would change the limits of the sets.
    limits : Mapping[str, Mapping[str, object]], optional
        Sets: name → limits of a trace that it changes; without it `LIMITS`. A limit that is given beside it holds
        where a set does not change it.
    progress : callable, optional
        Called with the name of a set and the progress that `mistray.pst` reports.
    seconds : float, optional
        Time limit of each PST, s, see `mistray.pst`.
    wavelength_nm : float | Iterable[float], optional
        Wavelengths, nm. 10 … 1e7 nm.
    weights : float | Iterable[float], optional
        Shares of the flux, one for each of the wavelengths; without them equal. 0 … 1e30.
    detector : str, optional
        Shape with the sensor, where the scene has several.
    max_reflections : int, optional
        Reflections on one path, those of mirrors and TIR not counted. 0 … 32767.
    max_generations : int, optional
        Reflections and scatter events together on one path. 0 … 32767.
    max_events : int, optional
        Surfaces met on one path. 1 … 1000.
    max_consecutive : int, optional
        Hits of one surface in a row on one path. 1 … 32767.
    max_segments : int, optional
        Ray segments of the tree of one start ray. 1 … 4294967295.
    flux_threshold : float, optional
        Flux below which a ray ends, relative to its start ray. 0 … < 1.
    cut_below : object, optional
        Flux below which branches end, relative to the start ray, by kind, such as 'R=1e-6, t=1e-9': R and T
        specular, r and t scattered reflection and transmission, A absorption.
    cut_below_W : object, optional
        The same in W.
    splitting : {"split", "one"}, optional
        Follow both rays at a surface, or one of them by chance.
    below_threshold : {"cut", "roulette"}, optional
        End a ray below the threshold, or play unbiased roulette.
    seed : int, optional
        Seed of the random numbers. 0 … 4294967295.
    ray_control : str, optional
        What light may do at surfaces: allow_all, transmit_specular, reflect_specular, halt_all, or letters of T, R,
        I (total reflection), M (mirrors), t and r (scatter) and A (absorption), such as TIA.
    polarization : {"auto", "unpolarized", "stokes"}, optional
        Means of s and p at every hit, or Stokes vectors along paths; auto: Stokes where it changes a listed path by
        more than a hundredth.
    max_scatters : int, optional
        Scatter events on one path; 0: none. 0 … 32767.
    max_optical_scatters : int, optional
        Those of them at surfaces that transmit. 0 … 32767.
    max_random_scatters : int, optional
        Those of them that are not aimed at a target. 0 … 32767.
    scatter_rays : int, optional
        Rays scattered at random at every hit. 1 … 255.
    aimed_rays : int, optional
        Rays aimed at the targets at every hit, to either side; 0: none. 0 … 255.
    aim : {"auto", "targets", "none"}, optional
        Aim at the detector and targets of the scene, only at these, or not.
    scatter_threshold : float, optional
        Flux below which hits scatter by chance, relative to the ray's start. 0 … < 1.

    Raises
    ------
    MistrayError
        If the limits are empty or one is unknown, or `mistray.pst` raises it.

    Examples
    --------
    >>> found = mistray.first_level(mistray.load("plate_and_wall"), [30], rays=10_000)
    >>> for name, pst in found.curves.items():
    ...     print(f"{name}: {pst.curve('stray')[0][0]:.1e}")
    scatter once: 2.8e-03
    ghosts off: 2.8e-03
    scatter off: 0.0e+00
    all: 2.9e-03
    """

def ghosts(
    scene: mi.Scene,
    field_deg: float | Iterable[float] | None = None,
    wavelength_nm: float | Iterable[float] | None = None,
    weights: float | Iterable[float] | None = None,
    azimuth_deg: float | None = None,
    progress: Callable[[float, float], None] | None = None,
    rank: str = "rms",
    seconds: float | None = None,
    contested_rays: int | None = None,
    *,
    field_mm: float | Iterable[float] | None = None,
    detector: str | None = None,
    rays: int | None = None,
    max_reflections: int | None = None,
    max_generations: int | None = None,
    max_events: int | None = None,
    max_consecutive: int | None = None,
    max_segments: int | None = None,
    flux_threshold: float | None = None,
    cut_below: Any | None = None,
    cut_below_W: Any | None = None,
    splitting: str | None = None,
    below_threshold: str | None = None,
    seed: int | None = None,
    ray_control: str | None = None,
    polarization: str | None = None,
    max_scatters: int | None = None,
    max_optical_scatters: int | None = None,
    max_random_scatters: int | None = None,
    scatter_rays: int | None = None,
    aimed_rays: int | None = None,
    aim: str | None = None,
    scatter_threshold: float | None = None,
) -> GhostReport:
    r"""
    Trace a scene at several field angles and rank its stray light.

    The direct image on axis, the denominator of every normalised value, is taken from the field 0. If ``field_deg``
    lacks this field, it is traced as well, without reflections and scatter. All fields have the same polarization.
    Every list of worst paths names the strongest path by power, too. Where paths are ranked by RMS irradiance and
    without a time budget, a field with a contested worst path (``contested`` in `GhostReport.table`) is traced again.

    Parameters
    ----------
    scene : mi.Scene
        Scene with one source, from `mistray.load`.
    field_deg : float | Iterable[float], optional
        Field angles, degrees; without them that of the scene's source. > -90 … < 90 degrees.
    wavelength_nm : float | Iterable[float], optional
        Wavelengths, nm. 10 … 1e7 nm.
    weights : float | Iterable[float], optional
        Shares of the flux, one for each of the wavelengths; without them equal. 0 … 1e30.
    azimuth_deg : float, optional
        Azimuth of the field about z, degrees. -360 … 360 degrees.
    progress : callable, optional
        Called now and then with the number of fields done, parts of one included, and of all fields.
    rank : {"rms", "power", "peak"}, optional
        What the list of worst paths goes by: RMS irradiance, power, or peak, the brightest pixel, for which the
        rays are traced again.
    seconds : float, optional
        Time for all fields, s, in equal shares; each ends with the rays that it has, see `mistray.trace`. Fields for
        which it is too short are in `GhostReport.not_traced`; those that are traced are spread over all. Maps, which a
        report requests later, take as long again.
    contested_rays : int, optional
        Start rays of a field where by RMS irradiance another path may be as bright as the worst: it is traced
        again; without them 4 times its rays; 0: never. 0 … 4294967295.
    field_mm : float | Iterable[float], optional
        Object heights of a near source instead, mm. -1e12 … 1e12 mm.
    detector : str, optional
        Shape with the sensor, where the scene has several.
    rays : int, optional
        Start rays of all sources together. 1 … 4294967295.
    max_reflections : int, optional
        Reflections on one path, those of mirrors and TIR not counted. 0 … 32767.
    max_generations : int, optional
        Reflections and scatter events together on one path. 0 … 32767.
    max_events : int, optional
        Surfaces met on one path. 1 … 1000.
    max_consecutive : int, optional
        Hits of one surface in a row on one path. 1 … 32767.
    max_segments : int, optional
        Ray segments of the tree of one start ray. 1 … 4294967295.
    flux_threshold : float, optional
        Flux below which a ray ends, relative to its start ray. 0 … < 1.
    cut_below : object, optional
        Flux below which branches end, relative to the start ray, by kind, such as 'R=1e-6, t=1e-9': R and T
        specular, r and t scattered reflection and transmission, A absorption.
    cut_below_W : object, optional
        The same in W.
    splitting : {"split", "one"}, optional
        Follow both rays at a surface, or one of them by chance.
    below_threshold : {"cut", "roulette"}, optional
        End a ray below the threshold, or play unbiased roulette.
    seed : int, optional
        Seed of the random numbers. 0 … 4294967295.
    ray_control : str, optional
        What light may do at surfaces: allow_all, transmit_specular, reflect_specular, halt_all, or letters of T, R,
        I (total reflection), M (mirrors), t and r (scatter) and A (absorption), such as TIA.
    polarization : {"auto", "unpolarized", "stokes"}, optional
        Means of s and p at every hit, or Stokes vectors along paths; auto: Stokes where it changes a listed path by
        more than a hundredth.
    max_scatters : int, optional
        Scatter events on one path; 0: none. 0 … 32767.
    max_optical_scatters : int, optional
        Those of them at surfaces that transmit. 0 … 32767.
    max_random_scatters : int, optional
        Those of them that are not aimed at a target. 0 … 32767.
    scatter_rays : int, optional
        Rays scattered at random at every hit. 1 … 255.
    aimed_rays : int, optional
        Rays aimed at the targets at every hit, to either side; 0: none. 0 … 255.
    aim : {"auto", "targets", "none"}, optional
        Aim at the detector and targets of the scene, only at these, or not.
    scatter_threshold : float, optional
        Flux below which hits scatter by chance, relative to the ray's start. 0 … < 1.

    Returns
    -------
    GhostReport
        A mapping from field angle to `mistray.trace.Trace`.

    Raises
    ------
    MistrayError
        If an argument is invalid, none of several detectors is named, or `mistray.trace` raises it.
    UnfinishedError
        If workers of `mistray.distribute` are lost; ``partial`` maps fields to traces, the last of them of fewer rays,
        and is a `GhostReport` if the field 0 is known.
    Interrupted
        If the user presses Ctrl-C; ``partial`` is as above, with the finished fields and the rays of the unfinished
        one.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> report.top(0, 2)[["ghost_1", "ghost_2"]]
        ghost_1   ghost_2
    2  L3_front   L2_rear
    5   L3_rear  L1_front
    """

def image_quality(
    scene: mi.Scene,
    field_deg: float | Iterable[float] | None = None,
    *,
    field_mm: float | Iterable[float] | None = None,
    stop: str | None = None,
    grid: int | None = None,
    reference_radius_mm: float | None = None,
    progress: Callable[[float, float], None] | None = None,
    azimuth_deg: float | None = None,
    wavelength_nm: float | Iterable[float] | None = None,
    weights: float | Iterable[float] | None = None,
    detector: str | None = None,
) -> ImageQuality:
    r"""
    Compute the image quality of the direct light of a scene.

    Rays of its design path, in float64, fill the aperture that the scene leaves open. Stops, rims, barrels and vanes
    limit it; the size of a beam does not. Coatings and absorption weight the pupil. Image points are those of the chief
    ray at the wavelength of the largest weight; of several such the one nearest to the mean. Definitions:
    docs/image_quality.md.

    Parameters
    ----------
    scene : mi.Scene
        Scene with a source far away, or a `point_source` or `surface_source` in its object plane; of several the first.
    field_deg : float | Iterable[float], optional
        Field angles, degrees; those of a near object are seen from the origin of its frame; without them the axis.
        > -90 … < 90 degrees.
    field_mm : float | Iterable[float], optional
        Object heights of a near source instead, mm. -1e12 … 1e12 mm.
    stop : str, optional
        Surface that limits the light; without it that at which most light next to the pupil ends.
    grid : int, optional
        Cells across the pupil; without it 64, or as many as the wavefront asks for, up to 512. 16 … 1024.
    reference_radius_mm : float, optional
        Radius of the reference sphere, mm, inf for a plane; without it the distance of the exit pupil.
    progress : callable, optional
        Called with the work done so far and the total work.
    azimuth_deg : float, optional
        Azimuth of the field about z, degrees. -360 … 360 degrees.
    wavelength_nm : float | Iterable[float], optional
        Wavelengths, nm. 10 … 1e7 nm.
    weights : float | Iterable[float], optional
        Shares of the flux, one for each of the wavelengths; without them equal. 0 … 1e30.
    detector : str, optional
        Shape with the sensor, where the scene has several.

    Returns
    -------
    ImageQuality

    Raises
    ------
    MistrayError
        If no light reaches the detector by the design path, at a field or at all, or the light does not converge. Also
        if a surface on the way is a mesh, the source is neither far away nor a point, or rays miss the requested
        reference sphere.

    Examples
    --------
    >>> found = mistray.image_quality(mistray.load("ritchey_chretien"), [0, 0.1], grid=32)
    >>> for field in found:
    ...     print(f"{field.name}: RMS spot {1000 * field.rms_spot_mm():.1f} µm, Strehl ratio {field.strehl:.2f}")
    0°: RMS spot 0.1 µm, Strehl ratio 1.00
    0.1°: RMS spot 3.3 µm, Strehl ratio 0.88
    """

def objects(
    scene: mi.Scene,
    *,
    rays: int | None = None,
    half_angle_deg: float | None = None,
    field_deg: float | Iterable[float] | None = None,
    azimuth_deg: float = 0.0,
    disc_mm: tuple[float, float] | None = None,
    view_half_angle_deg: float = 90.0,
    wavelength_nm: float | None = None,
    stop: str | None = None,
    threshold: float = 1e-06,
    ray_control: str = "transmit_specular",
    total_reflection: bool = True,
    source: DiskSource | None = None,
    progress: Callable[[float, float], None] | None = None,
    seconds: float | None = None,
    detector: str | None = None,
    max_events: int | None = None,
    seed: int | None = None,
) -> Objects:
    r"""
    Find the objects that the detector sees, those that light from outside reaches, and those that are both.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    rays : int, optional
        Start rays from the detector, and from outside at each angle; without it as the scene says, else 1e6. 1 …
        4294967295.
    half_angle_deg : float, optional
        Light comes from everywhere within this angle of the axis, degrees; without it 20. 1e-6 … 90 degrees.
    field_deg : float | Iterable[float], optional
        Field angles of a distant source instead, degrees. > -90 … < 90 degrees.
    azimuth_deg : float, optional
        Azimuth of the distant source, degrees, from +y to -x. -360 … 360 degrees.
    disc_mm : tuple[float, float], optional
        Z and radius of a Lambertian disc across the z axis instead, mm; its cone has that half angle. -1e12 … 1e12
        mm.
    view_half_angle_deg : float, optional
        Rays leave the detector within this angle of its normal, degrees. 1e-6 … 90 degrees.
    wavelength_nm : float, optional
        Wavelength, nm; without it the first of the scene's source. 10 … 1e7 nm.
    stop : str, optional
        Part or shape that is the aperture stop; without it what ends the beam on the axis.
    threshold : float, optional
        Flux that an object must get to count, W for each W that starts; one ray is 1/rays. 0 … < 1.
    ray_control : str, optional
        What light may do at surfaces: allow_all, transmit_specular, reflect_specular, halt_all, or letters of T, R,
        I (total reflection), M (mirrors), t and r (scatter) and A (absorption), such as TIA.
    total_reflection : bool, optional
        Follow rays in total reflection.
    source : DiskSource, optional
        Lambertian disc as the source, at any place, with optional holes in disc and cone; None: the source of
        `request`.
    progress : callable, optional
        Called from time to time with (parts done, parts in all). A part is the rays from the detector, or those of one
        source.
    seconds : float, optional
        Time limit, s, shared equally by the rays from the detector and those of each source. A part of it is kept for
        the scatter estimates. A warning reports the number of rays traced.
    detector : str, optional
        Shape with the sensor, where the scene has several.
    max_events : int, optional
        Surfaces met on one path. 1 … 1000.
    seed : int, optional
        Seed of the random numbers. 0 … 4294967295.

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

def pst(
    scene: mi.Scene,
    field_deg: float | Iterable[float] = range(0, 81, 2),
    *,
    method: str = "joined",
    convention: str = "normal",
    azimuths_deg: float | Iterable[float] | None = None,
    cell_deg: float | None = None,
    azimuth_cell_deg: float | None = None,
    rays: int | None = None,
    relative_error: float | None = None,
    error_up_to_deg: float | None = None,
    paths: bool = True,
    map_pixels: int = 0,
    next_order: bool = False,
    state: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[PstProgress], None] | None = None,
    seconds: float | None = None,
    wavelength_nm: float | Iterable[float] | None = None,
    weights: float | Iterable[float] | None = None,
    detector: str | None = None,
    max_reflections: int | None = None,
    max_generations: int | None = None,
    max_events: int | None = None,
    max_consecutive: int | None = None,
    max_segments: int | None = None,
    flux_threshold: float | None = None,
    cut_below: Any | None = None,
    cut_below_W: Any | None = None,
    splitting: str | None = None,
    below_threshold: str | None = None,
    seed: int | None = None,
    ray_control: str | None = None,
    polarization: str | None = None,
    max_scatters: int | None = None,
    max_optical_scatters: int | None = None,
    max_random_scatters: int | None = None,
    scatter_rays: int | None = None,
    aimed_rays: int | None = None,
    aim: str | None = None,
    scatter_threshold: float | None = None,
) -> Pst:
    r"""
    Compute the point source transmittance (PST) over field angle, by class of light, with standard errors and paths.

    The adjoint method traces rays from the detector backwards. They leave the scene in directions from which light
    arrives, so that one trace covers all angles and azimuths. The forward method traces a plane wave over the whole
    scene from each cell of directions. The joined method, the default, does both: rays start from the
    detector and from all cells, and each path is weighted by the balance heuristic (E. Veach, Robust Monte Carlo
    methods for light transport simulation, 1997, section 9.2). A pilot learns where light gets in and how many rays
    each direction needs. All three have the same mean.

    Parameters
    ----------
    scene : mi.Scene
        Angles are measured from the axis of its first `collimated` source, or from +z if it has none. The size of the
        source does not matter: the light covers the whole scene.
    field_deg : float | Iterable[float], optional
        Field angles, degrees, ascending, each the middle of a cell over which the PST is averaged; negative ones
        are at the opposite azimuth. -90 … 90 degrees.
    method : {"joined", "adjoint", "forward"}, optional
        Both directions at once, rays from the detector alone, or beams of each angle.
    convention : {"normal", "projected"}, optional
        E_det/E_⊥ across the beam, or E_det/(E_⊥ cos θ).
    azimuths_deg : float | Iterable[float], optional
        Azimuths of a map, degrees, from +y towards -x; without them the mean over all. -360 … 360 degrees.
    cell_deg : float, optional
        Width of the cells of field angle, degrees; without it 2, or the distance of two angles. 1e-6 … 90 degrees.
    azimuth_cell_deg : float, optional
        And of azimuth, degrees; without it the distance of two azimuths. 1e-6 … 360 degrees.
    rays : int, optional
        Start rays in all, or for each angle (forward), with a relative error the most; without it 4e6, forward 2e5.
        1 … 4294967295.
    relative_error : float, optional
        Standard error over the PST at every angle, for which a pilot estimates the rays. 1e-5 … < 1.
    error_up_to_deg : float, optional
        Largest field angle at which that error is required, degrees. 0 … 90 degrees.
    paths : bool, optional
        Keep the strongest paths of each angle.
    map_pixels : int, optional
        Longer side of maps of the detector for each angle, pixels; 0: none. 0 … 4096.
    next_order : bool, optional
        Measure the PST again with one more scatter event and, apart from that, with one more reflection, see
        `Pst.next_orders`. These have together as many rays as the first. If the stray light at some angle changes
        by more than 5 % and two errors, the result is the PST with that limit.
    state : str or Path, optional
        File with the finished part of the run, updated during the run; not with the method "forward".
    resume : bool
        Whether to continue the run of `state`.
    progress : callable, optional
        Called with a `PstProgress` after every pass.
    seconds : float, optional
        Time, s, after which the run ends with the rays traced so far, once the current pass is complete; a note reports
        their number. With the method "forward" the cells share the time. The other methods take all of it if neither a
        number of rays nor a relative error is given.
    wavelength_nm : float | Iterable[float], optional
        Wavelengths, nm. 10 … 1e7 nm.
    weights : float | Iterable[float], optional
        Shares of the flux, one for each of the wavelengths; without them equal. 0 … 1e30.
    detector : str, optional
        Shape with the sensor, where the scene has several.
    max_reflections : int, optional
        Reflections on one path, those of mirrors and TIR not counted. 0 … 32767.
    max_generations : int, optional
        Reflections and scatter events together on one path. 0 … 32767.
    max_events : int, optional
        Surfaces met on one path. 1 … 1000.
    max_consecutive : int, optional
        Hits of one surface in a row on one path. 1 … 32767.
    max_segments : int, optional
        Ray segments of the tree of one start ray. 1 … 4294967295.
    flux_threshold : float, optional
        Flux below which a ray ends, relative to its start ray. 0 … < 1.
    cut_below : object, optional
        Flux below which branches end, relative to the start ray, by kind, such as 'R=1e-6, t=1e-9': R and T
        specular, r and t scattered reflection and transmission, A absorption.
    cut_below_W : object, optional
        The same in W.
    splitting : {"split", "one"}, optional
        Follow both rays at a surface, or one of them by chance.
    below_threshold : {"cut", "roulette"}, optional
        End a ray below the threshold, or play unbiased roulette.
    seed : int, optional
        Seed of the random numbers. 0 … 4294967295.
    ray_control : str, optional
        What light may do at surfaces: allow_all, transmit_specular, reflect_specular, halt_all, or letters of T, R,
        I (total reflection), M (mirrors), t and r (scatter) and A (absorption), such as TIA.
    polarization : {"auto", "unpolarized", "stokes"}, optional
        Means of s and p at every hit, or Stokes vectors along paths; auto: Stokes where it changes a listed path by
        more than a hundredth.
    max_scatters : int, optional
        Scatter events on one path; 0: none. 0 … 32767.
    max_optical_scatters : int, optional
        Those of them at surfaces that transmit. 0 … 32767.
    max_random_scatters : int, optional
        Those of them that are not aimed at a target. 0 … 32767.
    scatter_rays : int, optional
        Rays scattered at random at every hit. 1 … 255.
    aimed_rays : int, optional
        Rays aimed at the targets at every hit, to either side; 0: none. 0 … 255.
    aim : {"auto", "targets", "none"}, optional
        Aim at the detector and targets of the scene, only at these, or not.
    scatter_threshold : float, optional
        Flux below which hits scatter by chance, relative to the ray's start. 0 … < 1.

    Returns
    -------
    Pst

    Raises
    ------
    MistrayError
        If an argument is out of range, or a state belongs to another run.
    UnfinishedError
        If workers of `mistray.distribute` are lost; ``partial`` is the PST of the passes before, or, forward, the sums
        of the finished cells by their indices.
    KeyboardInterrupt
        After the pass in which an interrupt came; the finished part is then in `state`, if that is given.

    Examples
    --------
    >>> pst = mistray.pst(mistray.load("lens_and_window"), [10, 30], rays=20_000)
    >>> stray, error = pst.curve("stray")
    >>> for angle, value, se in zip(pst.field_deg, stray, error):
    ...     print(f"{angle:.0f}°: {value:.1e} ± {se:.0e}")
    10°: 4.7e-05 ± 1e-06
    30°: 3.8e-05 ± 5e-07
    """

def study(
    scene: mi.Scene,
    pst_field_deg: float | Iterable[float] = range(0, 81, 2),
    field_deg: float | Iterable[float] | None = None,
    *,
    rays: int | None = None,
    quick: bool = False,
    relative_error: float | None = None,
    convention: str = "normal",
    next_order: bool = True,
    state: str | Path | None = None,
    resume: bool = False,
    name: str = "scene",
    progress: Callable[[int, str, float], None] | None = None,
    seconds: float | None = None,
    azimuth_deg: float | None = None,
    wavelength_nm: float | Iterable[float] | None = None,
    weights: float | Iterable[float] | None = None,
    max_reflections: int | None = None,
    max_generations: int | None = None,
    max_events: int | None = None,
    max_consecutive: int | None = None,
    max_segments: int | None = None,
    flux_threshold: float | None = None,
    cut_below: Any | None = None,
    cut_below_W: Any | None = None,
    splitting: str | None = None,
    below_threshold: str | None = None,
    seed: int | None = None,
    ray_control: str | None = None,
    polarization: str | None = None,
    max_scatters: int | None = None,
    max_optical_scatters: int | None = None,
    max_random_scatters: int | None = None,
    scatter_rays: int | None = None,
    aimed_rays: int | None = None,
    aim: str | None = None,
    scatter_threshold: float | None = None,
) -> Study:
    r"""
    Run the eight steps of a stray-light study.

    The steps are those that "Stray Light Analysis of a Mobile Phone Camera" quotes from R. Pfisterer:
    optical model, mechanical model, critical objects, illuminated objects, common objects, coatings and scatter models,
    importance sampling, stray-light analysis. Steps 1, 2, 6 and 7 use the first wavelength only. The azimuth is
    that of the ghosts; the PST is the mean over all azimuths.

    Parameters
    ----------
    scene : mi.Scene
        Scene from `mistray.load`, with a ``collimated`` source and a detector.
    pst_field_deg : float | Iterable[float], optional
        Field angles of the PST, numbers and ranges first:last:step, degrees. -90 … 90 degrees.
    field_deg : float | Iterable[float], optional
        Field angles of the ghosts, degrees; without them 0, 1/2, 1 and 5/4 of the half field. > -90 … < 90 degrees.
    rays : int, optional
        Start rays of the PST; objects get a fifth at each angle, ghosts a tenth and images of points a fiftieth at
        each field; without it 1e6, quick 1e5. 1 … 4294967295.
    quick : bool, optional
        Fewer rays, for a first look.
    relative_error : float, optional
        Go on until the standard error over the PST is below this at every angle, with `rays` as a limit. 1e-5 … <
        1.
    convention : {"normal", "projected"}, optional
        PST as E_det/E_⊥ across the beam, or E_det/(E_⊥ cos θ).
    next_order : bool, optional
        Measure the PST again with one more scatter event and one more reflection on each path.
    name : str
        Name of the system, for the report.
    progress : callable, optional
        See `Progress`.
    seconds : float, optional
        Time for all steps, s. A quarter is for the objects, a tenth of the rest for the check of the sampling, and a
        third of the rest for the ghosts. Then a fifth of the rest is for images of points with stray light (wavefronts
        take extra time), and all that remains for the PST. Each ends with the rays that it has, and a warning reports
        their number.
    azimuth_deg : float, optional
        Azimuth of the field about z, degrees. -360 … 360 degrees.
    wavelength_nm : float | Iterable[float], optional
        Wavelengths, nm. 10 … 1e7 nm.
    weights : float | Iterable[float], optional
        Shares of the flux, one for each of the wavelengths; without them equal. 0 … 1e30.
    max_reflections : int, optional
        Reflections on one path, those of mirrors and TIR not counted. 0 … 32767.
    max_generations : int, optional
        Reflections and scatter events together on one path. 0 … 32767.
    max_events : int, optional
        Surfaces met on one path. 1 … 1000.
    max_consecutive : int, optional
        Hits of one surface in a row on one path. 1 … 32767.
    max_segments : int, optional
        Ray segments of the tree of one start ray. 1 … 4294967295.
    flux_threshold : float, optional
        Flux below which a ray ends, relative to its start ray. 0 … < 1.
    cut_below : object, optional
        Flux below which branches end, relative to the start ray, by kind, such as 'R=1e-6, t=1e-9': R and T
        specular, r and t scattered reflection and transmission, A absorption.
    cut_below_W : object, optional
        The same in W.
    splitting : {"split", "one"}, optional
        Follow both rays at a surface, or one of them by chance.
    below_threshold : {"cut", "roulette"}, optional
        End a ray below the threshold, or play unbiased roulette.
    seed : int, optional
        Seed of the random numbers. 0 … 4294967295.
    ray_control : str, optional
        What light may do at surfaces: allow_all, transmit_specular, reflect_specular, halt_all, or letters of T, R,
        I (total reflection), M (mirrors), t and r (scatter) and A (absorption), such as TIA.
    polarization : {"auto", "unpolarized", "stokes"}, optional
        Means of s and p at every hit, or Stokes vectors along paths; auto: Stokes where it changes a listed path by
        more than a hundredth.
    max_scatters : int, optional
        Scatter events on one path; 0: none. 0 … 32767.
    max_optical_scatters : int, optional
        Those of them at surfaces that transmit. 0 … 32767.
    max_random_scatters : int, optional
        Those of them that are not aimed at a target. 0 … 32767.
    scatter_rays : int, optional
        Rays scattered at random at every hit. 1 … 255.
    aimed_rays : int, optional
        Rays aimed at the targets at every hit, to either side; 0: none. 0 … 255.
    aim : {"auto", "targets", "none"}, optional
        Aim at the detector and targets of the scene, only at these, or not.
    scatter_threshold : float, optional
        Flux below which hits scatter by chance, relative to the ray's start. 0 … < 1.

    Raises
    ------
    MistrayError
        If an argument is out of range, the scene has no source or no detector, or a source is polarised.

    Examples
    --------
    >>> found = mistray.study(mistray.load("newtonian_scatter"), [10, 30], [0], rays=2000)
    >>> [step for step in found if "objects" in step]
    ['critical_objects', 'illuminated_objects', 'common_objects']
    >>> print(found.findings[0].partition(",")[0])
    2 optical surfaces: focal length 1270 mm
    """

def thermal(
    scene: mi.Scene,
    temperature_K: float = 293.0,
    band_um: tuple[float, float] = (8.0, 12.0),
    *,
    temperatures: Mapping[str, float] | None = None,
    scene_K: float | None = None,
    wavelengths_um: float | Iterable[float] | None = None,
    detector: str | None = None,
    noise: DetectorNoise | None = None,
    rays: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    seconds: float | None = None,
    max_reflections: int | None = None,
    max_generations: int | None = None,
    max_events: int | None = None,
    max_consecutive: int | None = None,
    max_segments: int | None = None,
    flux_threshold: float | None = None,
    cut_below: Any | None = None,
    cut_below_W: Any | None = None,
    splitting: str | None = None,
    below_threshold: str | None = None,
    seed: int | None = None,
    ray_control: str | None = None,
    polarization: str | None = None,
    max_scatters: int | None = None,
    max_optical_scatters: int | None = None,
    max_random_scatters: int | None = None,
    scatter_rays: int | None = None,
    aimed_rays: int | None = None,
    aim: str | None = None,
    scatter_threshold: float | None = None,
) -> ThermalReport:
    r"""
    Return the irradiance on the detector by thermal emission, for every surface and medium.

    E = π ∫ L_B(λ, T) emission(λ) dλ, where the emission holds n² of the medium before the detector. Between wavelengths
    it is interpolated linearly, beyond them it is that of the nearest. The detector is cooled by the id of its shape.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    temperature_K : float, optional
        Temperature of everything without one of its own, K. 0 … 1e6 K.
    band_um : tuple[float, float], optional
        Band of the detector, µm. 0.01 … 10000 µm.
    temperatures : Mapping[str, float], optional
        Temperatures of surfaces, parts or materials by name, with * and ?, K; the last that fits holds. 0 … 1e6 K.
    scene_K : float, optional
        Temperature of the blackbody around the system, K; without it that of everything. 0 … 1e6 K.
    wavelengths_um : float | Iterable[float], optional
        Wavelengths at which optics are traced, µm; without them as many as tell the integral over the band to 1 %.
        0.01 … 10000 µm.
    detector : str, optional
        Shape with the sensor, where the scene has several.
    noise : DetectorNoise, optional
        A pixel and its noise, for the NETD.
    rays : int, optional
        Rays from the detector, for each wavelength and twice: of everything, and of the image; without it 200 000,
        of more than three wavelengths 600 000 over their number. 1 … 4294967295.
    progress : callable, optional
        Called with (traces done, traces in all); those of narcissus by one reflection are not counted.
    seconds : float, optional
        Time for all traces, s, in equal shares; each ends with the rays that it has, and a note reports it. None: no
        limit.
    max_reflections : int, optional
        Reflections on one path, those of mirrors and TIR not counted. 0 … 32767.
    max_generations : int, optional
        Reflections and scatter events together on one path. 0 … 32767.
    max_events : int, optional
        Surfaces met on one path. 1 … 1000.
    max_consecutive : int, optional
        Hits of one surface in a row on one path. 1 … 32767.
    max_segments : int, optional
        Ray segments of the tree of one start ray. 1 … 4294967295.
    flux_threshold : float, optional
        Flux below which a ray ends, relative to its start ray. 0 … < 1.
    cut_below : object, optional
        Flux below which branches end, relative to the start ray, by kind, such as 'R=1e-6, t=1e-9': R and T
        specular, r and t scattered reflection and transmission, A absorption.
    cut_below_W : object, optional
        The same in W.
    splitting : {"split", "one"}, optional
        Follow both rays at a surface, or one of them by chance.
    below_threshold : {"cut", "roulette"}, optional
        End a ray below the threshold, or play unbiased roulette.
    seed : int, optional
        Seed of the random numbers. 0 … 4294967295.
    ray_control : str, optional
        What light may do at surfaces: allow_all, transmit_specular, reflect_specular, halt_all, or letters of T, R,
        I (total reflection), M (mirrors), t and r (scatter) and A (absorption), such as TIA.
    polarization : {"auto", "unpolarized", "stokes"}, optional
        Means of s and p at every hit, or Stokes vectors along paths; auto: Stokes where it changes a listed path by
        more than a hundredth.
    max_scatters : int, optional
        Scatter events on one path; 0: none. 0 … 32767.
    max_optical_scatters : int, optional
        Those of them at surfaces that transmit. 0 … 32767.
    max_random_scatters : int, optional
        Those of them that are not aimed at a target. 0 … 32767.
    scatter_rays : int, optional
        Rays scattered at random at every hit. 1 … 255.
    aimed_rays : int, optional
        Rays aimed at the targets at every hit, to either side; 0: none. 0 … 255.
    aim : {"auto", "targets", "none"}, optional
        Aim at the detector and targets of the scene, only at these, or not.
    scatter_threshold : float, optional
        Flux below which hits scatter by chance, relative to the ray's start. 0 … < 1.

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

def transfer(
    scene: mi.Scene,
    field_deg: float | Iterable[float] | None = None,
    *,
    field_mm: float | Iterable[float] | None = None,
    frequencies_per_mm: float | Iterable[float] | None = None,
    pixel_mm: float | Iterable[float] | None = None,
    diffusion_mm: float | None = None,
    detector_table: tuple[tuple[float, ...], tuple[float, ...]] | None = None,
    quality: ImageQuality | None = None,
    progress: Callable[[int, int], None] | None = None,
    seconds: float | None = None,
    azimuth_deg: float | None = None,
    wavelength_nm: float | Iterable[float] | None = None,
    weights: float | Iterable[float] | None = None,
    detector: str | None = None,
    rays: int | None = None,
    max_reflections: int | None = None,
    max_generations: int | None = None,
    max_events: int | None = None,
    max_consecutive: int | None = None,
    max_segments: int | None = None,
    flux_threshold: float | None = None,
    cut_below: Any | None = None,
    cut_below_W: Any | None = None,
    splitting: str | None = None,
    below_threshold: str | None = None,
    seed: int | None = None,
    ray_control: str | None = None,
    polarization: str | None = None,
    max_scatters: int | None = None,
    max_optical_scatters: int | None = None,
    max_random_scatters: int | None = None,
    scatter_rays: int | None = None,
    aimed_rays: int | None = None,
    aim: str | None = None,
    scatter_threshold: float | None = None,
) -> Transfer:
    r"""
    Return images of points with stray light: scatter and ghost transfer functions, MTF, PSF and energy balance.

    The direct image is that of `mistray.image_quality`. One trace of each field, with ghosts and scatter, gives the
    light on the detector by class and by position about the direct image. Definitions and limits:
    docs/transfer_functions.md.

    Parameters
    ----------
    scene : mi.Scene
        Scene with one source, as for `mistray.image_quality`.
    field_deg : float | Iterable[float], optional
        Field angles, degrees; those of a near object are seen from the origin of its frame; without them the axis.
        > -90 … < 90 degrees.
    field_mm : float | Iterable[float], optional
        Object heights of a near source instead, mm. -1e12 … 1e12 mm.
    frequencies_per_mm : float | Iterable[float], optional
        Frequencies of the transfer functions, 1/mm, ascending; without them from the inverse of the detector's size
        to the cut-off of diffraction. 0 … 1e30.
    pixel_mm : float | Iterable[float], optional
        Side of a pixel, or its sides along x and y, mm, see `PixelResponse`; without it the detector resolves
        everything.
    diffusion_mm : float, optional
        Standard deviation of the diffusion of charge, mm. 0 … 1e12 mm.
    detector_table : tuple[tuple[float, ...], tuple[float, ...]], optional
        Measured transfer function of the detector: frequencies, 1/mm, and values.
    quality : ImageQuality, optional
        Image quality of the same scene, if known already; it then sets fields, wavelengths and detector.
    progress : callable, optional
        Called with (fields done, fields in all).
    seconds : float, optional
        Time of each trace, s, which then ends with the rays that it has, and leaves out wavelengths if it is too short
        for all of four or more; their light counts at the nearest that is traced. None: no limit.
    azimuth_deg : float, optional
        Azimuth of the field about z, degrees. -360 … 360 degrees.
    wavelength_nm : float | Iterable[float], optional
        Wavelengths, nm. 10 … 1e7 nm.
    weights : float | Iterable[float], optional
        Shares of the flux, one for each of the wavelengths; without them equal. 0 … 1e30.
    detector : str, optional
        Shape with the sensor, where the scene has several.
    rays : int, optional
        Start rays of all sources together. 1 … 4294967295.
    max_reflections : int, optional
        Reflections on one path, those of mirrors and TIR not counted. 0 … 32767.
    max_generations : int, optional
        Reflections and scatter events together on one path. 0 … 32767.
    max_events : int, optional
        Surfaces met on one path. 1 … 1000.
    max_consecutive : int, optional
        Hits of one surface in a row on one path. 1 … 32767.
    max_segments : int, optional
        Ray segments of the tree of one start ray. 1 … 4294967295.
    flux_threshold : float, optional
        Flux below which a ray ends, relative to its start ray. 0 … < 1.
    cut_below : object, optional
        Flux below which branches end, relative to the start ray, by kind, such as 'R=1e-6, t=1e-9': R and T
        specular, r and t scattered reflection and transmission, A absorption.
    cut_below_W : object, optional
        The same in W.
    splitting : {"split", "one"}, optional
        Follow both rays at a surface, or one of them by chance.
    below_threshold : {"cut", "roulette"}, optional
        End a ray below the threshold, or play unbiased roulette.
    seed : int, optional
        Seed of the random numbers. 0 … 4294967295.
    ray_control : str, optional
        What light may do at surfaces: allow_all, transmit_specular, reflect_specular, halt_all, or letters of T, R,
        I (total reflection), M (mirrors), t and r (scatter) and A (absorption), such as TIA.
    polarization : {"auto", "unpolarized", "stokes"}, optional
        Means of s and p at every hit, or Stokes vectors along paths; auto: Stokes where it changes a listed path by
        more than a hundredth.
    max_scatters : int, optional
        Scatter events on one path; 0: none. 0 … 32767.
    max_optical_scatters : int, optional
        Those of them at surfaces that transmit. 0 … 32767.
    max_random_scatters : int, optional
        Those of them that are not aimed at a target. 0 … 32767.
    scatter_rays : int, optional
        Rays scattered at random at every hit. 1 … 255.
    aimed_rays : int, optional
        Rays aimed at the targets at every hit, to either side; 0: none. 0 … 255.
    aim : {"auto", "targets", "none"}, optional
        Aim at the detector and targets of the scene, only at these, or not.
    scatter_threshold : float, optional
        Flux below which hits scatter by chance, relative to the ray's start. 0 … < 1.

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

def transfer_of_bsdf(
    models: LobeModel | Sequence[LobeModel],
    wavelength_nm: float,
    event: str = "reflection",
    n_in: float = 1.0,
    n_out: float = 1.0,
    cos_i: float = 1.0,
    share: float = 1.0,
    from_front: bool = True,
) -> SurfaceTransfer:
    r"""
    Return the surface transfer function from the BSDF: ``H(s) = 1 - TIS + ∫ BSDF(β) exp(2πi n (β - β0) s/λ) d²β``.

    The lag s is in µm, β and β0 are direction cosines of the light and of the specular direction, n is the index there.
    Light that the surface reflects, or transmits, counts as 1, so that TIS is the integral at s = 0. The Hankel
    transform is about the specular direction and averages over azimuths: exact at normal incidence on an isotropic
    surface.

    Parameters
    ----------
    models : LobeModel or sequence of LobeModel
        Scatter models of the surface.
    wavelength_nm : float
        Vacuum wavelength, nm. 10 … 1e7 nm.
    event : {"reflection", "transmission"}, optional
        Event whose light makes the image.
    n_in : float, optional
        Index on the side of incidence.
    n_out : float, optional
        Index on the other side.
    cos_i : float, optional
        Cosine of the angle of incidence. > 0 … 1.
    share : float, optional
        R or T of the coating, with which models relative to the incident light are compared. 0 … 1.
    from_front : bool, optional
        Whether light comes from the front.

    Raises
    ------
    MistrayError
        If the event or a value is invalid, light is totally reflected, the surface sends no light on, or a model fails
        at this event.

    Examples
    --------
    >>> from mistray.scatter.abg import ABg
    >>> found = mistray.analysis.transfer_of_bsdf(ABg(A=0.0025, B=0.001, g=1.8), 550.0)
    >>> print(f"TIS {found.tis:.4f}")
    TIS 0.0413
    """

def transfer_of_spectrum(
    model: RoughSurface,
    wavelength_nm: float,
    event: str = "reflection",
    n_in: float = 1.0,
    n_out: float = 1.0,
    cos_i: float = 1.0,
) -> SurfaceTransfer:
    r"""
    Return the surface transfer function of a roughness spectrum by Harvey's formula, ``exp{-a [1 - C(s)/σ²]}``.

    s is the lag on the surface, µm, and a the variance of the phase, rad². C, µm², is the Hankel transform of the
    spectrum at the frequencies that scatter into the half space at normal incidence, 0 … n/λ. σ² is the variance of the
    heights there, n the index of the medium of the scattered light, and λ the vacuum wavelength. The formula holds for
    surfaces of any roughness whose heights are Gaussian.

    Parameters
    ----------
    model : RoughSurface
        A `KCorrelation` or a `PsdTable`.
    wavelength_nm : float
        Vacuum wavelength, nm. 10 … 1e7 nm.
    event : {"reflection", "transmission"}, optional
        Event whose light makes the image.
    n_in : float, optional
        Index on the side of incidence.
    n_out : float, optional
        Index on the other side.
    cos_i : float, optional
        Cosine of the angle of incidence. > 0 … 1.

    Raises
    ------
    MistrayError
        If the event or a value is invalid, or light is totally reflected.

    Warns
    -----
    MistrayWarning
        If the surface is not smooth, 2π Δn σ/λ above `mistray.physics.harvey_shack.MAX_PHASE`: its BSDF is then not
        that of the theories for smooth surfaces. The theory "ghs_full" has no such limit.

    Examples
    --------
    >>> from mistray.scatter.k_correlation import KCorrelation
    >>> found = mistray.analysis.transfer_of_spectrum(KCorrelation(2.0, 10.0, 2.5), 550.0)
    >>> print(f"TIS {found.tis:.2e}, {(4 * np.pi * 2.0 / 550) ** 2:.2e} by the formula of Bennett and Porteus")
    TIS 1.60e-03, 2.09e-03 by the formula of Bennett and Porteus
    """

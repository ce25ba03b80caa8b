"""Public names of sweeps and configurations, re-exported."""

# Written by tests/stubs.py from what the functions are when they run

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi

from mistray.analyses.sweep.configurations import AS_IT_IS as AS_IT_IS
from mistray.analyses.sweep.configurations import Configuration as Configuration
from mistray.analyses.sweep.edit_ranking import EditRanking as EditRanking
from mistray.analyses.sweep.pst_sweep import PstSweep as PstSweep
from mistray.analyses.sweep.read_configurations import read_configurations as read_configurations
from mistray.analyses.sweep.result import Sweep as Sweep
from mistray.analyses.sweep.write_configuration import write_configuration as write_configuration

__all__ = [
    "AS_IT_IS",
    "Configuration",
    "EditRanking",
    "PstSweep",
    "Sweep",
    "rank_edits",
    "read_configurations",
    "sweep",
    "sweep_pst",
    "write_configuration",
]

def rank_edits(
    scene: str | Path | mi.Scene,
    field_deg: float | Iterable[float],
    light: str | Sequence[str] = "stray",
    *,
    steps: Mapping[str, float | str] | None = None,
    keys: str | Sequence[str] | None = None,
    edge_width: float | None = None,
    azimuth_deg: float | None = None,
    progress: Callable[[float, float], None] | None = None,
    wavelength_nm: float | Iterable[float] | None = None,
    weights: float | Iterable[float] | None = None,
    detector: str | None = None,
    method: str | None = None,
    convention: str | None = None,
    azimuths_deg: float | Iterable[float] | None = None,
    cell_deg: float | None = None,
    azimuth_cell_deg: float | None = None,
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
) -> EditRanking:
    r"""
    Rank possible edits (moves, blocks, paint, coatings) by the first-order effect of one step of each on the PST.

    It takes one PST and, for each field angle, one reverse-mode run that gives the derivatives with respect to all
    parameters.

    ====== ========================================================================================================
    move   places and tilts of parts as a whole
    block  radii and ends of opaque surfaces that are not part of a lens
    paint  values of scatter models: of paint, polish, dust; the ideal R of opaque surfaces
    coat   thicknesses of layers, the ideal R of lenses, mirrors and detectors
    ====== ========================================================================================================

    Steps are in the unit of the parameter, or text in percent of its value, ``"2 %"``; of a list, such as the layers of
    a coating, each entry in percent of its own value. A step by key overrides one by kind, and a later one an earlier
    one.

    Parameters
    ----------
    scene : str, Path or mi.Scene
        Scene XML file, name of a shipped scene, or a loaded scene.
    field_deg : float | Iterable[float]
        Field angles of the PST, degrees. -90 … 90 degrees.
    light : str | Sequence[str], optional
        Stray, total or classes of light, see `mistray.optimize.PstObservation`.
    steps : Mapping[str, float | str], optional
        Of --rank: steps by kind, key or pattern, such as rim=0.5 or paint.reflectance=2%. Kinds with their usual
        steps are position, tilt, rim (0.1 mm or deg), scatter, share (1%) and coating (1 nm).
    keys : str | Sequence[str], optional
        Keys or patterns such as "vane_*.r0"; without them all that can be edited.
    edge_width : float, optional
        Width of the zone at a rim, over its radius; without it each field angle has its own. 1e-6 … 0.5.
    azimuth_deg : float, optional
        Azimuth of the PST, degrees; without it the mean over all. -360 … 360 degrees.
    progress : callable, optional
        Called with (runs done, runs to do).
    wavelength_nm : float | Iterable[float], optional
        Wavelengths, nm. 10 … 1e7 nm.
    weights : float | Iterable[float], optional
        Shares of the flux, one for each of the wavelengths; without them equal. 0 … 1e30.
    detector : str, optional
        Shape with the sensor, where the scene has several.
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
    EditRanking

    Raises
    ------
    MistrayError
        If there is nothing to edit, a key or step is unknown or out of range, a step in per cent is one of 0, or the
        PST at an angle is 0.

    Examples
    --------
    >>> steps = {"polish.A": "10 %"}
    >>> found = mistray.sweeps.rank_edits("plate_and_wall", 30, rays=10_000, keys="polish.*", steps=steps)
    >>> [edit.label for edit in found.edits]
    ['polish.A', 'polish.g', 'polish.B']
    >>> print(f"{found.to_pandas().change_percent[0]:.1f} % by a tenth more scatter")
    1.9 % by a tenth more scatter
    """

def sweep(
    scene: str | Path | dict[str, Any] | mi.Scene,
    field_deg: float | Iterable[float] | None = None,
    wavelength_nm: float | Iterable[float] | None = None,
    configurations: Mapping[str, Mapping[str, Any]] | Configuration | Sequence[Configuration] | None = None,
    *,
    cache: bool | str | Path | None = None,
    progress: Callable[[float, float], None] | None = None,
    seconds: float | None = None,
    azimuth_deg: float | None = None,
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
) -> Sweep:
    r"""
    Trace a scene at every field and wavelength, in every configuration.

    Each combination is a separate trace, with all the rays and at its wavelength alone, so that a row does not depend
    on the other rows. The scene is loaded once and its parameter values are data to the kernels. These are compiled for
    the first row and serve all others, unless a configuration adds another kind of effect, such as a reflectance or a
    decentre that was absent before.

    Parameters
    ----------
    scene : str, Path, dict or mi.Scene
        A scene XML file, the name of a shipped scene, a Mitsuba dict, or a loaded scene. Only results of files are
        cached.
    field_deg : float | Iterable[float], optional
        Field angles, degrees; without them that of the scene's source. > -90 … < 90 degrees.
    wavelength_nm : float | Iterable[float], optional
        Wavelengths, nm. 10 … 1e7 nm.
    configurations : mapping of str to mapping, Configuration or sequence of Configuration, optional
        Name → values of parameters, see `mistray.sweeps.Configuration`; `mistray.sweeps.read_configurations` reads
        them from TOML. Default: the scene as it is.
    cache : bool, str or Path, optional
        Folder of the cache; True for the user's, False for none. Default: the user's, if the scene can be cached.
    progress : callable, optional
        Called from time to time with (rows done, rows to do); the first counts parts of a row too.
    seconds : float, optional
        Time for all rows that are not in the cache, s, in equal shares; each ends with the rays that it has. A row of
        fewer rays than requested is not cached, and a warning reports their number. Rows without time are in
        `Sweep.not_traced`; traced rows are spread over configurations, wavelengths and fields.
    azimuth_deg : float, optional
        Azimuth of the field about z, degrees. -360 … 360 degrees.
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
    Sweep

    Raises
    ------
    MistrayError
        If a list is empty, an argument is unknown, a configuration names something that the scene lacks or makes
        surfaces overlap, a requested cache is impossible, or `mistray.trace` raises it. Finished rows are in the cache.
    UnfinishedError
        If workers are lost, see `mistray.distribute`; its `partial` is a Sweep of the finished rows.

    Examples
    --------
    >>> states = {"centred": {"L2.y": 0.0}, "shifted": {"L2.y": 0.3}}
    >>> found = mistray.sweep("cooke_triplet", 0, configurations=states, rays=5000, cache=False)
    >>> mistray.report.with_error(found.estimate("stray_W", "shifted"))
    '1.562 ± 0.018'
    >>> found.to_pandas().worst_path.tolist()
    ['L3_front → L2_rear', 'L3_front → L2_rear']
    """

def sweep_pst(
    scene: str | Path | mi.Scene,
    configurations: Mapping[str, Mapping[str, Any]] | Configuration | Sequence[Configuration] | None,
    field_deg: float | Iterable[float] = range(0, 81, 10),
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
    progress: Callable[[float, float], None] | None = None,
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
) -> PstSweep:
    r"""
    Return the PST of a scene as it is and in each configuration, with common random numbers.

    All runs use the same method, directions and numbers of rays, and forward rays cover the surfaces of all
    configurations. So light that an edit does not touch is the same in all, ray by ray.

    Parameters
    ----------
    scene : str, Path or mi.Scene
        Scene XML file, the name of a shipped scene, or a scene from `mistray.load` with its values as they are now,
        which stays as it is.
    configurations : mapping of str to mapping, Configuration or sequence of Configuration
        Changes of the scene; a mapping gives values of parameters only.
    field_deg : float | Iterable[float], optional
        Field angles of the PSTs, degrees. -90 … 90 degrees.
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
        Refused: it would give the runs different rays. 1e-5 … < 1.
    error_up_to_deg : float, optional
        Largest field angle at which that error is required, degrees. 0 … 90 degrees.
    paths : bool, optional
        Keep the strongest paths of each angle.
    map_pixels : int, optional
        Longer side of maps of the detector for each angle, pixels; 0: none. 0 … 4096.
    next_order : bool, optional
        Refused: it would give the runs different limits.
    progress : callable, optional
        Called after every PST with (PSTs done, PSTs to do).
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
    PstSweep

    Raises
    ------
    MistrayError
        If a configuration names something that the scene lacks, makes surfaces overlap or is impossible; if an argument
        is unknown; if a loaded scene is not from `mistray.load`, or is to be painted, coated or blocked although it has
        no file or other values than its file; or for any reason of `mistray.pst`.

    Examples
    --------
    >>> coated = mistray.sweeps.Configuration("coated", coat={"L1": "bbar3"})
    >>> found = mistray.sweeps.sweep_pst("lens_and_window", [coated], [10, 30], rays=20_000)
    >>> for row in found.to_pandas().itertuples():
    ...     print(f"{row.angle_deg:.0f}°: {row.before:.1e} before, {row.after:.1e} after")
    10°: 4.8e-05 before, 4.1e-08 after
    30°: 3.9e-05 before, 3.3e-08 after
    """

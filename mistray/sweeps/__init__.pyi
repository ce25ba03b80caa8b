"""Names of sweeps and configurations, re-exported."""

# Written by tests/stubs.py from what the functions are when they run

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi

from mistray.analyses.sweep.configurations import AS_IT_IS as AS_IT_IS
from mistray.analyses.sweep.configurations import Configuration as Configuration
from mistray.analyses.sweep.edit_ranking import EditRanking as EditRanking
from mistray.analyses.sweep.edit_ranking import rank_edits as rank_edits
from mistray.analyses.sweep.pst_sweep import PstSweep as PstSweep
from mistray.analyses.sweep.pst_sweep import sweep_pst as sweep_pst
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

def sweep(
    scene: str | Path | dict[str, Any] | mi.Scene,
    field_deg: float | Iterable[float] | None = None,
    wavelength_nm: float | Iterable[float] | None = None,
    configurations: Mapping[str, Mapping[str, Any]] | Sequence[Configuration] | None = None,
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

    Each combination is a trace of its own, with all the rays and at its wavelength alone, so that a row does not depend
    on what else is requested. The scene is loaded once and its numbers are data to the kernels, which are compiled for
    the first row and serve all others, unless a configuration brings something of another kind, such as a reflectance
    or a decentre where there was none.

    Parameters
    ----------
    scene : str, Path, dict or mi.Scene
        A scene XML file, the name of a shipped scene, a Mitsuba dict, or a loaded scene. Only results of files are
        cached.
    field_deg : float | Iterable[float], optional
        Field angles, degrees; without them that of the scene's source. > -90 … < 90 degrees.
    wavelength_nm : float | Iterable[float], optional
        Wavelengths, nm. 10 … 1e7 nm.
    configurations : mapping of str to mapping, or sequence of Configuration, optional
        Name → values of parameters, see `mistray.sweeps.Configuration`; `mistray.sweeps.read_configurations` reads
        them from TOML. Default: the scene as it is.
    cache : bool, str or Path, optional
        Folder of the cache; True for the user's, False for none. Default: the user's, where the scene can be cached.
    progress : callable, optional
        Called now and then with (rows done, rows to do); the first counts parts of a row too.
    seconds : float, optional
        Time for all rows that are not in the cache, in equal shares; each ends with the rays that it has. A row of
        fewer rays than requested is not cached, and a warning counts them. Rows for which it is too short are in
        `Sweep.not_traced`; those that are traced are spread over configurations, wavelengths and fields.
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
        If a list is empty, an argument is unknown, a configuration names what the scene has not or makes surfaces
        overlap, a cache is requested that is impossible, or what `mistray.trace` raises. Rows that were finished are in
        the cache.
    UnfinishedError
        If workers are gone, see `mistray.distribute`; its `partial` is a Sweep of the rows that were finished.
    """

"""Sweep of a scene: traces of every field at every wavelength in every configuration."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi

from mistray.analyses.sweep.cells import Cell, KeptRows, SceneContents, foreign_plugins, traced_facts
from mistray.analyses.sweep.configurations import Configuration, Resolved, as_configurations, resolve
from mistray.analyses.sweep.numbers import Numbers, numbers_of
from mistray.analyses.sweep.request import SweepRequest
from mistray.analyses.sweep.result import CELL, Source, Sweep
from mistray.cache import Cache, open_cache
from mistray.errors import MistrayError, UnfinishedError, errors_of
from mistray.metrics.changes.gaps import Contacts, Gap
from mistray.metrics.scene_values import changed
from mistray.sampling.sources import scene_sources, source_emitters, spectrum, spectrum_of
from mistray.scene import find, load
from mistray.scene.check import check_overlaps
from mistray.time_budget import TimeShares, coarse_first, is_limited, not_traced, within
from mistray.toolkit.analysis import analysis
from mistray.trace import Settings, trace

Progress = Callable[[float, float], None]

LATER = 0.2  # what a row takes in tables and reports, as a part of what its trace takes beside the rays


def run(
    scene: str | Path | dict[str, Any] | mi.Scene,
    request: SweepRequest,
    *,
    configurations: Mapping[str, Mapping[str, Any]] | Configuration | Sequence[Configuration] | None = None,
    cache: bool | str | Path | None = None,
    progress: Progress | None = None,
    seconds: float | None = None,
) -> Sweep:
    """
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
    request : SweepRequest
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
    source: Source = find(scene) if isinstance(scene, str | Path) else scene
    contents = SceneContents(source) if isinstance(source, Path) and cache is not False else None  # before it is read
    loaded = source if isinstance(source, mi.Scene) else load(source)
    wanted = as_configurations(configurations)
    rebuilt = [one.name for one in wanted if one.rebuilds]
    if rebuilt:
        raise MistrayError(f"configuration '{rebuilt[0]}' paints, coats or blocks; compare its PST, see sweep_pst")
    chosen = resolve(loaded, mi.traverse(loaded), wanted)
    azimuth_deg = request.light.get("azimuth_deg")
    wavelengths = _wavelengths(loaded, request.light.get("wavelength_nm"))
    angles = _angles(loaded, request.field_deg, azimuth_deg, wavelengths[0])
    arguments = ({} if azimuth_deg is None else {"azimuth_deg": azimuth_deg}) | dict(request.settings)
    cells = [Cell(one, wavelength, angle) for one in chosen for wavelength in wavelengths for angle in angles]
    store, warnings = _cache_of(source, loaded, cache)
    kept = None
    if store is not None and contents is not None:
        kept = KeptRows(store, contents, traced_facts(contents, Settings.of(loaded, **request.settings), azimuth_deg))
    found = kept.read(cells) if kept is not None else {}
    reused, short = len(found), list[Cell]()
    contacts = Contacts(loaded) if any(one.values for one in chosen) else None
    gaps: dict[str, tuple[Gap, ...]] = {}
    over = False  # all is done, or the time is up

    def result() -> Sweep:
        rows = [dict(zip(CELL, cell.name, strict=True)) | found[cell] for cell in cells if cell in found]
        folder = None if kept is None else kept.store.folder
        said = [*warnings, *([] if kept is None else kept.problems)]
        missing = [cell for cell in cells if cell not in found]
        if missing and over:
            said.append(not_traced([str(cell) for cell in missing], len(cells), "rows"))
        if short:
            said.append(f"the time was up in {len(short)} of {len(cells)} rows, which have fewer rays, see the column "
                        "rays; their errors are larger")  # fmt: skip
        return Sweep(
            source=source,
            configurations=tuple(chosen),
            field_deg=tuple(angles),
            wavelengths_nm=tuple(wavelengths),
            rows=rows,
            arguments=arguments,
            reused=reused,
            cache_folder=folder,
            warnings=tuple(said),
            gaps=dict(gaps),
            not_traced=tuple(cell.name for cell in missing) if over else (),
        )

    def trace_row(cell: Cell, shares: TimeShares) -> None:
        part = _part(progress, len(found), len(cells))
        try:
            with shares.one():
                found[cell], complete = _traced(loaded, cell, arguments, part)
        except UnfinishedError as error:
            raise UnfinishedError(f"{cell}: {error}", result()) from None
        except MistrayError as error:
            raise MistrayError(f"{cell}: {error}") from None
        if not complete:
            short.append(cell)
        elif kept is not None:
            kept.keep(cell, found[cell])

    with within(seconds):
        order = coarse_first if is_limited() else list
        left: dict[str, list[Cell]] = {one.name: [] for one in chosen}
        for cell in cells:
            if cell not in found:
                left[cell.configuration.name].append(cell)
        states = TimeShares(len(chosen), LATER)
        for one in order(chosen):
            if not states.enough():
                break
            with states.one(), _state(loaded, one):
                if contacts is not None:
                    gaps[one.name] = contacts.opened(loaded)
                shares = TimeShares(len(left[one.name]), LATER)
                for cell in order(left[one.name]):
                    if shares.enough():
                        trace_row(cell, shares)
    over = True
    if progress is not None:
        progress(len(cells), len(cells))
    return result()


sweep = analysis("sweep", SweepRequest, run, ("field_deg", "wavelength_nm", "configurations"))


def _traced(scene: Any, cell: Cell, arguments: Mapping[str, Any], progress: Any) -> tuple[Numbers, bool]:
    """Return the numbers of a row, and whether all of its rays were traced in the time left."""
    t = trace(scene, field_deg=cell.field_deg, wavelength_nm=cell.wavelength_nm, progress=progress, **arguments)
    return numbers_of(t), t.rays_traced >= t.rays_planned


@contextlib.contextmanager
def _state(scene: Any, configuration: Resolved) -> Iterator[None]:
    """
    Apply a configuration to a scene within a block, and restore the scene afterwards.

    A configuration without values leaves the scene as it is.

    Raises
    ------
    MistrayError
        If the configuration is impossible, or surfaces overlap in it.
    """
    if not configuration.values:
        yield
        return
    with contextlib.ExitStack() as stack:
        with errors_of(f"configuration '{configuration.name}'"):
            stack.enter_context(changed(mi.traverse(scene), configuration.values))
            check_overlaps(scene)
        yield


def _cache_of(source: Source, scene: Any, wanted: bool | str | Path | None) -> tuple[Cache | None, list[str]]:
    """
    Return the cache of a sweep; or None, with reasons if the results of a scene file cannot be cached.

    Raises
    ------
    MistrayError
        If a cache is requested that is impossible.
    """
    if wanted is False:
        return None, []
    reason = None
    if not isinstance(source, Path):
        reason = "sweep: only results of scene files are cached, whose content can be compared; give the scene's file"
    elif others := foreign_plugins(scene):
        reason = (
            f"sweep: the code of plugins from elsewhere ({', '.join(others)}) may change, so that nothing is cached"
        )
    if reason is None:
        return open_cache(wanted), []
    if wanted is not None:
        raise MistrayError(f"{reason}, or leave out the cache")
    return None, [reason] if isinstance(source, Path) else []


def _wavelengths(scene: Any, wavelength_nm: float | Sequence[float] | None) -> list[float]:
    """
    Return the wavelengths of a sweep, nm: the given ones, or those of the scene's source.

    Raises
    ------
    MistrayError
        If a wavelength is given twice, or none is given and the sources have several spectra.
    """
    if wavelength_nm is None and len({tuple(source.wavelengths_nm) for source in source_emitters(scene)}) > 1:
        raise MistrayError("sweep: the sources of the scene have several spectra; give wavelength_nm")
    found = spectrum_of(scene, None, None) if wavelength_nm is None else spectrum(wavelength_nm, None)
    return [float(value) for value in found[0]]


def _angles(
    scene: Any, field_deg: Sequence[float] | None, azimuth_deg: float | None, wavelength_nm: float
) -> list[float]:
    """
    Return the field angles of a sweep, degrees: the given ones without duplicates, or that of the scene's source.

    It is 0 if the source has no field angle.

    Raises
    ------
    MistrayError
        If the sources have several field angles and none is given, or the light cannot have one.
    """
    if field_deg is None:
        own = {float(emitter.field_deg) for emitter in source_emitters(scene)}
        if len(own) > 1:
            raise MistrayError("sweep: the sources of the scene have several field angles; give field_deg")
        angles = list(own) or [0.0]
    else:
        angles = list(dict.fromkeys(field_deg))
    for angle in angles:  # before the first is traced
        scene_sources(scene, angle, azimuth_deg, wavelength_nm)
    return angles


def _part(progress: Progress | None, done: int, rows: int) -> Callable[[int, int], None] | None:
    """
    Return a progress callback for one trace, which reports it as part of the whole sweep.

    The result is None without `progress`.
    """
    if progress is None:
        return None
    return lambda rays, of: progress(done + rays / of, rows)

"""`mistray ghosts`."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

from mistray.cli.ghosts_json import WORST_SHOWN, as_json
from mistray.cli.options import Options
from mistray.cli.progress import progress_bar
from mistray.errors import Interrupted, MistrayError, UnfinishedError
from mistray.ranges import AZIMUTH_DEG, BLOCK, CONTESTED_RAYS, FIELD_DEG, PART, PLACE_MM, ROWS, SECONDS, STOPS
from mistray.time_budget import within
from mistray.toolkit.arguments import pairs
from mistray.toolkit.command import Command, Group, Option
from mistray.toolkit.shared_options import (
    DETECTOR,
    MAP_FORMATS,
    SCATTER,
    SCENE,
    SCHEDULER,
    SENSORS,
    SOURCE,
    SPECTRUM,
    SURFACES,
    TABLE_FORMATS,
    TIME,
    output,
    ray_tree,
)

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd

    from mistray.analyses.ghosts.colour import Look
    from mistray.analyses.ghosts.result import GhostReport


# Of --seconds: the maps of a report trace the same rays again, and pictures take seconds, more with each field
SHARE_OF_TRACE = 0.5
PAGE_S, FIELD_S = 4.0, 1.0
ALL_ALIASES = ("part", "space")
# Of `mistray.metrics.ranking` and `mistray.analyses.ghosts.path_analysis`, not imported to parse a command line
RANKS = ("rms", "power", "peak")
SORT_KEYS = ("power_W", "objects", "branches", "last_object", "unique_objects", "opl_mm", "diffractions")
RAY_FORMAT = "dat"  # rays as a source file of Zemax
MOST_RAYS = 10_000
OF_COLOUR = ("stops", "reference", "white", "block")  # options of the colour pictures

# What --out writes
PAGE = "report.html"
FILES = (
    PAGE,
    "summary*.csv",
    "paths*.csv",
    "energy*.csv",
    "surfaces*.csv",
    "scatter*.csv",
    "stray_levels.csv",
    "aiming.csv",
    "aliased_paths.csv",
    "path_analysis.csv",
    "filtered_*.csv",
    "rays_at.csv",
    "rays_at_*deg.dat",
    "probes.csv",
    "far_fields.csv",
    "surface_maps.csv",
    "light_maps.csv",
    "flux_split.csv",
    "luminous_flux.csv",
    "photometric.csv",
    "overview*.png",
    "levels.png",
    "ghosts_*deg.png",
    "layout_*deg.png",
    "surface_maps_*deg.png",
    "light_maps_*deg.png",
    "colour_*deg.png",
    "path_sort_*deg.txt",
)


CONTESTED = Option(
    "--contested-rays",
    "start rays of a field where by RMS irradiance another path may be as bright as "
    "the worst: it is traced again (4 times --rays; 0: never)",
    CONTESTED_RAYS,
    "N",
)
_pattern = pairs("no alias; give PATTERN=NAME, part or space")


def _alias(text: str) -> str | tuple[str, str]:
    """PATTERN=NAME, or a word for all surfaces."""
    return text if text in ALL_ALIASES else _pattern(text)


# fmt: off
COMMAND = Command(
    "ghosts",
    "trace the ghosts and the scattered light of a scene and rank them",
    "Trace a scene at one or more field angles and list all paths to the detector. Stray paths are ranked\n"
    "by RMS irradiance P/(π r_rms²), by power or by their brightest pixel. The strongest path by power is\n"
    "always listed.",
    (
        "mistray ghosts phone_camera --field-deg 0 5 10 15 20 25 27 --out out",
        "mistray ghosts scene.xml --wavelength-nm 620 --rays 1e7 --json",
        "mistray ghosts scene.xml --probe 0,0,17,half_width=20,half_height=20,id=stop --out out",
        "mistray ghosts double_gauss_barrel --field-deg 20 --surface-maps 'barrel*' hood --out out",
        "mistray ghosts double_gauss_barrel --field-deg 20 --maps ghost 'S(barrel*)' --out out",
        "mistray ghosts phone_camera --field-deg 20 --rays-at 'barrel*' --filter G --formats dat --out out",
        "mistray ghosts phone_camera --wavelength-nm 450 555 650 --weights 1 2 1 --photometric",
        "mistray ghosts scene.xml --max-scatters 2 --max-reflections 1 --aimed-rays 4 --out out",
        "mistray ghosts scene.xml --out out --formats parquet fits",
        "mistray ghosts scene.xml --rays 1e9 --scheduler tcp://host:8786 --out out    # docs/distributed.md",
        "mistray ghosts scene.xml --wavelength-nm 450 550 650 --weights 1 2 1 --colour --out out",
    ),
    (
        SCENE,
        Group("source (default: as the scene says)", (
            Option("--field-deg", "field angles, degrees", FIELD_DEG, "DEG", "+"),
            Option("--field-mm", "object heights of a near source instead, mm", PLACE_MM, "MM", "+"),
            Option("--azimuth-deg", "azimuth of the field about z, degrees", AZIMUTH_DEG, "DEG"),
            *SPECTRUM,
            SOURCE,
            DETECTOR,
            *SENSORS,
        )),
        ray_tree("start rays at each field (1e6)", CONTESTED, TIME, SCHEDULER),
        SURFACES,
        SCATTER,
        output("report.html, CSV, PNG and path-sort files", FILES,
               Option("--rank", "what the list of worst paths goes by: RMS irradiance, power, or peak, the brightest "
                      "pixel, for which the rays are traced again (rms)", RANKS, default="rms"),
               Option("--per-wavelength", "add paths and ledgers at each wavelength", bool),
               Option("--levels", "print stray light by level of scatter or splitting and by critical surface", bool),
               Option("--alias", "add the paths with surfaces under other names, such as 'L1_*=L1'; or part or space: "
                      "by part, by optical space; with --out aliased_paths.csv", _alias, "PATTERN=NAME", "+"),
               Option("--path-analysis", "add the paths sorted by a key: "
                      f"{', '.join(SORT_KEYS)}; with --out path_analysis.csv", SORT_KEYS, "KEY"),
               Option("--least-share", "in the path analysis paths below this share of all light stand together (0)",
                      PART, "S"),
               Option("--filter", "add the paths that pass a filter, such as 'G(lens*) & !S', or have a name, such as "
                      "'L2_rear -> L1_front' (docs/rays.md); with --out filtered_paths.csv and filtered_rays.csv",
                      metavar="EXPR"),
               Option("--photometric", "add lm, lx, cd and cd/m², of visible wavelengths (docs/detectors.md)", bool),
               Option("--rays-at", "write rays_at.csv: rays that arrive at surfaces or parts, or that are blocked, "
                      "escaped or returned, and pass --filter (docs/rays.md); with --formats dat as Zemax files "
                      "too", None, "WHERE", "+"),
               Option("--most-rays", f"rays of --rays-at at each field, spread over the beams ({MOST_RAYS}); 0: all",
                      ROWS, "N"),
               Option("--maps", "map parts of the light on the detector, and on surfaces of --surface-maps: kinds such "
                      "as ghost or stray, filters or names of paths (docs/surface_maps.md)", None, "LIGHT", "+"),
               formats=(*TABLE_FORMATS, *MAP_FORMATS, RAY_FORMAT)),
        Group("colour pictures (need --out and three wavelengths or more)", (
            Option("--colour", "draw the ghosts as a photograph would show them", bool),
            Option("--stops", "exposure, stops over the one that just fills the brightest channel (0)", STOPS, "S"),
            Option("--reference", "brightest pixel of the stray light, or of the direct image on axis (ghosts)",
                   ("ghosts", "direct")),
            Option("--white", "what comes out as grey: the light of the source, or D65 (source)", ("source", "D65")),
            Option("--block", "pixels averaged along each side; 0: as many as the noise asks for (0)", BLOCK, "N"),
        )),
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    options.start()
    from mistray.analyses.ghosts.result import ghosts
    from mistray.analyses.ghosts.tables.ghosts import main_table
    from mistray.trace.check_paths import check_paths

    if options.field_mm and options.field_deg:
        raise MistrayError("--field-deg and --field-mm are given; give one of them")
    look = _look(options)
    _aliases(options.alias)
    if options.path_analysis is None:
        options.refuse(["least_share"], " is about the path analysis; add --path-analysis power_W, or leave it out")
    if not 0 <= (options.least_share or 0.0) < 1:
        raise MistrayError(f"--least-share is {options.least_share:g}; it is a share of all light, 0 to 1")
    scene = options.load()
    check_paths(scene, [options.filter] if options.filter else [])  # before anything is traced
    if options.maps:
        _check_maps(scene, options.maps)
    _check_rays(scene, options)
    if options.photometric:
        from mistray.trace.photometry import check_light

        check_light(scene, options.wavelength_nm)
    if options.field_mm:
        from mistray.sampling.sources import field_of

        options.field_deg = [field_of(scene, height) for height in options.field_mm]
    if look is not None:
        from mistray.analyses.ghosts.colour import check_wavelengths

        check_wavelengths(options.wavelength_nm or _own_wavelengths(scene))
    lines = options.per_wavelength
    files, report = [], None
    try:
        # The maps of the report are traced by the workers as well
        with within(options.seconds_left(0.0)), options.workers():
            with progress_bar(options) as progress:
                report = ghosts(
                    scene,
                    field_deg=options.field_deg,
                    azimuth_deg=options.azimuth_deg,
                    progress=progress,
                    rank=options.rank,
                    seconds=_seconds_of_trace(options),
                    contested_rays=options.contested_rays,
                    detector=options.detector,
                    **options.spectral_settings(),
                )
            if options.rank == "peak":
                with options.working("mapping the paths"):
                    for field in report:
                        report.table(field)
            report.photometric = options.photometric
            if options.maps:
                with options.working("mapping the light"):
                    report.map_light(options.maps)
            extra = _Extra(report, options)
            if options.out is not None:
                files = _write_report(report, extra, options, look)
    except UnfinishedError as error:
        if report is not None:  # all is traced, but for the maps
            error.partial = report
        _write_unfinished(error, options)
        raise
    except KeyboardInterrupt as error:
        finished = error.partial if isinstance(error, Interrupted) else report
        if not isinstance(finished, Mapping) or not finished or options.out is None:
            raise KeyboardInterrupt from None
        _write_tables(finished, options)
        raise Interrupted(f"{error}" if isinstance(error, Interrupted) else "all is traced", finished) from None

    def text() -> str:
        return "\n\n".join([main_table(report, WORST_SHOWN, lines), *extra.texts()])

    return options.show(lambda: as_json(report, lines, options.filter, extra.tables), text, files)


def _check_maps(scene: Any, selections: list[str]) -> None:
    """Refuse parts of the light that cannot be: on surfaces they are known by their events alone."""
    from mistray.recorders import SurfaceMaps
    from mistray.trace.check_paths import check_paths
    from mistray.trace.elsewhere import check_columns
    from mistray.trace.path_filter import PathFilter

    check_paths(scene, selections)
    recorders = (sensor.recorder() for sensor in scene.sensors() if hasattr(sensor, "recorder"))
    if any(isinstance(one, SurfaceMaps) for one in recorders):
        for text in selections:
            check_columns(PathFilter(text))


def _check_rays(scene: Any, options: Options) -> None:
    """Refuse rays at what there is not, and rays that go nowhere."""
    from mistray.trace.check_paths import check_paths
    from mistray.trace.elsewhere import check_columns, check_where
    from mistray.trace.path_filter import PathFilter

    if options.rays_at is None:
        options.refuse(["most_rays"], " is about the rays of --rays-at; add it, or leave this out")
        if RAY_FORMAT in options.formats:
            raise MistrayError(f"--formats {RAY_FORMAT} writes the rays of --rays-at; add it, or leave the format out")
        return
    if options.out is None:
        raise MistrayError("--rays-at writes rays_at.csv; say with --out where it shall go")
    check_paths(scene, [f'H("{name}")' for name in check_where(options.rays_at)])
    if options.filter:
        check_columns(PathFilter(options.filter))


def _seconds_of_trace(options: Options) -> float | None:
    """Return the part of --seconds that the trace has, so that the report of its rays is written in time, too."""
    left = options.seconds_left(PAGE_S + FIELD_S * len(options.field_deg or [None]))
    if left is None or options.out is None:
        return left
    return max(SHARE_OF_TRACE * left, SECONDS.low)


def _write_report(report: GhostReport, extra: _Extra, options: Options, look: Look | None) -> list[Path]:
    """All files; where there is no room for them the tables, as many as there is room for."""
    from mistray.analyses.ghosts.page.output import write_all
    from mistray.analyses.ghosts.tables.ghosts import main_table
    from mistray.replace_folder import replacing_folder

    try:
        with options.working("drawing the report"), replacing_folder(options.out):
            pdf = "pdf" in options.formats
            named = (options.title, options.command_line)
            files = write_all(report, options.out, *named, options.per_wavelength, look, pdf)
            return files + extra.write() + _write_formats(report, extra, options)
    except UnfinishedError:
        raise
    except MistrayError as error:
        kept = ", ".join(path.name for path in _write_tables(report, options)) or "nothing"
        traced = ", ".join(f"{field:g}" for field in report)
        print(main_table(report, WORST_SHOWN, options.per_wavelength))
        raise MistrayError(
            f"{error}; of the fields {traced} deg {kept} is written, and the main table is printed"
        ) from None


class _Extra:
    """Tables that are requested beside the main ones; made at once, so that a wrong name shows before the drawing."""

    def __init__(self, report: GhostReport, options: Options) -> None:
        from mistray.analyses.ghosts.tables.ghosts_csv import alias_frame, analysis_frame, filter_frame, filter_rays

        self._report, self._options = report, options
        self._aliases = _aliases(options.alias)
        self.tables: dict[str, pd.DataFrame] = {}
        self._rays = None
        if options.filter:
            self._filtered = filter_frame(report, options.filter)
            self._rays = partial(filter_rays, report, options.filter)
        if self._aliases is not None:
            self.tables["aliased_paths"] = alias_frame(report, self._aliases)
        if options.path_analysis:
            self.tables["path_analysis"] = analysis_frame(report, options.path_analysis, options.least_share or 0.0)

    def texts(self) -> list[str]:
        """Return the texts that are printed."""
        from mistray.analyses.ghosts.tables.levels import alias_text, analysis_text, filter_text, level_text

        options = self._options
        parts = [level_text(self._report)] if options.levels else []
        parts += [alias_text(self._report, self._aliases)] if self._aliases is not None else []
        if options.path_analysis:
            parts.append(analysis_text(self.tables["path_analysis"], options.path_analysis))
        return parts + ([filter_text(self._report, options.filter)] if options.filter else [])

    @cached_property
    def frames(self) -> dict[str, pd.DataFrame]:
        """The tables that are written, by file name; rays are traced when they are."""
        from mistray.analyses.ghosts.tables.ghosts_csv import rays_at_frame

        options, tables = self._options, dict(self.tables)
        if self._rays is not None:
            tables |= {"filtered_paths": self._filtered, "filtered_rays": self._rays()}
        if options.rays_at:
            most = MOST_RAYS if options.most_rays is None else options.most_rays or None
            tables["rays_at"] = rays_at_frame(self._report, options.rays_at, options.filter or "", most)
        return {f"{name}.csv": table for name, table in tables.items()}

    def write(self) -> list[Path]:
        """The tables as CSV."""
        from mistray.toolkit.pages.output import csv_text, write_files

        files = {name: csv_text(table, in_full=True) for name, table in self.frames.items()}
        return write_files(files, self._options.out) if files else []

    def ray_files(self) -> list[Path]:
        """The rays of --rays-at of each field as a source file of Zemax."""
        from mistray.files.ray_sets import RaySet, save_ray_set

        rays, out = self.frames["rays_at.csv"], self._options.out
        return [
            save_ray_set(out / f"rays_at_{field:g}deg.{RAY_FORMAT}", RaySet.of_table(own))
            for field, own in rays.groupby("field_deg")
            if own.flux_W.sum() > 0
        ]


def _aliases(words: list[str | tuple[str, str]] | None) -> dict[str, str] | str | None:
    """Return the aliases as `mistray.trace.PathTable.by_way` takes them."""
    if words is None:
        return None
    alone = [word for word in words if isinstance(word, str)]
    if alone and len(words) > 1:
        raise MistrayError(f"--alias {alone[0]} stands for all surfaces; give it alone")
    if alone:
        return alone[0]
    return dict(word for word in words if not isinstance(word, str))


def _write_unfinished(error: UnfinishedError, options: Options) -> None:
    """Write the fields that are finished, and of the last the rays that are, with maps that are traced here."""
    from mistray.analyses.ghosts.page.output import write_all
    from mistray.analyses.ghosts.result import GhostReport

    report = error.partial
    if options.out is None or not isinstance(report, GhostReport):
        return
    rays = "; ".join(f"{field:g}°: {t.rays_traced:.4g} of {t.rays_planned:.4g} rays" for field, t in report.items())
    title = f"{options.title}, unfinished ({rays})"
    with options.working("drawing what is finished"):
        write_all(report, options.out, title, options.command_line, options.per_wavelength, None)
    error.args = (f"{error}; a report of what is finished is in {options.out}",)


def _write_tables(report: Any, options: Options) -> list[Path]:
    """Write the tables of what is finished, as many as there is room for; maps would take as long as the trace has."""
    from mistray.analyses.ghosts.result import GhostReport
    from mistray.analyses.ghosts.tables.ghosts_csv import csv_tables
    from mistray.replace_file import replace_file
    from mistray.toolkit.pages.output import csv_text

    files: list[Path] = []
    if isinstance(report, GhostReport):
        with contextlib.suppress(OSError, MistrayError):
            options.out.mkdir(parents=True, exist_ok=True)
            for name, table in csv_tables(report, options.per_wavelength).items():
                files.append(replace_file(options.out / name, csv_text(table, in_full=True), "table"))
    return files


def _write_formats(report: GhostReport, extra: _Extra, options: Options) -> list[Path]:
    """The tables as Parquet, rays as files of Zemax, and irradiance_<field>deg in the other formats."""
    from mistray.analyses.ghosts.page.light_maps import light_map_files
    from mistray.analyses.ghosts.page.passing import passing_maps
    from mistray.analyses.ghosts.page.surface_maps import surface_map_files
    from mistray.analyses.ghosts.tables.ghosts_csv import csv_tables
    from mistray.files.irradiance_files import LUX, IrradianceMap
    from mistray.toolkit.pages.formats import write_formats

    tables = csv_tables(report, options.per_wavelength) | extra.frames
    rays = extra.ray_files() if RAY_FORMAT in options.formats else []
    formats = [name for name in options.formats if name != RAY_FORMAT]
    maps = {f"irradiance_{field:g}deg": IrradianceMap.of(t) for field, t in report.items()}
    if report.photometric:
        maps |= {f"illuminance_{field:g}deg": IrradianceMap.of(t, LUX) for field, t in report.items()}
    maps |= passing_maps(report) | surface_map_files(report) | light_map_files(report)
    return rays + write_formats(formats, options.out, tables, maps, {"command": options.command_line})


def _look(options: Options) -> Look | None:
    """How colour pictures shall look; None if there shall be none."""
    if not options.colour:
        options.refuse(OF_COLOUR, " is about colour pictures; add --colour, or leave it out")
        return None
    if options.out is None:
        raise MistrayError("--colour draws pictures; say with --out where they shall go")
    from mistray.analyses.ghosts.colour import Look

    return Look(**options.given(*OF_COLOUR))


def _own_wavelengths(scene: Any) -> list[float]:
    return sorted({float(nm) for emitter in scene.emitters() for nm in getattr(emitter, "wavelengths_nm", ())})

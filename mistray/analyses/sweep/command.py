"""Command `mistray sweep`, which traces all fields at all wavelengths in all configurations of a scene."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.errors import MistrayError, UnfinishedError, nearest
from mistray.time_budget import within
from mistray.toolkit.command import Command, Group, Option
from mistray.toolkit.field_options import group, options_of, request_of
from mistray.toolkit.shared_options import (
    SCATTER,
    SCENE,
    SCHEDULER,
    SURFACES,
    TABLE_FORMATS,
    TIME,
    output,
    ray_tree,
)

if TYPE_CHECKING:
    from mistray.analyses.sweep.configurations import Configuration
    from mistray.analyses.sweep.result import Sweep
    from mistray.cli.parsed_options import Options

COATING, PAINT, _ = SURFACES.options
OF_FIELDS = ("field_deg", "azimuth_deg", "seconds", "no_cache")  # options that mean nothing for a PST
OF_A_TRACE = ("field_deg", "azimuth_deg", "pst_field_deg", "rank", "step", "wavelength_nm", "rays", "out")
OF_PST = ("coating", "paint")  # options that mean nothing without one

COMMAND = Command(
    "sweep",
    "trace all fields at all wavelengths in all configurations: one table",
    "Trace a scene at every field and wavelength, in every configuration: zoom positions, coatings,\n"
    "temperatures as shifts of indices, whatever parameters of the scene say. STUDY is a TOML file with the\n"
    "configurations; docs/sweeps.md describes it. Rows that were traced before come from the cache.",
    (
        "mistray sweep cooke_triplet --field-deg 0 10 20 --wavelength-nm 450 550 650",
        "mistray sweep cooke_triplet examples/triplet_states.toml --field-deg 0 20 --rays 1e5 --out out/sweep",
        "mistray sweep scene.xml states.toml --json --no-cache",
        "mistray sweep baffle_tube edits.toml --pst-field-deg 10:60:10 --rays 1e6    # what each edit does",
        "mistray sweep baffle_tube --set tube_vane_3.z=2 --pst-field-deg 20:40:10     # a vane moved by 2 mm",
        "mistray sweep baffle_tube --pst-field-deg 10:60:10 --rank --step rim=0.5     # which would pay",
        "mistray sweep baffle_tube --set tube_vane_3.z=2 --write-scene moved.xml      # a file of it",
    ),
    lambda request: (
        SCENE,
        Option("study", "TOML file with the configurations (the scene as it is)", Path, "STUDY", "?"),
        group("what is traced (default: as the scene says)", request.SweepRequest, "field_deg", "light"),
        Group(
            "what is compared by the PST instead",
            (
                *options_of(request.SweepChoice, "pst_field_deg", "rank"),
                *options_of(request.RankingRequest, "steps"),
            ),
        ),
        Group(
            "one more configuration, beside the scene as it is",
            (
                *options_of(request.SweepChoice, "set"),
                Option(
                    "--write-scene",
                    "write the scene with this configuration, or with the one of STUDY that --configuration names, and "
                    "trace nothing",
                    Path,
                    "FILE",
                    writes=(),
                ),
                Option("--configuration", "with --write-scene: the one of STUDY, by its name", metavar="NAME"),
            ),
        ),
        Group("its coatings and paint, with --pst-field-deg", (COATING, PAINT)),
        ray_tree("start rays of every row (1e6; 4e6 with --pst-field-deg)", TIME, SCHEDULER),
        SCATTER,
        output(
            "report.html, CSV files, JSON and a picture",
            ("report.html", "configurations.csv", "sweep.*", "pst_sweep.*", "edit_ranking.*"),
            Option("--no-cache", "neither read results from the cache nor keep them", bool),
            formats=TABLE_FORMATS,
        ),
    ),
    __package__,
)


def run(options: Options) -> int:
    """Run `mistray sweep` with parsed options and return the exit code."""
    from mistray.analyses.sweep.request import SweepRequest

    if options.write_scene is not None:
        return _write_scene(options)
    options.refuse(["configuration"], " names what is written; add --write-scene FILE")
    if options.pst_field_deg is not None:
        return _run_pst(options)
    if options.rank or options.step:
        raise MistrayError("--rank and --step are about the PST; give its field angles with --pst-field-deg")
    options.refuse(OF_PST, " is compared by its PST; give --pst-field-deg as well")
    request = request_of(SweepRequest, vars(options))
    options.start()
    from mistray.analyses.sweep import page
    from mistray.analyses.sweep.configurations import AS_IT_IS, Configuration
    from mistray.analyses.sweep.result import Sweep
    from mistray.analyses.sweep.run import run as sweep

    configurations = _configurations(options)
    if options.study is None and configurations:
        configurations.insert(0, Configuration(AS_IT_IS))
    before = _entries(options)
    how: dict[str, Any] = {"configurations": configurations or None, "cache": False if options.no_cache else None}

    def write(result: Sweep, note: str = "") -> list[Path]:
        return options.write(lambda title, command: page.page(result, title, command), note=note)

    try:
        # The scene is loaded in that time as well
        with options.tracing() as progress, within(options.seconds_left()):
            result = sweep(options.scene, request, progress=progress, **how)
    except UnfinishedError as error:
        if options.out is not None and isinstance(error.partial, Sweep) and error.partial.rows:
            write(error.partial, ", unfinished")
            error.args = (f"{error}; the rows that are finished are in {options.out}",)
        raise
    except KeyboardInterrupt:
        if _entries(options) <= before:
            raise
        return options.interrupted("finished rows are in the cache, the same command goes on")
    for warning in result.warnings:
        print(f"mistray: warning: {warning}", file=sys.stderr)
    return options.show(lambda: page.record(result), lambda: page.text(result), write(result))


def _run_pst(options: Options) -> int:
    """Compute and print the effect of configurations or edits on the PST, write its files, and return the exit code."""
    from mistray.analyses.sweep.request import EditsRequest, RankingRequest

    options.refuse(OF_FIELDS, " is for traces of fields; leave it out with --pst-field-deg")
    if options.study is None and not (_edited(options) or options.rank):
        raise MistrayError(
            "--pst-field-deg compares configurations; give --set, --coating, --paint, a TOML file with them, or --rank"
        )
    if options.step and not options.rank:
        raise MistrayError("--step is about the ranking; give --rank as well, or leave it out")
    edits, ranked = request_of(EditsRequest, vars(options)), request_of(RankingRequest, vars(options))
    options.start()
    from mistray.analyses.sweep import edit_page as page
    from mistray.analyses.sweep.edit_ranking import run as rank_edits
    from mistray.analyses.sweep.pst_sweep import run as sweep_pst

    found, ranking = None, None
    if options.study is not None or _edited(options):
        with options.tracing() as progress:
            configurations = _configurations(options)
            found = sweep_pst(options.scene, edits, configurations=configurations, progress=progress)
    if options.rank:
        with options.tracing() as progress:
            ranking = rank_edits(options.scene, ranked, progress=progress)
    files = options.write(lambda title, command: page.page(found, ranking, title, command))
    return options.show(lambda: page.record(found, ranking), lambda: page.text(found, ranking), files)


def _write_scene(options: Options) -> int:
    """Write the scene with one configuration to a file, and return the exit code."""
    options.refuse(OF_A_TRACE, " has no effect with --write-scene, which traces nothing; leave it out")
    options.start()
    options.claim()
    from mistray.analyses.sweep.write_configuration import write_configuration

    known = {one.name: one for one in _configurations(options)}
    name = options.configuration or (next(iter(known)) if len(known) == 1 else "")
    if name not in known:
        what = f"there is no configuration '{name}'" if name else "--write-scene writes one configuration"
        remedy = nearest(name, known) if known else "give --set, or a TOML file and --configuration"
        raise MistrayError(f"{what}; {remedy}")
    with options.working("writing the scene"):
        file = write_configuration(options.scene, known[name], options.write_scene)
    return options.tell(lambda: {"configuration": name}, lambda: f"configuration: {name}", [file])


def _edited(options: Options) -> bool:
    """True if options of the command line define a configuration (--set, --coating or --paint)."""
    return bool(options.set or options.coating or options.paint)


def _configurations(options: Options) -> list[Configuration]:
    """Return the configurations in the file, and the one defined by options, which is named by its changes."""
    from mistray.analyses.sweep.configurations import Configuration
    from mistray.analyses.sweep.read_configurations import read_configurations

    found = [] if options.study is None else read_configurations(options.study)
    if _edited(options):
        values, coat, paint = (dict(given or ()) for given in (options.set, options.coating, options.paint))
        for key, value in options.set or ():
            if value != values[key]:
                raise MistrayError(f"--set: {key} is {value:g} and {values[key]:g}; give one value")
        changes = [f"{key} = {value:g}" for key, value in values.items()]
        changes += [f"{pattern} = {look}" for pattern, look in (coat | paint).items()]
        found.append(Configuration(", ".join(changes), values, paint, coat))
    return found


def _entries(options: Options) -> int:
    """Return the number of entries of the cache; 0 if there is no cache or it cannot be read."""
    from mistray.cache import open_cache

    cache = open_cache(False if options.no_cache else None)
    try:
        return 0 if cache is None else cache.contents().entries
    except MistrayError:  # the sweep will say so
        return 0

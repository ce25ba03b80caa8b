"""`mistray sweep`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.options import Options
from mistray.cli.signals import ignore
from mistray.errors import MistrayError, UnfinishedError, nearest
from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, FINITE, PST_FIELD_DEG
from mistray.supervisor import INTERRUPTED
from mistray.time_budget import within
from mistray.toolkit.arguments import pairs
from mistray.toolkit.command import Command, Group, Option, angles
from mistray.toolkit.shared_options import (
    SCATTER,
    SCENE,
    SCHEDULER,
    SPECTRUM,
    SURFACES,
    TABLE_FORMATS,
    TIME,
    output,
    ray_tree,
)

if TYPE_CHECKING:
    from mistray.analyses.sweep.configurations import Configuration
    from mistray.analyses.sweep.result import Sweep

# What --out writes
FILES = ("report.html", "configurations.csv", "sweep.*", "pst_sweep.*", "edit_ranking.*")
COATING, PAINT, _ = SURFACES.options
OF_FIELDS = ("field_deg", "azimuth_deg", "seconds", "no_cache")  # options that mean nothing for a PST
OF_A_TRACE = ("field_deg", "azimuth_deg", "pst_field_deg", "rank", "step", "wavelength_nm", "rays", "out")
OF_PST = ("coating", "paint")  # options that mean nothing without one

# fmt: off
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
    (
        SCENE,
        Option("study", "TOML file with the configurations (the scene as it is)", Path, "STUDY", "?"),
        Group("what is traced (default: as the scene says)", (
            Option("--field-deg", "field angles, degrees", FIELD_DEG, "DEG", "+"),
            Option("--azimuth-deg", "azimuth of the fields about z, degrees", AZIMUTH_DEG, "DEG"),
            angles("--pst-field-deg", "instead of fields: the PST at these field angles before and after what each "
                   "configuration moves, paints, coats or blocks", PST_FIELD_DEG),
            Option("--rank", "with --pst-field-deg: rank what can be moved, blocked, painted and coated by the "
                   "derivatives of the stray PST; STUDY may be left out", bool),
            Option("--step", "of --rank: steps by kind (position, tilt, rim, scatter, share, coating), key or pattern, "
                   "such as rim=0.5 or paint.reflectance=2% (0.1 mm and deg; 1% of scatter and R; 1 nm)",
                   pairs("no step; write KEY=STEP, such as rim=0.5 or paint.reflectance=2%"), "KEY=STEP", "+"),
            SPECTRUM[0],
        )),
        Group("one more configuration, beside the scene as it is", (
            Option("--set", "values of parameters, 'hood.z=-5' (a shift), 'L1_front.bsdf.R=0.01': keys, groups "
                   "or patterns, in the unit of the parameter",
                   pairs("no value; write KEY=VALUE, such as hood.z=-5", FINITE), "KEY=VALUE", "+", extends=True),
            Option("--write-scene", "write the scene with this configuration, or with the one of STUDY that "
                   "--configuration names, and trace nothing", Path, "FILE", writes=()),
            Option("--configuration", "with --write-scene: the one of STUDY, by its name", metavar="NAME"),
            Option("--coating", f"with --pst-field-deg: {COATING.help}", COATING.type, COATING.metavar, "+",
                   extends=True),
            Option("--paint", f"with --pst-field-deg: {PAINT.help}", PAINT.type, PAINT.metavar, "+", extends=True),
        )),
        ray_tree("start rays of every row (1e6; 4e6 with --pst-field-deg)", TIME, SCHEDULER),
        SCATTER,
        output("report.html, CSV files, JSON and a picture", FILES,
               Option("--no-cache", "neither read results from the cache nor keep them", bool), formats=TABLE_FORMATS),
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    if options.write_scene is not None:
        return _write_scene(options)
    options.refuse(["configuration"], " names what is written; add --write-scene FILE")
    if options.pst_field_deg is not None:
        return _run_pst(options)
    if options.rank or options.step:
        raise MistrayError("--rank and --step are about the PST; give its field angles with --pst-field-deg")
    options.refuse(OF_PST, " is compared by its PST; give --pst-field-deg as well")
    options.start()
    from mistray.analyses.sweep.configurations import AS_IT_IS, Configuration
    from mistray.analyses.sweep.page import sweep_record, sweep_text
    from mistray.analyses.sweep.result import Sweep
    from mistray.analyses.sweep.run import sweep

    configurations = _configurations(options)
    if options.study is None and configurations:
        configurations.insert(0, Configuration(AS_IT_IS))
    before = _entries(options)
    try:
        # The scene is loaded in that time as well
        with options.tracing() as progress, within(options.seconds_left()):
            result = sweep(
                options.scene,
                options.field_deg,
                options.wavelength_nm,
                configurations or None,
                azimuth_deg=options.azimuth_deg,
                cache=False if options.no_cache else None,
                progress=progress,
                **options.settings(),
            )
    except UnfinishedError as error:
        if options.out is not None and isinstance(error.partial, Sweep) and error.partial.rows:
            _write(error.partial, options, ", unfinished")
            error.args = (f"{error}; the rows that are finished are in {options.out}",)
        raise
    except KeyboardInterrupt:
        if _entries(options) <= before:
            raise
        ignore()
        print("mistray: interrupted; finished rows are in the cache, the same command goes on", file=sys.stderr)
        return INTERRUPTED
    for warning in result.warnings:
        print(f"mistray: warning: {warning}", file=sys.stderr)
    return options.show(lambda: sweep_record(result), lambda: sweep_text(result), _write(result, options))


def _run_pst(options: Options) -> int:
    """Compute and show the effect of the configurations on the PST."""
    options.refuse(OF_FIELDS, " is for traces of fields; leave it out with --pst-field-deg")
    if options.study is None and not (_edited(options) or options.rank):
        raise MistrayError(
            "--pst-field-deg compares configurations; give --set, --coating, --paint, a TOML file with them, or --rank"
        )
    if options.step and not options.rank:
        raise MistrayError("--step is about the ranking; give --rank as well, or leave it out")
    options.start()
    from mistray.analyses.sweep import edit_tables as edits
    from mistray.analyses.sweep.edit_page import edits_report
    from mistray.analyses.sweep.edit_ranking import rank_edits
    from mistray.analyses.sweep.pst_sweep import sweep_pst

    angles_deg, settings = options.pst_field_deg, {"wavelength_nm": options.wavelength_nm, **options.settings()}
    record: dict[str, Any] = {}
    texts: list[str] = []
    found, ranking = None, None
    if options.study is not None or _edited(options):
        with options.tracing() as progress:
            configurations = _configurations(options)
            found = sweep_pst(options.scene, configurations, angles_deg, progress=progress, **settings)
        record |= edits.pst_sweep_record(found)
        texts.append(edits.pst_sweep_text(found))
    if options.rank:
        given = {key: value for key, value in settings.items() if value is not None}
        with options.tracing() as progress:
            ranking = rank_edits(options.scene, angles_deg, steps=dict(options.step or ()), progress=progress, **given)
        record |= edits.edit_ranking_record(ranking)
        texts.append(edits.edit_ranking_text(ranking))
    files = options.write(lambda title, command: edits_report(found, ranking, title, command))
    return options.show(lambda: record, lambda: "\n\n".join(texts), files)


def _write_scene(options: Options) -> int:
    """The scene with one configuration, as a file."""
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
    """Whether there is a configuration on the command line."""
    return bool(options.set or options.coating or options.paint)


def _configurations(options: Options) -> list[Configuration]:
    """Return the configurations of the file, and that of the command line, which is named by what it changes."""
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
    """Results in the cache; 0 without one."""
    from mistray.cache import open_cache

    cache = open_cache(False if options.no_cache else None)
    try:
        return 0 if cache is None else cache.contents().entries
    except MistrayError:  # the sweep will say so
        return 0


def _write(result: Sweep, options: Options, note: str = "") -> list[Path]:
    from mistray.analyses.sweep.page import sweep_report

    return options.write(lambda title, command: sweep_report(result, title, command), note=note)

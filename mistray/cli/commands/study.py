"""`mistray study`."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mistray.cli.options import Options
from mistray.cli.progress import terminal_bar
from mistray.cli.saved_run import SavedRun
from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, PST_FIELD_DEG, RELATIVE_ERROR
from mistray.toolkit.arguments import FIELD_ANGLES
from mistray.toolkit.command import Command, Group, Option, angles
from mistray.toolkit.shared_options import (
    NEXT_ORDER,
    SCATTER,
    SCENE,
    SCHEDULER,
    SOURCE,
    SPECTRUM,
    SURFACES,
    TABLE_FORMATS,
    TIME,
    output,
    ray_tree,
)

STATE = "pst_state.npz"
STEPS = 8
PAGE_S = 7.0  # of the report, see `Options.seconds_left`: all figures of the ghosts, the objects and the PST

# What --out writes
FILES = ("report.html", "[1-8]_*.csv", STATE)

# fmt: off
COMMAND = Command(
    "study",
    "whole stray-light study: model, objects, scatter, sampling, ghosts and PST in one report",
    "Run the eight steps of a stray-light study: optical model, mechanical model, critical,\n"
    "illuminated and common objects, coatings and scatter models, importance sampling, and analysis. The analysis\n"
    "has ghosts at some fields, and the PST at all angles with its causes. --out writes one report.",
    (
        "mistray study phone_camera_scatter --quick --out out",
        "mistray study scene.xml --pst-field-deg 0:80:2 --field-deg 0 10 18 22 --rays 4e6 --out out",
        "mistray study scene.xml --relative-error 0.05 --rays 1e8 --out out    # until 5 % at every angle",
        "mistray study scene.xml --quick --json",
    ),
    (
        SCENE,
        Group("what is traced", (
            angles("--pst-field-deg", "field angles of the PST, numbers and ranges first:last:step (0:80:2)",
                   PST_FIELD_DEG),
            Option("--field-deg", "field angles of the ghosts (0, 1/2, 1 and 5/4 of the half field)",
                   FIELD_DEG, "DEG", "+"),
            Option("--azimuth-deg", "azimuth of these fields (as the scene says)", AZIMUTH_DEG, "DEG"),
            Option("--quick", "fewer rays, for a first look", bool),
            Option("--relative-error", "go on until the standard error over the PST is below this at every angle",
                   RELATIVE_ERROR, "E"),
            Option("--convention", "PST as E_det/E_⊥ across the beam, or E_det/(E_⊥ cos θ) (normal)",
                   ("normal", "projected"), default="normal"),
            *SPECTRUM,
            SOURCE,
        )),
        ray_tree("start rays of the PST; objects get a fifth at each angle, ghosts a tenth (1e6; quick: 1e5)",
                 TIME, NEXT_ORDER, SCHEDULER),
        SURFACES,
        SCATTER,
        output("report.html and a CSV file of every table", FILES,
               Option("--resume", "go on with the PST that was saved in --out", bool),
               shown="findings", formats=TABLE_FORMATS),
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    options.check()
    if options.resume and options.out is None:
        raise MistrayError("--resume needs the folder of the saved run; give --out")
    folder = options.start()
    from mistray.analyses.study.page import study_record, study_report, study_text
    from mistray.analyses.study.run import study

    state = None if folder is None else folder / STATE
    if state is not None:
        if options.resume and not state.exists():
            raise MistrayError(f"--resume: there is no saved run '{state}'; run without --resume first")
        state.parent.mkdir(parents=True, exist_ok=True)
    scene = options.load()
    saved = SavedRun(state, lambda: "the PST so far is", options.resume)
    files: list[Path] = []
    with saved.told():
        with options.workers(), _progress(options) as progress:
            found = study(
                scene,
                FIELD_ANGLES if options.pst_field_deg is None else options.pst_field_deg,
                options.field_deg,
                quick=options.quick,
                azimuth_deg=options.azimuth_deg,
                relative_error=options.relative_error,
                convention=options.convention,
                state=state,
                resume=options.resume,
                name=options.title,
                progress=progress,
                seconds=options.seconds_left(PAGE_S),
                next_order=not options.no_next_order,
                **options.spectral_settings(),
            )
        files = options.write(lambda _, command: study_report(found, command))
    return saved.code or options.show(lambda: study_record(found), lambda: study_text(found), files)


@contextlib.contextmanager
def _progress(options: Any) -> Iterator[Callable[[int, str, float], None] | None]:
    """A bar over the steps on stderr when that is a terminal."""
    with terminal_bar(options, "{desc}: {percentage:3.0f}% |{bar}| {elapsed}", what="study") as bar:

        def draw(step: int, what: str, share: float) -> None:
            assert bar is not None
            bar.set_description_str(f"step {step} of {STEPS}, {what}", refresh=False)
            bar.n = share
            bar.refresh()

        yield None if bar is None else draw

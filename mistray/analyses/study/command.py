"""Command `mistray study`, which makes the whole stray-light study in one report."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from mistray.toolkit.command import Command, Group, Option
from mistray.toolkit.field_options import options_of, request_of
from mistray.toolkit.shared_options import (
    SCATTER,
    SCENE,
    SCHEDULER,
    SOURCE,
    SURFACES,
    TABLE_FORMATS,
    TIME,
    output,
    ray_tree,
)

if TYPE_CHECKING:
    from mistray.cli.parsed_options import Options

STATE = "pst_state.npz"
STEPS = 8
PAGE_S = 7.0  # of the report, see `Options.seconds_left`: all figures of the ghosts, the objects and the PST
TRACED = ("pst_field_deg", "field_deg", "quick", "relative_error", "convention", "light")

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
    lambda request: (
        SCENE,
        Group("what is traced", (*options_of(request.StudyRequest, *TRACED), SOURCE)),
        ray_tree(request.StudyRequest, TIME, *options_of(request.StudyRequest, "next_order"), SCHEDULER),
        SURFACES,
        SCATTER,
        output(
            "report.html and a CSV file of every table",
            ("report.html", "[1-8]_*.csv", STATE),
            Option("--resume", "go on with the PST that was saved in --out", bool),
            shown="findings",
            formats=TABLE_FORMATS,
        ),
    ),
    __package__,
)


def run(options: Options) -> int:
    """Run `mistray study` with parsed options and return the exit code."""
    from mistray.analyses.study.request import StudyRequest

    options.check()
    request = request_of(StudyRequest, vars(options))
    options.start()
    from mistray.analyses.study import page
    from mistray.analyses.study.run import run as study

    saved = options.saved_run(STATE, lambda: "the PST so far is")
    scene = options.load()
    with saved.reported():
        with options.workers(), bar(options) as progress:
            seconds = options.seconds_left(PAGE_S)
            found = study(scene, request, **saved.how, name=options.title, progress=progress, seconds=seconds)
        files = options.write(lambda _, command: page.page(found, command))
        options.show(lambda: page.record(found), lambda: page.text(found), files)
    return saved.code


@contextlib.contextmanager
def bar(options: Options) -> Iterator[Callable[[int, str, float], None] | None]:
    """
    Show a progress bar of the study's steps on a terminal.

    Yield the callback (step, its name, share done 0 … 1) that moves the bar; None if no bar is shown.
    """
    with options.bar("{desc}: {percentage:3.0f}% |{bar}| {elapsed}", what="study") as shown:

        def draw(step: int, what: str, share: float) -> None:
            assert shown is not None
            shown.set_description_str(f"step {step} of {STEPS}, {what}", refresh=False)
            shown.n = share
            shown.refresh()

        yield None if shown is None else draw

"""Command `mistray validate`: compare mistray with published numbers and other programs, with a verdict on each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mistray.toolkit.command import Command, Group
from mistray.toolkit.field_options import group, options_of, request_of
from mistray.toolkit.shared_options import MACHINE, TABLE_FORMATS, output

if TYPE_CHECKING:
    from mistray.cli.parsed_options import Options

FILES = ("report.html", "validation.csv", "packs.csv", "validation.json", "differences.png")
DISAGREES = 1  # exit code: a row differs that should agree, or a program failed
UNDECIDED = 3  # exit code: else, and a row has too few rays, or no row has a verdict
COMMAND = Command(
    "validate",
    "published numbers beside ours, with a verdict on each",
    "Compare numbers of publications and of other programs with ours, row by row: both numbers, their\n"
    "errors, what is allowed, and a verdict. The exit code is 1 if a row differs that should agree, or a\n"
    "program that it asks failed. Else it is 3 if a row has too few rays for a verdict, or no row has one.",
    (
        "mistray validate",
        "mistray validate --only phone_camera 'rubin_ghosts/*flux' --out out",
        "mistray validate --own my_lens.toml --rays 1e6",
        "mistray validate --only lsst --json",
    ),
    lambda request: (
        group("rows", request.ValidateRequest, "only", "own"),
        Group("traces", (*options_of(request.ValidateRequest, "rays", "seed"), *MACHINE)),
        output("report.html, CSV, JSON and PNG files", FILES, formats=TABLE_FORMATS),
    ),
    __package__,
)


def run(options: Options) -> int:
    """Run `mistray validate` with parsed options; return 0 if it holds, else `DISAGREES` or `UNDECIDED`."""
    from mistray.analyses.validate.request import ValidateRequest

    request = request_of(ValidateRequest, vars(options))
    options.start()
    from mistray.analyses.validate import page
    from mistray.analyses.validate.run import run_validation

    with options.bar("{desc} … {elapsed}", "validation") as bar:

        def tell(title: str, number: int, packs: int) -> None:
            if bar is not None:
                bar.set_description_str(f"{number + 1} of {packs}: {title}", refresh=True)

        found = run_validation(request, tell)
    files = options.write(lambda _, command: page.page(found, command))
    options.show(lambda: page.record(found), lambda: page.text(found), files, result=found)
    return DISAGREES if found.refuted else 0 if found.holds else UNDECIDED

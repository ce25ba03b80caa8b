"""Command `mistray doctor`, which reports what is installed and what is missing."""

from __future__ import annotations

from mistray.cli.parsed_options import Options
from mistray.cli.progress import working
from mistray.toolkit.command import Command, Option

# fmt: off
COMMAND = Command(
    "doctor",
    "say what is installed, what is missing and how to get it",
    "Look for LLVM, Mitsuba and its variants, the packages mistray needs and a GPU that the cuda\n"
    "variants can trace on, and say how to get what is missing.",
    ("mistray doctor",),
    (Option("--json", "print JSON", bool),),
)
# fmt: on


def run(options: Options) -> int:
    """Print which requirements of mistray this machine meets; return the exit code, 1 if a required one is missing."""
    from mistray.cli import doctor

    with working("looking at this machine"):
        checks = doctor.report()
    return doctor.show(checks, options.json, options.asked)

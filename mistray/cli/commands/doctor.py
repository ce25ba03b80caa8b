"""`mistray doctor`."""

from __future__ import annotations

import argparse
from typing import Any

from mistray.cli.arguments import Help
from mistray.cli.tracing_arguments import working


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "doctor",
        help="say what is installed, what is missing and how to get it",
        description="Look for LLVM, Mitsuba and its variants, the packages mistray needs and a GPU that the cuda\n"
        "variants can trace on, and say how to get what is missing.",
        epilog="example:\n  mistray doctor",
        formatter_class=Help,
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from mistray import doctor

    with working("looking at this machine"):
        checks = doctor.report()
    return doctor.show(checks, as_json=options.json)

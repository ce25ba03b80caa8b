"""Run of one command; errors become one line on stderr and an exit code."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shlex
import sys
import time
import warnings
from collections.abc import Sequence
from functools import partial
from types import ModuleType
from typing import Any

from mistray.cli.claims import guard_of, named_places
from mistray.cli.lens_scene import lens_as_scene
from mistray.cli.parsed_options import Options
from mistray.cli.run_analysis import run_analysis
from mistray.cli.signals import ignore
from mistray.errors import Interrupted, MistrayError, one_line
from mistray.interrupts import requested
from mistray.notes import quiet
from mistray.replace_file import guarding, incomplete_notes, written
from mistray.supervisor import INTERRUPTED
from mistray.toolkit.arguments import Help, Parser, as_text
from mistray.toolkit.installed import analysis_commands, modules_in

BAD_INPUT = 2
LEAST_TOLD_S = 0.5  # of compilation
FILES_NAMED = 3  # of those that an interrupted command has written
# Of the help, by the way of the work; further commands follow
ORDER = (
    "doctor",
    "import",
    "coat",
    "export",
    "view",
    "app",
    "ghosts",
    "image",
    "sweep",
    "objects",
    "pst",
    "study",
    "thermal",
    "coating",
    "bsdf",
    "sensitivity",
    "budget",
    "optimize",
    "validate",
    "cache",
    "completion",
)
_ANALYSES, LEFT_OUT = analysis_commands()


def _place(module: ModuleType) -> tuple[int, str]:
    name = module.COMMAND.name
    return ORDER.index(name) if name in ORDER else len(ORDER), name


COMMANDS = tuple(sorted((*modules_in("mistray.cli.commands"), *_ANALYSES), key=_place))
"""Modules of the commands; each has a `COMMAND`, and a function `run` unless that is an `AnalysisCommand`."""


def main(argv: Sequence[str] | None = None) -> int:
    """
    Run one command.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; default: those of the process.

    Returns
    -------
    int
        Exit code: that of the command, usually 0; 2 after an error and 130 after an interrupt, each with one line on
        stderr. It is 0 if the reader of stdout ends early.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError):  # a replaced stream, as in a notebook, has no encoding to speak of
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    written.clear()
    os.environ["MPLBACKEND"] = "agg"  # commands open no window, and Matplotlib ends with an error for a wrong one
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            code = _command(list(sys.argv[1:] if argv is None else argv))
        if sys.stdout is not None:  # None: closed from the start
            sys.stdout.flush()
        return code
    except MistrayError as error:
        return _interrupted() if _stopped(error) else _fail(str(error))
    except BrokenPipeError:  # the reader, such as head, has seen enough
        _drop_output()
        return 0
    except OSError as error:  # files, and a disk that has no room for the output
        _drop_output()
        place = "" if error.filename is None else f"'{error.filename}': "
        return _fail(f"{place}{error.strerror or error}; check the place, its permissions and its free space")
    except MemoryError:
        return _fail("out of memory; use fewer rays, fields or pixels")
    except RecursionError:
        return _fail("an argument or a file is nested too deeply; write it with fewer brackets or levels")
    except RuntimeError as error:  # Mitsuba, Dr.Jit
        return _interrupted() if _stopped(error) else _fail(str(error))
    except KeyboardInterrupt as error:
        return _interrupted(error)


def _command(arguments: list[str]) -> int:
    """Parse the arguments, run the command and return its exit code; --help and --version included."""
    try:
        from mistray.toolkit.command_request import asked, take_request

        began = time.monotonic()
        options = _parser().parse_args(arguments, Options())
        options.began = began
        _check_working_folder()
        # Names that are no text in the locale's encoding stand in reports, which are UTF-8
        options.command_line = as_text(shlex.join(["mistray", *arguments]))
        if options.schema is not None:
            return _print_schema(options)
        if options.request is not None:
            take_request(options.command, options, options.request)
        options.asked = asked(options.command, options)
        options.guard = guard_of(options)
        for note in (*LEFT_OUT, *incomplete_notes(named_places(options))):
            print(f"mistray: warning: {note}", file=sys.stderr)
        with guarding(options.guard), lens_as_scene(options), quiet():  # commands print the notes of their results
            code = int(options.run(options))
        if options.has("seconds") is not None:
            _tell_of_compilation()
        return code
    except SystemExit as stop:
        return int(stop.code or 0)


def _print_schema(options: Options) -> int:
    """Print the JSON schema of the request of a command, or of what it prints with --json; return 0."""
    from mistray.toolkit.command_request import schema_of_request, schema_of_result

    schema = (schema_of_result if options.schema == "result" else schema_of_request)(options.command)
    print(json.dumps(schema, indent=2, ensure_ascii=False, allow_nan=False))
    return 0


def _tell_of_compilation() -> None:
    """
    Print on stderr how much of the time of --seconds, s, was spent on compiling kernels that were not cached.

    Less than `LEAST_TOLD_S` is not mentioned.
    """
    launches = sys.modules.get("mistray.kernel.launches")
    took = sum(launches.compilations) if launches else 0.0
    if took >= LEAST_TOLD_S:
        print(
            f"mistray: {took:.1f} s went into the compilation of kernels, which are kept for the next time",
            file=sys.stderr,
        )


def _check_working_folder() -> None:
    """Raise `MistrayError` if the working folder does not exist, since Mitsuba would abort the process."""
    try:
        os.getcwd()
    except OSError:
        raise MistrayError("the working folder was deleted; change to one that exists, such as by: cd") from None


def _stopped(error: BaseException | None) -> bool:
    """True if Ctrl-C or SIGTERM caused the error; Mitsuba as it starts and Dr.Jit in a loop raise their own errors."""
    if requested():
        return True
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def _interrupted(error: BaseException | None = None) -> int:
    ignore()
    kept = f"; {error}" if isinstance(error, Interrupted) else ""
    places = list(dict.fromkeys(str(path) for path in written if path.exists()))  # not those of temporary folders
    files = f"; written: {', '.join(places[:FILES_NAMED])}{' …' if len(places) > FILES_NAMED else ''}"
    print(f"mistray: interrupted{kept}{files if places else ', nothing was written'}", file=sys.stderr)
    return INTERRUPTED


def _drop_output() -> None:
    """Connect stdout to the null device if it accepts no more output, so that the flush at exit does not fail."""
    try:
        sys.stdout.flush()
    except (OSError, AttributeError):
        with contextlib.suppress(OSError, AttributeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _warn(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: Any = None,
    line: str | None = None,
) -> None:
    """Print a warning as one line on stderr, without its place in the source, in place of `warnings.showwarning`."""
    print(f"mistray: warning: {one_line(message)}", file=sys.stderr)


def _fail(message: str) -> int:
    print(f"mistray: error: {one_line(message)}", file=sys.stderr)
    return BAD_INPUT


class _Version(argparse.Action):
    """Option that prints the version. This is looked up only when asked for, as it takes as long as all of --help."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        import importlib.metadata

        print(f"mistray {importlib.metadata.version('mistray')}")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="mistray",
        description="Stray-light analysis of optical systems. Units: mm, nm (wavelengths), degrees, W.",
        epilog="A SCENE is a file, or the name of a shipped scene such as phone_camera. --out writes files, --json\n"
        "prints JSON for scripts, COMMAND --help explains and has examples.\n\n"
        "examples:\n"
        "  mistray import lens.zmx -o lens.xml\n"
        "  mistray ghosts phone_camera --field-deg 0 10 20 --out out\n"
        "  mistray pst phone_camera_scatter --out out/pst\n"
        "  mistray ghosts --help",
        formatter_class=Help,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for module in COMMANDS:
        run = getattr(module, "run", None) or partial(run_analysis, module.COMMAND)
        module.COMMAND.declare(commands, run)
    return parser

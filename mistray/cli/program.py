"""Runs one command and turns what goes wrong into one line and an exit code."""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import os
import shlex
import sys
from collections.abc import Sequence

from mistray.cli import (
    bsdf,
    budget,
    coating,
    completion,
    doctor,
    export_lens,
    ghosts,
    import_lens,
    objects,
    optimize,
    pst,
    sensitivity,
    study,
    thermal,
    view,
)
from mistray.cli.arguments import INTERRUPTED, RAW, Parser
from mistray.errors import MistrayError

BAD_INPUT = 2
# In the order of the help; each has `add`
COMMANDS = (
    doctor,
    import_lens,
    export_lens,
    view,
    ghosts,
    objects,
    pst,
    study,
    thermal,
    coating,
    bsdf,
    sensitivity,
    budget,
    optimize,
    completion,
)


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
        Exit code: 0, or 2 after one line on stderr that says what is wrong with the input.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError):  # a replaced stream, as in a notebook, has no encoding to speak of
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        options = _parser().parse_args(arguments)
        options.command_line = shlex.join(["mistray", *arguments])
        code = int(options.run(options))
        sys.stdout.flush()
        return code
    except MistrayError as error:
        return _fail(str(error))
    except BrokenPipeError:  # the reader, such as head, has seen enough; nothing may be flushed to it at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (RuntimeError, OSError, MemoryError) as error:  # Mitsuba, Dr.Jit, files
        return _fail(f"{type(error).__name__}: {error}" if not isinstance(error, RuntimeError) else str(error))
    except KeyboardInterrupt:
        print("mistray: interrupted, nothing was written", file=sys.stderr)
        return INTERRUPTED


def _fail(message: str) -> int:
    print(f"mistray: error: {' '.join(message.split())}", file=sys.stderr)
    return BAD_INPUT


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
        formatter_class=RAW,
    )
    parser.add_argument("--version", action="version", version=f"mistray {importlib.metadata.version('mistray')}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add(commands)
    return parser

"""Whether a change of the program keeps what users see: output, files and reports of all commands, options, signatures.

    python benchmarks/same_outputs.py before.json [--commands ghosts pst …]
    python benchmarks/same_outputs.py after.json --against before.json

`command_calls.py` has the calls; together they use every option of every command. They run in this process, one thread,
in a temporary folder with an empty cache. `output_differences.py` says what counts as a difference.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import dataclasses
import importlib
import io
import json
import os
import re
import shlex
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from command_calls import CALLS, EXACT, EXCEPT, INPUTS, PREPARED, REFUSED, WRONG
from declared import declared_options, public_signatures
from output_differences import differences

import mistray
from mistray.cli import main as mistray_main
from mistray.cli.program import COMMANDS
from mistray.errors import MistrayError
from mistray.replace_file import replace_file
from mistray.scene import find
from mistray.toolkit.arguments import Parser

# The class whose objects are the reports of the commands, whatever writes them
REPORT = ("mistray.toolkit.pages.model", "Report")
TEXTS = (".xml", ".txt", ".toml", ".zmx", ".bsdf")  # files whose text is kept
LEAST_HTML = 20_000  # characters from which on the HTML of a part is data for scripts
DRAWING = ("--out", "--plot", "--plot-particles", "--layout")  # options whose calls take long
SEEN = 20  # differences of one call that are listed
ROOT = Path(__file__).resolve().parent.parent
# What differs between two runs of the same program: places, clocks, versions, ports and secrets
MASKS = (
    (re.compile(r"TEMPORARY/[^/\s'\"]+"), "TEMPORARY"),
    (re.compile(r"http://127\.0\.0\.1:\S*"), "ADDRESS"),
    (re.compile(r"\b\d{4}-\d{2}-\d{2}([ T]\d{2}:\d{2}(:\d{2}(\.\d+)?)?)?"), "DATE"),
    (re.compile(r"\b\d+\.\d+\.\d+[\w.+]*"), "VERSION"),
    (re.compile(r"mistray: [\d.]+ s went into the compilation of kernels.*\n"), ""),
    (re.compile(r"\b\d[\d.e+-]* s\b"), "TIME"),
)
TIMES = re.compile(r"(^|[_ ])(seconds|port)([_ ]|$)")  # keys of JSON, columns, facts of a report

Record = dict[str, Any]


def typed(command: Any) -> Iterator[str]:
    """The calls of a command: those of the table, and of what draws nothing the same with --json instead of text."""
    known = {option.name for option in command.options}
    for line in CALLS.get(command.name, ()):
        yield line
        words = set(shlex.split(line))
        if "--json" in known and not {"--json", "--quiet", *DRAWING} & words:
            yield f"{line} --json" + (" --force" if "--force" in known and not {"--force", "--resume"} & words else "")


def used_options(command: Any) -> set[str]:
    """The names of the options that the calls of a command give, with other values than the default."""
    parser = Parser(prog="mistray")
    command.declare(parser.add_subparsers(), print)
    found = set()
    for line in typed(command):
        given = parser.parse_args([command.name, *shlex.split(line.replace("{port}", "1"))])
        for option in command.options:
            value = getattr(given, option.dest)
            if value is not None and value is not False and value not in ([], option.default):
                found.add(option.name)
    return found


def unused_options() -> list[str]:
    """The options that no call uses, each with its command."""
    return [
        f"{command.name} {option.name}"
        for command in (module.COMMAND for module in COMMANDS)
        for used in [used_options(command)]
        for option in command.options
        if option.name not in used and option.name not in EXCEPT
    ]


def masked(text: str) -> str:
    """A text without what differs between two runs of the same program."""
    for folder, name in ((os.getcwd(), "FOLDER"), (tempfile.gettempdir(), "TEMPORARY"), (sys.prefix, "PYTHON")):
        text = text.replace(folder, name)
    text = text.replace(str(ROOT), "ROOT")
    for pattern, name in MASKS:
        text = pattern.sub(name, text)
    return text


def plain(value: Any) -> Any:
    """Values of JSON or of a report as they are kept: without times, pictures and what scripts of a page read."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        named = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return {"is": type(value).__name__, **plain(named)}
    if hasattr(value, "_asdict"):
        return plain(value._asdict())
    if isinstance(value, str):
        return masked(value) if len(value) < LEAST_HTML else "DATA"
    if isinstance(value, Mapping):
        return {masked(str(key)): "TIME" if TIMES.search(str(key)) else plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray):
        return {"shape": list(value.shape), "sum": plain(np.nansum(value)) if value.dtype.kind in "if" else "OTHER"}
    if isinstance(value, np.generic):
        return plain(value.item())
    if value is None or isinstance(value, bool | int | float):
        return value
    if isinstance(value, bytes):
        return "PICTURE"
    if isinstance(value, Iterable):
        found = [plain(one) for one in value]
        named = len(found) == 2 and isinstance(found[0], str)  # a fact of a report: its name and its text
        return [found[0], "TIME"] if named and TIMES.search(found[0]) else found
    return "DRAWN"


def report_record(report: Any) -> Record:
    """What a report says; its files are those that the command writes."""
    names = ("heading", "title", "tab", "page", "contents", "scripts", "warnings", "lead", "sections")
    files = {name: sorted(map(masked, getattr(report, name))) for name in ("csv", "json", "files")}
    return {**{name: plain(getattr(report, name)) for name in names}, **files}


@contextlib.contextmanager
def reports_kept() -> Iterator[list[Any]]:
    """The block in which all reports that are made are kept."""
    home, name = REPORT
    kind = getattr(importlib.import_module(home), name)
    made: list[Any] = []
    before: Callable[..., None] = kind.__init__

    def remember(self: Any, *arguments: Any, **named: Any) -> None:
        before(self, *arguments, **named)
        made.append(self)

    kind.__init__ = remember
    try:
        yield made
    finally:
        kind.__init__ = before


def ran(words: list[str]) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = mistray_main(words)
    return code, out.getvalue(), err.getvalue()


def table_record(text: str) -> Record:
    """A CSV file by column; lines in front of its head are kept as they are."""
    lines = text.splitlines()
    comments = [line for line in lines if line.startswith("#")]
    head, *rows = csv.reader(line for line in lines if not line.startswith("#"))
    cells: list[list[Any]] = [[_cell(text) for text in row] for row in rows]
    by_column = {name: [row[k] if k < len(row) else None for row in cells] for k, name in enumerate(head)}
    return {"comments": comments, "head": head, "columns": by_column}


def _cell(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def file_record(path: Path) -> Any:
    """What is kept of a file: tables, JSON and text; of others that they are there."""
    kind = path.suffix
    if kind == ".csv":
        return plain(table_record(path.read_text(encoding="utf-8")))
    if kind == ".json":
        return plain(json.loads(path.read_text(encoding="utf-8")))
    return masked(path.read_text(encoding="utf-8", errors="replace")) if kind in TEXTS else "THERE"


def call_record(words: list[str]) -> Record:
    """What one call of a command prints, writes and reports."""
    before = {path: path.stat().st_mtime_ns for path in Path().rglob("*") if path.is_file()}
    with reports_kept() as reports:
        code, out, err = ran(words)
    files = sorted(path for path in Path().rglob("*") if path.is_file())
    made = {str(path): file_record(path) for path in files if before.get(path) != path.stat().st_mtime_ns}
    kept = [report_record(one) for one in reports]
    told = {"json": plain(json.loads(out))} if "--json" in words and code == 0 else {"stdout": masked(out)}
    reports_made = [one for k, one in enumerate(kept) if one not in kept[:k]]
    return {"exit": code, **told, "stderr": masked(err), "files": made, "reports": reports_made}


@contextlib.contextmanager
def working_folder() -> Iterator[None]:
    """The block in which the current folder is a temporary one with the small files, and the cache is empty."""
    with tempfile.TemporaryDirectory(prefix="same-outputs-") as name:
        folder = Path(name).resolve() / "work"
        folder.mkdir()
        os.environ["MISTRAY_CACHE"] = str(folder.with_name("cache"))
        for file, text in INPUTS.items():
            (folder / file).write_text(text, encoding="utf-8")
        with contextlib.chdir(folder):
            yield


def calls_of(command: Any) -> dict[str, Record]:
    """All calls of one command, one after the other in a folder of their own, by what is typed."""
    found = {}
    with working_folder():
        for line in PREPARED.get(command.name, ()):
            code, _, err = ran(shlex.split(line))
            if code:
                raise MistrayError(f"mistray {line}: {err}")
        for line in [*typed(command), "--help"]:
            filled = line.replace("{scenes}", str(find("plate").parent.parent)).replace("{port}", str(free_port()))
            made = found[f"{command.name} {line}"] = call_record([command.name, *shlex.split(filled)])
            if made["exit"] and not any(words in line for words in REFUSED):
                print(f"exit {made['exit']} of {command.name} {line}: {made['stderr']}", file=sys.stderr, flush=True)
    return found


def wrong_calls(commands: Iterable[str]) -> dict[str, Record]:
    """Calls with wrong input."""
    with working_folder():
        return {line: call_record(shlex.split(line)) for line in WRONG if line.split()[0] in commands}


def free_port() -> int:
    """A port that nothing listens at."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def record(names: Iterable[str]) -> Record:
    """Everything of some commands, and the signatures of all public names."""
    os.environ["COLUMNS"] = "120"  # of the help
    mistray.ensure_variant()
    mistray.set_threads(1)  # the order of sums is that of the rays
    known = {module.COMMAND.name: module.COMMAND for module in COMMANDS}
    calls: Record = {}
    for name in names:
        began = time.monotonic()
        made = calls_of(known[name])
        print(f"{name}: {len(made)} calls, {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
        calls |= made
    calls |= wrong_calls(names)
    options = {name: declared_options(known[name]) for name in names}
    return {"calls": calls, "options": options, "signatures": public_signatures(), "exact": list(EXACT)}


def only(before: Record, names: Iterable[str]) -> Record:
    """The part of a record that is about some commands."""
    calls = {call: one for call, one in before["calls"].items() if call.split()[0] in names}
    return before | {"calls": calls, "options": {name: before["options"].get(name) for name in names}}


def main(arguments: list[str] | None = None) -> int:
    """
    The command.

    Returns
    -------
    int
        1 if something differs that is not on purpose, 2 if there is an option that no call uses.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path, help="file to write")
    parser.add_argument("--against", type=Path, metavar="FILE", help="compare with this earlier file")
    parser.add_argument("--commands", nargs="+", metavar="NAME", choices=tuple(CALLS), help="only these")
    options = parser.parse_args(arguments)
    if unused := unused_options():
        print(f"no call uses {', '.join(unused)}; add one to benchmarks/command_calls.py", file=sys.stderr)
        return 2
    names = options.commands or list(CALLS)
    before = json.loads(options.against.read_text(encoding="utf-8")) if options.against else None
    after = json.loads(json.dumps(record(names), ensure_ascii=False))
    replace_file(options.out, json.dumps(after, ensure_ascii=False) + "\n", "record of outputs")
    if before is None:
        return 0
    found, wanted = differences(only(before, names), after, SEEN)
    for title, lines in wanted.items():
        print(f"on purpose: {title}: {len(lines)} differences, such as {lines[0]}")
    for lines in found.values():
        print("\n".join(lines))
    parts = len(after["calls"]) + len(after["options"]) + len(after["signatures"])
    print(f"{len(found)} of {parts} calls differ")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())

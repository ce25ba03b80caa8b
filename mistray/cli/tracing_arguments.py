"""What the commands that trace a scene share: their arguments, and what is made of them."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from mistray.cli.arguments import as_text
from mistray.cli.claims import declare_outputs
from mistray.errors import MistrayError
from mistray.interrupts import check, later
from mistray.ranges import (
    RAYS,
    SECONDS,
    THREADS,
    WAVELENGTH_NM,
    WEIGHT,
    Range,
    Words,
    demand_of,
    doc_of,
    number_text,
)
from mistray.settings import BY_BRANCH, NO_LIMIT, NOTHING_CUT, Settings

ELSE = "(default: as the scene says, else what stands in brackets)"
FIRST_SECOND = 1.0  # s, after which what is still at work says so


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Declare the scene."""
    parser.add_argument(
        "scene", metavar="SCENE", help="scene XML file, or the name of a shipped scene such as phone_camera"
    )


def add_spectrum(group: Any) -> None:
    """Declare wavelengths and their weights in a group of arguments."""
    group.add_argument("--wavelength-nm", type=WAVELENGTH_NM, nargs="+", metavar="NM", help="wavelengths, nm")
    group.add_argument("--weights", type=WEIGHT, nargs="+", metavar="W",
                       help="shares of the flux, one for each of --wavelength-nm (equal)")  # fmt: skip


def add_ray_tree(parser: argparse.ArgumentParser, rays: str) -> Any:
    """Declare the settings of the ray tree; `rays` is the help of --rays. Returns their group."""
    group = parser.add_argument_group(f"ray tree {ELSE}")
    group.add_argument("--rays", type=RAYS, metavar="N", help=rays)
    for name in settings_between("rays", "max_scatters"):
        add_setting(group, name)
    add_machine(group)
    return group


def add_seconds(group: Any) -> None:
    """Declare a time budget."""
    group.add_argument("--seconds", type=SECONDS, metavar="S",
                       help="end this time after the start of the command, with what is found so far")  # fmt: skip


def seconds_left(options: argparse.Namespace) -> float | None:
    """What is left of --seconds; None where it is not given."""
    if options.seconds is None:
        return None
    return max(options.seconds - (time.monotonic() - options.began), SECONDS.low)


def add_machine(group: Any) -> None:
    """Declare what traces, see `start_mitsuba`."""
    group.add_argument("--variant", metavar="NAME",
                       help="Mitsuba variant; cuda_ad_rgb traces on an NVIDIA GPU (llvm_ad_rgb)")  # fmt: skip
    group.add_argument("--threads", type=THREADS, metavar="N", help="threads of the processor (all)")


def add_scheduler(group: Any) -> None:
    """Declare the cluster that traces, see `workers_of`."""
    group.add_argument("--scheduler", metavar="ADDRESS",
                       help="trace by the workers of a dask cluster, tcp://host:port (this process)")  # fmt: skip


def workers_of(options: argparse.Namespace) -> contextlib.AbstractContextManager[None]:
    """The block in which the workers of --scheduler trace, if it is given."""
    if options.scheduler is None:
        return contextlib.nullcontext()
    from mistray.cluster import distribute

    return distribute(options.scheduler)


def add_scatter(parser: argparse.ArgumentParser) -> None:
    """Declare the settings of scatter."""
    group = parser.add_argument_group(f"scatter {ELSE}")
    for name in ("max_scatters", *settings_between("max_scatters")):
        add_setting(group, name)


def settings_between(first: str, last: str = "") -> list[str]:
    """Names of the settings behind `first`, up to `last` or to the end."""
    names = [setting.name for setting in fields(Settings)]
    return names[names.index(first) + 1 : names.index(last) if last else len(names)]


def add_setting(group: Any, name: str, default: str = "") -> None:
    """Declare the option of a setting; `default` says what it is by default, where the command has another one."""
    setting, usual = Settings.__dataclass_fields__[name], getattr(Settings, name)
    demand, words = demand_of(setting), {NO_LIMIT: "no limit", NOTHING_CUT: "none"}.get(usual)
    default = default or words or (usual if isinstance(usual, str) else number_text(usual))
    kind: dict[str, Any] = {"metavar": "LIST" if demand is BY_BRANCH else "WHAT"}
    if isinstance(demand, Words):
        kind = {"choices": demand.choices}
    elif isinstance(demand, Range):
        kind = {"type": demand, "metavar": "N" if demand.whole else "F"}
    group.add_argument(flag(name), help=f"{doc_of(setting)} ({default})", **kind)


def flag(name: str) -> str:
    """The option of a setting."""
    return f"--{name.replace('_', '-')}"


TABLE_FORMATS = ("parquet",)
MAP_FORMATS = ("exr", "fits", "npy")


def add_output(
    parser: argparse.ArgumentParser,
    files: str,
    names: Sequence[str],
    shown: str = "tables",
    formats: Sequence[str] = (),
) -> argparse._ArgumentGroup:
    """
    Declare where results go.

    Parameters
    ----------
    parser : ArgumentParser
    files : str
        What --out writes.
    names : sequence of str
        Patterns of the names of these files, see `mistray.cli.claims`.
    shown : str
        What is printed.
    formats : sequence of str
        Further formats of the files, from `TABLE_FORMATS` and `MAP_FORMATS`; none: there is no --formats.

    Returns
    -------
    argparse._ArgumentGroup
    """
    group = parser.add_argument_group("output")
    group.add_argument("--out", type=Path, metavar="DIR", help=f"write {files} there")
    declare_outputs(parser, group, folder=names)
    if formats:
        what = "tables as Parquet too" + ("; irradiance with its error as EXR, FITS, NPY" if len(formats) > 1 else "")
        group.add_argument("--formats", nargs="+", choices=formats, default=[], help=f"{what} (needs --out)")
    group.add_argument("--json", action="store_true", help=f"print JSON instead of the {shown}")
    group.add_argument("--quiet", action="store_true", help=f"no progress, no {shown}")
    return group


def show(
    options: argparse.Namespace,
    record: Callable[[], Mapping[str, Any]],
    text: Callable[[], str],
    files: Sequence[Path],
    page: str = "report.html",
) -> None:
    """Print a result as `add_output` has it: the record with the names of the files, or the text, or nothing."""
    if options.json:
        print_json(record(), files)
    elif not options.quiet:
        print(text())
        if files:
            print(f"\n{len(files)} files in {options.out}; open {options.out / page}")


def print_json(record: Mapping[str, Any], files: Sequence[Path] = ()) -> None:
    """Print one JSON object: the record, and the names of the files that were written; see docs/json.md."""
    print(json.dumps({**record, "files": [str(file) for file in files]}, indent=2, allow_nan=False))


def check_formats(options: argparse.Namespace) -> None:
    """Refuse --formats without --out, or without the packages that they need, before anything is traced."""
    if not options.formats:
        return
    if options.out is None:
        raise MistrayError("--formats writes files; say with --out where they shall go")
    from mistray.report.formats import require_formats

    require_formats(options.formats)


def settings_of(options: argparse.Namespace) -> dict[str, Any]:
    """All fields of `mistray.trace.Settings` as given; None where the scene or the default decides."""
    return {setting.name: getattr(options, setting.name) for setting in fields(Settings)}


def check_weights(options: argparse.Namespace) -> None:
    """Refuse weights that do not fit the wavelengths."""
    if options.weights is None:
        return
    if options.wavelength_nm is None:
        raise MistrayError("--weights without --wavelength-nm; give one wavelength for each weight")
    if len(options.weights) != len(options.wavelength_nm):
        raise MistrayError(
            f"--weights has {len(options.weights)} values for {len(options.wavelength_nm)} of --wavelength-nm; "
            "give one weight for each wavelength"
        )


def start_mitsuba(options: argparse.Namespace) -> None:
    """Choose the variant, which settles libLLVM, and the threads before anything imports Mitsuba."""
    from mistray._mitsuba_compat import silence_warnings
    from mistray._variant import ensure_variant, set_threads

    with later():  # an interrupt may crash Mitsuba and Dr.Jit while they start
        ensure_variant(options.variant)
        if options.threads is not None:
            set_threads(options.threads)
        silence_warnings()
    check()


def scene_title(scene: str) -> str:
    """Name of a scene: that of its file, or of its folder if the file is called scene.xml."""
    path = Path(scene).resolve()
    return as_text(path.parent.name if path.name == "scene.xml" else path.stem)


@contextlib.contextmanager
def working(what: str, quiet: bool = False) -> Iterator[None]:
    """
    A line on stderr with the time that passes, for what has no steps to count; only on a terminal, after a second.

    Parameters
    ----------
    what : str
        What is done, such as "loading phone_camera".
    quiet : bool
        No line.
    """
    if quiet or not sys.stderr.isatty():
        yield
        return
    ended, began = threading.Event(), time.time()

    def show_time() -> None:
        if ended.wait(FIRST_SECOND):
            return
        from tqdm import tqdm

        with tqdm(desc=what, bar_format="{desc} … {elapsed}", leave=False, file=sys.stderr) as line:
            line.start_t = began
            while not ended.wait(FIRST_SECOND / 2):
                line.refresh()

    clock = threading.Thread(target=show_time, daemon=True)
    clock.start()
    try:
        yield
    finally:
        ended.set()
        clock.join()


@contextlib.contextmanager
def terminal_bar(
    options: argparse.Namespace, form: str, what: str = "tracing", total: float = 1.0
) -> Iterator[Any | None]:
    """
    A tqdm bar on stderr; None with --quiet, and where stderr is no terminal.

    Set its ``n`` and its texts, and let it ``refresh``: ``update`` draws nothing within 0.1 s of the time before, so
    that the step that takes long would stand under the text of the one before it.

    Parameters
    ----------
    options : Namespace
        Has ``quiet``.
    form : str
        What tqdm calls bar_format.
    what : str
        What is done.
    total : float
        ``n`` of a full bar.
    """
    if options.quiet or not sys.stderr.isatty():
        yield None
        return
    from tqdm import tqdm

    with tqdm(desc=what, total=total, bar_format=form, leave=False, file=sys.stderr, dynamic_ncols=True) as bar:
        yield bar


@contextlib.contextmanager
def progress_bar(options: argparse.Namespace) -> Iterator[Callable[[float, float], None] | None]:
    """A bar on stderr when that is a terminal: a function of what is done and what there is to do."""
    with terminal_bar(options, "{desc}: {percentage:3.0f}% |{bar}| {elapsed} < {remaining}") as bar:

        def advance(done: float, total: float) -> None:
            assert bar is not None
            bar.n = max(done / total, bar.n)
            bar.refresh()

        yield None if bar is None else advance

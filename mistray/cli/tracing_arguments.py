"""What the commands that trace a scene share: their options, and what is shown while they are at work."""

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

from mistray.cli.command import Group, Option
from mistray.ranges import RAYS, SECONDS, THREADS, WAVELENGTH_NM, WEIGHT, Range, Words, demand_of, doc_of, number_text
from mistray.settings import BY_BRANCH, NO_LIMIT, NOTHING_CUT, Settings

ELSE = "(default: as the scene says, else what stands in brackets)"
FIRST_SECOND = 1.0  # s, after which what is still at work says so
TABLE_FORMATS = ("parquet",)
MAP_FORMATS = ("exr", "fits", "npy")
NAMES = tuple(setting.name for setting in fields(Settings))


def flag(name: str) -> str:
    """The option of a setting."""
    return f"--{name.replace('_', '-')}"


def setting(name: str, default: str = "") -> Option:
    """The option of a setting; `default` says what it is by default, where the command has another one."""
    field, usual = Settings.__dataclass_fields__[name], getattr(Settings, name)
    demand, words = demand_of(field), {NO_LIMIT: "no limit", NOTHING_CUT: "none"}.get(usual)
    default = default or words or (usual if isinstance(usual, str) else number_text(usual))
    text = f"{doc_of(field)} ({default})"
    if isinstance(demand, Words):
        return Option(flag(name), text, demand.choices)
    if isinstance(demand, Range):
        return Option(flag(name), text, demand, "N" if demand.whole else "F")
    return Option(flag(name), text, metavar="LIST" if demand is BY_BRANCH else "WHAT")


def ray_tree(rays: str, *more: Option) -> Group:
    """The settings of the ray tree, and more options; `rays` is the help of --rays."""
    names = NAMES[NAMES.index("rays") + 1 : NAMES.index("max_scatters")]
    return Group(f"ray tree {ELSE}", (Option("--rays", rays, RAYS, "N"), *map(setting, names), *MACHINE, *more))


# fmt: off
SCENE = Option("scene", "scene XML file, or the name of a shipped scene such as phone_camera", metavar="SCENE")
SPECTRUM = (
    Option("--wavelength-nm", "wavelengths, nm", WAVELENGTH_NM, "NM", "+"),
    Option("--weights", "shares of the flux, one for each of --wavelength-nm (equal)", WEIGHT, "W", "+"),
)
TIME = Option("--seconds", "end this time after the start of the command, with what is found so far", SECONDS, "S")
MACHINE = (
    Option("--variant", "Mitsuba variant; cuda_ad_rgb traces on an NVIDIA GPU (llvm_ad_rgb)", metavar="NAME"),
    Option("--threads", "threads of the processor (all)", THREADS, "N"),
)
SCHEDULER = Option("--scheduler", "trace by the workers of a dask cluster, tcp://host:port (this process)",
                   metavar="ADDRESS")
SCATTER = Group(f"scatter {ELSE}", tuple(map(setting, NAMES[NAMES.index("max_scatters") :])))
DETECTOR = Option("--detector", "shape with the sensor, where the scene has several", metavar="ID")
FORCE = Option("--force", "replace existing files; never one that is read", bool)
# fmt: on


def output(
    files: str, names: Sequence[str], *more: Option, shown: str = "tables", formats: Sequence[str] = ()
) -> Group:
    """
    Where results go.

    Parameters
    ----------
    files : str
        What --out writes.
    names : sequence of str
        Patterns of the names of these files, see `mistray.cli.claims`.
    *more : Option
    shown : str
        What is printed.
    formats : sequence of str
        Further formats of the files, from `TABLE_FORMATS` and `MAP_FORMATS`; none: there is no --formats.
    """
    what = "tables as Parquet too" + ("; irradiance with its error as EXR, FITS, NPY" if len(formats) > 1 else "")
    kinds = Option("--formats", f"{what} (needs --out)", tuple(formats), nargs="+", default=[])
    options = (
        Option("--out", f"write {files} there", Path, "DIR", writes=tuple(names)),
        FORCE,
        *([kinds] if formats else []),
        Option("--json", f"print JSON instead of the {shown}", bool),
        Option("--quiet", f"no progress, no {shown}", bool),
    )
    return Group("output", (*options, *more))


def print_json(record: Mapping[str, Any], files: Sequence[Path] = ()) -> None:
    """Print one JSON object: the record, and the names of the files that were written; see docs/json.md."""
    print(json.dumps({**record, "files": [str(file) for file in files]}, indent=2, allow_nan=False))


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

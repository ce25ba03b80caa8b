"""
Checks of the files that a command writes: never one that it reads, and existing ones only with --force or --resume.

The files are checked before the command reads anything, and again when a scene is loaded.
"""

from __future__ import annotations

import argparse
import fnmatch
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mistray.errors import MistrayError
from mistray.replace_file import Guard


def guard_of(options: argparse.Namespace) -> Guard:
    """Return the guard of a command's files; with --force or --resume it allows existing files to be replaced."""
    return Guard(getattr(options, "force", False) or getattr(options, "resume", False))


def claim_files(options: argparse.Namespace, *paths: Path | None) -> None:
    """
    Raise `MistrayError` if a file to write was read, is named twice, or exists and the command may not replace it.

    Paths that are None are skipped.
    """
    wanted = [path for path in paths if path is not None]
    names = [os.path.realpath(path) for path in wanted]
    for path, name in zip(wanted, names, strict=True):
        if names.count(name) > 1:
            raise MistrayError(f"output '{path}' is given twice; name two files")
    _refuse(options, wanted)


def claim_folder(options: argparse.Namespace) -> Path | None:
    """
    Return the folder of --out, checked before anything is computed; None without --out.

    Raises
    ------
    MistrayError
        If nothing can be written there, or files that the command would write exist without --force or --resume.
    """
    if options.out is None:
        return None
    from mistray.toolkit.pages.output import writable_directory

    folder = writable_directory(options.out)
    if folder.is_dir():
        names = sorted(entry.name for entry in os.scandir(folder))
        _refuse(options, [options.out / name for name in names if is_declared(options, name)])
    return folder


def is_declared(options: argparse.Namespace, name: str) -> bool:
    """True if the command may write a file of this name into the folder of --out."""
    patterns = list(options.folder_files)
    for kind in getattr(options, "formats", ()):
        tables = [pattern.replace(".csv", ".parquet") for pattern in options.folder_files]
        pages = [pattern.replace(".html", ".pdf") for pattern in options.folder_files]
        patterns += {"parquet": tables, "pdf": pages}.get(kind, [f"irradiance_*deg.{kind}", f"illuminance_*deg.{kind}"])
    return any(fnmatch.fnmatch(name, pattern) for pattern in patterns)


def _refuse(options: argparse.Namespace, paths: Sequence[Path]) -> None:
    old = options.guard.in_the_way(paths)
    if old:
        more = f", and {len(old) - 1} more of its files" if len(old) > 1 else ""
        resume = ", go on with --resume" if hasattr(options, "resume") else ""
        raise MistrayError(f"output '{old[0]}' exists{more}; name another one{resume}, or replace with --force")


def named_places(options: argparse.Namespace) -> list[str]:
    """Return the strings among the arguments that name existing files or folders."""
    own = ("outputs", "folder_files", "command_line", "asked")
    texts = _texts({name: value for name, value in vars(options).items() if name not in own})
    return [text for text in dict.fromkeys(texts) if "\0" not in text and os.path.exists(text)]


def _texts(value: Any) -> Iterator[str]:
    """Yield all strings and paths in nested dicts, lists and tuples of option values, as strings."""
    if isinstance(value, str | Path):
        yield str(value)
    elif isinstance(value, dict):
        yield from _texts(list(value.values()))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _texts(item)

"""Files that a command may write: none that it reads, and one that exists only with --force."""

from __future__ import annotations

import argparse
import fnmatch
import json
import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from mistray.errors import MistrayError
from mistray.read_file import read_file, read_text
from mistray.replace_file import Guard

SCENE = ".xml"
SETTINGS = (".toml", ".json")
LENSES = (".zmx", ".seq", ".len", ".lens", ".roa", ".yaml", ".yml")
_ENDS = re.compile("[\n\r\"'{}[\\]]")  # what may stand before or behind the name of a file in a lens


def guard_of(options: argparse.Namespace) -> Guard:
    """The guard of a command's files; --resume goes on with files of its own, so that these may be replaced."""
    force = getattr(options, "force", False) or getattr(options, "resume", False)
    return Guard(partial(input_files, options), force)


def claim_files(options: argparse.Namespace, *paths: Path | None) -> None:
    """Refuse files that must not be written, before anything is computed."""
    wanted = [path for path in paths if path is not None]
    names = [os.path.realpath(path) for path in wanted]
    for path, name in zip(wanted, names, strict=True):
        if names.count(name) > 1:
            raise MistrayError(f"output '{path}' is given twice; name two files")
    _refuse(options, wanted)


def claim_folder(options: argparse.Namespace) -> Path | None:
    """
    The folder of --out, None without one; refused, before anything is computed, if it cannot be used.

    Raises
    ------
    MistrayError
        If nothing can be written there, or there are files of the names that the command writes, without --force.
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
    """Whether the command may write a file of this name into the folder of --out."""
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
    """Files and folders that there are among the arguments, read or written."""
    own = ("outputs", "folder_files", "command_line")
    texts = _texts({name: value for name, value in vars(options).items() if name not in own})
    return [text for text in dict.fromkeys(texts) if "\0" not in text and os.path.exists(text)]


def input_files(options: argparse.Namespace) -> list[Path]:
    """
    Files that a command reads: what its arguments name, and what scenes, lenses, TOML and JSON files among them name.

    Words count as the name of a file where there is one: better one too many than one too few. In a lens a catalogue of
    glasses, which has no ending there, counts as an AGF file.
    """
    from mistray._variant import ensure_variant

    ensure_variant()  # settles libLLVM before anything imports Mitsuba
    from mistray.materials.agf import decode
    from mistray.scene.files import named_files, scene_files
    from mistray.scene.load import find

    found: dict[Path, None] = {}

    def add(file: Path, ending: str) -> None:
        if file in found:
            return
        found[file] = None
        try:
            if ending == SCENE:
                found.update(dict.fromkeys(scene_files(file)))
            elif ending in SETTINGS:
                text = read_text(file)
                read(_texts(tomllib.loads(text) if ending == ".toml" else json.loads(text)), file.parent)
            elif ending in LENSES:
                text = decode(read_file(file))
                lines = {*text.splitlines(), *_ENDS.split(text)}
                catalogues = {word for line in lines if line.startswith("GCAT ") for word in line.split()[1:]}
                read(lines | {f"{name}{end}" for name in catalogues for end in (".agf", ".AGF")}, file.parent)
        except (MistrayError, ValueError, OSError, RecursionError):
            return  # the command says what is wrong with it

    def read(texts: Iterable[str], folder: Path) -> None:
        for text in texts:
            for file in named_files(text, (folder, Path.cwd())):
                add(file, file.suffix.lower())

    own = {*options.outputs, "outputs", "folder_files", "command_line"}
    given = {name: value for name, value in vars(options).items() if name not in own}
    for name in ("scene", "coating", "into"):
        if isinstance(given.get(name), str):
            try:
                add(find(given[name]).resolve(), SCENE)
            except MistrayError:
                continue
    read(_texts(given), Path.cwd())
    return list(found)


def _texts(value: Any) -> Iterator[str]:
    """All text in nested values."""
    if isinstance(value, str | Path):
        yield str(value)
    elif isinstance(value, dict):
        yield from _texts(list(value.values()))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _texts(item)

"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from mistray.errors import MistrayError

# Names of what is open already, such as /dev/stdout: where that is a file, it is written on, and not replaced
_OPEN = re.compile(r"/dev/std(?P<name>in|out|err)|(/dev|/proc/self)/fd/(?P<number>\d+)")
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
FREE = "free some space"  # the remedy then
_STANDARD = {"in": 0, "out": 1, "err": 2}
written: list[Path] = []  # files of this process, the last one last
_drafts: set[Path] = set()  # folders with files that are not finished


@contextlib.contextmanager
def draft_folder(place: Path) -> Iterator[Path]:
    """
    A hidden folder for files that appear together at the end of the block.

    Parameters
    ----------
    place : Path
        Folder that it is in.
    """
    folder = Path(tempfile.mkdtemp(prefix=".mistray-", dir=place))
    _drafts.add(folder)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _drafts.discard(folder)


def remove_drafts() -> None:
    """Remove the folders of `draft_folder`, before a process ends at once."""
    for folder in list(_drafts):
        shutil.rmtree(folder, ignore_errors=True)


@dataclass
class Guard:
    """
    Which files the commands of a block may replace: see `guarding`.

    Attributes
    ----------
    find_inputs : callable
        Gives the files that are read. They are never replaced. It is asked when the first file is in the way.
    force : bool
        Replace other existing files. Those that the block itself wrote are always replaced.
    """

    find_inputs: Callable[[], Iterable[Path]] = tuple
    force: bool = False
    _written: set[str] = field(default_factory=set)

    @cached_property
    def inputs(self) -> tuple[Path, ...]:
        """The files that are read."""
        return tuple(self.find_inputs())

    def in_the_way(self, paths: Iterable[str | Path]) -> list[Path]:
        """
        Which of some files exist and may not be replaced.

        Raises
        ------
        MistrayError
            If one of them is read; links and other spellings of its name count too.
        """
        # What is open already, a pipe or a device is written to, and a folder has its own message
        old = [Path(path) for path in paths if os.path.isfile(path) or _is_dangling(path)]
        old = [path for path in old if opened(path) is None]
        old = [path for path in old if os.path.abspath(path) not in self._written]
        for path in old:
            if any(_same(path, source) for source in self.inputs):
                raise MistrayError(f"output '{path}' is a file that this command reads; write to another one")
        return [] if self.force else old

    def claim(self, paths: Iterable[str | Path]) -> None:
        """Note that files are about to be written; raises if one of them is in the way."""
        wanted = [Path(path) for path in paths]
        old = self.in_the_way(wanted)
        if old:
            raise MistrayError(f"output '{old[0]}' exists; name another one, or replace it with --force")
        self._written.update(map(os.path.abspath, wanted))


def _is_dangling(path: str | Path) -> bool:
    """Whether the path is a link to nothing."""
    return os.path.islink(path) and not os.path.exists(path)


def _same(path: Path, other: Path) -> bool:
    try:
        return os.path.samefile(path, other)
    except OSError:  # a link to nothing, or a file that has gone
        return False


def opened(path: str | Path) -> int | None:
    """The number of the open file that a path names; None for others."""
    match = _OPEN.fullmatch(os.path.normpath(path))
    if match is None:
        return None
    return int(match["number"]) if match["number"] else _STANDARD[match["name"]]


_guards: list[Guard] = []


@contextlib.contextmanager
def guarding(guard: Guard) -> Iterator[None]:
    """Let `replace_file` ask a guard. Without one it replaces what there is, as a program that names a file expects."""
    _guards.append(guard)
    try:
        yield
    finally:
        _guards.remove(guard)


def claim_files(paths: Iterable[str | Path]) -> None:
    """Ask the guard, if there is one, for several files before the first of them is written."""
    if _guards:
        _guards[-1].claim(paths)


def replace_file(path: str | Path, content: str | bytes, what: str = "file") -> Path:
    """As `replace_files`, of one file; returns its path."""
    return replace_files({path: content}, what)[0]


def replace_files(files: Mapping[Any, str | bytes], what: str = "file") -> list[Path]:
    """
    Write files through drafts beside them: on an error, or when interrupted, all old files stay as they were.

    The drafts have names of their own: of two processes that write the same file one comes last, and either is whole.
    To what is no file, or is open already, such as /dev/stdout, the content is written as it is.

    Parameters
    ----------
    files : mapping of str or Path to str or bytes
        Contents; text is written as UTF-8.
    what : str
        Kind of file, for the message.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    MistrayError
        If one of them cannot be written, or the guard of this block keeps it; see `guarding`.
    """
    whole = {Path(path): text.encode("utf-8") if isinstance(text, str) else text for path, text in files.items()}
    claim_files(whole)
    drafts: dict[Path, Path] = {}
    path = Path()
    try:
        for path, data in whole.items():
            if os.path.isdir(path):
                raise MistrayError(f"{what} '{path}' is a folder; name a file")
            if opened(path) is None and (os.path.isfile(path) or not os.path.exists(path)):
                drafts[path] = path.with_name(f".{secrets.token_hex(4)}.part")
                drafts[path].write_bytes(data)
        for path, data in whole.items():
            if path in drafts:
                os.replace(drafts[path], path)
                written.append(path)
            else:
                _write_on(path, data)
    except BrokenPipeError:  # the reader, such as head, has seen enough
        raise
    except OSError as error:
        check = FREE if error.errno in NO_ROOM else "check the folder and its permissions"
        raise MistrayError(f"{what} '{path}': {error.strerror}; {check}, or choose another") from None
    finally:
        for draft in drafts.values():
            with contextlib.suppress(OSError):
                draft.unlink(missing_ok=True)
    return list(whole)


def _write_on(path: Path, data: bytes) -> None:
    """Write to what is no regular file, or is open already, after what has been printed."""
    number = opened(path)
    if number is None:
        path.write_bytes(data)
        return
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    with open(os.dup(number), "wb") as file:
        file.write(data)

"""
Reading of files that a user names as inputs: only regular files are opened.

A pipe without a writer would block the reader for ever, and a device may have no end. All inputs are read here. If a
library opens a file by its name, `require_file` checks it first. So `recording` knows all that a block has read.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from mistray.errors import MistrayError

KINDS = {
    stat.S_IFIFO: "it is a pipe, no regular file",
    stat.S_IFCHR: "it is a device, no regular file",
    stat.S_IFBLK: "it is a device, no regular file",
    stat.S_IFSOCK: "it is a socket, no regular file",
    stat.S_IFDIR: os.strerror(errno.EISDIR),
}
REMEDY = "check the path"
_records: list[dict[str, None]] = []


@contextlib.contextmanager
def recording(record: dict[str, None]) -> Iterator[None]:
    """Record all input files opened within a block: their real paths become keys of `record`."""
    _records.append(record)
    try:
        yield
    finally:
        del _records[next(number for number, one in enumerate(_records) if one is record)]


def count_as_read(path: str | Path) -> None:
    """Add the real path of an input file to the records of all enclosing `recording` blocks."""
    for record in _records:
        record[os.path.realpath(path)] = None


def open_input(path: str | Path, own: bool = False) -> BinaryIO:
    """
    Return a regular file, opened for reading in binary mode.

    Parameters
    ----------
    path : str or Path
        File to read.
    own : bool
        Whether the file is a result of mistray, such as a saved state or a report, and not an input. A result may be
        replaced after it has been read.

    Raises
    ------
    OSError
        If the file cannot be opened, or is not a regular file; ``strerror`` says why.
    """
    try:
        _refuse(path, os.stat(path).st_mode)
        # Another file may have taken its place since: without O_NONBLOCK a pipe would be waited for
        file = os.fdopen(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)), "rb")
    except ValueError:  # a name with a null byte
        raise OSError(errno.EINVAL, "it is not the name of a file", str(path)) from None
    try:
        _refuse(path, os.fstat(file.fileno()).st_mode)
    except OSError:
        file.close()
        raise
    if not own:
        count_as_read(path)
    return file


def read_file(
    path: str | Path, what: str = "file", remedy: str = REMEDY, most: int | None = None, own: bool = False
) -> bytes:
    """
    Return the content of a regular file.

    Parameters
    ----------
    path : str or Path
        File to read.
    what : str
        Kind of file, for the start of the message.
    remedy : str
        Advice for the end of the message.
    most : int, optional
        Largest allowed size, bytes; None: any size.
    own : bool
        Whether it is a result and not an input, see `open_input`.

    Raises
    ------
    MistrayError
        If the file cannot be read, is not a regular file, or is too large.
    """
    try:
        with open_input(path, own) as file:
            content = file.read() if most is None else file.read(most + 1)
    except OSError as error:
        raise _error(path, what, error.strerror, remedy) from None
    if most is not None and len(content) > most:
        raise _error(path, what, f"it has more than {most >> 20} MiB", "make it smaller")
    return content


def read_text(path: str | Path, what: str = "file", remedy: str = REMEDY) -> str:
    """
    Return the text of a UTF-8 file, with or without byte order mark, with line feeds as line ends.

    `what` and `remedy` are those of `read_file`. Raise `MistrayError` as it does, or if the text is not UTF-8.
    """
    try:
        text = read_file(path, what, remedy).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise _error(path, what, "it is not a text file in UTF-8", remedy) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def require_file(path: str | Path, what: str = "file", remedy: str = REMEDY) -> None:
    """
    Raise `MistrayError` if a file that a library will open by name cannot be opened or is not a regular file.

    `what` and `remedy` are those of `read_file`. The file is recorded as an input, see `recording`.
    """
    try:
        open_input(path).close()
    except OSError as error:
        raise _error(path, what, error.strerror, remedy) from None


def _refuse(path: str | Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        reason = KINDS.get(stat.S_IFMT(mode), "it is not a regular file")
        raise OSError(errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL, reason, str(path))


def _error(path: str | Path, what: str, reason: str | None, remedy: str) -> MistrayError:
    return MistrayError(f"{what} '{path}': {reason or 'it cannot be read'}; {remedy}")

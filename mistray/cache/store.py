"""Cache of results in a folder, each in its own file named by a key of what the result depends on.

Several processes may use a folder at the same time, without locks:

- An entry is written to a draft with a unique name and then renamed, so that a reader finds all of it or nothing. Two
  processes that compute the same result write the same content, and the later one wins.
- An entry begins with its key and a checksum. If these do not match, or the content has the wrong form, the entry is
  reported and removed, and its result is computed again.
- Reading an entry updates the time of its file, so that the least recently read entries are removed first.

If a folder cannot be written or a disk is full, the user gets one line, and results are computed without the cache.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import secrets
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from mistray.errors import MistrayError
from mistray.read_file import open_input

T = TypeVar("T")

MAGIC = b"mistray cache 1"  # the number changes when the form of the files does
ENDING, DRAFT_ENDING = ".result", ".draft"
OLD_DRAFT_SECONDS = 3600.0  # a draft of this age was left behind by a process that was killed
KEPT = 0.9  # of the limit, after old entries were removed
CHECKED = 0.25  # of the room that is left: so much is written before the size is looked at again
_KEY = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Contents:
    """
    Number and size of the files in the folder of a cache.

    Attributes
    ----------
    entries : int
        Number of entries.
    size_bytes : int
        Total size of entries and drafts, bytes.
    """

    entries: int
    size_bytes: int


class Cache:
    """
    Cache of results on disk, by key.

    Parameters
    ----------
    folder : Path
        Folder of the cache; it is created when the first entry is written.
    limit_bytes : int
        Size, bytes, above which the least recently read entries are removed.

    Attributes
    ----------
    problems : list of str
        Problems that occurred, one line each, without repetition.
    """

    def __init__(self, folder: Path, limit_bytes: int) -> None:
        self.folder, self.limit_bytes = folder, limit_bytes
        self.problems: list[str] = []
        self._writable = True
        self._room = 0.0  # bytes that may be written until the size is looked at

    def get(self, key: str, read: Callable[[bytes], T]) -> T | None:
        """
        Return the result of an entry, or None if there is no intact entry of the right form.

        A damaged entry is removed. This and a folder that cannot be read are reported in `problems`.

        Parameters
        ----------
        key : str
            Key from `key_of`.
        read : callable
            Function from content to result; it raises ValueError, TypeError or KeyError for other content.
        """
        path = self._path(key)
        try:
            with open_input(path, own=True) as file:
                data = file.read()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            self._tell(f"cache '{self.folder}': {error.strerror}; nothing is read from it, {self._remedy}")
            return None
        try:
            found = read(_opened(data, key))
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
            self._tell(f"cache entry '{path}' is damaged; its result is computed again")
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
            return None
        with contextlib.suppress(OSError):  # a folder that may only be read
            os.utime(path)
        return found

    def put(self, key: str, content: bytes) -> None:
        """
        Store a result in the cache; after a failure, which is reported, nothing more is written.

        Parameters
        ----------
        key : str
            Key from `key_of`.
        content : bytes
            Content of the entry.
        """
        if not self._writable:
            return
        path = self._path(key)
        data = b"\n".join((MAGIC, key.encode(), hashlib.sha256(content).hexdigest().encode(), content))
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            draft = self.folder / f"{key}-{secrets.token_hex(4)}{DRAFT_ENDING}"
            try:
                with draft.open("xb") as file:
                    file.write(data)
                os.replace(draft, path)
            except BaseException:  # an interrupt as well
                with contextlib.suppress(OSError):
                    draft.unlink()
                raise
        except OSError as error:
            self._writable = False
            self._tell(f"cache '{self.folder}': {error.strerror}; results are not kept, {self._remedy}")
            return
        self._room -= len(data)
        if self._room < 0:
            self._make_room(path)

    def contents(self) -> Contents:
        """
        Return the number of entries in the folder, and the size of entries and drafts.

        Raises
        ------
        MistrayError
            If the folder cannot be read.
        """
        files = list(self._files())
        return Contents(sum(file.path.suffix == ENDING for file in files), sum(file.size for file in files))

    def clear(self) -> Contents:
        """
        Remove all entries and abandoned drafts; other files in the folder stay.

        Returns
        -------
        Contents
            Number of removed entries, and total size of removed files.

        Raises
        ------
        MistrayError
            If the folder cannot be read, or a file cannot be removed.
        """
        entries = size = 0
        for file in list(self._files()):
            if file.path.suffix == DRAFT_ENDING and not file.abandoned:
                continue  # another process is at it
            try:
                file.path.unlink(missing_ok=True)
            except OSError as error:
                raise MistrayError(f"cache entry '{file.path}': {error.strerror}; remove it yourself") from None
            entries += file.path.suffix == ENDING
            size += file.size
        return Contents(entries, size)

    def _path(self, key: str) -> Path:
        if not _KEY.fullmatch(key):
            raise ValueError(f"'{key}' is not a key of a cache; make it with key_of")
        return self.folder / f"{key}{ENDING}"

    def _files(self) -> Iterator[_File]:
        """
        Yield the files of the folder that belong to the cache.

        There are none if the folder does not exist. Raise `MistrayError` if the folder cannot be read.
        """
        try:
            with os.scandir(self.folder) as listed:
                for item in listed:
                    if not (_KEY.match(item.name) and item.name.endswith((ENDING, DRAFT_ENDING))):
                        continue
                    with contextlib.suppress(FileNotFoundError):  # another process was faster
                        status = item.stat()
                        yield _File(Path(item.path), status.st_size, status.st_mtime)
        except FileNotFoundError:
            return
        except OSError as error:
            raise MistrayError(f"cache '{self.folder}': {error.strerror}; check MISTRAY_CACHE") from None

    def _make_room(self, newest: Path) -> None:
        """
        Remove abandoned drafts, and above the limit the least recently read entries down to `KEPT` of it.

        The entry `newest` stays. A folder that cannot be read is reported and left as it is.
        """
        try:
            files = sorted(self._files(), key=lambda file: file.used)
        except MistrayError as error:
            self._tell(str(error))
            return
        size = sum(file.size for file in files)
        wanted = KEPT * self.limit_bytes if size > self.limit_bytes else float(size)
        for file in files:
            surplus = size > wanted and file.path.suffix == ENDING and file.path != newest
            if file.abandoned or surplus:
                with contextlib.suppress(OSError):
                    file.path.unlink(missing_ok=True)
                    size -= file.size
        self._room = CHECKED * max(self.limit_bytes - size, 0)

    @property
    def _remedy(self) -> str:
        return "make room or name another folder in MISTRAY_CACHE, or switch the cache off"

    def _tell(self, problem: str) -> None:
        if problem not in self.problems:
            self.problems.append(problem)


@dataclass(frozen=True)
class _File:
    """File of the cache: its path, its size in bytes, and the time of its last use, s since the epoch."""

    path: Path
    size: int
    used: float

    @property
    def abandoned(self) -> bool:
        """True if the file is a draft older than `OLD_DRAFT_SECONDS`, of a process that was killed."""
        return self.path.suffix == DRAFT_ENDING and self.used < time.time() - OLD_DRAFT_SECONDS


def _opened(data: bytes, key: str) -> bytes:
    """Return the content of an entry; raise ValueError if it is damaged or belongs to another key."""
    magic, _, rest = data.partition(b"\n")
    written, _, rest = rest.partition(b"\n")
    checksum, _, content = rest.partition(b"\n")
    whole = magic == MAGIC and written == key.encode() and checksum == hashlib.sha256(content).hexdigest().encode()
    if not whole:
        raise ValueError("no whole entry")
    return content

"""
Atomic writing of files: each appears whole or not at all, even after a power cut.

A file is written to a draft beside it, which is synced and then renamed. Several files cannot be renamed at once, so a
file `incomplete` in their folder lists them meanwhile. It is made before the first rename and removed after the last,
so that it remains if the process ends in between.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import sys
import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mistray.errors import MistrayError
from mistray.interrupts import later, requested
from mistray.read_file import open_input, recording

# Names of what is open already, such as /dev/stdout: where that is a file, it is written on, and not replaced
_OPEN = re.compile(r"/dev/std(?P<name>in|out|err)|(/dev|/proc/self)/fd/(?P<number>\d+)")
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
FREE = "free some space"  # the remedy then
_STANDARD = {"in": 0, "out": 1, "err": 2}
INCOMPLETE = "incomplete"  # file that names those of which some are still the old ones
NOTE = "mistray was ended while it replaced these files: some may be old, others new; run the command again"
OLD_DRAFT_SECONDS = 3600.0  # a draft of this age was left behind, if its process has ended
_DRAFT = re.compile(r"\.mistray-(?:(?P<process>\d+)-)?[0-9a-z_]{8}")
written: list[Path] = []  # files of this process, the last one last
_drafts: set[Path] = set()  # folders with files that are not finished
_swept: set[Path] = set()  # folders that were searched for old drafts
collected: dict[str, dict[str, bytes]] = {}  # real path of a folder → its files, which `replace_folder` writes as one


def draft_name() -> str:
    """Return a unique file name for a draft, with the number of this process."""
    return f".mistray-{os.getpid()}-{os.urandom(4).hex()}"


@contextlib.contextmanager
def draft_folder(place: Path) -> Iterator[Path]:
    """
    Yield a new hidden folder for drafts, which is removed at the end of the block.

    Parameters
    ----------
    place : Path
        Folder in which it is made.
    """
    sweep_drafts(place)
    folder = place / draft_name()
    folder.mkdir()
    _drafts.add(folder)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _drafts.discard(folder)


def remove_drafts() -> None:
    """Remove the folders of `draft_folder`, before a process ends abruptly."""
    for folder in list(_drafts):
        shutil.rmtree(folder, ignore_errors=True)


def sweep_drafts(place: Path) -> None:
    """Remove drafts older than an hour, of processes that have ended, from a folder; later calls for it do nothing."""
    if place in _swept:
        return
    _swept.add(place)
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(place)):
            match = _DRAFT.fullmatch(entry.name)
            if match is None or _runs(match["process"]):
                continue
            with contextlib.suppress(OSError):
                if entry.stat(follow_symlinks=False).st_mtime > time.time() - OLD_DRAFT_SECONDS:
                    continue
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path, ignore_errors=True)
                else:
                    os.unlink(entry.path)


def _runs(process: str | None) -> bool:
    """True if the process with this number is alive; False without a number, or where processes cannot be looked up."""
    if process is None or os.name != "posix":
        return False
    try:
        os.kill(int(process), 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # of another user
        return True
    return True


def sync(path: Path) -> None:
    """
    Wait until a file, or the list of names in a folder, is on the disk.

    Raises
    ------
    OSError
        If a file cannot be synced to its disk. Folders and file systems that do not support syncing raise nothing.
    """
    try:
        number = os.open(path, os.O_RDONLY)
    except OSError:
        if path.is_dir():
            return
        raise
    try:
        os.fsync(number)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):  # no disk, such as some shared folders
            raise
    finally:
        os.close(number)


@dataclass
class Guard:
    """
    Protection of existing files from being replaced by the commands of a block, see `guarding`.

    Attributes
    ----------
    force : bool
        Whether existing files may be replaced. Files that the block has read never are; files that it wrote itself
        always may be.
    read : dict
        Real paths of the files that the block has read.
    """

    force: bool = False
    read: dict[str, None] = field(default_factory=dict)
    _wanted: dict[str, Path] = field(default_factory=dict)
    _written: set[str] = field(default_factory=set)

    def was_read(self, path: str | Path) -> bool:
        """True if the block has read a file, under any spelling of its name or through links."""
        return any(_same(path, source) for source in list(self.read))

    def refuse_read(self) -> None:
        """
        Check again that none of the files to be replaced has been read, as the block may have read more by now.

        Raises
        ------
        MistrayError
            If one of them has been read.
        """
        self._refuse_read(path for place, path in self._wanted.items() if place not in self._written)

    def _refuse_read(self, paths: Iterable[Path]) -> None:
        for path in paths:
            if self.was_read(path):
                raise MistrayError(f"output '{path}' is a file that this command reads; write to another one")

    def in_the_way(self, paths: Iterable[str | Path]) -> list[Path]:
        """
        Return the existing files among some paths that may not be replaced; none if `force` is set.

        Raise `MistrayError` if the block has read one of them.
        """
        # What is open already, a pipe or a device is written to, and a folder has its own message
        old = [Path(path) for path in paths if os.path.isfile(path) or _is_dangling(path)]
        old = [path for path in old if opened(path) is None and os.path.abspath(path) not in self._written]
        self._refuse_read(old)
        if not self.force:
            return old
        self._wanted.update({os.path.abspath(path): path for path in old})
        return []

    def claim(self, paths: Iterable[str | Path]) -> None:
        """Register files that are about to be written; raise `MistrayError` if one of them may not be replaced."""
        wanted = [Path(path) for path in paths]
        old = self.in_the_way(wanted)
        if old:
            raise MistrayError(f"output '{old[0]}' exists; name another one, or replace it with --force")
        self._written.update(map(os.path.abspath, wanted))


def is_input(path: str | Path) -> bool:
    """True if the file was read inside a `with` block that guards outputs against overwriting inputs; False outside."""
    return any(guard.was_read(path) for guard in _guards)


def refuse_read() -> None:
    """
    Raise `MistrayError` if a file that a guarded block is to replace has been read.

    So a long computation does not end in a refused output.
    """
    for guard in _guards:
        guard.refuse_read()


def _is_dangling(path: str | Path) -> bool:
    """True if a path is a symbolic link to a missing file."""
    return os.path.islink(path) and not os.path.exists(path)


def _same(path: str | Path, other: str | Path) -> bool:
    try:
        return os.path.samefile(path, other)
    except OSError:  # a link to nothing, or a file that has gone
        return False


def opened(path: str | Path) -> int | None:
    """Return the file descriptor that a path such as /dev/stdout stands for; None for other paths."""
    match = _OPEN.fullmatch(os.path.normpath(path))
    if match is None:
        return None
    return int(match["number"]) if match["number"] else _STANDARD[match["name"]]


_guards: list[Guard] = []


@contextlib.contextmanager
def guarding(guard: Guard) -> Iterator[None]:
    """Make `replace_file` consult a guard within a block; without one it replaces existing files."""
    _guards.append(guard)
    try:
        with recording(guard.read):
            yield
    finally:
        _guards.remove(guard)


def claim_files(paths: Iterable[str | Path]) -> None:
    """
    Check that the guard of the innermost `guarding` block, if any, permits writing these files; register them.

    Raise `MistrayError` if it does not.
    """
    if _guards:
        _guards[-1].claim(paths)


def replace_file(path: str | Path, content: str | bytes, what: str = "file") -> Path:
    """Write one file as `replace_files` does, and return its path; raise as it does."""
    return replace_files({path: content}, what)[0]


def replace_files(files: Mapping[Any, str | bytes], what: str = "file") -> list[Path]:
    """
    Write files through drafts beside them; if a draft cannot be written, all old files stay as they were.

    Drafts have unique names, so if two processes write the same file, the later one wins and the file is whole. Content
    for a device, a pipe or an open file such as /dev/stdout is written directly. Files in a folder that is being
    replaced as a whole appear with it, see `mistray.replace_folder`.

    Parameters
    ----------
    files : mapping of str or Path to str or bytes
        Contents; text is written as UTF-8.
    what : str
        Kind of file, for the message.

    Returns
    -------
    list of Path
        Paths of the files.

    Raises
    ------
    MistrayError
        If a file cannot be written, or the guard of this block protects it; see `guarding`.
    BrokenPipeError
        If the reader of a pipe has ended.
    KeyboardInterrupt
        On Ctrl-C; see `rename_drafts` for the state of the files.
    """
    whole = {Path(path): text.encode("utf-8") if isinstance(text, str) else text for path, text in files.items()}
    claim_files(whole)
    now: dict[Path, bytes] = {}
    for path, data in whole.items():
        if os.path.isdir(path):
            raise MistrayError(f"{what} '{path}' is a folder; name a file")
        if opened(path) is not None or not (os.path.isfile(path) or not os.path.exists(path)):
            continue
        folder = collected.get(os.path.realpath(path.parent))
        if folder is None:
            now[path] = data
        else:
            folder[path.name] = data
    rename_drafts(now, what)
    for path, data in whole.items():
        if opened(path) is not None or (os.path.exists(path) and not os.path.isfile(path)):
            with telling(path, what):
                _write_on(path, data)
    return list(whole)


def rename_drafts(files: Mapping[Path, bytes], what: str = "file", obsolete: Collection[Path] = ()) -> None:
    """
    Write files through drafts without asking a guard, and remove files that they make obsolete.

    Parameters
    ----------
    files : mapping of Path to bytes
        Paths that are not folders, and contents. The last one names the set in the file `incomplete`, which is written
        if there are several files, obsolete ones included.
    what : str
        Kind of file, for the message.
    obsolete : collection of Path
        Files that are removed after the renames.

    Raises
    ------
    MistrayError
        If a file cannot be written, or a file `incomplete` of another program is there; all old files then stay. If a
        later rename fails, some files are new, and `incomplete` remains. So it does if an obsolete file cannot be
        removed; all files are new then.
    KeyboardInterrupt
        On Ctrl-C. While drafts are written, all old files stay. During the renames the first one is raised once all
        files are new; a second one is raised at once, and `incomplete` remains if some files are old.
    """
    drafts: dict[Path, Path] = {}
    path = Path()
    before = requested()
    try:
        for path, data in files.items():
            sweep_drafts(path.parent)
            drafts[path] = path.with_name(draft_name())
            with telling(path, what):
                drafts[path].write_bytes(data)
                sync(drafts[path])
        with later(), _marked([*files], obsolete) as moved:
            for path, draft in drafts.items():
                with telling(path, what):
                    os.replace(draft, path)
                moved.append(path)
            for path in obsolete:
                with telling(path, what):
                    path.unlink(missing_ok=True)
    finally:
        for draft in drafts.values():
            with contextlib.suppress(OSError):
                draft.unlink(missing_ok=True)
    if requested() and not before:
        raise KeyboardInterrupt


@contextlib.contextmanager
def telling(path: Path, what: str) -> Iterator[None]:
    """
    Turn an OSError from writing a file within a block into a one-line `MistrayError`.

    A BrokenPipeError is passed on as it is.
    """
    try:
        yield
    except BrokenPipeError:  # the reader, such as head, has seen enough
        raise
    except OSError as error:
        check = FREE if error.errno in NO_ROOM else "check the folder and its permissions"
        raise MistrayError(f"{what} '{path}': {error.strerror}; {check}, or choose another") from None


@contextlib.contextmanager
def _marked(files: Sequence[Path], obsolete: Collection[Path]) -> Iterator[list[Path]]:
    """
    Keep the file `incomplete` up to date while a block renames several files; for a single one it is not needed.

    The block appends each renamed file to the yielded list. If it fails before the first, the old `incomplete` comes
    back. Raise `MistrayError` as `_mark` does.
    """
    several = len(files) + len(obsolete) > 1
    before = {folder: incomplete_sets(folder) for folder in sorted({path.parent for path in files})}
    for folder, sets in before.items() if several else ():
        own = [path.name for path in files if path.parent == folder]
        names = {*own, *(path.name for path in obsolete if path.parent == folder), *sets.get(own[-1], ())}
        _mark(folder, {**sets, own[-1]: sorted(names)})
    moved: list[Path] = []
    try:
        yield moved
    except BaseException:
        for folder, sets in before.items() if several and not moved else ():
            _mark(folder, sets)
        raise
    finally:
        written.extend(moved)
    for folder in before:
        with telling(folder, "folder"):
            sync(folder)
        sets = incomplete_sets(folder)
        if sets:
            done = {path.name for path in (*files, *obsolete) if path.parent == folder}
            _mark(folder, sets_without(sets, done))


def sets_without(sets: Mapping[str, Collection[str]], done: Collection[str]) -> dict[str, list[str]]:
    """Return the sets of `incomplete_sets` without the file names in `done`; sets that are then empty are dropped."""
    return {name: left for name, names in sets.items() if (left := sorted({*names} - {*done}))}


def incomplete_sets(folder: Path) -> dict[str, list[str]]:
    """
    Return the sets of files in a folder that may mix old and new ones.

    Parameters
    ----------
    folder : Path
        Folder to examine.

    Returns
    -------
    dict
        Name of the last file of a set → names of all its files in the folder. Empty if there is no file `incomplete` of
        mistray.
    """
    import json

    try:
        with open_input(folder / INCOMPLETE, own=True) as file:
            found = json.loads(file.read())["sets"]
        return {str(name): [one for one in map(str, names) if Path(one).name == one] for name, names in found.items()}
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return {}


def incomplete_notes(places: Iterable[str | Path]) -> list[str]:
    """
    Return notes on folders in which mistray was ended between two renames.

    Parameters
    ----------
    places : iterable of str or Path
        Folders, or files in them; missing ones are ignored.
    """
    folders: dict[Path, None] = {}
    for place in map(Path, places):
        with contextlib.suppress(OSError, ValueError):
            folders[place if place.is_dir() else place.parent] = None
    notes = []
    for folder in folders:
        for name, names in incomplete_sets(folder).items():
            notes.append(
                f"folder '{folder}' is incomplete: mistray was ended while it replaced {name} and {len(names)} files "
                f"in all, so that some are old; run that command again, or remove '{folder / INCOMPLETE}'"
            )
    return notes


def incomplete_bytes(sets: Mapping[str, Collection[str]]) -> bytes:
    """Return the content of a file `incomplete`, JSON as bytes, for sets in the form of `incomplete_sets`."""
    import json

    return json.dumps({"note": NOTE, "sets": {name: [*names] for name, names in sets.items()}}, indent=1).encode()


def _mark(folder: Path, sets: Mapping[str, Collection[str]]) -> None:
    """
    Write, update or remove the file `incomplete` of a folder and wait until it is on the disk.

    Raise `MistrayError` if that fails, or if the file there is not from mistray.
    """
    path = folder / INCOMPLETE
    if path.exists() and not incomplete_sets(folder):
        raise MistrayError(f"file '{path}' is not from mistray, which needs its name; rename it")
    with telling(path, "file"):
        if sets:
            draft = folder / draft_name()
            try:
                draft.write_bytes(incomplete_bytes(sets))
                sync(draft)
                os.replace(draft, path)
            finally:
                draft.unlink(missing_ok=True)
        else:
            path.unlink(missing_ok=True)
        sync(folder)


def _write_on(path: Path, data: bytes) -> None:
    """Write bytes to a device, a pipe or an open file, after flushing what has been printed."""
    number = opened(path)
    if number is None:
        path.write_bytes(data)
        return
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    with open(os.dup(number), "wb") as file:
        file.write(data)

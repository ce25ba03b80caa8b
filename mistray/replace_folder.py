"""
Atomic replacement of a folder of results: it holds either the old files or the new ones, even after a power cut.

The new folder is made beside the old one, with other files carried over as hard links. It is synced and exchanged with
the old one in one system call, ``renameat2`` with ``RENAME_EXCHANGE`` of Linux. This is impossible for the current
folder, a mount point, a folder with subfolders, a folder of another user, and on other systems. Then the files are
renamed one by one, and a file `incomplete` marks this meanwhile, see `mistray.replace_file`.

The page of a report lists its files with their checksums. If a new run writes the same page but not a listed file, that
file is removed, unless it was changed since. Scenes stay, because other commands read them.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from mistray.read_file import read_file
from mistray.replace_file import (
    INCOMPLETE,
    collected,
    draft_folder,
    incomplete_bytes,
    incomplete_sets,
    is_input,
    rename_drafts,
    sets_without,
    sweep_drafts,
    sync,
    telling,
    written,
)

EXCHANGE = 2  # RENAME_EXCHANGE
HERE = -100  # AT_FDCWD
PAGE, END, SCENE = ".html", b"</html>", ".xml"
_LIST = re.compile(rb"<!-- files of this report: (.*?) -->", re.DOTALL)


class _Impossible(Exception):
    """Raised if a folder cannot be exchanged as a whole, so that its files are replaced one by one."""


@contextlib.contextmanager
def replacing_folder(folder: str | Path) -> Iterator[None]:
    """
    Make all files that `mistray.replace_file` writes into a folder within a block appear together at its end.

    A nested block for the same folder is part of the outer one. An error in the block leaves the folder unchanged.

    Parameters
    ----------
    folder : str or Path
        Folder, created with its parents if it is missing and a file is written. Other files in it stay.

    Raises
    ------
    MistrayError
        If a file cannot be written. The old folder is unchanged, apart from the case in
        `mistray.replace_file.rename_drafts`.
    KeyboardInterrupt
        On Ctrl-C, as in `mistray.replace_file.rename_drafts`.
    """
    target = Path(os.path.realpath(Path(folder).expanduser()))
    if str(target) in collected:
        yield
        return
    files = collected[str(target)] = {}
    try:
        yield
    finally:
        del collected[str(target)]
    if files:
        _replace(target, files)


def _replace(target: Path, files: dict[str, bytes]) -> None:
    """
    Replace files of a folder (name → content) by exchanging the whole folder if possible, else one by one.

    Raise `MistrayError` if the folder or a file cannot be written.
    """
    sweep_drafts(target)
    page = next((name for name in reversed(files) if name.endswith(PAGE)), None)
    gone: set[str] = set()
    if page is not None:
        gone = _obsolete(target, page) - files.keys()
        files[page] = _with_list(files[page], {name: data for name, data in files.items() if name != page})
        files[page] = files.pop(page)  # the last one gives the set its name
    try:
        _exchange(target, files, gone)
    except _Impossible:
        with telling(target, "folder"):
            target.mkdir(parents=True, exist_ok=True)
        rename_drafts({target / name: data for name, data in files.items()}, "file", [target / name for name in gone])
        return
    written.extend(target / name for name in files)


def _exchange(target: Path, files: Mapping[str, bytes], gone: set[str]) -> None:
    """
    Replace a folder in one system call: it gets `files`, by name, and keeps its others except those in `gone`.

    Raise `_Impossible`, with nothing changed, if that is not possible. A file that cannot be written raises
    `MistrayError`.
    """
    old = os.path.lexists(target)
    move: Callable[[Path, Path], None] = os.rename
    if old:
        move = _exchanger()
        _check(target)
    place = next(folder for folder in target.parents if folder.exists())
    with contextlib.ExitStack() as stack:
        try:
            draft = stack.enter_context(draft_folder(place))
            if old:
                shutil.copystat(target, draft)
                if (target.stat().st_uid, target.stat().st_gid) != (draft.stat().st_uid, draft.stat().st_gid):
                    os.chown(draft, target.stat().st_uid, target.stat().st_gid)
        except OSError:
            raise _Impossible from None
        for name, data in files.items():
            with telling(target / name, "file"):
                (draft / name).write_bytes(data)
                sync(draft / name)
        sets = incomplete_sets(target)
        own = {*files, *gone, *([INCOMPLETE] if sets else [])}
        try:
            if left := sets_without(sets, own):
                (draft / INCOMPLETE).write_bytes(incomplete_bytes(left))
            for entry in list(os.scandir(target)) if old else ():
                if entry.name not in own:
                    os.link(entry.path, draft / entry.name, follow_symlinks=False)
            sync(draft)
            target.parent.mkdir(parents=True, exist_ok=True)
            move(draft, target)
        except OSError:
            raise _Impossible from None
        if old:
            _bring_late(draft, target, own)
        with telling(target, "folder"):
            sync(target.parent)


def _check(target: Path) -> None:
    """
    Raise `_Impossible` if a folder is the current one, a mount point, unreadable, or holds other folders.

    One that holds anything but files and links raises it as well.
    """
    try:
        here = os.path.samefile(target, os.curdir)
        plain = target.is_dir() and not os.path.ismount(target)
        whole = all(entry.is_symlink() or entry.is_file() for entry in list(os.scandir(target)))
    except OSError:
        raise _Impossible from None
    if here or not plain or not whole:
        raise _Impossible


@functools.cache
def _renameat2() -> Callable[..., int] | None:
    """Return the function ``renameat2`` of the C library; None if it does not exist, as outside Linux."""
    try:
        found = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError, TypeError):
        return None
    found.argtypes = [ctypes.c_int, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_uint]
    return found


def _exchanger() -> Callable[[Path, Path], None]:
    function = _renameat2()
    if function is None:
        raise _Impossible

    def exchange(one: Path, other: Path) -> None:
        if function(HERE, os.fsencode(one), HERE, os.fsencode(other), EXCHANGE) != 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))

    return exchange


def _bring_late(old: Path, new: Path, own: set[str]) -> None:
    """Move files that another process added or replaced in the old folder meanwhile to the new one, except `own`."""
    for entry in list(os.scandir(old)):
        with contextlib.suppress(OSError):
            place = new / entry.name
            here = place.lstat() if os.path.lexists(place) else None
            if entry.name not in own and (here is None or here.st_ino != entry.stat(follow_symlinks=False).st_ino):
                os.replace(entry.path, place)


def _obsolete(folder: Path, page: str) -> set[str]:
    """
    Return names of unchanged files that the previous run of a page wrote, and of files in an incomplete set.

    The page itself, scenes, and files that serve as input are left out.
    """
    found = {*incomplete_sets(folder).get(page, ())} - {page}
    with contextlib.suppress(ValueError, AttributeError, RecursionError):  # a page of somebody else
        lists = _LIST.findall(read_file(folder / page, own=True))
        for name, written_sum in json.loads(lists[-1]).items() if lists else ():
            old = folder / name
            if Path(name).name == name and old.is_file() and _sum(read_file(old, own=True)) == written_sum:
                found.add(name)
    return {name for name in found if not name.endswith(SCENE) and not is_input(folder / name)}


def _with_list(page: bytes, files: Mapping[str, bytes]) -> bytes:
    """Return a page with the list of its files and checksums before its end; unchanged if it has no ``</html>``."""
    start, end, rest = page.rpartition(END)
    if not end:
        return page
    text = (
        json.dumps({name: _sum(data) for name, data in files.items()}).replace(">", "\\u003e").replace("-", "\\u002d")
    )
    return start + b"<!-- files of this report: " + text.encode() + b" -->" + end + rest


def _sum(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()

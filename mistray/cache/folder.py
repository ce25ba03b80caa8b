"""Folder and size limit of the cache: set by the user, or those by default."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path

from mistray.cache.store import Cache
from mistray.errors import MistrayError

FOLDER, LIMIT = "MISTRAY_CACHE", "MISTRAY_CACHE_MB"
OFF = ("off", "0")
DEFAULT_MB = 1000.0


def default_folder() -> Path | None:
    """
    Return the folder of the cache: ``MISTRAY_CACHE``, or ``mistray`` in the user's folder for caches.

    Returns
    -------
    Path or None
        Folder; None if ``MISTRAY_CACHE`` is ``off`` or ``0``.

    Raises
    ------
    MistrayError
        If the user has no home folder.
    """
    given = os.environ.get(FOLDER, "").strip()
    if given.lower() in OFF:
        return None
    try:
        if given:
            return Path(given).expanduser().absolute()
        if sys.platform == "win32":
            return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "mistray" / "cache"
        if sys.platform == "darwin":
            return Path.home() / "Library" / "Caches" / "mistray"
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache").absolute() / "mistray"
    except RuntimeError:
        raise MistrayError(
            f"there is no home folder for a cache; set {FOLDER} to a folder, or to 'off' for none"
        ) from None


def limit_bytes() -> int:
    """
    Return the size limit of the cache in bytes: ``MISTRAY_CACHE_MB``, by default 1000, in units of 10⁶ bytes.

    Raises
    ------
    MistrayError
        If ``MISTRAY_CACHE_MB`` is not a number above 0.
    """
    given = os.environ.get(LIMIT, "").strip()
    try:
        megabytes = float(given) if given else DEFAULT_MB
    except ValueError:
        megabytes = math.nan
    if not 0 < megabytes < math.inf:
        raise MistrayError(f"{LIMIT} is '{given}'; give the size of the cache in MB, greater than 0")
    return round(1e6 * megabytes)


def open_cache(where: bool | str | Path | None = None) -> Cache | None:
    """
    Return the cache of results to use.

    Parameters
    ----------
    where : bool, str, Path or None
        Folder of the cache; True or None for that of `default_folder`; False for no cache.

    Returns
    -------
    Cache or None
        Cache; None if it is switched off. ``True`` does not override ``MISTRAY_CACHE=off``.

    Raises
    ------
    MistrayError
        If the user has no home folder, or ``MISTRAY_CACHE_MB`` is not a number above 0.
    """
    if where is False:
        return None
    folder = default_folder() if where is None or where is True else Path(where).expanduser().absolute()
    return None if folder is None else Cache(folder, limit_bytes())

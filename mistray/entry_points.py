"""Entry points of other distributions, found without reading the metadata of every package that is installed."""

from __future__ import annotations

import contextlib
import os
import sys


def points_of(group: str) -> list[tuple[str, str]]:
    """Return name and value of each entry point of a group, sorted by name; their modules are not imported."""
    if not any(_names(folder, group) for folder in sys.path):
        return []
    from importlib.metadata import entry_points

    return sorted((point.name, point.value) for point in entry_points(group=group))


def _names(folder: str, group: str) -> bool:
    """True if a package installed in a folder of the import path declares entry points of a group."""
    with contextlib.suppress(OSError):
        for entry in os.scandir(folder or os.curdir):
            if entry.name.endswith((".dist-info", ".egg-info")):
                with contextlib.suppress(OSError), open(os.path.join(entry.path, "entry_points.txt"), "rb") as file:
                    if f"[{group}]".encode() in file.read():
                        return True
    return False

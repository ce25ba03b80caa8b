"""Installed analyses: folders of `mistray.analyses`, and packages of other distributions."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import os
import pkgutil
import sys
from collections.abc import Iterator
from types import ModuleType

ENTRY_POINTS = "mistray.analyses"  # group; each names a package with a module `command`


def analysis_commands() -> tuple[list[ModuleType], list[str]]:
    """
    Return the modules ``command`` of all analyses, each with its ``COMMAND``, and messages on omitted ones.

    A package of another distribution that cannot be imported, or has no command, is left out, and a message gives the
    reason.
    """
    commands = [f"{name}.command" for name, is_package in _names_in("mistray.analyses") if is_package]
    modules = [importlib.import_module(name) for name in commands if importlib.util.find_spec(name)]
    left_out = []
    for name, package in _packages_of_others():
        try:
            module = importlib.import_module(f"{package}.command")
            list(module.COMMAND.options)  # all that it needs can be imported
            modules.append(module)
        except Exception as error:  # code of others
            left_out.append(
                f"analysis '{name}' is left out; repair or remove package '{package}': {type(error).__name__}: {error}"
            )
    return modules, left_out


def modules_in(package: str) -> list[ModuleType]:
    """Return all modules of a package."""
    return [importlib.import_module(name) for name, _ in _names_in(package)]


def _names_in(package: str) -> list[tuple[str, bool]]:
    """Return full names of the modules of a package, and whether each is a package; none if not installed."""
    if importlib.util.find_spec(package) is None:
        return []
    folder = importlib.import_module(package).__path__
    return [(f"{package}.{found.name}", found.ispkg) for found in pkgutil.iter_modules(folder)]


def _packages_of_others() -> Iterator[tuple[str, str]]:
    """Yield name and package of each analysis that other installed packages declare as an entry point."""
    if not any(_names_analyses(folder) for folder in sys.path):
        return
    from importlib.metadata import entry_points

    for point in sorted(entry_points(group=ENTRY_POINTS), key=lambda point: point.name):
        yield point.name, point.value


def _names_analyses(folder: str) -> bool:
    """Return whether a package folder on the import path declares analyses as entry points."""
    with contextlib.suppress(OSError):
        for entry in os.scandir(folder or os.curdir):
            if entry.name.endswith((".dist-info", ".egg-info")):
                with contextlib.suppress(OSError), open(os.path.join(entry.path, "entry_points.txt"), "rb") as file:
                    if f"[{ENTRY_POINTS}]".encode() in file.read():
                        return True
    return False

"""Discovery of installed analyses: subpackages of `mistray.analyses`, and packages of other distributions."""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
from types import ModuleType

from mistray.entry_points import points_of

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
    for name, package in points_of(ENTRY_POINTS):
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
    """Import and return all modules of a package; none if it is not installed."""
    return [importlib.import_module(name) for name, _ in _names_in(package)]


def _names_in(package: str) -> list[tuple[str, bool]]:
    """Return full names of a package's modules, each with True if it is a package; empty if it is not installed."""
    if importlib.util.find_spec(package) is None:
        return []
    folder = importlib.import_module(package).__path__
    return [(f"{package}.{found.name}", found.ispkg) for found in pkgutil.iter_modules(folder)]

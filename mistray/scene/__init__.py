"""Optical systems as Mitsuba scenes: loading, checking, editing, naming and coating."""

from mistray.scene.add_structures import add_structures
from mistray.scene.coat import Coated, coat, write_coated
from mistray.scene.load import find, load
from mistray.scene.surface_rules import Rules

__all__ = ["Coated", "Rules", "add_structures", "coat", "find", "load", "write_coated"]


def __dir__() -> list[str]:
    return sorted(__all__)

"""Optical systems as Mitsuba scenes: loading, checking, naming."""

from mistray.scene.add_structures import add_structures
from mistray.scene.load import find, load

__all__ = ["add_structures", "find", "load"]

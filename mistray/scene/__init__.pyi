"""Optical systems as Mitsuba scenes: loading, checking, editing, naming and coating."""

# Written by tests/stubs.py from what the functions are when they run

from mistray.scene.add_structures import add_structures as add_structures
from mistray.scene.coat import Coated as Coated
from mistray.scene.coat import coat as coat
from mistray.scene.coat import write_coated as write_coated
from mistray.scene.load import find as find
from mistray.scene.load import load as load
from mistray.scene.surface_rules import Rules as Rules

__all__ = ["Coated", "Rules", "add_structures", "coat", "find", "load", "write_coated"]

"""Optical systems as Mitsuba scenes: loading, checking, naming."""

from mistray.scene.load import find, load

__all__ = ["find", "load"]

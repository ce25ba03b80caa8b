"""Mechanical parts from CAD and mesh files: analytic where a face is a complete band of revolution, else triangles."""

# Written by tests/stubs.py from what the functions are when they run

from mistray.mechanics.finish import Finish as Finish
from mistray.mechanics.finish import finish as finish
from mistray.mechanics.mechanics import Mechanics as Mechanics
from mistray.mechanics.mechanics import read_mechanics as read_mechanics

__all__ = ["Finish", "Mechanics", "finish", "read_mechanics"]

"""Mechanical parts from CAD and mesh files: analytic where a face is a complete band of revolution, else triangles."""

from mistray.mechanics.finish import Finish, finish
from mistray.mechanics.mechanics import Mechanics, read_mechanics

__all__ = ["Finish", "Mechanics", "finish", "read_mechanics"]

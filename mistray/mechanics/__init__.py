"""Mechanical parts from CAD and mesh files: analytic where a face is a complete band of revolution, else triangles."""

from typing import TYPE_CHECKING

from mistray._lazy import lazy_package

if TYPE_CHECKING:
    from mistray.mechanics.finish import Finish, finish
    from mistray.mechanics.mechanics import Mechanics, read_mechanics

__all__ = lazy_package(__name__, {"finish": ["Finish", "finish"], "mechanics": ["Mechanics", "read_mechanics"]})

"""Mechanical parts from CAD and mesh files: analytic where a face is a complete band of revolution, else triangles."""

from mistray._lazy import lazy_package

__all__ = lazy_package(__name__, {"finish": ["Finish", "finish"], "mechanics": ["Mechanics", "read_mechanics"]})

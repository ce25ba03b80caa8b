"""Thermal emission of warm surfaces, as sources of a forward trace."""

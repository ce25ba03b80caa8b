"""Figures of ghosts."""

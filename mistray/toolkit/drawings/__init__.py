"""Drawings of systems: sections with rays, bodies cut open, and baffles."""

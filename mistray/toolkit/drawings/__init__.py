"""Drawings of systems: sections with rays, bodies cut open, baffles."""

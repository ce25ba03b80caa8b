"""Drawings of optical systems: sections with rays, bodies cut open, and baffles."""

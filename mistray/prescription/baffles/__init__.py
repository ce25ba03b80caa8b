"""Baffles by construction: vane tubes, telescope baffles, and the zones of their walls that light reaches."""

"""Baffles by construction: vane tubes, telescope baffles, and which of their walls light reaches."""

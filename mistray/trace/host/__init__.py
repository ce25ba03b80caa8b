"""Rays traced on the host in float64, one hit after the other, and their start points."""

"""Rays traced on the host in float64, one hit after the other: their start points, bundles and stops."""

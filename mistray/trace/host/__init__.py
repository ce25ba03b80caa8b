"""Rays on the host in float64: their start points and their paths, one hit after the other."""

"""Rays on the host in float64: where they start, and where they go one after the other."""

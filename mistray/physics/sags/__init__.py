"""Sags of optical surfaces in float64: terms that can be added to a conic, one file for each family."""

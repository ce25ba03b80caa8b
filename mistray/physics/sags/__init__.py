"""Sags of optical surfaces in float64: what can be added to a conic, one family a file."""

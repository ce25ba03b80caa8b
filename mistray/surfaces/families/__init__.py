"""Families of analytic surfaces: each answers what a trace asks, in a file of its own."""

"""Cassegrain telescope whose primary mirror consists of 18 hexagons."""

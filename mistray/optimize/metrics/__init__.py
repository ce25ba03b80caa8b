"""Metrics that are to be small or large, of traces and of point source transmittances, and what they look at."""

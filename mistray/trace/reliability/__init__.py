"""Reliability of the numbers of a trace: light that was cut, and the sampling of scattered light."""

"""Fits of parameters of a scene to measured values, such as a PST."""

"""Fits of parameters of a scene to measured values."""

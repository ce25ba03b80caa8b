"""Fit parameters of a scene to measured values."""

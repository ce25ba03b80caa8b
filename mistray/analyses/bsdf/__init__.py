"""Scatter models by themselves: BSDF, total scatter, fits to measured data."""

"""Scatter models evaluated on their own: BSDF, total integrated scatter and fits to measured data."""

"""Evaluate scatter models on their own: BSDF, total integrated scatter and fits to measured data."""

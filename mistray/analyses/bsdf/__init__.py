"""Scatter models evaluated on their own: BSDF and total integrated scatter (TIS)."""

"""Rims that a beam exactly fills, where a metric has only one-sided derivatives; rays on the beam's edge find them."""

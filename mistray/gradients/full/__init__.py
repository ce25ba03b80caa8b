"""Rims that a beam just fills, at which a metric has no derivative; rays along the beam's edge find them."""

"""Rims that a beam just fills, at which a metric has no derivative: found by the rays along the beam's edge."""

"""Rims that a beam just fills: found by the rays along its edge, for they have no derivative there."""

"""Cooke triplet, f = 50 mm, f/4, uncoated."""

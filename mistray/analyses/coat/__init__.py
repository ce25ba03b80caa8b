"""Coatings, paint and scatter put on surfaces of a scene by name."""

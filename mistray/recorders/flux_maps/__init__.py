"""Recorders of flux that do not change the light: on a rectangle, on surfaces, or by direction far away."""

"""Metrics of a scene that are to be small or large: their values, parameters, derivatives and side effects."""

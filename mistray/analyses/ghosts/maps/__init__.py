"""Irradiance maps of paths and of parts of the light of a field."""

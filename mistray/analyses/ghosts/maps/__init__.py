"""Irradiance maps of single paths and of parts of the light at one field."""

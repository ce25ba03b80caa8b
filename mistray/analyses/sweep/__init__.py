"""Sweep of a scene over fields, wavelengths and configurations in one call, with the kernels compiled once."""

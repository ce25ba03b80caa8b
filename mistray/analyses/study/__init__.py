"""Stray-light study of a system in eight steps."""

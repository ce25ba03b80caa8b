"""Telescopes of batoid (.yaml)."""

"""Ghosts and scattered light by path: their power, their images, and what they do to the picture."""

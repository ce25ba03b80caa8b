"""Ghosts and scattered light by path: power, images on the detector, and ratio to the direct image."""

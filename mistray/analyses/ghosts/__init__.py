"""Ghosts and scattered light path by path: power, images on the detector, and ratio to the direct image."""

"""Geometry of surfaces: sag, outlines, crossings and poses, and HEALPix pixels."""

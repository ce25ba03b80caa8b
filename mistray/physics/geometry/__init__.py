"""Equations of shapes and places: sag, crossings, poses, first-order optics."""

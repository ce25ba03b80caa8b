"""Equations of shapes and positions: sag, crossings, poses, first-order optics."""

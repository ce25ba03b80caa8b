"""Newtonian telescope: tube with vanes, primary, diagonal, eyepiece tube, image."""

"""Cassegrain telescope with main tube, vanes, secondary baffle and inner baffle."""

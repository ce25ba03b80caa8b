"""Thermal self-emission on the detector."""

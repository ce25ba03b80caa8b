"""Quantities derived from a PST: ratios, veiling glare, and irradiance from extended sources."""

"""Families of analytic surfaces: one file for each, with its crossings, normals, areas and rims."""

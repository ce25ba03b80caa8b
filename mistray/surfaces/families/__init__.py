"""Families of analytic surfaces, one per file: ray crossings, normals, areas and rims."""

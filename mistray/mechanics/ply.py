"""Writer of triangles as a binary PLY file (G. Turk, The PLY polygon file format, 1994)."""

from __future__ import annotations

import numpy as np


def ply_bytes(vertices: np.ndarray, triangles: np.ndarray) -> bytes:
    """
    Return the content of a PLY file in single precision, little-endian; unused vertices are left out.

    Parameters
    ----------
    vertices : (n, 3) float64
        Positions of the vertices, mm.
    triangles : (m, 3) int64
        Indices of the vertices of each triangle.
    """
    points, inverse = np.unique(vertices[triangles].reshape(-1, 3).astype("<f4"), axis=0, return_inverse=True)
    table = np.zeros(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    table["count"] = 3
    table["corners"] = inverse.reshape(-1, 3)
    head = [
        "ply",
        "format binary_little_endian 1.0",
        "comment mm, written by mistray",
        f"element vertex {len(points)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(table)}",
        "property list uchar int vertex_indices",
        "end_header",
        "",
    ]
    return "\n".join(head).encode("ascii") + points.tobytes() + table.tobytes()

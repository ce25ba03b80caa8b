"""Columns of the derivatives of a metric by the geometry of surfaces."""

from __future__ import annotations

COEFFICIENTS = tuple(f"a{order}" for order in range(4, 21, 2))
# By surface, in its own frame at the vertex: displacement (mm) and rotation (rad) about its axes; curvature (1/mm),
# conic and aspheric coefficients; radius at the vertex (mm) and dr/dz of a cone
SHAPE_COLUMNS = (
    *("x", "y", "z", "tilt_x", "tilt_y", "tilt_z"),
    *("curvature", "conic", *COEFFICIENTS),
    *("r0", "slope"),
)
# Rims: clear radii, half sides of a rectangle, ends of a cone along the axis from the vertex; mm
RIM_COLUMNS = ("outer", "inner", "half_width", "half_height", "z_low", "z_high")
GEOMETRY = (*SHAPE_COLUMNS, *RIM_COLUMNS)

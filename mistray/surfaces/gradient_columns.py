"""Columns of derivatives of a metric with respect to the geometry of surfaces: displacement, rotation and shape."""

from __future__ import annotations

from collections.abc import Mapping

DISPLACEMENT, ROTATION = ("x", "y", "z"), ("tilt_x", "tilt_y", "tilt_z")
POSE = (*DISPLACEMENT, *ROTATION)
COEFFICIENTS = tuple(f"a{order}" for order in range(4, 21, 2))
OWN = tuple(f"own_{k}" for k in range(1, 129))
# Columns of a surface, in its own frame at the vertex: displacement (mm) and rotation (rad) about its axes; curvature
# (1/mm), conic and aspheric coefficients; radius at the vertex (mm) and dr/dz of a cone; numbers of other families
SHAPE_COLUMNS = (
    *POSE,
    *("curvature", "conic", *COEFFICIENTS),
    *("r0", "slope"),
    *OWN,
)
# Rims: clear radii, half sides of a rectangle, ends along a coordinate of the family (z of a cone); mm
RIM_COLUMNS = ("outer", "inner", "half_width", "half_height", "low", "high")
OUTER, INNER, HALF_WIDTH, HALF_HEIGHT, LOW, HIGH = range(len(RIM_COLUMNS))
GEOMETRY = (*SHAPE_COLUMNS, *RIM_COLUMNS)
# The columns that a parameter of a shape may move; a frustum turns about its origin, which is not its vertex
PARAMETER_COLUMNS: dict[str, frozenset[str]] = {
    **dict.fromkeys(DISPLACEMENT, frozenset(DISPLACEMENT)),
    **dict.fromkeys(ROTATION, frozenset(POSE)),
}


def declare_columns(columns: Mapping[str, tuple[str, ...]]) -> None:
    """
    Register, for each parameter name of a shape family, the `GEOMETRY` columns that the parameter changes.

    A name that several families share has the columns of all of them.
    """
    for name, moved in columns.items():
        PARAMETER_COLUMNS[name] = PARAMETER_COLUMNS.get(name, frozenset()) | set(moved)

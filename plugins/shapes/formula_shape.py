"""Base class of shapes that are given by a formula: a mesh for Mitsuba, the formula for the ray tree."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import mitsuba as mi
import numpy as np

from mistray._mitsuba_compat import build_mesh, write_mesh
from mistray.errors import MistrayError
from mistray.param import OBJECT, REQUIRED, Param, fixed, take
from mistray.physics.geometry.pose import moved, rigid_motion
from mistray.ranges import AZIMUTH_DEG, FINITE, PLACE_MM, SPACE, TEXT, Range
from mistray.surfaces.gradient_columns import POSE, declare_columns
from mistray.surfaces.upload import changed_numbers

if TYPE_CHECKING:
    from mistray.surfaces.surface import TracedSurface

SHIFT = Param("mm", PLACE_MM, "displacement along the axes of this frame", default=0.0)
TURN = Param(
    "deg",
    AZIMUTH_DEG,
    "right-handed rotations about these axes, through the displaced origin; that about z comes first, then y, then x",
    default=0.0,
)
FRAME = {"to_world": fixed("mm", OBJECT, "position and orientation of its frame", within="rigid", otherwise="identity")}
MOVES = {**dict.fromkeys(POSE[:3], SHIFT), **dict.fromkeys(POSE[3:], TURN)}
NAMES = {
    "part": fixed("string", TEXT, "name of the object the surface belongs to", None, otherwise="shape id"),
    "space": fixed("integer", SPACE, "optical space, for grouping in reports", -1),
    "(nested) bsdf": fixed("bsdf", OBJECT, "an ``interface``"),
}
DETECTOR = {
    "(nested) sensor": fixed(
        "sensor",
        OBJECT,
        "an ``irradiancemeter``: makes this shape the detector; Mitsuba's own integrators see the front of its mesh",
        None,
    )
}
RADIUS = fixed(
    "mm", Range(-math.inf, math.inf), "vertex radius of curvature; 0 or inf is a plane", None, otherwise="plane"
)
CURVATURE = Param("1/mm", FINITE, "curvature instead of ``radius``", default=0.0)
FARTHEST_MM = PLACE_MM.high  # largest distance from the origin; single precision ends at 1e38
# Steps of differences. Displacements are linear; for a tilt the relative error is its square in rad, 3e-10 / 6
MM, DEGREES = 1.0, 1e-3
RELATIVE = 1e-5  # step of all other parameters, in units of the surface's size


class FormulaShape(mi.Mesh):
    """
    Base class of surfaces given by a formula.

    A subclass calls `_start` and `_finish` from its constructor and provides `check`, `outer_radius`, `_local_mesh` and
    `surface`, which is its form in the ray tree. The named parameters in `values` (floats, on the host) are exposed to
    `mi.traverse` as differentiable ``mi.Float``, those named in `in_double` as ``mi.Float64``. An update reads them
    back, checks them and remakes the mesh.

    Attributes
    ----------
    properties : mapping of str to Param
        All that a scene may give, by name; `ranges` and `defaults` of the subclass's own parameters are made from it.
    values : dict of str to float
        Parameters by name, those of the subclass and then `POSE`.
    base : (4, 4) float64
        Frame given by ``to_world``: rigid transform to the world, mm.
    detects : bool
        Whether a sensor is nested. The mesh normals then point to the front, from which the light comes.
    """

    columns: Mapping[str, tuple[str, ...]] = {}
    """Columns that each parameter changes, beside the pose; see `mistray.surfaces.gradient_columns`."""
    in_double: tuple[str, ...] = ()
    properties: ClassVar[Mapping[str, Param]]
    ranges: Mapping[str, Range]
    defaults: ClassVar[Mapping[str, float]] = {}
    values: dict[str, float]

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        stated = vars(cls).get("properties", {})
        own = {key: param for key, param in stated.items() if param.moves and key not in MOVES}
        if own:
            cls.ranges = {key: param.values for key, param in own.items()}
            cls.defaults = {key: param.default for key, param in own.items() if param.default is not REQUIRED}
        declare_columns(cls.columns)

    def _start(self, props: mi.Properties) -> None:
        take_names(self, props)
        self.base = rigid_motion(props.get("to_world", mi.ScalarTransform4f()).matrix, self.owner)

    def _finish(self, props: mi.Properties, values: dict[str, float]) -> None:
        self.values = values | {key: param.of(props, key, self.owner) for key, param in MOVES.items()}
        self._loaded = dict(self.values)
        objects = (props[key] for key in list(props.keys()) if props.type(key) == mi.Properties.Type.Object)
        self.detects = any(isinstance(item, mi.Sensor) for item in objects)
        self._check_all()
        self.parameters = {
            key: (mi.Float64 if key in self.in_double else mi.Float)(value) for key, value in self.values.items()
        }
        build_mesh(self, self.name, *self._checked_mesh(), props)
        if hasattr(self.bsdf(), "carried"):
            self.bsdf().carried(self, self.detects)

    def _check_all(self) -> None:
        for key, value in self.values.items():
            (MOVES.get(key) or self.ranges[key]).check(key, value, self.owner)
        self.check()

    def check(self) -> None:
        """
        Raise `MistrayError` if a parameter of the shape is out of range, or if parameters do not go together.

        It may keep what follows from `values`: after a refused update it is called again, with the values before.
        """
        raise NotImplementedError

    @property
    def matrix(self) -> np.ndarray:
        """Transform from the displaced and tilted frame of the surface to the world, (4, 4) float64, mm."""
        return moved(self.base, *(self.values[key] for key in POSE))

    @property
    def outer_radius(self) -> float:
        """Largest distance of the surface from its axis, mm."""
        raise NotImplementedError

    @staticmethod
    def surface(values: Mapping[str, float]) -> TracedSurface:
        """Return the ray tree's form of the surface with given parameters, in the frame of its vertex."""
        raise NotImplementedError

    @staticmethod
    def vertex_frame(values: Mapping[str, float], matrix: np.ndarray) -> np.ndarray:
        """
        Return the frame of the vertex, (4, 4) float64, mm, of a surface with given parameters and frame `matrix`.

        In the base class it is `matrix` itself.
        """
        return matrix

    @property
    def held(self) -> set[str]:
        """Names of the parameters for which there are no derivatives; in the base class none."""
        return set()

    @property
    def differentiable(self) -> tuple[str, ...]:
        """Names of the parameters for which there are derivatives."""
        held = self.held
        return tuple(key for key in self.values if key not in held)

    def step(self, name: str) -> float:
        """Return the step of a parameter for finite differences, in the parameter's unit."""
        if name in POSE:
            return DEGREES if name.startswith("tilt") else MM
        return RELATIVE * self.outer_radius

    @property
    def figure(self) -> str:
        """Kind of the surface, such as "asphere", for messages."""
        return type(self).__name__.lower()

    mechanics = True
    """Whether the surface is made and mounted as a mechanical part, with its tolerances; otherwise as optics."""

    @property
    def sheet(self) -> bool:
        """True if the surface lies across its axis, so that rays are aimed at its outline alone."""
        return False

    def _local_mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the mesh in the local frame: vertices, (n, 3), mm, and faces as vertex indices, (m, 3)."""
        raise NotImplementedError

    def _checked_mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Return vertices in the world, (n, 3), mm, and faces, (m, 3).

        Raise `MistrayError` if it reaches too far from the origin.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            vertices, faces = self._tessellate()
            check_reach(vertices, self.name)
        return vertices, faces

    def _tessellate(self) -> tuple[np.ndarray, np.ndarray]:
        vertices, faces = self._local_mesh()
        matrix = self.matrix
        # Mitsuba's own sensors look along the normals of their mesh
        return vertices @ matrix[:3, :3].T + matrix[:3, 3], faces[:, ::-1] if self.detects else faces

    def traverse(self, callback: mi.TraversalCallback) -> None:
        mi.Mesh.traverse(self, callback)
        given = self.__dict__.get("parameters", {})
        held = self.held if given else set()
        for key, value in given.items():
            kind = mi.ParamFlags.NonDifferentiable if key in held else mi.ParamFlags.Differentiable
            callback.put(key, value, kind | mi.ParamFlags.Discontinuous)

    def parameters_changed(self, keys: list[str] = []) -> None:  # noqa: B006  (Mitsuba's own signature)
        parameters = self.__dict__.get("parameters", {})
        before, changed = self.__dict__.get("values", {}), dict.fromkeys(parameters, 0.0)
        try:
            asked = {key: value for key, value in parameters.items() if not keys or key in keys}
            changed = changed_numbers(asked, self.owner, before, self._loaded, self.in_double)
            if not changed:
                mi.Mesh.parameters_changed(self, keys)
                return
            self.values = before | changed
            self._check_all()
            mesh = self._checked_mesh()
        except MistrayError:
            self.values = before
            for key in changed:  # in place: mi.traverse has handed out these very objects
                mi.set_property(parameters[key], type(parameters[key])(before[key]))
            self.check()  # a subclass keeps there what follows from its values
            raise
        write_mesh(self, *mesh)

    def to_string(self) -> str:
        inside = ", ".join(f"{key} = {value:g}" for key, value in self.values.items() if value)
        return f"{type(self).__name__}[id = {self.name}, {inside}]"


def grid(half_width: float, half_height: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the mesh of a rectangle with count × count cells: x and y, (n, 2), mm, and faces towards +z, (m, 3)."""
    x, y = np.meshgrid(
        np.linspace(-half_width, half_width, count + 1), np.linspace(-half_height, half_height, count + 1)
    )
    i, j = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
    a = (i * (count + 1) + j).ravel()
    b, c, d = a + 1, a + count + 1, a + count + 2
    faces = np.concatenate([np.column_stack([a, b, d]), np.column_stack([a, d, c])]).astype(np.uint32)
    return np.column_stack([x.ravel(), y.ravel()]), faces


def take_names(shape: Any, props: mi.Properties) -> None:
    """Set `name`, `owner` for messages, `part` and optical `space` of a shape from its properties."""
    shape.name = str(props.id())
    shape.owner = f"shape '{shape.name}'"
    part, shape.space = (NAMES[key].of(props, key, shape.owner) for key in ("part", "space"))
    shape.part = shape.name if part is None else part


def curvature_of(shape: FormulaShape, props: mi.Properties, radius: str, curvature: str) -> float:
    """
    Return the curvature, 1/mm, of a shape from the property named `curvature`, or `radius`, mm; 0 without either.

    A radius of 0 or inf is a plane. Raise `MistrayError` if both are given.
    """
    if radius in props and curvature in props:
        raise MistrayError(f"{shape.owner}: give {radius} or {curvature}, not both")
    if radius not in props:
        return float(take(shape, props, curvature) or 0.0)
    length = take(shape, props, radius)
    return 0.0 if length == 0 or np.isinf(length) else 1.0 / length


def check_reach(vertices: np.ndarray, name: str) -> None:
    """Raise `MistrayError` if a world coordinate of a vertex, mm, is `FARTHEST_MM` or more in size; name the shape."""
    farthest = float(np.abs(vertices).max())
    if not farthest < FARTHEST_MM:
        raise MistrayError(
            f"shape '{name}': it reaches {farthest:g} mm from the origin; correct its sizes or its place"
        )

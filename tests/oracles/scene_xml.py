"""Reads a mistray scene XML into a plain float64 model, without Mitsuba; what is not understood raises ValueError."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from .freeform import Freeform
from .geometry import Array, Asphere, Frustum, Mask, Plane, Sphere, Surface
from .glass import refractive_index
from .interface import ABSORBER, CoatingTable, Interface

CENTRE = ("center.x", "center.y", "center.z")
PARAMETERS = {
    "asphere": {
        "radius", "curvature", "conic", "semi_diameter", "inner_semi_diameter", "half_width", "half_height",
        *(f"a{order}" for order in range(4, 21, 2)),
    },
    "frustum": {"r0", "z0", "r1", "z1"},
    "rectangle": {"flip_normals"},
    "disk": {"flip_normals"},
    "sphere": {"flip_normals", "radius", *CENTRE},
}  # fmt: skip


@dataclass(frozen=True)
class SceneShape:
    shape_id: str
    surface: Surface
    to_world: Array
    interface: Interface
    part: str
    space: int
    detector: bool = False

    def to_local(self, origin: Array, direction: Array) -> tuple[Array, Array]:
        rotation = self.to_world[:3, :3]
        return (origin - self.to_world[:3, 3]) @ rotation, direction @ rotation

    def first_hit(self, origin: Array, direction: Array, leaving: Mask) -> Array:
        """Path length in mm to the first hit of world rays, inf where they miss."""
        return self.surface.first_hit(*self.to_local(origin, direction), leaving)

    def normal(self, point: Array) -> Array:
        local = (point - self.to_world[:3, 3]) @ self.to_world[:3, :3]
        return self.surface.normal(local) @ self.to_world[:3, :3].T


@dataclass(frozen=True)
class Emitter:
    """Source as the XML gives it; lengths in mm, irradiance in W/mm^2 normal to the beam, intensity in W/sr."""

    to_world: Array
    values: Mapping[str, str | float]
    kind: str = "collimated"


@dataclass(frozen=True)
class SceneModel:
    path: Path | None
    shapes: tuple[SceneShape, ...]
    emitters: tuple[Emitter, ...]
    settings: Mapping[str, str | float] = field(default_factory=dict)

    @cached_property
    def by_id(self) -> dict[str, SceneShape]:
        return {shape.shape_id: shape for shape in self.shapes}

    detectors = property(lambda self: tuple(shape.shape_id for shape in self.shapes if shape.detector))

    def indices(self, shape_id: str, wavelength_nm: float) -> tuple[float, float]:
        """Refractive indices (front, back); (1, 1) for an opaque surface."""
        interface = self.by_id[shape_id].interface
        if interface.opaque:
            return 1.0, 1.0
        return refractive_index(interface.front, wavelength_nm), refractive_index(interface.back, wavelength_nm)

    def radius_about(self, point: Array) -> float:
        """Radius in mm of a ball about a point that holds every surface."""
        return max(float(np.linalg.norm(s.to_world[:3, 3] - point)) + s.surface.extent() for s in self.shapes)

    def without(self, *shape_ids: str) -> SceneModel:
        return replace(self, shapes=tuple(s for s in self.shapes if s.shape_id not in shape_ids))


def read_scene(path: str | Path) -> SceneModel:
    path = Path(path)
    return parse_scene(path.read_text(encoding="utf-8"), path)


def parse_scene(text: str, path: Path | None = None) -> SceneModel:
    """Model of a scene given as XML text; ``path`` locates coating tables."""
    return _Reader(ElementTree.fromstring(text), path).model()


class _Reader:
    def __init__(self, root: ElementTree.Element, path: Path | None) -> None:
        if root.tag != "scene":
            raise ValueError(f"root element is <{root.tag}>, expected <scene>")
        self.root, self.path = root, path
        self.defaults = {node.attrib["name"]: node.attrib["value"] for node in root.iter("default")}
        self.named = {node.attrib["id"]: node for node in root.iter() if "id" in node.attrib and node.tag != "ref"}

    def model(self) -> SceneModel:
        shapes: list[SceneShape] = []
        emitters: list[Emitter] = []
        settings: Mapping[str, str | float] = {}
        for node in self.root:
            if node.tag == "shape":
                shapes.append(self._shape(node, len(shapes)))
            elif node.tag == "emitter":
                if node.attrib["type"] not in ("collimated", "point_source"):
                    raise ValueError(f"oracle knows no emitter {node.attrib['type']!r}")
                emitters.append(Emitter(self._transform(node), self._values(node), node.attrib["type"]))
            elif node.tag == "integrator":
                settings = self._values(node)
            elif node.tag not in ("default", "bsdf", "sensor"):
                raise ValueError(f"oracle knows no <{node.tag}> in a scene")
        ids = [shape.shape_id for shape in shapes]
        if len(set(ids)) != len(ids):
            raise ValueError(f"shape ids are not unique: {sorted(i for i in set(ids) if ids.count(i) > 1)}")
        return SceneModel(self.path, tuple(shapes), tuple(emitters), settings)

    def _text(self, value: str) -> str:
        for name in sorted(self.defaults, key=len, reverse=True):
            value = value.replace(f"${name}", self.defaults[name])
        return value

    def _numbers(self, value: str) -> list[float]:
        return [float(item) for item in self._text(value).replace(",", " ").split()]

    def _values(self, node: ElementTree.Element) -> dict[str, str | float]:
        values: dict[str, str | float] = {}
        for child in node:
            name, text = child.attrib.get("name", ""), self._text(child.attrib.get("value", ""))
            if child.tag in ("float", "integer"):
                values[name] = float(text)
            elif child.tag == "boolean":
                values[name] = float(text.lower() == "true")
            elif child.tag == "string":
                values[name] = text
            elif child.tag in ("point", "vector"):
                values |= {f"{name}.{axis}": number for axis, number in zip("xyz", self._vector(child), strict=True)}
        return values

    def _vector(self, node: ElementTree.Element, default: float = 0.0) -> list[float]:
        if "value" in node.attrib:
            numbers = self._numbers(node.attrib["value"])
            return numbers * 3 if len(numbers) == 1 else numbers
        return [float(self._text(node.attrib.get(axis, str(default)))) for axis in "xyz"]

    def _transform(self, node: ElementTree.Element) -> Array:
        """to_world of a plugin: the children act in the order in which they are written."""
        matrix = np.eye(4)
        for transform in node.findall("transform"):
            if transform.attrib["name"] != "to_world":
                raise ValueError(f"oracle knows no transform {transform.attrib['name']!r}")
            for step in transform:
                matrix = self._step(step) @ matrix
        return matrix

    def _step(self, step: ElementTree.Element) -> Array:
        matrix = np.eye(4)
        if step.tag == "translate":
            matrix[:3, 3] = self._vector(step)
        elif step.tag == "scale":
            matrix[:3, :3] = np.diag(self._vector(step, 1.0))
        elif step.tag == "rotate":
            matrix[:3, :3] = _rotation(np.array(self._vector(step)), float(self._text(step.attrib["angle"])))
        elif step.tag == "matrix":
            numbers = self._numbers(step.attrib["value"])
            size = {16: 4, 9: 3}[len(numbers)]
            matrix[:size, :size] = np.array(numbers).reshape(size, size)
        elif step.tag == "lookat":
            origin, target, up = (np.array(self._numbers(step.attrib[key])) for key in ("origin", "target", "up"))
            forward = (target - origin) / np.linalg.norm(target - origin)
            left = np.cross(up, forward)
            left /= np.linalg.norm(left)
            matrix[:3, :] = np.stack([left, np.cross(forward, left), forward, origin], axis=1)
        else:
            raise ValueError(f"oracle knows no transform step <{step.tag}>")
        return matrix

    def _nested(self, node: ElementTree.Element, tag: str) -> list[ElementTree.Element]:
        direct = node.findall(tag)
        referred = [self.named[ref.attrib["id"]] for ref in node.findall("ref")]
        return direct + [target for target in referred if target.tag == tag]

    def _shape(self, node: ElementTree.Element, number: int) -> SceneShape:
        shape_id = node.attrib.get("id", f"shape_{number}")
        kind = node.attrib["type"]
        values, matrix = self._values(node), self._transform(node)
        own = {key: value for key, value in values.items() if key not in {"part", "space"}}
        if kind == "freeform":
            surface: Surface = Freeform.of(own)
            pose = _rigid(shape_id, matrix)
        elif kind in PARAMETERS:
            surface, pose = _surface(kind, shape_id, {key: float(value) for key, value in own.items()}, matrix)
        else:
            raise ValueError(f"oracle knows no shape type {kind!r} ({shape_id})")
        sensors = [s for s in self._nested(node, "sensor") if s.attrib["type"] == "irradiancemeter"]
        part = str(values.get("part", shape_id))
        return SceneShape(
            shape_id, surface, pose, self._interface(node, shape_id), part, int(values.get("space", -1)), bool(sensors)
        )

    def _interface(self, node: ElementTree.Element, shape_id: str) -> Interface:
        """The nested interface; a shape without one absorbs everything."""
        nested = self._nested(node, "bsdf")
        if not nested:
            return ABSORBER
        bsdf = nested[0]
        if bsdf.attrib["type"] == "null":
            return Interface(reflectance=0.0, transmittance=1.0)
        if bsdf.attrib["type"] != "interface":
            raise ValueError(f"oracle knows no bsdf {bsdf.attrib['type']!r} ({shape_id})")
        values = self._values(bsdf)
        unknown = set(values) - {"front", "back", "R", "T", "table", "mirror", "wavelength_nm"}
        if unknown:
            raise ValueError(f"interface of {shape_id}: unknown parameters {sorted(unknown)}")
        table = None
        if "table" in values:
            table = CoatingTable.read((self.path.parent if self.path else Path()) / str(values["table"]))
        front, back = (str(values.get(side, "air")) for side in ("front", "back"))
        powers = (float(values["R"]), float(values.get("T", 0.0))) if "R" in values else (None, None)
        return Interface(front, back, *powers, table, bool(values.get("mirror", 0.0)))


def _rotation(axis: Array, angle_deg: float) -> Array:
    return Rotation.from_rotvec(angle_deg * axis / np.linalg.norm(axis), degrees=True).as_matrix()


def _rigid(shape_id: str, matrix: Array) -> Array:
    if not np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-9) or np.linalg.det(matrix[:3, :3]) < 0:
        raise ValueError(f"to_world of {shape_id} is not rigid")
    return matrix


def _surface(kind: str, shape_id: str, v: Mapping[str, float], matrix: Array) -> tuple[Surface, Array]:
    if set(v) - PARAMETERS[kind]:
        raise ValueError(f"shape {shape_id}: unknown parameters {sorted(set(v) - PARAMETERS[kind])}")
    if kind == "frustum":
        return Frustum(v["r0"], v["z0"], v["r1"], v["z1"]), _rigid(shape_id, matrix)
    if kind == "asphere":
        radius = v.get("radius", 0.0)
        curvature = 1 / radius if radius and np.isfinite(radius) else v.get("curvature", 0.0)
        powers = tuple((order // 2, v[f"a{order}"]) for order in range(4, 21, 2) if v.get(f"a{order}", 0.0))
        sizes = v.get("semi_diameter", np.inf), v.get("inner_semi_diameter", 0.0)
        sides = v.get("half_width", np.inf), v.get("half_height", np.inf)
        return Asphere(curvature, v.get("conic", 0.0), powers, *sizes, *sides), _rigid(shape_id, matrix)
    scale, pose = np.linalg.norm(matrix[:3, :3], axis=0), matrix.copy()
    pose[:3, :3] /= scale
    sign = -1.0 if v.get("flip_normals") else 1.0
    _rigid(shape_id, pose)
    if kind == "rectangle":
        return Plane(half_width=scale[0], half_height=scale[1], sign=sign), pose
    if not np.allclose(scale[:2] if kind == "disk" else scale, scale[0]):
        raise ValueError(f"oracle knows no elliptic {kind} ({shape_id})")
    if kind == "disk":
        return Plane(outer=scale[0], sign=sign), pose
    pose[:3, 3] = (matrix @ [*(v.get(axis, 0.0) for axis in CENTRE), 1.0])[:3]
    return Sphere(v.get("radius", 1.0) * scale[0], sign), pose

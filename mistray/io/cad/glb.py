"""Reader of the binary glTF files that cascadio writes: meshes, exact surfaces of faces, and assemblies.

glTF 2.0 (Khronos, ISO/IEC 12113:2022); the extension TM_brep_faces is cascadio's. Lengths in these files are in metres.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mistray.io.cad.part import CadPart, RoundSurface
from mistray.read_file import read_file

MM = 1000.0  # per metre
MAGIC = b"glTF"
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
COMPONENTS: dict[int, Any] = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC3": 3}
TRIANGLES = 4  # mode of a primitive
EXTENSION = "TM_brep_faces"
DEEPEST = 200  # assemblies within assemblies


@dataclass(frozen=True)
class Instance:
    """
    Placed copy of a mesh in an assembly.

    It has the index of the mesh, the names from the top of the assembly down, and the matrix, (4, 4), mm, from the
    frame of the mesh to that of the file.
    """

    mesh: int
    names: tuple[str, ...]
    matrix: np.ndarray


class Glb:
    """
    Meshes and assembly in a GLB file.

    Raises
    ------
    ValueError, KeyError, IndexError, struct.error
        If the file does not conform to glTF.
    """

    def __init__(self, path: Path) -> None:
        data = read_file(path)
        if data[:4] != MAGIC:
            raise ValueError("it is not a GLB file")
        self.tree: dict[str, Any] = {}
        self.binary = b""
        position = 12
        while position + 8 <= len(data):
            length, kind = struct.unpack_from("<II", data, position)
            chunk = data[position + 8 : position + 8 + length]
            if kind == JSON_CHUNK:
                self.tree = json.loads(chunk)
            elif kind == BINARY_CHUNK:
                self.binary = chunk
            position += 8 + length

    def instances(self) -> Iterator[Instance]:
        """Yield all placed copies of meshes in the assembly, in the order of the file."""
        nodes = self.tree.get("nodes", [])
        scenes = self.tree.get("scenes", [])
        tops = scenes[self.tree.get("scene", 0)].get("nodes", []) if scenes else []
        yield from (found for top in tops for found in self._below(nodes, top, (), np.eye(4)))

    def _below(self, nodes: list[Any], number: int, names: tuple[str, ...], frame: np.ndarray) -> Iterator[Instance]:
        node = nodes[number]
        names = (*names, str(node.get("name", "")))
        if len(names) > DEEPEST:
            raise ValueError(f"assemblies are nested more than {DEEPEST} times")
        frame = frame @ _matrix(node)
        if "mesh" in node:
            yield Instance(node["mesh"], names, frame)
        for child in node.get("children", []):
            yield from self._below(nodes, child, names, frame)

    def mesh_name(self, number: int) -> str:
        """Return the name of a mesh, which is the name of its product."""
        return str(self.tree["meshes"][number].get("name", ""))

    def mesh(self, number: int) -> tuple[CadPart, int]:
        """Return a mesh in its own frame as a part without names, vertices in mm, and the number of its faces."""
        vertices: list[np.ndarray] = []
        triangles: list[np.ndarray] = []
        faces: list[np.ndarray] = []
        surfaces: dict[int, RoundSurface] = {}
        vertex_count = face_count = 0
        for primitive in self.tree["meshes"][number]["primitives"]:
            if primitive.get("mode", TRIANGLES) != TRIANGLES:  # curves have no faces
                continue
            corners = MM * self._array(primitive["attributes"]["POSITION"]).astype(np.float64)
            indices = self._array(primitive["indices"]).astype(np.int64).reshape(-1, 3)
            brep = primitive.get("extensions", {}).get(EXTENSION, {})
            known = brep.get("faces", [])
            numbers = np.zeros(len(indices), dtype=np.int64)
            if "faceIndices" in brep:
                numbers = self._array(brep["faceIndices"]).astype(np.int64).ravel()
            vertices.append(corners)
            triangles.append(indices + vertex_count)
            faces.append(numbers + face_count)
            for index, face in enumerate(known):
                surface = _surface(face)
                if surface is not None:
                    surfaces[index + face_count] = surface
            vertex_count += len(corners)
            face_count += max(len(known), 1)
        if not vertices:
            return CadPart("", "", "", "", np.empty((0, 3)), np.empty((0, 3), int), np.empty(0, int), {}), 0
        part = CadPart(
            "", "", "", "", np.concatenate(vertices), np.concatenate(triangles), np.concatenate(faces), surfaces
        )
        return part, face_count

    def _array(self, number: int) -> np.ndarray:
        accessor = self.tree["accessors"][number]
        width, kind = WIDTHS[accessor["type"]], np.dtype(COMPONENTS[accessor["componentType"]])
        view = self.tree["bufferViews"][accessor["bufferView"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        stride = view.get("byteStride", width * kind.itemsize)
        if stride != width * kind.itemsize:
            raise ValueError(f"a buffer has a stride of {stride} bytes")
        values = np.frombuffer(self.binary, dtype=kind, count=accessor["count"] * width, offset=start)
        return values.reshape(-1, width)


def _matrix(node: dict[str, Any]) -> np.ndarray:
    """Return the matrix, (4, 4), mm, from the frame of a glTF node to that of the node above it."""
    if "matrix" in node:
        matrix = np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    else:
        x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
        norm = np.sqrt(x * x + y * y + z * z + w * w)
        x, y, z, w = (value / norm for value in (x, y, z, w))
        matrix = np.eye(4)
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        matrix[:3, :3] *= np.array(node.get("scale", (1.0, 1.0, 1.0)))
        matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    u, s, v = np.linalg.svd(matrix[:3, :3])
    if np.allclose(s, 1, atol=1e-5):  # a rotation in single precision
        matrix[:3, :3] = u @ v
    matrix[:3, 3] *= MM
    return matrix


def _surface(face: dict[str, Any] | None) -> RoundSurface | None:
    kind = face.get("type") if face else None
    if face is None or kind not in ("plane", "cylinder", "cone"):
        return None
    point = MM * np.array(face["apex" if kind == "cone" else "origin"], dtype=np.float64)
    axis = np.array(face["normal" if kind == "plane" else "axis"], dtype=np.float64)
    length = float(np.linalg.norm(axis))
    size = {
        "plane": lambda: 0.0,
        "cylinder": lambda: MM * float(face["radius"]),
        "cone": lambda: abs(float(np.tan(face["semi_angle"]))),
    }[kind]()
    if not (np.all(np.isfinite(point)) and 0 < length < np.inf and np.isfinite(size)):
        return None
    return RoundSurface(kind, point, axis / length, size)

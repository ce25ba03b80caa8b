"""Reader of triangle meshes: STL, PLY and glTF 2.0 through trimesh, and OBJ with its objects and groups."""

from __future__ import annotations

import io
import json
import logging
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from mistray.errors import MistrayError, foreign_errors
from mistray.files.packages import package
from mistray.io.cad.part import CadPart, checked, unique_names
from mistray.materials.mate import shown
from mistray.prescription.sequential.table import Unread
from mistray.read_file import read_file

GLTF_SUFFIXES = (".glb", ".gltf")
Found = tuple[dict[str, Any], list[Unread]]  # vertices and triangles by title, and what else is in the file
LOOKS = ("vt", "vn", "s", "mtllib", "usemtl")  # lines of an OBJ file that say nothing about shape


def read_mesh(path: Path, *, unit_mm: float) -> tuple[list[CadPart], list[Unread]]:
    """
    Read the parts of an STL, PLY, OBJ or glTF file.

    An STL or PLY file is one part, named after the file; an ASCII STL file may hold several solids with names. A part
    of an OBJ file is a combination of one ``o`` and one ``g`` line. A part of a glTF file is a node with its mesh, at
    its place. Polygons are cut into triangles from their first corner. Each part is one face, because these files hold
    no exact surfaces.

    Parameters
    ----------
    path : Path
        Mesh file.
    unit_mm : float
        Length of the file's unit, mm. Only glTF files have a fixed unit, the metre.

    Returns
    -------
    parts : list of CadPart
        Parts with vertices in mm.
    unread : list of Unread
        Content that was left out: lines and elements without polygons, and triangles of no area.

    Raises
    ------
    MistrayError
        If the file is damaged or empty, or trimesh is missing.
    """
    what = path.suffix.lower()[1:].upper()
    read = _obj if what == "OBJ" else _trimesh
    with foreign_errors(f"{what} file '{path}'", "export it again"):
        found, unread = read(path)
    found = {title: mesh for title, mesh in found.items() if len(mesh[1])}
    if not found:
        raise MistrayError(f"{what} file '{path}': it holds no triangles; export it as a mesh")
    parts = []
    for name, (title, (vertices, triangles)) in zip(unique_names(found), found.items(), strict=True):
        vertices = unit_mm * np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
        triangles = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
        part = CadPart(name, title, title, title, vertices, triangles, np.zeros(len(triangles), dtype=np.int64))
        part, empty = checked(part)
        if empty:
            unread.append(
                Unread(0, f"part '{shown([title])}', {empty} triangles", "they have no area; they are left out")
            )
        parts.append(part)
    return parts, unread


def _trimesh(path: Path) -> Found:
    trimesh = package("mesh files need trimesh", "trimesh", "cad")
    log = logging.getLogger("trimesh")
    if not log.handlers:  # or its warnings, with tracebacks, would go to stderr
        log.addHandler(logging.NullHandler())
    content = read_file(path, "mechanics")
    if path.suffix.lower() == ".gltf" and not _is_whole(content):
        raise MistrayError(f"glTF file '{path}': its numbers are in other files; export it as .glb, which holds all")
    with io.BytesIO(content) as file, warnings.catch_warnings():
        # NumPy warns of text that is no number, and goes on without it
        warnings.filterwarnings("error", "string or file could not be read")
        scene = trimesh.load_scene(file, file_type=path.suffix[1:].lower(), process=False)
    placed = {node: scene.graph[node] for node in scene.graph.nodes_geometry}
    named = len(placed) > 1 or path.suffix.lower() in GLTF_SUFFIXES
    meshes: dict[str, Any] = {}
    unread = []
    for node, (frame, name) in placed.items():
        mesh = scene.geometry[name]
        if not hasattr(mesh, "faces"):
            unread.append(Unread(0, f"'{shown([node])}'", "it has no faces"))
            continue
        vertices = np.asarray(mesh.vertices, dtype=np.float64) @ frame[:3, :3].T + frame[:3, 3]
        mirrors = np.linalg.det(frame[:3, :3]) < 0
        meshes[node if named else path.stem] = (vertices, mesh.faces[:, ::-1] if mirrors else mesh.faces)
    return meshes, unread


def _is_whole(content: bytes) -> bool:
    """True if a .gltf file contains all its data, without separate files."""
    buffers = json.loads(content).get("buffers", [])
    return all(str(buffer.get("uri", "")).startswith("data:") for buffer in buffers)


def _obj(path: Path) -> Found:
    """
    Return the meshes of an OBJ file, from its ``v``, ``f``, ``o`` and ``g`` lines, and the lines left out.

    Negative vertex indices count from the last vertex. Raise `MistrayError` if a line is malformed.
    """
    others: dict[str, list[tuple[int, str]]] = {}
    vertices: list[list[float]] = []
    triangles: dict[str, list[tuple[int, int, int]]] = {}
    names = {"o": "", "g": ""}
    for number, line in enumerate(read_file(path, "mechanics").decode("utf-8", "replace").splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        try:
            if words[0] == "v":
                vertices.append([float(word) for word in words[1:4]])
                if len(words) < 4:
                    raise ValueError("it has fewer than three coordinates")
            elif words[0] in names:
                names[words[0]] = " ".join(words[1:])
                if words[0] == "o":
                    names["g"] = ""
            elif words[0] == "f":
                corners = [_corner(word, len(vertices)) for word in words[1:]]
                if len(corners) < 3:
                    raise ValueError("a face has fewer than three corners")
                title = "/".join(filter(None, names.values())) or path.stem
                mine = triangles.setdefault(title, [])
                mine += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
            elif words[0] not in LOOKS and not words[0].startswith("#"):
                others.setdefault(words[0], []).append((number, shown(words)))
        except ValueError as error:
            reason = shown(str(error).split())
            raise MistrayError(
                f"OBJ file '{path}', line {number}: '{shown(words)}': {reason}; export it again"
            ) from None
    unread = [
        Unread(*lines[0], f"{len(lines)} '{word}' lines; they hold no polygons") for word, lines in others.items()
    ]
    return {title: (vertices, faces) for title, faces in triangles.items()}, unread


def _corner(word: str, count: int) -> int:
    number = int(word.split("/")[0])
    index = number - 1 if number > 0 else count + number
    if number == 0 or not 0 <= index < count:
        raise ValueError(f"there is no vertex {number}")
    return index

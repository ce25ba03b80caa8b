"""STL, PLY and OBJ: names, units, polygons, damage; and the PLY files that are written."""

import base64
import json
import struct
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import vectors
from oracles.small_scenes import write
from refusals import refused

from mistray._mitsuba_compat import mesh_arrays
from mistray.mechanics import read_mechanics
from mistray.mechanics.ply import ply_bytes

pytestmark = pytest.mark.quick

CORNERS = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, 4.0)]
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]  # a tetrahedron of 4 mm³, normals outwards
OBJ = vectors.text("two_parts.obj")


def ascii_stl(*names: str) -> str:
    text = ""
    for number, name in enumerate(names):
        corners = [f"   vertex {x + 10 * number} {y} {z}\n" for x, y, z in CORNERS]
        faces = ("".join(corners[i] for i in face) for face in FACES)
        body = "".join(f" facet normal 0 0 0\n  outer loop\n{face}  endloop\n endfacet\n" for face in faces)
        text += f"solid {name}\n{body}endsolid {name}\n"
    return text


def binary_stl() -> bytes:
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *(c for i in face for c in CORNERS[i]), 0) for face in FACES)
    return b"\0" * 80 + struct.pack("<I", len(FACES)) + body


def gltf() -> tuple[dict[str, Any], bytes]:
    """In metres: the tetrahedron at its place, moved by 10 mm, and mirrored at x = 0; a line is no polygon."""
    places = np.array(CORNERS, dtype="<f4") * np.float32(1e-3)
    buffer = places.tobytes() + np.array(FACES, dtype="<u2").tobytes()
    primitive = {"attributes": {"POSITION": 0}, "indices": 1}
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"name": "assembly", "children": [1, 2, 3, 4]},
            {"name": "vane", "mesh": 0},
            {"name": "moved vane", "mesh": 0, "translation": [0.01, 0, 0]},
            {"name": "mirrored", "mesh": 0, "scale": [-1, 1, 1]},
            {"name": "wire", "mesh": 1},
        ],
        "meshes": [{"name": "tetrahedron", "primitives": [primitive]}, {"primitives": [{**primitive, "mode": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
             "min": places.min(axis=0).tolist(), "max": places.max(axis=0).tolist()},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
        "buffers": [{"byteLength": len(buffer)}],
    }  # fmt: skip
    return tree, buffer


def glb() -> bytes:
    tree, buffer = gltf()
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def gltf_text(uri: str | None) -> str:
    """A .gltf file; with None the buffer stands in it."""
    tree, buffer = gltf()
    tree["buffers"][0]["uri"] = uri or "data:application/octet-stream;base64," + base64.b64encode(buffer).decode()
    return json.dumps(tree)


def written(tmp_path: Path, name: str, content: str | bytes) -> Path:
    return write(tmp_path, content, name)


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.sum(np.cross(a, b) * c)) / 6


class TestFormats:
    @pytest.mark.parametrize(
        ("name", "content"),
        [
            ("my part.stl", ascii_stl("x")),
            ("my part.STL", binary_stl()),
            ("my part.ply", ply_bytes(np.array(CORNERS), np.array(FACES))),
            ("my part.obj", "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS)
             + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in FACES)),
        ],
    )  # fmt: skip
    def test_one_part(self, name: str, content: str | bytes, tmp_path: Path) -> None:
        (part,) = read_mechanics(written(tmp_path, name, content), unit="inch").parts
        assert (part.name, part.title) == ("my_part", "my part")
        assert volume(part.vertices, part.triangles) == pytest.approx(4 * 25.4**3, rel=1e-6)

    def test_solids_of_an_ascii_stl_and_what_is_written(self, tmp_path: Path) -> None:
        """What is written is read by Mitsuba, with the winding kept and unused vertices gone."""
        parts = read_mechanics(written(tmp_path, "a.stl", ascii_stl("left wall", "right wall"))).parts
        assert [(part.name, part.title) for part in parts] == [("left_wall", "left wall"), ("right_wall", "right wall")]
        assert parts[1].vertices[:, 0].min() == 10
        path = written(tmp_path, "a.ply", ply_bytes(np.array([(9.0, 9.0, 9.0), *CORNERS]), np.array(FACES) + 1))
        vertices, triangles = mesh_arrays(mi.load_dict({"type": "ply", "filename": str(path)}))
        assert (len(vertices), volume(vertices, triangles.astype(int))) == (4, pytest.approx(4))

    @pytest.mark.parametrize(("name", "content"), [("a.glb", glb()), ("a.gltf", gltf_text(None))])
    def test_nodes_of_a_gltf(self, name: str, content: str | bytes, tmp_path: Path) -> None:
        """Metres by the standard, each node at its place; a mirrored one keeps its normals outwards."""
        mechanics = read_mechanics(written(tmp_path, name, content))
        parts = {part.title: part for part in mechanics.parts}
        assert set(parts) == {"vane", "moved vane", "mirrored"}
        for part in parts.values():
            assert volume(part.vertices, part.triangles) == pytest.approx(4, rel=1e-6)
        assert parts["moved vane"].vertices[:, 0].min() == pytest.approx(10)
        assert parts["mirrored"].vertices[:, 0].min() == pytest.approx(-2)
        assert len(mechanics.unread) == 1
        (part, *_) = read_mechanics(tmp_path / name, unit="mm").parts
        assert volume(part.vertices, part.triangles) == pytest.approx(4e-9, rel=1e-6)

    def test_objects_and_groups_of_an_obj(self, tmp_path: Path) -> None:
        """Lines without polygons are listed once for each kind; what says how surfaces look is no shape."""
        text = "# l 1 2\nmtllib a.mtl\nvn 0 0 1\n" + OBJ + "usemtl black\nl 1 2\ncurv 0 1 1 2\nl 2 3\nf 1 2 2\n"
        mechanics = read_mechanics(written(tmp_path, "a.obj", text))
        parts = mechanics.parts
        assert [part.title for part in parts] == ["plate", "fin/left", "fin/right"]
        assert [part.name for part in parts] == ["plate", "fin_left", "fin_right"]
        assert [len(part.triangles) for part in parts] == [2, 1, 1]
        np.testing.assert_array_equal(parts[2].vertices[parts[2].triangles[0]], [[0, 0, 0], [2, 3, 0], [0, 3, 0]])
        assert [(item.line, item.text, item.reason) for item in mechanics.unread if item.line] == [
            (17, "l 1 2", "2 'l' lines; they hold no polygons"),
            (18, "curv 0 1 1 2", "1 'curv' lines; they hold no polygons"),
        ]
        (flat,) = [item for item in mechanics.unread if not item.line]
        assert (flat.text, flat.reason) == ("part 'fin/right', 1 triangles", "they have no area; they are left out")


def test_damage_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, content, words in (
        ("a.stl", b"", "STL file"),
        ("a.glb", glb()[:-9], "GLB file"),
        ("a.gltf", "{", "GLTF file"),
        ("a.gltf", gltf_text("../a.bin"), "in other files"),
        ("a.stl", binary_stl()[:-30], "STL file"),
        ("a.stl", ascii_stl("x").replace("vertex 2.0", "vertex 2.0mm", 1), "STL file"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1000000000000\n", "PLY file"),
        ("a.ply", ply_bytes(np.array(CORNERS), np.array(FACES))[:-9], "PLY file"),
        ("a.obj", "v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n", "part 'a': a vertex is not finite"),
        ("a.obj", "v 0 0 0\nv 1e9 0 0\nv 0 1 0\nf 1 2 3\n", "it reaches to 1e+09 mm; the most is 1e+07 mm"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "all its triangles have no area"),
    ):
        written(tmp_path, name, content)
        with refused("", words):
            read_mechanics(name)


def test_wrong_options(tmp_path: Path) -> None:
    path = written(tmp_path, "a.obj", OBJ)
    for name in ("tolerance_mm", "time_limit_s"):
        with refused(f"{name} = 0.1; it is for STEP files, leave it out"):
            read_mechanics(path, **{name: 0.1})
        with refused(f"{name} = 0; it must be greater than 0"):
            read_mechanics(vectors.DATA / "vane_tube.step", **{name: 0.0})
    with refused("unit 'furlong' is unknown"):
        read_mechanics(path, unit="furlong")
    assert read_mechanics(path, unit="cm").parts[0].vertices.max() == 30.0

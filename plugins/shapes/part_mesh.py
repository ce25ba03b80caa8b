"""Plugin `part_mesh`: a triangle mesh from a PLY file, with its part and its optical space."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from mistray._mitsuba_compat import build_mesh, mesh_arrays
from mistray.errors import MistrayError
from mistray.param import documented, fixed
from mistray.physics.geometry.pose import rigid_motion
from mistray.plugins.shapes.formula_shape import FRAME, NAMES, check_reach, take_names
from mistray.ranges import TEXT


@documented
class PartMesh(mi.Mesh):
    r"""
    Mesh of a mechanical part (:monosp:`part_mesh`): triangles of a PLY file, with flat normals.

    Mitsuba's ``ply`` with an ``interface`` is traced in the same way; this plugin also declares the part and the
    optical space. Normals are those of the triangles, counter-clockwise, towards the ``back`` of the nested
    ``interface``, the outside of a closed body. Hits are found in single precision.

    .. parameters::

    .. code-block:: xml

        <shape type="part_mesh" id="bracket">
            <string name="filename" value="camera_bracket.ply"/> <integer name="space" value="2"/>
            <bsdf type="interface"> <float name="R" value="0"/> </bsdf>
        </shape>

    .. code-block:: python

        {"type": "part_mesh", "filename": "bracket.ply", "bsdf": {"type": "interface", "R": 0.0}}
    """

    properties = {
        "filename": fixed("string", TEXT, "PLY file of triangles, mm, relative to the scene file"),
        **FRAME,
        **NAMES,
    }

    def __init__(self, props: mi.Properties) -> None:
        take_names(self, props)
        self.filename = props.get("filename", None)
        if not isinstance(self.filename, str):
            raise MistrayError(f"{self.owner}: filename is {self.filename!r}; name a PLY file")
        file = mi.file_resolver().resolve(self.filename)
        description: dict[str, Any] = {"type": "ply", "filename": str(file), "face_normals": True}
        if "to_world" in props:
            rigid_motion(props["to_world"].matrix, self.owner, "scale the file")
            description["to_world"] = props["to_world"]
        try:
            vertices, faces = mesh_arrays(mi.load_dict(description))
        except RuntimeError as error:
            reason = str(error).rpartition(": ")[2].strip(" !.\n")
            raise MistrayError(
                f"{self.owner}: filename '{self.filename}': {reason}; check the path, or export it again"
            ) from None
        if not len(faces):
            raise MistrayError(f"{self.owner}: filename '{self.filename}' holds no triangles; export it again")
        if faces.max() >= len(vertices):
            raise MistrayError(
                f"{self.owner}: filename '{self.filename}': a triangle refers to vertex {faces.max()} of "
                f"{len(vertices)}; the file is damaged, export it again"
            )
        check_reach(vertices, self.name)
        build_mesh(self, self.name, vertices, faces, props)

    def to_string(self) -> str:
        return f"PartMesh[id = {self.name}, {self.face_count()} triangles, filename = {self.filename}]"


mi.register_shape("part_mesh", lambda props: PartMesh(props))

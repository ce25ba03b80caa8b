"""Mechanical structure that is given as a triangle mesh in a file."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import PurePath

from mistray.errors import MistrayError
from mistray.prescription.coating import BLACK, Coating, check_name
from mistray.prescription.scatter import SCATTER, Scatter
from mistray.ranges import check_fields


@dataclass(frozen=True)
class MeshStructure:
    """
    A mesh for structure that no frustum describes, such as a bracket; `mistray.mechanics` makes it from CAD files.

    Attributes
    ----------
    name : str
        Shape id, unique in the prescription, without dots.
    file : str
        PLY file with coordinates in mm in the frame of the scene; path relative to the scene file.
    front, back : str
        Materials. `back` is on the side that the normals of the triangles point to, the outside of a body.
    coating, scatter, part, space
        Coating, scatter models, part and space, as in `Structure`.

    Raises
    ------
    MistrayError
        If the name or the ending of the file is not allowed.

    Examples
    --------
    >>> bracket = mistray.prescription.MeshStructure("bracket", "meshes/bracket.ply")
    >>> bracket.coating.R  # black
    0.0
    """

    name: str
    file: str
    _: KW_ONLY
    front: str = "air"
    back: str = "air"
    coating: Coating | None = BLACK
    scatter: tuple[Scatter, ...] = SCATTER.field(())
    part: str | None = None
    space: int = -1

    def __post_init__(self) -> None:
        check_name(self.name)
        check_fields(self, f"structure '{self.name}'")
        if PurePath(self.file).suffix.lower() != ".ply":
            raise MistrayError(f"structure '{self.name}': file '{self.file}'; give a .ply file")

"""Mechanical parts from a file, painted by name, as structures of a scene."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError
from mistray.ids import fits
from mistray.io.cad.mesh import GLTF_SUFFIXES, read_mesh
from mistray.io.cad.part import UNITS_MM, CadPart, unique_names
from mistray.io.cad.step import read_step
from mistray.mechanics.finish import ABSORBER, FINISHES, Finish, finish
from mistray.mechanics.ply import ply_bytes
from mistray.mechanics.recognise import RevolvedBand, bands
from mistray.prescription.mesh_structure import MeshStructure
from mistray.prescription.model import Placed, Structure
from mistray.prescription.scene_file import comment_text, structure_text
from mistray.prescription.sequential.table import Unread
from mistray.ranges import SPACE, ByName, OfType
from mistray.read_file import require_file
from mistray.replace_file import replace_files

STEP_SUFFIXES, MESH_SUFFIXES = (".step", ".stp"), (".stl", ".obj", ".ply", *GLTF_SUFFIXES)
MOST_ANALYTIC = 64
TOLERANCE_MM = 0.01
TILT_DIGITS = 5  # degrees: the single precision of a rotation
PAINTS = ByName(OfType(Finish | str, "must be a mistray.mechanics.Finish or its text"), "{'vane*': 'flat_black'}")
SPACES = ByName(SPACE, "{'vane*': 1}")


@dataclass(frozen=True, eq=False)
class Mechanics:
    """
    Mechanical parts in the frame of the scene, made by `read_mechanics`.

    Attributes
    ----------
    source : Path
        File of the parts.
    parts : tuple of CadPart
        Parts with their triangles, mm.
    unread : tuple of Unread
        Content of the file that is not in the parts.
    paint : tuple of (str, Finish)
        Pairs of a pattern and a finish for matching faces; the last match counts.
    space : tuple of (str, int)
        Pairs of a pattern and an optical space for matching faces; the last match counts.
    most_analytic : int
        Largest number of analytic surfaces; the largest surfaces are chosen. Each one adds a little time per ray.

    Examples
    --------
    >>> import trimesh
    >>> _ = trimesh.creation.box((4, 4, 10)).export("post.stl")
    >>> post = mistray.mechanics.read_mechanics("post.stl").painted({"post": "0.05"})
    >>> post.parts[0].name, post.paint[0][1].scatter[0].kind
    ('post', 'paint')
    """

    source: Path
    parts: tuple[CadPart, ...]
    unread: tuple[Unread, ...] = ()
    paint: tuple[tuple[str, Finish], ...] = ()
    space: tuple[tuple[str, int], ...] = ()
    most_analytic: int = MOST_ANALYTIC

    def painted(
        self,
        paint: Mapping[str, Finish | str] | None = None,
        *,
        space: Mapping[str, int] | None = None,
        known: Mapping[str, Finish] | None = None,
    ) -> Mechanics:
        """
        Return a copy with paint and optical spaces assigned to parts and faces.

        Parameters
        ----------
        paint : mapping of str to Finish or str
            Pattern such as ``"vane*"`` → a `Finish`, or a string for `finish`, such as ``"flat_black"``. A pattern is
            compared with the name of a part, its title, product and path in the file, and with the names of faces,
            ``<part>_face_<number>``. Later patterns override earlier ones. Unmatched faces absorb all light.
        space : mapping of str to int
            Pattern → optical space, for grouping in tables.
        known : mapping of str to Finish
            Further names for `finish`, such as those of a scene.

        Raises
        ------
        MistrayError
            If a pattern matches nothing, or a paint is unknown.
        """
        names = {} if known is None else FINISHES.check("known", known)
        paints = {} if paint is None else PAINTS.check("paint", paint)
        rules = [(p, finish(f, names) if isinstance(f, str) else f) for p, f in paints.items()]
        spaces = [] if space is None else list(SPACES.check("space", space).items())
        for pattern, _ in (*rules, *spaces):
            self._check_pattern(pattern)
        return replace(self, paint=(*self.paint, *rules), space=(*self.space, *spaces))

    def _check_pattern(self, pattern: str) -> None:
        part_names = {name: None for part in self.parts for name in _titles(part)}
        if any(fits(name, pattern) for name in part_names):
            return
        faces = [part.face_name(int(face)) for part in self.parts for face in np.unique(part.faces)]
        if any(fits(name, pattern) for name in faces):
            return
        offered = list(part_names)
        near = difflib.get_close_matches(pattern.strip("*?"), [*offered, *faces], n=3, cutoff=0.4) or offered[:5]
        raise MistrayError(f"'{self.source}': no part or face is called '{pattern}'; the nearest are {', '.join(near)}")

    def structures(self, folder: str | Path) -> tuple[Structure | MeshStructure, ...]:
        """
        Return structures for a `Prescription`; meshes are written to a folder and named by their absolute path.

        Parameters
        ----------
        folder : str or Path
            Existing folder for the meshes.

        Returns
        -------
        tuple of Structure or MeshStructure
            Complete cylinders, cones, discs and annuli become a `Structure`, named after their first face. The rest of
            a part becomes one `MeshStructure` for each paint and space. Normals of meshes point outwards. If the normal
            of a `Structure` points inwards, one-sided paint is put on its other side.
        """
        folder = Path(folder).resolve()
        built = self._built()
        replace_files({folder / f"{shape.name}.ply": mesh for shape, mesh in built if mesh is not None}, "mesh")
        return tuple(
            replace(shape, file=str(folder / shape.file)) if isinstance(shape, MeshStructure) else shape
            for shape, _ in built
        )

    def write(self, scene: str | Path) -> tuple[Structure | MeshStructure, ...]:
        """
        Write the meshes beside a scene file; the structures name them relative to it.

        Parameters
        ----------
        scene : str or Path
            Scene file; it need not exist yet, but its folder must.

        Returns
        -------
        tuple of Structure or MeshStructure
            Structures for a `Prescription`.
        """
        shapes, meshes = self.beside(scene)
        replace_files(meshes, "mesh")
        return shapes

    def beside(self, scene: str | Path) -> tuple[tuple[Structure | MeshStructure, ...], dict[Path, bytes]]:
        """
        Return the structures of `write`, and its files ``<scene>_<shape>.ply`` with their contents, unwritten.

        Parameters
        ----------
        scene : str or Path
            Scene file.
        """
        scene = Path(scene)
        shapes: list[Structure | MeshStructure] = []
        meshes: dict[Path, bytes] = {}
        for shape, mesh in self._built():
            if isinstance(shape, MeshStructure) and mesh is not None:
                # By $ a scene file knows its parameters, also in the name of a file
                shape = replace(shape, file=f"{scene.stem.replace('$', '_')}_{shape.file}")
                meshes[scene.parent / shape.file] = mesh
            shapes.append(shape)
        return tuple(shapes), meshes

    def to_xml(self, path: str | Path) -> tuple[Structure | MeshStructure, ...]:
        """Write a scene file of the structures only, for inclusion in scenes, and its meshes; return the structures."""
        shapes, meshes = self.beside(path)
        lines = [
            "<?xml version='1.0' encoding='utf-8'?>",
            f"<!-- Mechanics of {comment_text(self.source.name)}; include it in a scene. Units: mm. -->",
            '<scene version="3.0.0">',
            structure_text(shapes),
            "</scene>",
            "",
        ]
        replace_files({**meshes, Path(path): "\n".join(lines)}, "scene file")
        return shapes

    @property
    def beyond_limit(self) -> int:
        """Number of surfaces that could be analytic but remain meshes because of `most_analytic`."""
        return max(sum(map(len, self._bands.values())) - max(self.most_analytic, 0), 0)

    @cached_property
    def _bands(self) -> dict[str, list[RevolvedBand]]:
        """Bands of one finish and optical space, which can be exact, by part."""
        return {
            part.name: [band for band in bands(part) if len({self._look(part, face) for face in band.faces}) == 1]
            for part in self.parts
        }

    def _built(self) -> list[tuple[Structure | MeshStructure, bytes | None]]:
        """
        Return the structures, each with the bytes of its PLY file ``<shape>.ply``, or None if it has none.

        The largest bands of one finish, at most `most_analytic`, become exact structures, all other triangles meshes.
        """
        found = self._bands
        sizes = sorted((band.area for each in found.values() for band in each), reverse=True)
        least = sizes[self.most_analytic - 1] if 0 < self.most_analytic < len(sizes) else 0.0
        if self.most_analytic < 1:
            least = math.inf
        left = self.most_analytic
        result: list[tuple[Structure | MeshStructure, bytes | None]] = []
        for part in self.parts:
            looks = {int(face): self._look(part, int(face)) for face in np.unique(part.faces)}
            free = np.ones(len(part.triangles), dtype=bool)
            for band in found[part.name]:
                if band.area < least or left == 0:
                    continue
                left -= 1
                free[band.triangles] = False
                result.append((_structure(part, band, *looks[band.faces[0]]), None))
            result += self._meshes(part, looks, free)
        names = unique_names(shape.name for shape, _ in result)
        return [(_renamed(shape, name), mesh) for name, (shape, mesh) in zip(names, result, strict=True)]

    def _look(self, part: CadPart, face: int) -> tuple[Finish, int]:
        """Return the finish and the optical space of a face."""
        names = (*_titles(part), part.face_name(face))

        def last(rules: Iterable[tuple[str, object]], default: object) -> object:
            matching = [value for pattern, value in rules if any(fits(name, pattern) for name in names)]
            return matching[-1] if matching else default

        paint, space = last(self.paint, ABSORBER), last(self.space, -1)
        assert isinstance(paint, Finish)
        assert isinstance(space, int)
        return paint, space

    def _meshes(
        self, part: CadPart, looks: Mapping[int, tuple[Finish, int]], free: np.ndarray
    ) -> list[tuple[Structure | MeshStructure, bytes | None]]:
        """Return a mesh, with its PLY file as bytes, of the triangles `free` of a part, for each finish and space."""
        groups: dict[tuple[Finish, int], list[int]] = {}
        for face in np.unique(part.faces[free]):
            groups.setdefault(looks[int(face)], []).append(int(face))
        whole = len(groups) == 1 and bool(free.all())
        result: list[tuple[Structure | MeshStructure, bytes | None]] = []
        for (paint, space), faces in groups.items():
            name = part.name if whole else f"{part.name}_mesh"
            chosen = free & np.isin(part.faces, faces)
            shape = MeshStructure(
                name, f"{name}.ply", coating=paint.coating, scatter=paint.scatter, part=part.name, space=space
            )
            result.append((shape, ply_bytes(part.vertices, part.triangles[chosen])))
        return result


def read_mechanics(
    path: str | Path,
    *,
    unit: str | None = None,
    at: Placed | None = None,
    tolerance_mm: float | None = None,
    most_analytic: int = MOST_ANALYTIC,
    time_limit_s: float | None = None,
) -> Mechanics:
    """
    Read mechanical parts from a STEP, STL, OBJ, PLY or glTF file.

    Parameters
    ----------
    path : str or Path
        File to read.
    unit : str, optional
        Unit of lengths in a mesh file: a key of `UNITS_MM`. The default is "mm" for STL, OBJ and PLY files, which state
        no unit, and "m" for glTF files, as in their standard. A STEP file states its unit.
    at : Placed, optional
        Position of the file's origin in the scene, mm, and tilt of its frame, degrees; None: its frame is the scene's.
    tolerance_mm : float, optional
        Largest distance of facets from the surfaces of a STEP file, mm; default 0.01. Other files hold facets already.
    most_analytic : int
        Largest number of analytic surfaces, see `Mechanics`; 0: everything stays a mesh.
    time_limit_s : float, optional
        Limit of processor time for reading a STEP file, s; default 5 s plus 30 s for each MB.

    Raises
    ------
    MistrayError
        If the file is missing, damaged, empty or of another type, an option is out of range or does not suit the type,
        or a package is missing.

    Examples
    --------
    >>> import trimesh
    >>> _ = trimesh.creation.box((4, 4, 10)).export("post.stl")
    >>> post = mistray.mechanics.read_mechanics("post.stl", unit="mm")
    >>> post.parts[0].name
    'post'
    >>> [shape.name for shape in post.to_xml("parts.xml")]
    ['post']
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (*STEP_SUFFIXES, *MESH_SUFFIXES):
        known = ", ".join((*STEP_SUFFIXES, *MESH_SUFFIXES))
        raise MistrayError(f"mechanics '{path}': files of type '{path.suffix}' cannot be read; give {known}")
    require_file(path, "mechanics")
    for name, value in (("tolerance_mm", tolerance_mm), ("time_limit_s", time_limit_s)):
        if value is not None and suffix not in STEP_SUFFIXES:
            raise MistrayError(f"mechanics '{path}': {name} = {value:g}; it is for STEP files, leave it out")
        if value is not None and not 0 < value < math.inf:
            raise MistrayError(f"mechanics '{path}': {name} = {value:g}; it must be greater than 0")
    if unit is not None and unit not in UNITS_MM:
        raise MistrayError(f"mechanics '{path}': unit '{unit}' is unknown; give {', '.join(UNITS_MM)}")
    if unit is not None and suffix in STEP_SUFFIXES:
        raise MistrayError(f"mechanics '{path}': unit = '{unit}'; a STEP file states its unit, leave it out")
    if suffix in STEP_SUFFIXES:
        parts, unread = read_step(path, tolerance_mm=tolerance_mm or TOLERANCE_MM, time_limit_s=time_limit_s)
    else:
        parts, unread = read_mesh(path, unit_mm=UNITS_MM[unit or ("m" if suffix in GLTF_SUFFIXES else "mm")])
    if at is not None:
        parts = [part.moved(at.to_world()) for part in parts]
    return Mechanics(path, tuple(parts), tuple(unread), most_analytic=most_analytic)


def _titles(part: CadPart) -> tuple[str, ...]:
    return part.name, part.title, part.product, part.path


def _structure(part: CadPart, band: RevolvedBand, paint: Finish, space: int) -> Structure:
    x, y, z = (float(value) for value in band.foot)
    ax, ay, az = (float(value) for value in band.axis)
    tilt = (-math.degrees(math.asin(max(-1.0, min(1.0, ay)))), math.degrees(math.atan2(ax, az)), 0.0)
    seen = paint if band.outward else paint.turned()
    return Structure(
        part.face_name(band.faces[0]), band.r0, band.z0, band.r1, band.z1,
        x=x, y=y, z=z, tilt_deg=(round(tilt[0], TILT_DIGITS) + 0.0, round(tilt[1], TILT_DIGITS) + 0.0, 0.0),
        coating=seen.coating, scatter=seen.scatter, part=part.name, space=space,
    )  # fmt: skip


def _renamed(shape: Structure | MeshStructure, name: str) -> Structure | MeshStructure:
    if isinstance(shape, MeshStructure):
        return replace(shape, name=name, file=f"{name}.ply")
    return replace(shape, name=name)

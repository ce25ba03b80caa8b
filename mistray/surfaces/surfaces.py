"""Surfaces of a scene in the form that the kernel reads: analytic surfaces unrolled, properties in packed tables.

Most analytic surfaces are quadrics of revolution

    F(x, y, z) = a (x² + y²) + b z² + e z + g = 0

in the frame of their vertex; aspheres add an even polynomial. See `mistray.surfaces.surface` for the families.
Positions on the device are relative to `SurfaceTable.centre`, because float32 has 7 digits. Positions on the host are
in the world, in float64.

All other shapes of the scene, meshes and Mitsuba's own primitives, are put into one separate Mitsuba scene. Rays hit
them through its acceleration structure.
"""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Sequence
from copy import copy
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray._mitsuba_compat import peek
from mistray.cache.remembered import remembered
from mistray.errors import MistrayError
from mistray.physics.geometry.sag import in_proportion
from mistray.ranges import FILM_PIXELS, FILM_SIDE, several
from mistray.scene.mitsuba_bsdfs import remedy
from mistray.surfaces.bodies import Bodies
from mistray.surfaces.families.sag_surface import SagSurface
from mistray.surfaces.family_table import FamilyTable
from mistray.surfaces.free_space import FreeSpace
from mistray.surfaces.host_rays import HostSurfaces
from mistray.surfaces.optics import ASPHERIC, DETECTOR, MIRROR, STOCK, WALL, Optics
from mistray.surfaces.seams import WallRims, let_overlap
from mistray.surfaces.shell_tree import ShellTree, many
from mistray.surfaces.surface import TracedSurface
from mistray.surfaces.upload import download, opaque, upload

SAME_FRAME = 1e-9  # difference up to which directions of axes count as equal
# Row of the polynomial table: curvature, conic, a4 … a20 in units of the aperture and the unit of these, see
# `mistray.physics.geometry.sag.in_proportion`; z range, outer (-1: a rectangle), slope
POLYNOMIAL_VECTORS = 4
# The fourth number of a vertex is the sign of the surface's normal; of an asphere its size is `SagSurface.bend`, 1/mm,
# within these limits
TINY_BEND, LARGE_BEND = 1e-30, 1e30


class LocalFrame:
    """
    Rotation of directions between the scene's frame and the frames of surfaces, one surface per lane.

    Parameters
    ----------
    rows : list of mi.Vector4f, optional
        Rows of the rotations from the surfaces' frames to the scene; None if no surface of the scene is rotated.
    """

    def __init__(self, rows: list[mi.Vector4f] | None) -> None:
        self._rows = rows

    def inward(self, v: mi.Vector3f) -> mi.Vector3f:
        """Return a vector of the scene's frame in the frame of each lane's surface."""
        if self._rows is None:
            return v
        rows = self._rows
        return mi.Vector3f(*(rows[0][k] * v.x + rows[1][k] * v.y + rows[2][k] * v.z for k in range(3)))

    def outward(self, v: mi.Vector3f) -> mi.Vector3f:
        """Return a vector of each lane's surface frame in the scene's frame."""
        if self._rows is None:
            return v
        return mi.Vector3f(*(row.x * v.x + row.y * v.y + row.z * v.z for row in self._rows))


class SurfaceTable:
    """
    Geometry and optics of all surfaces of a scene at one wavelength, in the form that the kernel reads.

    Parameters
    ----------
    scene : mi.Scene
        Scene whose shapes all carry an ``interface``; shapes with a ``target`` are left out.
    wavelength_nm : float
        Vacuum wavelength, nm.
    detector : str or sequence of str, optional
        Ids of the detectors; by default every shape with an ``irradiancemeter``. A sensor that is not named counts as
        an ordinary surface.
    stokes : bool
        Whether coatings are tabulated for polarised light.

    Raises
    ------
    MistrayError
        For a shape without interface, a missing detector or a missing material.

    Attributes
    ----------
    scene : mi.Scene or None
        Scene that was given; None in tables that are kept with it, see `mistray.sampling.design.kept_tables`.
    shared, kept : dict
        What was made of the geometry, and what of the whole table, by name: tables of the same geometry share the
        first, copies of the table the second.
    detectors : list of int
        Indices of the surfaces whose light is recorded, in the order of their ids.
    design_mirrors : frozenset of int
        Indices of the opaque surfaces that are mirrors of the design, see `with_mirrors`.
    detector_axes : dict
        Middle, mm, and unit vectors along x and y, on the device, of each detector that is a Mitsuba shape.
    centre : (3,) float64
        World position of the device's origin, mm: the middle of the analytic surfaces if these lie far from the world's
        origin, else that origin.
    tree : ShellTree or None
        Tree of the surfaces that are too many to be unrolled into the kernel; None: all are unrolled.
    """

    def __init__(
        self,
        scene: mi.Scene,
        wavelength_nm: float,
        detector: str | Sequence[str] | None = None,
        stokes: bool = False,
    ) -> None:
        # In the order of their ids: a ray that meets two surfaces within the rounding must not see the scene's order
        self.scene: mi.Scene | None = scene
        self.shared: dict[str, Any] = {}
        self.kept: dict[Hashable, Any] = {}
        named = named_shapes(scene)
        shapes = sorted(named.items())
        analytic = [(name, shape) for name, shape in shapes if is_analytic(shape)]
        stock = [(name, shape) for name, shape in shapes if not is_analytic(shape)]
        self.ids = [name for name, _ in analytic + stock]
        self.shapes = [shape for _, shape in analytic + stock]
        numbers = {name: i for i, name in enumerate(self.ids)}
        self.listed = [numbers[name] for name in named]
        self.parts = [part_of(name, shape) for name, shape in analytic + stock]
        self.spaces = [int(getattr(shape, "space", -1)) for shape in self.shapes]
        self.count = len(self.shapes)
        self.wavelength_nm = wavelength_nm
        self.interfaces = [interface_of(shape) for shape in self.shapes]
        self.detectors = self._find_detectors(detector)
        self.design_mirrors: frozenset[int] = frozenset()
        self._geometry(self.shapes[: len(analytic)])
        self._stock(self.shapes[len(analytic) :])
        self.detector_frames = {i: self._detector_frame(i) for i in self.detectors if i >= len(self.pieces)}
        self.detector_axes = {
            i: [opaque(mi.Vector3f, v) for v in (middle - self.centre, x / np.linalg.norm(x), y / np.linalg.norm(y))]
            for i, (middle, x, y) in self.detector_frames.items()
        }
        self.bodies = Bodies(self)
        self.optics = Optics(self.ids, self.interfaces, self._flags(), self.bodies, wavelength_nm, stokes)

    @property
    def host(self) -> HostSurfaces:
        """Analytic surfaces as float64 arrays for ray intersection on the host; built on first use."""
        return remembered(self.shared, "host", lambda: HostSurfaces(self))

    def at(self, wavelength_nm: float) -> SurfaceTable:
        """Return the surfaces of the scene at another wavelength, nm; the geometry is shared."""
        return self._changed(wavelength_nm, self.detectors, self.optics.stokes, self.design_mirrors)

    def on(self, detector: int) -> SurfaceTable:
        """
        Return a copy of the table with this detector only; other detectors become ordinary surfaces.

        If it is the only one already, the table itself is returned.
        """
        if self.detectors == [detector]:
            return self
        return self._changed(self.wavelength_nm, [detector], self.optics.stokes, self.design_mirrors)

    def with_mirrors(self, surfaces: frozenset[int]) -> SurfaceTable:
        """
        Return a copy of the table in which these opaque surfaces count as mirrors of the design.

        Without any surfaces the table itself is returned.
        """
        return self._changed(self.wavelength_nm, self.detectors, self.optics.stokes, surfaces) if surfaces else self

    def varied(
        self,
        wavelength_nm: float,
        detector: str | Sequence[str] | None,
        stokes: bool,
        mirrors: frozenset[int],
    ) -> SurfaceTable:
        """Return a table of the same surfaces, see `SurfaceTable` and `with_mirrors`; the geometry is shared."""
        return self._changed(wavelength_nm, self._find_detectors(detector), stokes, mirrors)

    def __copy__(self) -> SurfaceTable:
        other = object.__new__(type(self))  # as it is: a pickle would make it anew
        vars(other).update(vars(self))
        return other

    def without_scene(self) -> SurfaceTable:
        """Return a copy without the scene, for what is kept with a table, see `mistray.sampling.design.kept_tables`."""
        other = copy(self)
        other.scene = None
        return other

    def _changed(
        self, wavelength_nm: float, detectors: list[int], stokes: bool, mirrors: frozenset[int]
    ) -> SurfaceTable:
        other = copy(self)
        other.kept = {}
        other.wavelength_nm, other.detectors, other.design_mirrors = wavelength_nm, detectors, mirrors
        other.optics = Optics(self.ids, self.interfaces, other._flags(), self.bodies, wavelength_nm, stokes)
        return other

    @property
    def detector(self) -> int:
        """
        Index of the surface that is the only detector.

        Raises
        ------
        MistrayError
            If the scene has several detectors.
        """
        require_one([self.ids[i] for i in self.detectors])
        return self.detectors[0]

    @property
    def detector_names(self) -> str | list[str]:
        """Id of the only detector, or list of the ids of all detectors."""
        names = [self.ids[i] for i in self.detectors]
        return names[0] if len(names) == 1 else names

    @property
    def event_ids(self) -> list[str]:
        """Names of all surfaces and media in which events occur: ids of surfaces, then media in parentheses."""
        return [*self.ids, *map(medium_id, self.optics.media)]

    @property
    def event_parts(self) -> list[str]:
        """Names of the parts where events occur: parts of the surfaces, then media."""
        return [*self.parts, *self.optics.media]

    @property
    def event_words(self) -> np.ndarray:
        """
        Flag words of all surfaces and media, (places,) uint32, see `mistray.surfaces.optics`; 0 for media.

        Sensors that are not traced as detectors count as detectors here, too.
        """
        sensors = np.array([DETECTOR * shape.is_sensor() for shape in self.shapes], dtype=np.uint32)
        return np.concatenate([self.optics.host_words | sensors, np.zeros(len(self.optics.media), dtype=np.uint32)])

    def upload_point(self, point: np.ndarray) -> mi.Vector3f:
        """Return a world point, (3,), mm, as an opaque device vector relative to `centre`, mm."""
        return opaque(mi.Vector3f, point - self.centre)

    def upload_points(self, points: np.ndarray) -> mi.Vector3f:
        """Return world points, (n, 3), mm, as a device vector relative to `centre`."""
        return mi.Vector3f(*(upload(mi.Float, column) for column in (points - self.centre).T))

    def download_points(self, points: mi.Vector3f) -> np.ndarray:
        """Return device points, which are relative to `centre`, as world points on the host, (n, 3) float64, mm."""
        return download(points) + self.centre

    def frame(self, s: mi.UInt32, active: mi.Bool | bool = True) -> LocalFrame:
        """Return the rotations between the scene and the frames of the surfaces s, one per lane."""
        if not self.rotated:
            return LocalFrame(None)
        return LocalFrame([dr.gather(mi.Vector4f, self.rotation, 3 * s + k, active) for k in range(3)])

    def asphere_row(self, s: mi.UInt32, active: mi.Bool | bool = True) -> list[mi.Float]:
        """
        Return the parameters of the aspheres s: curvature, 1/mm, conic constant, coefficients, bounds, mm, and slope.

        Their order, and the unit of the coefficients, are given at `POLYNOMIAL_VECTORS`.
        """
        row = [
            dr.gather(mi.Vector4f, self.polynomial, POLYNOMIAL_VECTORS * s + k, active)
            for k in range(POLYNOMIAL_VECTORS)
        ]
        return [vector[k] for vector in row for k in range(4)]

    def asphere_sag(
        self, s: mi.UInt32, active: mi.Bool | bool = True
    ) -> tuple[mi.Float, mi.Float, list[mi.Float], mi.Float]:
        """
        Return the sag's parameters of the aspheres s: curvature, 1/mm, conic constant, coefficients and their unit.

        See `mistray.physics.geometry.sag`.
        """
        row = self.asphere_row(s, active)
        return row[0], row[1], row[2 : 2 + self.coefficient_count], row[11]

    def _find_detectors(self, wanted: str | Sequence[str] | None) -> list[int]:
        sensors = [i for i, shape in enumerate(self.shapes) if shape.is_sensor()]
        if not sensors:
            raise MistrayError("the scene has no detector; nest an 'irradiancemeter' sensor in the shape that detects")
        if wanted is None:
            return sensors
        names = several(wanted)
        known = [self.ids[i] for i in sensors]
        if not names:
            raise MistrayError(f"detector is an empty list; choose from {', '.join(known)}")
        for name in names:
            if name not in known:
                raise MistrayError(f"'{name}' is not a detector of this scene; choose from {', '.join(known)}")
        return [i for i in sensors if self.ids[i] in names]

    def _geometry(self, shapes: list[Any]) -> None:
        self.frames: list[np.ndarray] = [np.eye(3)]
        self.pieces: list[TracedSurface] = [shape.surface(shape.values) for shape in shapes]
        vertices = np.zeros((self.count, 3))
        rotations = np.tile(np.eye(3), (self.count, 1, 1))
        matrices = [shape.vertex_frame(shape.values, shape.matrix) for shape in shapes]
        self.centre = _centre([matrix[:3, 3] for matrix in matrices], [shape.outer_radius for shape in shapes])
        known = np.tile(np.eye(3), (len(shapes) + 1, 1, 1))
        axes: dict[tuple[int, float, float], int] = {}
        for i, (piece, matrix) in enumerate(zip(self.pieces, matrices, strict=True)):
            rotation, position = matrix[:3, :3], matrix[:3, 3]
            same = np.all(np.abs(known[: len(self.frames)] - rotation) <= SAME_FRAME, axis=(1, 2))
            frame = int(np.argmax(same)) if same.any() else len(self.frames)
            if frame == len(self.frames):
                known[frame] = rotation
                self.frames.append(rotation)
            local = self.frames[frame].T @ (position - self.centre)
            axis = axes.setdefault((frame, round(float(local[0]), 9), round(float(local[1]), 9)), len(axes))
            piece.index, piece.frame, piece.axis, piece.z = i, frame, axis, float(local[2])
            vertices[i], rotations[i] = position, self.frames[frame]
        looped = many(self.pieces)
        between_media = [interface.front != interface.back for interface in self.interfaces[: len(shapes)]]
        rounding = let_overlap(self.pieces, vertices[: len(shapes)] - self.centre, between_media, looped)
        self.wall_rims = WallRims(self.pieces, self.count, rounding)
        self.axes = list(axes)
        self.families = FamilyTable(self.pieces, self.count)
        self.tree = ShellTree(self.pieces, looped, self.frames, self.axes) if looped else None
        self.vertices, self.rotations = vertices, rotations
        self.rotated = len(self.frames) > 1
        quadric = np.zeros((self.count, 4))
        vertex = np.zeros((self.count, 4))
        vertex[:, :3], vertex[:, 3] = vertices - self.centre, 1.0
        aspheres = [p for p in self.pieces if isinstance(p, SagSurface) and p.coefficients]
        self.coefficient_count = max((len(p.coefficients) for p in aspheres), default=0)
        polynomial = np.zeros((self.count, 4 * POLYNOMIAL_VECTORS))
        clip = np.zeros((self.count, 2))
        for p in self.pieces:
            quadric[p.index], vertex[p.index, 3], clip[p.index] = p.quadric, p.sign, p.clip
        for a in aspheres:
            coefficients, per_area = in_proportion(a.coefficients, a.size)
            polynomial[a.index, : 2 + len(coefficients)] = [a.curvature, a.conic, *coefficients]
            vertex[a.index, 3] *= min(max(a.bend, TINY_BEND), LARGE_BEND)
            polynomial[a.index, 11:] = [per_area, *a.z_range, a.outer + a.overlap if a.outer else -1.0, a.slope]
        self.clip = upload(mi.Float, clip)  # half size of a rectangle; square of the inner radius of all else
        self.quadric = upload(mi.Float, quadric)
        self.vertex = upload(mi.Float, vertex)
        self.polynomial = upload(mi.Float, polynomial)
        self.rotation = upload(mi.Float, np.concatenate([self.rotations, np.zeros((self.count, 3, 1))], axis=2))

    def _stock(self, shapes: list[Any]) -> None:
        """Build a Mitsuba scene of the shapes that are not analytic, if any, and the table of their surface indices."""
        self.mitsuba_scene, self.free_space = None, None
        if not shapes:
            return
        self.mitsuba_scene = mi.load_dict(
            {"type": "scene", **dict(zip(self.ids[len(self.pieces) :], shapes, strict=True))},
            optimize=False,  # the key becomes the id
        )
        pointers = dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shapes))
        registry = np.array(pointers)
        lookup = np.zeros(int(registry.max()) + 1, dtype=np.uint32)
        lookup[registry] = np.arange(len(shapes), dtype=np.uint32) + len(self.pieces)
        self.mitsuba_lookup = upload(mi.UInt32, lookup)
        size = float(np.max(np.abs([*self.mitsuba_scene.bbox().min, *self.mitsuba_scene.bbox().max])))
        self.mitsuba_epsilon = 4e-6 * (1.0 + size)
        self.mitsuba_offset = opaque(mi.Vector3f, self.centre)
        free_space = FreeSpace(self) if self.pieces else None
        self.free_space = free_space if free_space is not None and free_space.some else None

    @property
    def mitsuba_hash(self) -> bytes:
        """SHA-256 hash of the frames and vertices of all Mitsuba shapes that are not analytic."""

        def of_shapes() -> bytes:
            digest = hashlib.sha256()
            for shape in self.shapes[len(self.pieces) :]:
                params = mi.traverse(shape)
                for key in (key for key in params.keys() if "." not in key):  # noqa: SIM118  it iterates over pairs
                    value = peek(params, key)
                    value = value.matrix if isinstance(value, mi.Transform4f) else value
                    if dr.is_array_v(value):
                        digest.update(np.array(dr.detach(value)).tobytes())
            return digest.digest()

        return remembered(self.shared, "mitsuba hash", of_shapes)

    def mitsuba_normals(self, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """
        Return the unit normals, (n, 3), of the Mitsuba shapes that rays meet at world points, (n, 3), mm.

        Normals are from front to back. `directions`, (n, 3), are the unit directions of the rays.
        """
        assert self.mitsuba_scene is not None
        starts = points - 8 * self.mitsuba_epsilon * directions
        # From memory: as literals in the code they would make each ray a kernel to compile
        origin, along = (dr.unravel(mi.Vector3f, upload(mi.Float, rays)) for rays in (starts, directions))
        found = self.mitsuba_scene.ray_intersect(mi.Ray3f(mi.Point3f(origin), along))
        return download(found.n)

    def _flags(self) -> np.ndarray:
        """Return flag bits of surfaces, (s,) uint32: detector, Mitsuba shape, design mirror, wall, asphere."""
        flags = np.zeros(self.count, dtype=np.uint32)
        for i in range(self.count):
            piece = self.pieces[i] if i < len(self.pieces) else None
            flags[i] = (
                (DETECTOR if i in self.detectors else 0)
                | (STOCK if piece is None else 0)
                | (MIRROR if i in self.design_mirrors else 0)
                | (WALL if piece is not None and piece.wall else 0)
                | (ASPHERIC if piece is not None and piece.searched else 0)
            )
        return flags

    def film(self, detector: int | None = None) -> tuple[int, int, tuple[float, float, float, float]]:
        """
        Return the numbers of pixel columns and rows of a detector, and its extent x0, x1, y0, y1 in its own frame, mm.

        `detector` is the index of its surface, by default that of the only detector.

        Raises
        ------
        MistrayError
            If there are several detectors and none is given, the film is too large or cropped, or the surface cannot
            hold a film.
        """
        detector = self.detector if detector is None else detector
        shape, owner = self.shapes[detector], f"detector '{self.ids[detector]}'"
        width, height = film_size(shape.sensor().film(), owner)
        FILM_SIDE.check("width of its film", width, owner)
        FILM_SIDE.check("height of its film", height, owner)
        FILM_PIXELS.check("number of its pixels", width * height, owner)
        if detector in self.detector_frames:
            half_x, half_y = np.linalg.norm(self.detector_frames[detector][1:], axis=1).tolist()
            return width, height, (-half_x, half_x, -half_y, half_y)
        half = self.pieces[detector].detector_half
        if half is None:
            raise MistrayError(f"{owner} is not an optical surface; use an 'asphere' or a flat 'frustum'")
        return width, height, (-half[0], half[0], -half[1], half[1])

    def _detector_frame(self, detector: int) -> np.ndarray:
        """
        Return centre and half sides along x and y, as rows (3, 3), mm, of a detector that is a Mitsuba rectangle.

        They are in the world. Another Mitsuba shape raises `MistrayError`.
        """
        matrix = _rectangle_matrix(self.shapes[detector], self.ids[detector])
        return matrix[:3, [3, 0, 1]].T


def _centre(vertices: Sequence[np.ndarray], radii: Sequence[float]) -> np.ndarray:
    """
    Return the point that device positions are relative to, (3,), mm, from vertices and radii of surfaces, mm.

    It is the middle of the box around the surfaces, if that lies farther from the world's origin than the box's
    diagonal. Otherwise, and without surfaces, it is the origin.
    """
    if not vertices:
        return np.zeros(3)
    places, reach = np.array(vertices), np.array(radii)[:, None]
    low, high = (places - reach).min(axis=0), (places + reach).max(axis=0)
    middle = 0.5 * (low + high)
    return middle if np.linalg.norm(middle) > np.linalg.norm(high - low) else np.zeros(3)


def is_analytic(shape: Any) -> bool:
    """True if a shape describes its own analytic surface; all other shapes are intersected by Mitsuba."""
    return hasattr(shape, "surface")


def solid_shapes(scene: mi.Scene) -> list[Any]:
    """Return the shapes of a scene that light can hit: all except targets at which scattered rays are aimed."""
    return [shape for shape in scene.shapes() if not getattr(shape.bsdf(), "is_target", False)]


def named_shapes(scene: mi.Scene) -> dict[str, Any]:
    """
    Return the shapes of a scene that light can hit, by id, in the order of the scene.

    A shape without an id gets one by its number. Raise `MistrayError` if an id is given twice.
    """
    solid = solid_shapes(scene)
    named = {shape.id() or f"shape_{number}": shape for number, shape in enumerate(solid, start=1)}
    if len(named) < len(solid):
        raise MistrayError("two shapes of the scene have the same id; give every shape an id of its own")
    return named


def part_of(name: str, shape: Any) -> str:
    """Return the name of the part that a shape belongs to: the declared part, or else the shape's name."""
    return getattr(shape, "part", "") or name


def medium_id(medium: str) -> str:
    """Return the name under which events in a medium are listed, such as ``(air)``, without spaces."""
    return f"({medium})".replace(" ", "_")


def require_one(detectors: Sequence[str]) -> None:
    """Raise `MistrayError` if a list of detector ids has more than one entry."""
    if len(detectors) > 1:
        raise MistrayError(
            f"the scene has {len(detectors)} detectors ({', '.join(detectors)}); name one: detector=, --detector, or "
            "on(…) of a trace of all"
        )


def interface_of(shape: Any) -> Any:
    """Return the ``interface`` of a shape; raise `MistrayError` if it carries another BSDF."""
    bsdf = shape.bsdf()
    if not hasattr(bsdf, "coating"):
        raise MistrayError(f"shape '{shape.id()}' carries the BSDF {remedy(bsdf)}")
    return bsdf


def _rectangle_matrix(shape: Any, name: str) -> np.ndarray:
    params = mi.traverse(shape)
    if not str(shape).startswith("Rectangle"):
        raise MistrayError(
            f"detector '{name}' is {str(shape).split('[')[0]}; use an 'asphere', a flat 'frustum' or a 'rectangle'"
        )
    return np.array(params["to_world"].matrix, dtype=np.float64).reshape(4, 4)


def film_size(film: mi.Film, owner: str) -> tuple[int, int]:
    """
    Return the numbers of pixel columns and rows of a film.

    Raise `MistrayError` if it is cropped; `owner` begins the message.
    """
    width, height = (int(n) for n in film.size())
    if [width, height] != [int(n) for n in film.crop_size()]:
        raise MistrayError(f"{owner}: its film has a crop, which is not used; leave the crop out")
    return width, height

"""Dataclasses of the parts of an optical system: surfaces, structure, stop, detector; sources are in `sources`.

Lengths in mm, light travels +z, angles in degrees in names that end in ``_deg``. A surface's vertex is the origin of
its frame and ``front`` is its -z side. All classes are immutable; edit one with `dataclasses.replace`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.errors import MistrayError
from mistray.materials import refractive_index
from mistray.physics.geometry.crossing import meeting, near
from mistray.physics.geometry.outline import Outline
from mistray.physics.geometry.pose import fixed_turn
from mistray.physics.geometry.sag import conic_end, sag
from mistray.physics.imaging.paraxial import ParaxialSystem
from mistray.physics.sags.terms import SAG, check_names, vertex_curvatures, with_even
from mistray.physics.sags.terms import sag as freeform_sag
from mistray.prescription.coating import BLACK, Coating, check_name
from mistray.prescription.mesh_structure import MeshStructure
from mistray.prescription.naming import scattering, shared_coatings, shared_scatter
from mistray.prescription.scatter import SCATTER, Scatter
from mistray.ranges import (
    COEFFICIENTS,
    FILM_SIDES,
    PLACE_MM,
    RADIUS_MM,
    SIZE_MM,
    TILT_DEG,
    OfType,
    Range,
    Several,
    check_fields,
)

if TYPE_CHECKING:
    from pathlib import Path

    from mistray.prescription.sources import ObjectPoint, Source

MAX_COEFFICIENTS = 9
"""Number of even coefficients a4 … a20 that the `asphere` plugin takes."""

_RIM_SAMPLES = 513
_STEP = 1e-3  # of the differences that give the curvature of a freeform, in units of its radius
_LEVEL = 1e-12  # of its radius, by which the heights of a rim may differ by round-off


@dataclass(frozen=True, kw_only=True)
class Placed:
    """
    Placement in the world: the frame is tilted about x, then y, then z (fixed axes), then moved to (x, y, z).

    Attributes
    ----------
    x, y, z : float
        Origin of the frame, mm.
    tilt_deg : tuple of three float
        Rotations about the world's x, y, z axes, degrees.
    """

    x: float = PLACE_MM.field(0.0)
    y: float = PLACE_MM.field(0.0)
    z: float = PLACE_MM.field(0.0)
    tilt_deg: tuple[float, float, float] = TILT_DEG.field((0.0, 0.0, 0.0))

    def __post_init__(self) -> None:
        check_fields(self, "frame")

    @property
    def coaxial(self) -> bool:
        """True if the frame's z axis lies on the world's z axis and points the same way."""
        return self.x == 0 and self.y == 0 and self.tilt_deg[:2] == (0.0, 0.0)

    def to_world(self) -> np.ndarray:
        """Return the rigid transform from the part's frame to the world, (4, 4), mm."""
        matrix = np.eye(4)
        matrix[:3, :3] = fixed_turn(self.tilt_deg)
        matrix[:3, 3] = self.x, self.y, self.z
        return matrix


@dataclass(frozen=True)
class Surface(Placed):
    """
    An optical surface: a conic with polynomial terms or any other sag, clipped by radii or by any outline.

    Attributes
    ----------
    name : str
        Shape id, unique in the prescription, without dots; by convention ``<part>_<face>``.
    radius : float
        Radius of curvature at the vertex, mm; ``inf`` or 0 is a plane. Positive: centre on the +z side.
    conic : float
        Conic constant; 0 sphere, -1 paraboloid.
    coefficients : tuple of float
        Aspheric coefficients (a4, a6, …, a20), mm⁻³, mm⁻⁵, …; at most nine.
    semi_diameter, inner_semi_diameter : float or None, float
        Outer and inner clear radius, mm; an inner one of 0: no hole.
    half_width, half_height : float or None
        Rectangular clip in x and y instead of ``semi_diameter``, mm.
    sag : mapping of str to float, and of "grid" to Grid
        Parameters of a freeform sag in addition to those above, see `mistray.physics.sags.terms`.
    outline : Outline or None
        Clear outline instead of ``semi_diameter`` and half sizes, in the frame of the vertex, mm.
    front, back : str
        Materials on the -z and the +z side; see `mistray.materials`.
    coating : Coating or None
        Coating of the surface; ``None``: bare Fresnel interface.
    scatter : tuple of Scatter
        Models that scatter a part of the light; their scatter adds up.
    mirror : bool
        Whether the design path is reflected here, so that this reflection does not count as a ghost.
    meets : str
        Direction of light that meets the surface: "both", "+z" or "-z". Light in the opposite direction passes through
        (freeform only).
    part : str or None
        Object that the surface belongs to; ``None``: its own name.
    space : int
        Optical space for grouping in tables; -1: none.

    Examples
    --------
    >>> mirror = mistray.Surface("primary", radius=-1000, conic=-1, semi_diameter=100, mirror=True)
    >>> print(f"sag at the rim: {mirror.z_at(100.0):.1f} mm")
    sag at the rim: -5.0 mm
    """

    name: str
    _: KW_ONLY
    radius: float = math.inf
    conic: float = 0.0
    coefficients: tuple[float, ...] = COEFFICIENTS.field(())
    semi_diameter: float | None = SIZE_MM.field(None)
    inner_semi_diameter: float = 0.0
    half_width: float | None = SIZE_MM.field(None)
    half_height: float | None = SIZE_MM.field(None)
    sag: Mapping[str, Any] = field(default_factory=dict, hash=False)
    outline: Outline | None = None
    front: str = "air"
    back: str = "air"
    coating: Coating | None = None
    scatter: tuple[Scatter, ...] = SCATTER.field(())
    mirror: bool = False
    meets: str = "both"
    part: str | None = None
    space: int = -1

    def __post_init__(self) -> None:
        check_name(self.name)
        rectangle = (self.half_width, self.half_height)
        ways = [self.semi_diameter is not None, None not in rectangle, self.outline is not None]
        if sum(ways) != 1 or (rectangle != (None, None) and not ways[1]):
            raise MistrayError(
                f"surface '{self.name}': semi_diameter = {self.semi_diameter} with half_width, half_height = "
                f"{rectangle} and {'an' if ways[2] else 'no'} outline; give either semi_diameter, both half sizes or "
                "an outline"
            )
        owner = f"surface '{self.name}'"
        SAG.check("sag", self.sag, owner)
        check_names({"curvature", "conic", *self.sag}, owner)
        if self.outline is not None:
            self.outline.check(owner)
        check_fields(self, owner)
        within(self.outer_radius).check("inner_semi_diameter", self.inner_semi_diameter, owner)
        if len(self.coefficients) > MAX_COEFFICIENTS:
            raise MistrayError(
                f"surface '{self.name}': {len(self.coefficients)} coefficients; at most {MAX_COEFFICIENTS} (a4 … "
                "a20) are supported"
            )
        end = conic_end(self.curvature, self.conic)
        if self.outer_radius >= end and not self.freeform:
            raise MistrayError(
                f"surface '{self.name}': clear radius {self.outer_radius:g} mm; its conic ends at {end:.6g} mm "
                f"(radius {self.radius:g} mm, conic {self.conic:g}), make the surface smaller"
            )

    @property
    def curvature(self) -> float:
        """Curvature 1/radius, 1/mm; 0 for a plane."""
        return 0.0 if self.radius == 0 or math.isinf(self.radius) else 1.0 / self.radius

    @property
    def freeform(self) -> bool:
        """True if the surface needs the `freeform` plugin: for `sag`, `outline`, or `meets` other than "both"."""
        return bool(self.sag) or self.outline is not None or self.meets != "both"

    @property
    def sag_numbers(self) -> dict[str, Any]:
        """Parameters that define the sag, keyed by their names and in their units in `mistray.physics.sags.terms`."""
        return with_even(self.curvature, self.conic, self.coefficients, self.sag)

    @property
    def outer_radius(self) -> float:
        """Largest distance of a point of the surface from its axis, mm; for an outline, of its bounding box."""
        if self.semi_diameter is not None:
            return self.semi_diameter
        if self.outline is not None:
            x0, x1, y0, y1 = self.outline.bounds()
            return math.hypot(max(abs(x0), abs(x1)), max(abs(y0), abs(y1)))
        assert self.half_width is not None
        assert self.half_height is not None
        return math.hypot(self.half_width, self.half_height)

    def z_at(self, r: Any) -> Any:
        """Return world z, mm, of a coaxial surface at radius ``r``, mm (float or array); with a `sag`, at (0, r)."""
        if self.sag:
            return self.z + freeform_sag(np.zeros_like(r), r, self.sag_numbers)
        return self.z + sag(r * r, self.curvature, self.conic, self.coefficients)

    @property
    def rim(self) -> tuple[float, float]:
        """Radius and z of the outer rim of a coaxial round surface, mm; with a `sag`, z at azimuth +y."""
        return self.outer_radius, float(self.z_at(self.outer_radius))

    @property
    def rim_heights(self) -> tuple[float, float]:
        """Least and greatest z of the rim of a coaxial round surface, mm: equal without a `sag`; NaN if it has none."""
        r, z = self.rim
        if not self.sag:
            return z, z
        angle = np.linspace(0, 2 * np.pi, _RIM_SAMPLES)
        heights = self.z + freeform_sag(r * np.cos(angle), r * np.sin(angle), self.sag_numbers)
        low, high = float(heights.min()), float(heights.max())
        return (z, z) if high - low <= _LEVEL * r else (low, high)


@dataclass(frozen=True)
class Structure(Placed):
    """
    A frustum of a cone about the z axis of its frame; a cylinder and a flat annulus are special cases.

    Barrel walls, lens edges, bevels, stop faces and vanes are frusta.

    Attributes
    ----------
    name : str
        Shape id, unique in the prescription, without dots.
    r0, z0, r1, z1 : float
        Radii and axial positions of its two ends, mm.
    front, back : str
        Materials on its two sides. The normal points away from the axis, or to +z for an annulus (z0 = z1). ``front``
        lies on the opposite side: the inside of a tube, or the -z side of an annulus.
    coating : Coating or None
        Coating of the frustum; ``None``: bare Fresnel interface. The default is a perfect absorber.
    scatter, part, space
        Scatter models, part and space, as in `Surface`.

    Examples
    --------
    >>> tube = mistray.Structure("tube", 30, -100, 30, 0, coating=mistray.Coating(R=0.03))
    >>> vane = mistray.Structure("vane", 25, -50, 30, -50)  # a ring, black without a coating
    >>> vane.coating.R
    0.0
    """

    name: str
    r0: float = RADIUS_MM.field()
    z0: float = PLACE_MM.field()
    r1: float = RADIUS_MM.field()
    z1: float = PLACE_MM.field()
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
        if self.r0 == self.r1 and (self.z0 == self.z1 or self.r0 == 0):
            raise MistrayError(
                f"structure '{self.name}': from (r {self.r0:g}, z {self.z0:g}) to (r {self.r1:g}, z {self.z1:g}) mm "
                "it has "
                "no area; give it two different ends or remove it"
            )


@dataclass(frozen=True)
class Detector(Surface):
    """
    A surface that records irradiance: plane, opaque, and perfectly absorbing by default.

    Attributes
    ----------
    pixels : tuple of two int
        Columns (along x) and rows (along y) over the clip's bounding rectangle.
    design_path : str
        Sequences of surfaces that form its image, such as ``"L1:T L2:T fold:R"``. Alternatives for a step are joined by
        ``|``, sequences by ``;``. If empty, they are found automatically, see docs/design_path.md.

    Examples
    --------
    >>> sensor = mistray.Detector(z=51, half_width=4, half_height=3, pixels=(800, 600))
    >>> print(f"pixels of {1000 * 2 * sensor.half_width / sensor.pixels[0]:.0f} µm")
    pixels of 10 µm
    """

    name: str = "detector"
    _: KW_ONLY
    coating: Coating | None = BLACK
    pixels: tuple[int, int] = FILM_SIDES.field((256, 256))
    design_path: str = ""

    def __post_init__(self) -> None:
        FILM_SIDES.check("pixels", self.pixels, f"detector '{self.name}'")
        super().__post_init__()

    def notes(self) -> list[str]:
        """Return notes on a detector from a lens file: one if it is black and scatters no light; else none."""
        if self.coating != BLACK or self.scatter:
            return []
        return [
            f"the detector absorbs all light, so that ghosts by way of it are missing: put --coating "
            f"'{self.name}=R=0.1' on it, here or with mistray coat"
        ]


@dataclass(frozen=True)
class Stop:
    """
    An aperture stop of finite thickness: front annulus, inner wall, rear annulus.

    Attributes
    ----------
    radius : float
        Radius of the opening, mm.
    z_front, z_rear : float
        Positions of its faces on the z axis of the world, mm; equal for a thin stop, which is one annulus.
    outer_front, outer_rear : float
        Outer radii of the two faces, mm.
    coating, scatter, part, space
        Coating, scatter models, part and space, as in `Structure`. The name of the part also starts the names of the
        faces.

    Examples
    --------
    >>> stop = mistray.prescription.Stop(radius=4, z_front=10, z_rear=10.5, outer_front=12, outer_rear=12)
    >>> [face.name for face in stop.faces()]
    ['stop_front', 'stop_wall', 'stop_rear']
    """

    radius: float
    z_front: float
    z_rear: float
    outer_front: float
    outer_rear: float
    _: KW_ONLY
    coating: Coating | None = BLACK
    scatter: tuple[Scatter, ...] = SCATTER.field(())
    part: str = "stop"
    space: int = -1

    def __post_init__(self) -> None:
        check_fields(self, f"stop '{self.part}'")
        opening = replace(within(min(self.outer_front, self.outer_rear)), above=True)
        opening.check("radius", self.radius, f"stop '{self.part}'")
        if self.z_rear < self.z_front:
            raise MistrayError(
                f"stop '{self.part}': z_rear = {self.z_rear:g} mm lies before z_front = {self.z_front:g} mm; swap them"
            )

    def faces(self) -> tuple[Structure, ...]:
        """
        Return the faces of the stop: front annulus, inner wall and rear annulus, or one annulus for a thin stop.

        `Structure.front` of the wall is the opening.
        """
        profiles = [("front", self.outer_front, self.z_front, self.radius, self.z_front)]
        if self.z_rear > self.z_front:
            profiles.append(("wall", self.radius, self.z_front, self.radius, self.z_rear))
            profiles.append(("rear", self.radius, self.z_rear, self.outer_rear, self.z_rear))
        return tuple(
            Structure(
                f"{self.part}_{face}",
                *profile,
                coating=self.coating,
                scatter=self.scatter,
                part=self.part,
                space=self.space,
            )
            for face, *profile in profiles
        )


STRUCTURES = Several(
    OfType(
        Structure | Surface | MeshStructure, "must be a mistray.Structure, a Surface or a MeshStructure, or several"
    ),
    least=0,
)


@dataclass(frozen=True, kw_only=True)
class Prescription:
    """
    An optical system, ready to be written as a scene.

    Attributes
    ----------
    name : str
        Title of the system.
    surfaces : tuple of Surface
        Optical surfaces, in the order in which light meets them on the design path.
    structures : tuple of Structure, Surface or MeshStructure
        All mechanical parts, in any order. A `Surface` or a `MeshStructure` describes parts that are not frusta, such
        as a board or a bracket.
    stop : Stop or None
        Aperture stop; its faces become part of the scene.
    detector, source
        Detector of the design, and source; None: none. Both are needed by `to_dict`, `to_xml` and `to_scene` only.
    more_detectors : tuple of Detector
        Detectors in addition to that of the design; `mistray.trace` records the light on all of them.
    provenance : str
        Origin of the data; it is written to the XML file as a comment.

    Raises
    ------
    MistrayError
        If a detector is not a `Detector`, if two names are equal, if coatings or scatter models of the same name
        differ, or if two coaxial surfaces without outlines cross or coincide within their common aperture. Of a
        rectangle the inscribed circle counts, and of a `sag` its heights along +y.

    Examples
    --------
    >>> front = mistray.Surface("L1_front", radius=50, semi_diameter=10, back="N-BK7", part="L1")
    >>> rear = mistray.Surface("L1_rear", z=5, radius=-50, semi_diameter=10, front="N-BK7", part="L1")
    >>> detector = mistray.Detector(z=51, half_width=4, half_height=3)
    >>> lens = mistray.Prescription(
    ...     name="singlet",
    ...     surfaces=(front, rear),
    ...     structures=mistray.prescription.barrel([front, rear, detector]),
    ...     detector=detector,
    ...     source=mistray.Source(radius=8),
    ... )
    >>> scene = lens.to_scene()
    >>> [shape.id() for shape in scene.shapes()]
    ['L1_front', 'L1_rear', 'L1_edge', 'barrel_1_wall', 'detector']
    """

    name: str
    surfaces: tuple[Surface, ...] = Several(OfType(Surface, "must be a mistray.Surface, or several"), least=0).field()
    structures: tuple[Structure | Surface | MeshStructure, ...] = STRUCTURES.field(())
    stop: Stop | None = None
    detector: Detector | None = None
    source: Source | ObjectPoint | None = None
    provenance: str = ""
    more_detectors: tuple[Detector, ...] = Several(
        OfType(Detector, "must be a mistray.Detector, or several"), least=0
    ).field(())

    def __post_init__(self) -> None:
        check_fields(self, f"prescription '{self.name}'")
        if not isinstance(self.detector, Detector | None):
            raise MistrayError(
                f"prescription '{self.name}': detector is a {type(self.detector).__name__}; give a "
                "mistray.prescription.Detector, such as Detector(name='detector', z=50, half_width=5, half_height=5)"
            )
        for name, count in Counter(shape.name for shape in self.shapes()).items():
            if count > 1:
                raise MistrayError(
                    f"prescription '{self.name}': {count} shapes are called '{name}'; give each its own name"
                )
        self.shared_scatter()
        optical = [s for s in (*self.surfaces, *self.detectors) if s.coaxial and s.outline is None]
        for i, j in near([(s.z_at, s.outer_radius) for s in optical]):
            _check_crossing(optical[i], optical[j])

    @property
    def detectors(self) -> tuple[Detector, ...]:
        """All detectors: the detector of the design, if there is one, and further ones."""
        return self.more_detectors if self.detector is None else (self.detector, *self.more_detectors)

    def shapes(self) -> Iterator[Surface | Structure | MeshStructure]:
        """Yield every shape of the scene, in this order: surfaces, structures, stop faces, detectors."""
        yield from self.surfaces
        yield from self.structures
        if self.stop is not None:
            yield from self.stop.faces()
        yield from self.detectors

    def shared_coatings(self) -> dict[str, Coating]:
        """
        Return the named coatings of all shapes, keyed by name.

        Raises
        ------
        MistrayError
            If two coatings of the same name differ, or a shape has that name.
        """
        return shared_coatings(f"prescription '{self.name}'", self.shapes())

    def shared_scatter(self) -> dict[str, Scatter]:
        """
        Return the named scatter models of all shapes, keyed by name.

        Raises
        ------
        MistrayError
            If two models of the same name differ, or a shape or a coating has that name.
        """
        return shared_scatter(f"prescription '{self.name}'", self.shapes())

    def with_scatter(self, rules: Mapping[str, Scatter | Sequence[Scatter]]) -> Prescription:
        """
        Return a copy with scatter models added to shapes.

        Parameters
        ----------
        rules : mapping of str to Scatter or sequence of Scatter
            Name of a shape, or a pattern such as ``"barrel_*"`` → models. The models of all matching patterns are added
            to those that a shape has.

        Raises
        ------
        MistrayError
            If a pattern matches no shape, or only some of the faces of a stop, which share their finish.
        """
        return scattering(self, rules)

    def with_source(self, **changes: Any) -> Prescription:
        """
        Return a copy with some parameters of the source replaced, for example ``with_source(field_deg=10)``.

        Raises
        ------
        MistrayError
            If there is no source, or a value is out of range.
        """
        if self.source is None:
            raise MistrayError(f"prescription '{self.name}': it has no source; give it a Source first")
        return replace(self, source=replace(self.source, **changes))

    def paraxial(self, wavelength_nm: float) -> ParaxialSystem:
        """
        Return the paraxial system of the refracting surfaces, in order, at a wavelength in nm; of a `sag` along y.

        Raises
        ------
        MistrayError
            If a surface is a mirror or off the axis.
        """
        for s in self.surfaces:
            if s.mirror or not s.coaxial:
                raise MistrayError(
                    f"surface '{s.name}': it is a mirror or off the axis; paraxial figures need coaxial refracting "
                    "surfaces"
                )
        index = [refractive_index(s.front, wavelength_nm) for s in self.surfaces[:1]]
        index += [refractive_index(s.back, wavelength_nm) for s in self.surfaces]
        bends = [
            vertex_curvatures(s.sag_numbers, _STEP * s.outer_radius)[1] if s.sag else s.curvature for s in self.surfaces
        ]
        return ParaxialSystem(bends, [s.z for s in self.surfaces], index)

    def to_dict(self) -> dict[str, Any]:
        """Return a Mitsuba scene dictionary for `mistray.load` or `mi.load_dict`; a variant is set if none is."""
        from mistray.prescription.scene_file import scene_dict

        return scene_dict(self)

    def to_xml(self, path: str | Path) -> None:
        """Write the scene as Mitsuba 3 XML; the same prescription always gives the same bytes."""
        from mistray.prescription.scene_file import write_xml

        write_xml(self, path)

    def to_scene(self) -> Any:
        """Return the prescription, loaded as an ``mi.Scene``."""
        from mistray.scene import load

        return load(self.to_dict())


def within(outer: float) -> Range:
    """Return the allowed range of an inner radius, mm, given the outer radius, mm."""
    return Range(0.0, outer, below=True, unit="mm", remedy="the outer radius is the end")


def _check_crossing(a: Surface, b: Surface) -> None:
    """Raise `MistrayError` if coaxial surfaces cross or coincide within their common aperture, see `Prescription`."""
    inner = max(a.inner_semi_diameter, b.inner_semi_diameter)
    outer = min(s.semi_diameter or min(s.half_width or 0.0, s.half_height or 0.0) for s in (a, b))
    met = meeting(a.z_at, b.z_at, inner, outer)
    if met is not None:
        raise MistrayError(met.between(a.name, b.name))

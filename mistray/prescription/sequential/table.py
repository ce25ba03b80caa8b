"""A lens as lens design programs write it: a table of surfaces in the order of light.

All lengths are in mm, angles in degrees where a name ends in ``_deg``, wavelengths in nm, whatever the units of the
file. Readers give a `Sequential`; `mistray.prescription.closing.system` makes a `Prescription` of it, and writers take
one.

Frames. The first surface's vertex is at the origin, light travels along +z. After each row the frame moves by its
``thickness`` along its own z. A row with a `Decentre` first moves the frame as that says, and a surface in it lies in
the moved frame; a row of kind "coordinate_break" has no surface. After a mirror light travels along -z, thicknesses are
negative there, and materials are those that light passes through.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, Literal

from mistray.errors import MistrayError
from mistray.physics.geometry.outline import Outline
from mistray.physics.sags.terms import with_even

Kind = Literal["surface", "coordinate_break", "image"]
ApertureKind = Literal["entrance_pupil_diameter", "f_number", "object_na", "stop_diameter"]
FieldKind = Literal["angle_deg", "object_height", "image_height"]


@dataclass(frozen=True)
class Unread:
    """
    Something in a file that had no effect.

    Attributes
    ----------
    line : int
        Number of the line, from 1; 0: no line of its own.
    text : str
        What stands there.
    reason : str
        Why it had no effect, and what that means for the result.
    """

    line: int
    text: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Decentre:
    """
    A move of the frame: shifted by (x, y, z) and turned about x, then y, then z, each about the axes as turned so far.

    Attributes
    ----------
    x, y, z : float
        mm.
    tilt_deg : tuple of three float
        Right-handed about the frame's own axes, degrees. Readers turn the senses of their programs into this one.
    tilt_first : bool
        Turn first (in the order z, y, x), then shift along the turned axes.
    returns : bool
        The frame of later rows is that before the move, as with a decentre of one surface alone.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tilt_first: bool = False
    returns: bool = False


@dataclass(frozen=True)
class Row:
    """
    A row of the table, without the object's.

    Attributes
    ----------
    number : int
        As the file counts it.
    kind : str
        "surface", "coordinate_break" or "image" (the last row).
    label : str
        Comment or name in the file; "" without.
    radius, conic, coefficients, sag
        As in `Surface`: mm, ``inf`` is a plane; (a4, a6, …); numbers of a freeform by name.
    thickness : float
        To the next row along z, mm; negative after an odd number of mirrors.
    material : str
        Behind the surface, as `mistray.materials` takes it ("air", "N-BK7", "1.5168", "nd=1.62 Vd=36.4 k=0"); that of
        a mirror is the one in front of it.
    mirror, stop : bool
    semi_diameter : float or None
        Clear semi-diameter of the file, mm; None where it gives none, so that rays decide.
    semi_diameter_fixed : bool
        It is an aperture that stops light, not a drawing size.
    aperture : Outline or None
        Where the file says explicitly what the surface lets pass or reflects, in its frame, mm. It may have no bounds.
    obscuration : Outline or None
        What stops light on it.
    coating : str
        Its name in the file; "" without.
    decentre : Decentre or None
        Before the surface.
    line : int
        Where it begins in the file.
    """

    number: int
    _: KW_ONLY
    kind: Kind = "surface"
    label: str = ""
    radius: float = math.inf
    conic: float = 0.0
    coefficients: tuple[float, ...] = ()
    sag: Mapping[str, Any] = field(default_factory=dict, hash=False)
    thickness: float = 0.0
    material: str = "air"
    mirror: bool = False
    stop: bool = False
    semi_diameter: float | None = None
    semi_diameter_fixed: bool = False
    aperture: Outline | None = None
    obscuration: Outline | None = None
    coating: str = ""
    decentre: Decentre | None = None
    line: int = 0

    @property
    def sag_numbers(self) -> dict[str, Any]:
        """All numbers of its sag, by their names in `mistray.physics.sags.terms`."""
        return with_even(1 / self.radius if self.radius else 0.0, self.conic, self.coefficients, self.sag)


@dataclass(frozen=True)
class Sequential:
    """
    A sequential lens.

    Attributes
    ----------
    name : str
    rows : tuple of Row
        From the first surface after the object to the image.
    source : str
        Where it comes from, such as "Zemax file cooke.zmx".
    object_distance : float
        From the object to the first row, mm; ``inf`` for collimated light.
    object_material : str
    aperture_kind, aperture : str, float
        What limits the beam: diameter in mm, image-space F-number at infinite conjugates, sine-based object NA.
    telecentric : bool
        Chief rays leave the object parallel to the axis, wherever the stop stands, which then aims no ray.
    field_kind : str
    fields : tuple of (float, float)
        (x, y), degrees or mm.
    vignetting : tuple of (VDX, VDY, VCX, VCY)
        One for each field, empty for none.
    wavelengths_nm, weights : tuple of float
    primary : int
        Place of the reference wavelength, from 0.
    unread : tuple of Unread
    notes : tuple of str
        Assumptions that a user should know.
    """

    name: str
    rows: tuple[Row, ...]
    _: KW_ONLY
    source: str = ""
    object_distance: float = math.inf
    object_material: str = "air"
    aperture_kind: ApertureKind = "entrance_pupil_diameter"
    aperture: float = 0.0
    telecentric: bool = False
    field_kind: FieldKind = "angle_deg"
    fields: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    vignetting: tuple[tuple[float, float, float, float], ...] = ()
    wavelengths_nm: tuple[float, ...] = (587.56,)
    weights: tuple[float, ...] = (1.0,)
    primary: int = 0
    unread: tuple[Unread, ...] = field(default=())
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        if len(self.rows) < 2 or self.rows[-1].kind != "image":
            raise MistrayError(f"lens '{self.name}': {len(self.rows)} surfaces; it needs one at least, and an image")
        if sum(row.stop for row in self.rows) > 1:
            numbers = ", ".join(str(row.number) for row in self.rows if row.stop)
            raise MistrayError(f"lens '{self.name}': surfaces {numbers} are all stops; keep one")
        if self.telecentric and math.isinf(self.object_distance):
            raise MistrayError(
                f"lens '{self.name}': its object space is telecentric and its object lies at infinity; give the object "
                "a distance"
            )
        if len(self.weights) != len(self.wavelengths_nm) or not 0 <= self.primary < len(self.wavelengths_nm):
            raise MistrayError(
                f"lens '{self.name}': {len(self.wavelengths_nm)} wavelengths, {len(self.weights)} weights, reference "
                f"{self.primary + 1}; give every wavelength one weight and choose one of them"
            )

    @property
    def wavelength_nm(self) -> float:
        """The reference wavelength."""
        return self.wavelengths_nm[self.primary]

    def with_rows(self, rows: Sequence[Row]) -> Sequential:
        """Return the lens with other rows."""
        return replace(self, rows=tuple(rows))

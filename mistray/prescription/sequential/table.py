"""Sequential lens, as in lens design programs: a table of surfaces in the order of light.

All lengths are in mm, angles in degrees where a name ends in ``_deg``, wavelengths in nm, whatever the units of the
file. Readers return a `Sequential`; `mistray.prescription.closing.system` converts it to a `Prescription`, and writers
accept one.

Frames. The first surface's vertex is at the origin, light travels along +z. After each row the frame moves by its
``thickness`` along its own z. A `Decentre` of a row moves the frame first, and a surface in the row lies in the moved
frame; a row of kind "coordinate_break" has no surface. After an odd number of mirrors light travels along -z, and
thicknesses are negative. The material of a row is the one that light passes through after it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, Literal

from mistray.errors import MistrayError
from mistray.physics.geometry.outline import Outline
from mistray.physics.sags.terms import SAG, with_even
from mistray.ranges import (
    COEFFICIENTS,
    FINITE,
    TEXT,
    TILT_DEG,
    WAVELENGTHS_NM,
    WEIGHTS,
    Each,
    OfType,
    Several,
    check_fields,
    several,
)

Kind = Literal["surface", "coordinate_break", "image"]
ApertureKind = Literal["entrance_pupil_diameter", "f_number", "object_na", "stop_diameter"]
FieldKind = Literal["angle_deg", "object_height", "image_height"]


@dataclass(frozen=True)
class Unread:
    """
    Content of a lens file that had no effect on the lens.

    Attributes
    ----------
    line : int
        Line number, from 1; 0 if it has no line.
    text : str
        Content as written in the file.
    reason : str
        Reason why it had no effect, and the consequence for the result.

    Examples
    --------
    >>> unread = mistray.prescription.Unread(12, "GLRS 0 0", "it draws the lens")
    >>> print(f"line {unread.line}: {unread.text} has no effect, since {unread.reason}")
    line 12: GLRS 0 0 has no effect, since it draws the lens
    """

    line: int
    text: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Decentre:
    """
    Move of the frame: shift by (x, y, z), then rotation about x, the new y and the newest z.

    Attributes
    ----------
    x, y, z : float
        Shift, mm.
    tilt_deg : tuple of three float
        Right-handed rotations about the frame's own axes, degrees. Readers convert the sign conventions of their
        programs.
    tilt_first : bool
        Whether to rotate first (in the order z, y, x), then shift along the rotated axes.
    returns : bool
        Whether later rows use the frame before the move, as for the decentre of a single surface.

    Examples
    --------
    >>> fold = mistray.prescription.Decentre(tilt_deg=(45, 0, 0), returns=True)
    >>> row = mistray.prescription.Row(2, mirror=True, thickness=-30, decentre=fold)
    >>> row.decentre.tilt_deg
    (45.0, 0.0, 0.0)
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    tilt_deg: tuple[float, float, float] = TILT_DEG.field((0.0, 0.0, 0.0))
    tilt_first: bool = False
    returns: bool = False

    def __post_init__(self) -> None:
        check_fields(self, "decentre")


@dataclass(frozen=True)
class Row:
    """
    Row of a lens table: a surface, a coordinate break or the image.

    Attributes
    ----------
    number : int
        Number of the surface as counted by the file.
    kind : str
        Kind of row: "surface", "coordinate_break" or "image" (the last row).
    label : str
        Comment or name in the file; "" if there is none.
    radius, conic, coefficients, sag
        Figure as in `Surface`: radius in mm (``inf`` or 0: plane; positive: centre on the +z side), conic constant,
        (a4, a6, …) in mm⁻³, mm⁻⁵, …, and parameters of a freeform by name.
    thickness : float
        Distance to the next row along z, mm; negative after an odd number of mirrors.
    material : str
        Material behind the surface, a string as in `mistray.materials` ("air", "N-BK7", "1.5168", "nd=1.62 Vd=36.4
        k=0"). For a mirror it is the material in front.
    mirror, stop : bool
        Whether the surface reflects, and whether the row is the aperture stop.
    semi_diameter : float or None
        Clear semi-diameter of the file, mm; None if it gives none, so that rays decide.
    semi_diameter_fixed : bool
        Whether the semi-diameter is an aperture that stops light, not only a drawing size.
    aperture : Outline or None
        Explicitly stated clear area of the surface, in its frame, mm. It may be unbounded.
    obscuration : Outline or None
        Explicitly stated opaque area of the surface, in its frame, mm.
    coating : str
        Name of the coating in the file; "" if there is none.
    decentre : Decentre or None
        Move of the frame before the surface.
    line : int
        Line number at which the surface begins in the file; 0 if it has none.

    Examples
    --------
    >>> row = mistray.prescription.Row(1, radius=50, thickness=5, material="N-BK7", stop=True)
    >>> row.conic, row.semi_diameter  # a sphere, whose size follows from the rays
    (0.0, None)
    """

    number: int
    _: KW_ONLY
    kind: Kind = "surface"
    label: str = ""
    radius: float = math.inf
    conic: float = 0.0
    coefficients: tuple[float, ...] = COEFFICIENTS.field(())
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

    def __post_init__(self) -> None:
        check_fields(self, f"surface {self.number}")
        SAG.check("sag", self.sag, f"surface {self.number}")

    @property
    def sag_numbers(self) -> dict[str, Any]:
        """Parameters that define the sag, by their names and in their units in `mistray.physics.sags.terms`."""
        return with_even(1 / self.radius if self.radius else 0.0, self.conic, self.coefficients, self.sag)


ROWS = Several(OfType(Row, "must be a Row, or several"), least=0)


@dataclass(frozen=True)
class Sequential:
    """
    Sequential lens: rows, aperture, fields and wavelengths.

    Attributes
    ----------
    name : str
        Name of the lens.
    rows : tuple of Row
        Rows from the first surface after the object to the image.
    source : str
        Origin of the lens, such as "Zemax file cooke.zmx".
    object_distance : float
        Distance from the object to the first row, mm; ``inf`` for collimated light.
    object_material : str
        Material between the object and the first row.
    aperture_kind, aperture : str, float
        Kind and value of the aperture: entrance pupil or stop diameter in mm, image-space F-number at infinite
        conjugates, or object NA n sin θ.
    telecentric : bool
        Whether chief rays leave the object parallel to the axis, regardless of the stop.
    field_kind : str
        Kind of fields: "angle_deg", "object_height" or "image_height".
    fields : tuple of (float, float)
        Fields (x, y), degrees or mm.
    vignetting : tuple of (VDX, VDY, VCX, VCY)
        Shift and compression of the pupil for each field, in units of its radius; empty if all are 0.
    wavelengths_nm, weights : tuple of float
        Wavelengths, nm, and their relative weights.
    primary : int
        Index of the reference wavelength, from 0.
    unread : tuple of Unread
        Content of the file that had no effect.
    notes : tuple of str
        Assumptions that a user should know, each once.

    Examples
    --------
    >>> row = mistray.prescription.Row
    >>> glass = row(1, radius=50, thickness=5, material="N-BK7", stop=True)
    >>> rows = glass, row(2, radius=-50, thickness=46), row(3, kind="image")
    >>> lens = mistray.prescription.Sequential("singlet", rows, aperture=8, fields=((0, 0), (0, 3)))
    >>> lens.wavelength_nm
    587.56
    """

    name: str
    rows: tuple[Row, ...] = ROWS.field()
    _: KW_ONLY
    source: str = ""
    object_distance: float = math.inf
    object_material: str = "air"
    aperture_kind: ApertureKind = "entrance_pupil_diameter"
    aperture: float = 0.0
    telecentric: bool = False
    field_kind: FieldKind = "angle_deg"
    fields: tuple[tuple[float, float], ...] = Several(Each(FINITE, 2)).field(((0.0, 0.0),))
    vignetting: tuple[tuple[float, float, float, float], ...] = Several(Each(FINITE, 4), least=0).field(())
    wavelengths_nm: tuple[float, ...] = WAVELENGTHS_NM.field((587.56,))
    weights: tuple[float, ...] = WEIGHTS.field((1.0,))
    primary: int = 0
    unread: tuple[Unread, ...] = Several(OfType(Unread, "must be an Unread"), least=0).field(())
    notes: tuple[str, ...] = Several(TEXT, least=0).field(())

    def __post_init__(self) -> None:
        check_fields(self, f"lens '{self.name}'")
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
        object.__setattr__(self, "notes", tuple(dict.fromkeys(self.notes)))
        if not any(map(any, self.vignetting)):
            object.__setattr__(self, "vignetting", ())

    @property
    def wavelength_nm(self) -> float:
        """Reference wavelength, nm."""
        return self.wavelengths_nm[self.primary]

    def with_rows(self, rows: Row | Sequence[Row]) -> Sequential:
        """Return a copy of the lens with other rows; raise `MistrayError` as the constructor does."""
        return replace(self, rows=tuple(several(rows)))

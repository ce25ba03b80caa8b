"""Requests for `mistray import`: the lens file to read, and the placement of mechanical parts about it."""

from __future__ import annotations

from dataclasses import MISSING, dataclass

from mistray.ranges import (
    AZIMUTH_DEG,
    MARGIN,
    PLACE_MM,
    ROWS,
    SECONDS,
    SIZE_MM,
    SPACE,
    TEXT,
    TOLERANCE_MM,
    WAVELENGTH_NM,
    ByName,
    Each,
    Several,
    Words,
)
from mistray.toolkit.fields import Request, field

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class LensRequest(Request):
    """Lens file to import, with settings for data that it does not contain."""

    lens: str = field(
        TEXT,
        MISSING,
        "lens as .zmx, .seq, .len, .roa, .lens, batoid .yaml (also one of its own, by name) or .json (like "
        "scenes/phone_camera), or mechanics as .step, .stl, .obj, .ply or .glb",
        option="lens",
        metavar="FILE",
    )
    wavelength_nm: float | None = field(
        WAVELENGTH_NM, None, "wavelength of the source, nm (batoid: required; others: as the file says)"
    )
    beam: str | None = field(
        TEXT,
        None,
        "the source overfills the entrance pupil by 5 %, so that the stop has derivatives (pupil), just fills it "
        "(exact), or overfills the first surface (front; lens files only) (pupil)",
        metavar="KIND",
    )
    variant: str | None = field(TEXT, None, "design variant that a JSON file holds, such as R13=5.272")
    edges: str | None = field(
        TEXT,
        None,
        "lens edges: blackened, ground, or open, which are polished and without a barrel (blackened)",
        metavar="KIND",
    )
    coatings: str | None = field(TEXT, None, "COATING.DAT that holds the coatings of a .zmx file", metavar="FILE")
    glass: dict[str, str] | None = field(
        ByName(TEXT, "'MYGLASS=N-BK7'"),
        None,
        "material of a glass name, such as 'MYGLASS=nd=1.62 Vd=36.4 k=0'",
        metavar="NAME=MATERIAL",
    )
    glass_catalogue: tuple[str, ...] = field(Several(TEXT), None, "further glass catalogues", metavar="AGF")
    radius_mode: str | None = field(
        Words(("yes", "no")), None, "a .seq file gives radii (yes) or curvatures (no), where it does not say"
    )
    configuration: str | None = field(
        TEXT,
        None,
        "configuration or zoom position, by number or name (that the file was saved in, or the first one)",
    )
    margin: float | None = field(
        MARGIN, None, "clear radii that the file does not give exceed the rays by this part (0.02)", metavar="PART"
    )
    detector_half_mm: tuple[float, ...] | None = field(
        Each(SIZE_MM, 2),
        None,
        "half width and height of the detector, mm (as the file states, or the image of all fields)",
        metavar=("X", "Y"),
    )


@dataclass(frozen=True)
class MechanicsRequest(Request):
    """Scene and placement of imported mechanics, and accuracy of their surfaces."""

    into: str | None = field(
        TEXT, None, "scene that the parts are added to (default: a file for <include>)", metavar="SCENE"
    )
    space: dict[str, int] | None = field(
        ByName(SPACE, "'vane*=2'"), None, "optical space of parts or faces", metavar="PATTERN=N"
    )
    unit: str | None = field(
        TEXT, None, "of STL, OBJ, PLY (mm) and glTF (m): um, mm, cm, m, inch or ft", metavar="UNIT"
    )
    move_mm: Triple = field(
        Each(PLACE_MM, 3),
        (0.0, 0.0, 0.0),
        "where the origin of the parts goes after the tilt, mm",
        metavar=("X", "Y", "Z"),
    )
    tilt_deg: Triple = field(
        Each(AZIMUTH_DEG, 3),
        (0.0, 0.0, 0.0),
        "turns about x, then y, then z of the scene, degrees",
        metavar=("X", "Y", "Z"),
    )
    most_analytic: int = field(ROWS, 64, "surfaces made exact at most, the largest; 0: all are meshes")
    tolerance_mm: float | None = field(
        TOLERANCE_MM, None, "largest distance of the facets of a STEP file from its surfaces, mm (0.01)"
    )
    time_limit_s: float | None = field(
        SECONDS, None, "for reading a STEP file, processor time, seconds (5, and 30 for each MB)"
    )

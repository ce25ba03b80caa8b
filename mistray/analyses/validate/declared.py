"""Rows of a validation as TOML files declare them: published number, source, and allowed difference from mistray.

The files of the packs that come along and those of users have the same form.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mistray.errors import MistrayError
from mistray.ranges import (
    AZIMUTH_DEG,
    FIELD_DEG,
    FINITE,
    NOT_NEGATIVE,
    PLACE_MM,
    RAYS,
    TEXT,
    WAVELENGTH_NM,
    ByName,
    Each,
    OfType,
    Several,
    Words,
    check_fields,
    demand_of,
)
from mistray.toolkit.toml_section import TomlSection, keys_of

UNITS = {
    "power_W": "W",
    "share_percent": "%",
    "x_mm": "mm",
    "y_mm": "mm",
    "rms_radius_mm": "mm",
    "rms_irradiance_W_mm2": "W/mm²",
    "diameter_x_mm": "mm",
    "diameter_y_mm": "mm",
    "detected_W": "W",
    "scattered_W": "W",
    "pst": "1",
}
"""Quantities of a scene that a row may name, and their units; see `mistray.analyses.validate.scene_numbers`."""


@dataclass(frozen=True)
class DeclaredRow:
    """
    One published number that mistray's number is compared with.

    Ours agrees with the published number if they differ by at most four standard errors of both, added in quadrature,
    plus `tolerance`, plus `relative` times the published number. A number that is known to differ has to agree with
    the `expected` one in the same way.
    """

    name: str = TEXT.field(doc="name of the row")
    quantity: str = Words(tuple(UNITS)).field("", "number that a trace of the scene gives")
    published: float | None = FINITE.field(None, "published number, in the unit of the quantity")
    uncertainty: float = NOT_NEGATIVE.field(0.0, "its standard error")
    tolerance: float = NOT_NEGATIVE.field(
        0.0, "difference beyond the errors that the source leaves open, such as rounding"
    )
    relative: float = NOT_NEGATIVE.field(0.0, "the same as a share of the published number")
    differs: str = TEXT.field("", "reason why the numbers differ, if that is known; needs `expected`")
    expected: float | None = FINITE.field(
        None, "our number where it is known to differ; ours has to agree with this one instead"
    )
    expected_uncertainty: float = NOT_NEGATIVE.field(0.0, "its standard error")
    unit: str = TEXT.field("", "unit, where there is no quantity")
    path: tuple[str, ...] = Several(TEXT, 0).field(
        (), "surfaces that reflect the light, in order; those of the design are left out. Empty: the image"
    )
    scattered_by: str = TEXT.field("", "surfaces that scatter the light of `scattered_W`, with * for any letters")
    field_deg: float | None = FIELD_DEG.field(None, "field angle, degrees; that of the file")
    azimuth_deg: float | None = AZIMUTH_DEG.field(None, "azimuth of the field, degrees; that of the file")
    wavelength_nm: float | None = WAVELENGTH_NM.field(None, "wavelength, nm; that of the file")
    set: Mapping[str, float] | None = ByName(FINITE, "L1_front.bsdf.R=0.01").field(
        None, "values of parameters of the scene, by key, besides those of the file"
    )
    given: Mapping[str, Any] | None = OfType(Mapping, "must be a table").field(None)

    def __post_init__(self) -> None:
        where = f"row '{self.name}'"
        check_fields(self, where)
        if bool(self.differs) != (self.expected is not None):
            given, missing = ("differs", "expected") if self.differs else ("expected", "differs")
            raise MistrayError(f"{where}: {given} is given without {missing}; give both: why, and our number")
        if self.quantity in OF_MANY_PATHS and self.path:
            raise MistrayError(f"{where}: path is given for {self.quantity}, the light of many paths; leave it out")
        if (self.quantity == "scattered_W") != bool(self.scattered_by):
            raise MistrayError(f"{where}: give scattered_by with the quantity scattered_W, and with no other")
        if self.quantity == "pst" and self.field_deg is None:
            raise MistrayError(f"{where}: field_deg is missing, the angle of the pst; give it in the row or the file")

    def argument(self, name: str) -> Any:
        """Return the value `name` of the row's table `given`, from which a built-in pack computes mistray's number."""
        assert self.given is not None
        return self.given[name]

    def allowed(self, se: float, published: float, published_se: float) -> float:
        """
        Return the largest difference between mistray's and the published number that still counts as agreement.

        The numbers and their standard errors are in the unit of the quantity.
        """
        return ERRORS * math.hypot(se, published_se) + self.tolerance + self.relative * abs(published)


OF_MANY_PATHS = ("detected_W", "scattered_W", "pst")
ERRORS = 4.0  # standard errors within which numbers agree: by chance one of 16,000 rows does not


@dataclass(frozen=True)
class ReferenceFile:
    """Published numbers of one source, with the light (azimuth, wavelength, ...) that they hold for."""

    title: str = TEXT.field(doc="system, or subject")
    source: str = TEXT.field(doc="publication with its place, or program with its version")
    licence: str = TEXT.field("", "licence of the numbers")
    note: str = TEXT.field("", "what differs between the source and this program, and why")
    scene: str = TEXT.field("", "scene file, relative to this file, or the name of a shipped scene")
    rays: int = RAYS.field(100_000, "start rays of each trace")
    field_deg: float | None = FIELD_DEG.field(None, "field angle, degrees; that of the scene")
    azimuth_deg: float | None = AZIMUTH_DEG.field(None, "azimuth of the field, degrees; that of the scene")
    wavelength_nm: float | None = WAVELENGTH_NM.field(None, "wavelength, nm; that of the scene")
    pivot_mm: tuple[float, ...] | None = Each(PLACE_MM, count=3).field(
        None, "x, y and z of the point about which the beam turns with the field angle, mm; that of the scene"
    )
    set: Mapping[str, float] | None = ByName(FINITE, "L1_front.bsdf.R=0.01").field(
        None, "values of parameters of the scene, by key"
    )
    rows: tuple[DeclaredRow, ...] = ()
    folder: Path = Path()

    def __post_init__(self) -> None:
        check_fields(self)


def read_reference(path: str | Path) -> ReferenceFile:
    """
    Return the published numbers that a TOML file declares.

    Raises
    ------
    MistrayError
        If the file is missing, is not valid TOML, has an unknown key or a value that is not allowed, or has no row or
        two of one name.
    """
    section = TomlSection.of(path, "numbers")
    section.known((*keys_of(ReferenceFile), "row"))
    rows = [_row(one, section.content) for one in section.tables("row")]
    if not rows:
        raise section.fail("row", "is missing; write a section [[row]] for each number")
    names = [row.name for row in rows]
    double = next((name for name in names if names.count(name) > 1), None)
    if double is not None:
        raise section.fail("row", f"'{double}' is there twice; give each row a name of its own")
    return section.make(ReferenceFile, {"rows": tuple(rows), "folder": section.folder})


def _row(section: TomlSection, file: Mapping[str, Any]) -> DeclaredRow:
    """Return a row of a file; a field, azimuth or wavelength that it leaves out is that of the whole file."""
    section.known([field.name for field in dataclasses.fields(DeclaredRow) if demand_of(field)])
    light = {key: file.get(key) for key in ("field_deg", "azimuth_deg", "wavelength_nm") if key in file}
    return section.make(DeclaredRow, {}, **light)


def require_own(file: ReferenceFile, path: str) -> None:
    """Raise `MistrayError` unless a file of a user names a scene, and each row a quantity and a published number."""
    if not file.scene:
        raise MistrayError(f"numbers '{path}': scene is missing; name a scene file or a shipped scene")
    for row in file.rows:
        if not row.quantity:
            raise MistrayError(f"numbers '{path}': row '{row.name}' has no quantity; give one of {', '.join(UNITS)}")
        if row.published is None:
            raise MistrayError(f"numbers '{path}': row '{row.name}' has no published; give the number of the source")
        if row.given:
            raise MistrayError(f"numbers '{path}': row '{row.name}' has a table 'given'; leave it out")

"""Requests for an export: light of the critical rays, and contents of a STEP file."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

from mistray.ranges import (
    AZIMUTH_DEG,
    FIELD_DEG,
    RAYS,
    RAYS_DRAWN,
    ROWS,
    SIZE_MM,
    WAVELENGTH_NM,
    WAVELENGTHS_NM,
    Each,
)
from mistray.toolkit.fields import Request, field


@dataclass(frozen=True)
class CriticalRaysRequest(Request):
    """Light and number of the critical rays to be found."""

    field_deg: tuple[float, ...] | None = field(Each(FIELD_DEG), None, "field angles, degrees (that of the scene)")
    wavelength_nm: tuple[float, ...] | None = field(WAVELENGTHS_NM, None, "wavelengths, nm (those of the scene)")
    azimuth_deg: float | None = field(AZIMUTH_DEG, None, "azimuth of the field, degrees (that of the scene)")
    rim: int = field(RAYS_DRAWN, 8, "rays round the rim, at equal angles about the beam")
    rays: int = field(RAYS, 4000, "start rays at each field; the rim is found to about 1/√rays")


@dataclass(frozen=True)
class StepRequest(Request):
    """Contents, light and accuracy of a STEP file."""

    field_deg: tuple[float, ...] | None = field(
        Each(FIELD_DEG), None, "fields whose clear beams are written, degrees; none: no beams"
    )
    _: KW_ONLY
    wavelength_nm: float | None = field(WAVELENGTH_NM, None, "wavelength of beams and stray paths (the scene's), nm")
    paths: int = field(ROWS, 0, "strongest stray paths of each field, as polylines; without fields of the scene's own")
    rays: int = field(RAYS, 20_000, "start rays of the trace that finds them")
    rays_per_path: int = field(RAYS_DRAWN, 10, "most rays of each path")
    mirror_thickness_mm: float | None = field(
        SIZE_MM,
        None,
        "makes round mirrors without a body solids with a flat back, nowhere thinner than this, mm (sheets)",
    )
    freeform_tolerance_mm: float = field(SIZE_MM, 1e-5, "largest distance of a B-spline from a freeform, mm")

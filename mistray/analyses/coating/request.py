"""Request for `mistray coating`: a coating or a scene, its surroundings and the light."""

from __future__ import annotations

from dataclasses import MISSING, dataclass

from mistray.ranges import FLAG, POLAR_DEG, TEXT, WAVELENGTH_NM, Ascending, Each
from mistray.toolkit.fields import Request, field


@dataclass(frozen=True)
class CoatingRequest(Request):
    """Coating, or scene with coatings, with the materials around it and the light on it."""

    coating: str = field(
        TEXT,
        MISSING,
        "preset, 'bare', table.csv, COATING.DAT:NAME, layers between commas (material and thickness in nm, or in waves "
        "with a w), or a scene",
        option="coating",
        metavar="COATING",
    )
    front: str = field(TEXT, "air", "material in front", metavar="MATERIAL")
    back: str | None = field(TEXT, None, "material behind (N-BK7; Ge for presets of the infrared)", metavar="MATERIAL")
    from_back: bool = field(FLAG, False, "light comes from behind")
    wavelength_nm: tuple[float, ...] = field(
        Ascending(WAVELENGTH_NM),
        None,
        "wavelengths, or first:last:step (400:700:5; in the infrared the band of the preset, or that of the scene's "
        "light)",
    )
    angles_deg: tuple[float, ...] = field(Each(POLAR_DEG), (0.0, 15.0, 30.0, 45.0), "angles of incidence")
    design_nm: float = field(
        WAVELENGTH_NM,
        550.0,
        "wavelength of thicknesses in waves and of presets; presets of the infrared have their own",
    )

"""Request for `mistray bsdf` apart from the model: light, materials, and a small detector to be hit by chance."""

from __future__ import annotations

from dataclasses import MISSING, dataclass

from mistray.ranges import (
    AZIMUTH_DEG,
    CHANCE,
    FIELD_DEG,
    FLAG,
    POLAR_DEG,
    SHARE,
    SOLID_ANGLE_SR,
    TEXT,
    WAVELENGTH_NM,
    Each,
    Words,
)
from mistray.toolkit.fields import Nested, Request, field

EVENTS = ("reflection", "transmission")


@dataclass(frozen=True)
class SmallDetector(Request):
    """
    Small detector, for the probability that rays scattered without aiming hit it.

    Its angle is in degrees, its solid angle in sr, and `hit_before` is a probability up to 1.
    """

    hit_deg: float = field(
        FIELD_DEG, MISSING, "angle of the detector with the normal, at the first angle of incidence", metavar="DEG"
    )
    hit_sr: float = field(SOLID_ANGLE_SR, MISSING, "its solid angle as seen from the surface")
    hit_before: float = field(CHANCE, 1.0, "chance that a ray gets to the surface", metavar="SHARE")


@dataclass(frozen=True)
class BsdfRequest(Request):
    """
    Light, materials and angles for which a scatter model is evaluated.

    Angles are in degrees, the wavelength in nm; `R` and `T` are fractions of the incident light, 0 … 1.
    """

    angles_deg: tuple[float, ...] = field(Each(POLAR_DEG), (0.0, 15.0, 30.0, 45.0, 60.0, 75.0), "angles of incidence")
    rotations_deg: tuple[float, ...] | None = field(
        Each(AZIMUTH_DEG),
        None,
        "anisotropic tables: azimuths of the sample's x axis from that of the specular direction (0 90)",
    )
    event: str | None = field(Words(EVENTS), None, "what is drawn and written (what the model scatters first)")
    wavelength_nm: float = field(WAVELENGTH_NM, 550.0, "wavelength")
    front: str = field(TEXT, "air", "material in front", metavar="MATERIAL")
    back: str = field(TEXT, "N-BK7", "material behind", metavar="MATERIAL")
    from_back: bool = field(FLAG, False, "light comes from behind")
    R: float = field(SHARE, 1.0, "what the coating reflects; 1: BSDF of the reflected beam", metavar="SHARE")
    T: float = field(SHARE, 1.0, "what it transmits; 1: BSDF of the transmitted beam", metavar="SHARE")
    hit: SmallDetector | None = field(Nested(SmallDetector), None, "detector that is to be hit")

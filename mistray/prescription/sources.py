"""Sources of an optical system: a collimated beam, or a point of a near object."""

from __future__ import annotations

from dataclasses import dataclass

from mistray.errors import MistrayError
from mistray.prescription.model import Placed, within
from mistray.prescription.polarized import PolarizedFields
from mistray.prescription.spectral import Spectral
from mistray.ranges import POSITIVE, SIZE_MM, Range, Words, check_fields


@dataclass(frozen=True, kw_only=True)
class Source(Placed, Spectral, PolarizedFields):
    """
    A collimated beam whose axis passes through the pivot (x, y, z), with the parameters of the `collimated` emitter.

    Attributes
    ----------
    radius, inner_radius : float or None, float
        Outer and inner radius of the beam's cross-section, mm; ``None``: it is a rectangle.
    half_width, half_height : float or None
        Half sizes of a rectangular cross-section, mm; ``None``: it is a circle or a ring.
    field_deg, azimuth_deg : float
        Field angle θ and azimuth about z, degrees. The direction (0, sin θ, cos θ) is rotated by the azimuth, in the
        frame given by ``tilt_deg``.
    plane : str
        Plane of the cross-section. "beam": normal to the beam; "axis": the pivot plane, normal to the frame's z.
    distance : float
        Distance of the start of the rays upstream of the pivot, mm; 0: outside the scene.
    irradiance : float
        Irradiance on a plane normal to the beam, W/mm².
    wavelength_nm, weights, spectrum, band_nm, bands
        Wavelengths of the light, see `Spectral`.
    pattern : str
        Arrangement of the rays: "random" or "grid".
    pupil_area : float or None
        Area of the cross-section whose light counts as launched in transmissions, mm²; None: the whole cross-section.
    stokes, jones, polarization_deg
        Polarisation of the light, see `PolarizedFields`.

    Examples
    --------
    >>> sun = mistray.Source(radius=8, field_deg=20, wavelength_nm=(486, 588, 656), irradiance=1e-3)
    >>> print(f"{sun.irradiance * np.pi * sun.radius**2:.3f} W")
    0.201 W
    """

    radius: float | None = SIZE_MM.field(None)
    inner_radius: float = 0.0
    half_width: float | None = SIZE_MM.field(None)
    half_height: float | None = SIZE_MM.field(None)
    field_deg: float = 0.0
    azimuth_deg: float = 0.0
    plane: str = Words(("beam", "axis")).field("beam")
    distance: float = 0.0
    irradiance: float = POSITIVE.field(1.0)
    pattern: str = Words(("random", "grid")).field("random")
    pupil_area: float | None = POSITIVE.field(None)

    def __post_init__(self) -> None:
        self.check_polarization("source")
        rectangle = (self.half_width, self.half_height)
        if (self.radius is None) == (None in rectangle):
            raise MistrayError(
                f"source: radius = {self.radius} with half_width, half_height = {rectangle}; "
                "give either radius or both half sizes"
            )
        check_fields(self, "source")
        if self.radius is not None:
            within(self.radius).check("inner_radius", self.inner_radius, "source")
        self.check_spectrum("source")


@dataclass(frozen=True, kw_only=True)
class ObjectPoint(Placed, Spectral, PolarizedFields):
    """
    A point of a near object instead of a collimated beam, with the parameters of the `point_source` emitter.

    At zero field it lies on the -z axis of its frame, whose origin is the centre of the entrance pupil.

    Attributes
    ----------
    distance : float
        Distance of the object in front of the origin of the frame, along -z, mm.
    field_deg, azimuth_deg : float
        Field angle and azimuth, degrees. They shift the point in its plane so that its light arrives at the origin at
        this angle.
    intensity : float
        Radiant intensity, W/sr.
    half_angle_deg : float
        Half angle of the cone of its light about the +z axis, degrees.
    wavelength_nm, weights, spectrum, band_nm, bands, stokes, jones, polarization_deg
        Wavelengths and polarisation, as for `Source`.

    Examples
    --------
    >>> lamp = mistray.prescription.ObjectPoint(distance=500, field_deg=2, half_angle_deg=5, intensity=2e-3)
    >>> lamp.intensity  # W/sr
    0.002
    """

    distance: float = SIZE_MM.field()
    field_deg: float = 0.0
    azimuth_deg: float = 0.0
    intensity: float = POSITIVE.field(1.0)
    half_angle_deg: float = Range(0.0, 180.0, above=True, unit="degrees").field(90.0)

    def __post_init__(self) -> None:
        self.check_polarization("object point")
        check_fields(self, "object point")
        self.check_spectrum("object point")

"""Request for the analysis of thermal emission: temperatures, band, noise and rays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

from mistray.errors import MistrayError
from mistray.ranges import (
    BANDWIDTH_HZ,
    DETECTIVITY,
    LENGTH_UM,
    QUANTUM_EFFICIENCY,
    RAYS,
    TEMPERATURE_K,
    TEXT,
    WAVELENGTH_UM,
    ByName,
    Each,
    Interval,
    check_fields,
)
from mistray.settings import Settings
from mistray.toolkit.fields import FieldSubset, Nested, Request, field


@dataclass(frozen=True, kw_only=True)
class DetectorNoise:
    """
    Pixel of the detector and its noise; `detectivity` or `quantum_efficiency` or both must be given.

    Attributes
    ----------
    pixel_um : float
        Side of the light-sensitive square of a pixel, µm.
    bandwidth_hz : float
        Bandwidth of the noise, Hz; 1/(2t) for an integration time t.
    detectivity : float, optional
        Specific detectivity D*, mean over the band, cm √Hz/W; without it there is no NETD by detectivity.
    quantum_efficiency : float, optional
        Electrons per photon, mean over the band, above 0 and at most 1; without it there is no NETD by photon noise.

    Raises
    ------
    MistrayError
        If a value is out of range, or neither `detectivity` nor `quantum_efficiency` is given.
    """

    pixel_um: float = LENGTH_UM.field(doc="side of a square pixel, µm")
    bandwidth_hz: float = BANDWIDTH_HZ.field(doc="bandwidth of the noise, Hz; 1/(2t) for an integration time t")
    detectivity: float | None = DETECTIVITY.field(None, "D*, mean over the band, cm √Hz/W")
    quantum_efficiency: float | None = QUANTUM_EFFICIENCY.field(
        None, "electrons per photon, mean over the band; for the noise of photons"
    )

    def __post_init__(self) -> None:
        check_fields(self, "noise of the detector")
        if self.detectivity is None and self.quantum_efficiency is None:
            raise MistrayError("noise of the detector: give detectivity, quantum_efficiency or both")

    @property
    def pixel_mm2(self) -> float:
        """Area of the pixel, mm²."""
        return (1e-3 * self.pixel_um) ** 2


@dataclass(frozen=True)
class ThermalRequest(Request):
    """Temperatures, band, noise and rays of an analysis of thermal emission."""

    temperature_K: float = field(TEMPERATURE_K, 293.0, "temperature of everything without one of its own, K")
    band_um: tuple[float, float] = field(Interval(WAVELENGTH_UM), (8.0, 12.0), "band of the detector, µm")
    _: KW_ONLY
    temperatures: Mapping[str, float] | None = field(
        ByName(TEMPERATURE_K, "detector=77"),
        None,
        "temperatures of surfaces, parts or materials by name, with * and ?, K; the last that fits holds",
        option="--part",
        metavar="NAME=T",
    )
    scene_K: float | None = field(
        TEMPERATURE_K, None, "temperature of the blackbody around the system, K; without it that of everything"
    )
    wavelengths_um: tuple[float, ...] | None = field(
        Each(WAVELENGTH_UM),
        None,
        "wavelengths at which optics are traced, µm; without them as many as tell the integral over the band to 1 %",
        option="--wavelength-um",
    )
    detector: str | None = field(TEXT, None, "shape with the sensor, where the scene has several", metavar="ID")
    noise: DetectorNoise | None = field(
        Nested(DetectorNoise, one_of=("detectivity", "quantum_efficiency")), None, "a pixel and its noise, for the NETD"
    )
    rays: int | None = field(
        RAYS,
        None,
        "rays from the detector, for each wavelength and twice: of everything, and of the image; without it 200 000, "
        "of more than three wavelengths 600 000 over their number",
    )
    settings: Mapping[str, Any] = field(FieldSubset.but(Settings, "rays"), None, "settings of the trace")

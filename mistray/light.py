"""Light of a trace and the detector that records it: what determines a trace beside its settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any


@dataclass(frozen=True)
class Light:
    """
    Light of a trace, and where it is recorded; None: as the scene says.

    Attributes
    ----------
    field_deg, azimuth_deg : float, optional
        Field angle and its azimuth, degrees; traces over a grid of directions do not read them.
    wavelength_nm : float or sequence of float, optional
        Wavelengths, nm.
    weights : sequence of float, optional
        Shares of the wavelengths in the flux.
    detector : str or sequence of str, optional
    """

    field_deg: float | None = None
    azimuth_deg: float | None = None
    wavelength_nm: Any = None
    weights: Sequence[float] | None = None
    detector: str | Sequence[str] | None = None

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> Light:
        """Return the light that the arguments of a call describe; others may be among them."""
        known = {f.name for f in fields(cls)}
        return cls(**{name: value for name, value in arguments.items() if name in known})


AS_THE_SCENE = Light()

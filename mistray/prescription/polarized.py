"""Polarisation of a source in a prescription."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mistray.physics.polarization.state import polarization_state


@dataclass(frozen=True, kw_only=True)
class PolarizedFields:
    """
    Polarisation of light, given by one of three descriptions; see docs/polarization.md.

    If none is given, the light is unpolarised.

    Attributes
    ----------
    stokes : tuple of three float or None
        Normalised Stokes parameters s1, s2, s3 (divided by S0), in the axes of the source.
    jones : tuple of two complex or None
        Jones vector (ex, ey) in these axes, of any magnitude.
    polarization_deg : float or None
        Angle of linear polarisation from the first axis towards the second one, degrees.
    """

    stokes: tuple[float, float, float] | None = None
    jones: tuple[complex, complex] | None = None
    polarization_deg: float | None = None

    def check_polarization(self, owner: str) -> None:
        """Raise `MistrayError` if the description is impossible, or more than one is given."""
        polarization_state(owner, self.stokes, self.jones, self.polarization_deg)

    @property
    def polarization_properties(self) -> dict[str, Any]:
        """Properties of the source plugin that state the polarisation; empty for unpolarised light."""
        found: dict[str, Any] = {}
        if self.stokes is not None:
            found["stokes"] = ", ".join(repr(float(value)) for value in self.stokes)
        if self.jones is not None:
            found["jones"] = ", ".join(str(complex(value)).strip("()") for value in self.jones)
        if self.polarization_deg is not None:
            found["polarization_deg"] = float(self.polarization_deg)
        return found

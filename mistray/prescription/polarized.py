"""The polarisation of a source of a prescription."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mistray.physics.polarization.state import polarization_state


@dataclass(frozen=True, kw_only=True)
class PolarizedFields:
    """
    Light that may be polarised: one of these numbers says how, none of them that it is not; see docs/polarization.md.

    Attributes
    ----------
    stokes : tuple of three float or None
        s1, s2, s3, divided by S0, in the axes of the source.
    jones : tuple of two complex or None
        Jones vector ex, ey in these axes, of any size.
    polarization_deg : float or None
        Linear polarisation, the angle from the first axis towards the second one.
    """

    stokes: tuple[float, float, float] | None = None
    jones: tuple[complex, complex] | None = None
    polarization_deg: float | None = None

    def check_polarization(self, owner: str) -> None:
        """Raise `MistrayError` if no light can be so."""
        polarization_state(owner, self.stokes, self.jones, self.polarization_deg)

    @property
    def polarization_properties(self) -> dict[str, Any]:
        """As properties of a plugin."""
        found: dict[str, Any] = {}
        if self.stokes is not None:
            found["stokes"] = ", ".join(repr(float(value)) for value in self.stokes)
        if self.jones is not None:
            found["jones"] = ", ".join(str(complex(value)).strip("()") for value in self.jones)
        if self.polarization_deg is not None:
            found["polarization_deg"] = float(self.polarization_deg)
        return found

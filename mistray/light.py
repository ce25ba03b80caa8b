"""Light of a trace and its detector: what determines a trace besides its settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, TEXT, WAVELENGTHS_NM, WEIGHTS


@dataclass(frozen=True)
class Light:
    """
    Field direction and wavelengths of a trace, and the detector that records it.

    An attribute that is None takes the scene's value, but wavelengths that are given without weights have equal ones.
    """

    field_deg: float | None = FIELD_DEG.field(
        None, "field angle, degrees; traces over a grid of directions do not read it"
    )
    azimuth_deg: float | None = AZIMUTH_DEG.field(None, "azimuth of the field about z, degrees")
    wavelength_nm: Any = WAVELENGTHS_NM.field(None, "wavelengths, nm")  # noqa: RUF009  of what cannot change
    weights: float | Sequence[float] | None = WEIGHTS.field(
        None, "shares of the flux, one for each of the wavelengths; without them equal"
    )
    detector: str | Sequence[str] | None = TEXT.field(None, "shape with the sensor, where the scene has several")

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> Light:
        """
        Return the light given by keyword arguments of a call.

        Arguments that are not attributes of `Light` are ignored.
        """
        known = {f.name for f in fields(cls)}
        return cls(**{name: value for name, value in arguments.items() if name in known})


AS_THE_SCENE = Light()

"""Stray-light metrics as values with standard error, unit and a definition in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.estimate import Estimate

if TYPE_CHECKING:
    import pandas as pd

DEFINITIONS = {
    "psrr": "point source rejection ratio: PST at the field angle over PST at the reference angle, of the same light",
    "psnit": "point source normalised irradiance transmittance: irradiance on the detector over irradiance at the "
    "entrance, the latter {plane}; the published wording leaves the plane open",
    "ndi": "normalised detector irradiance: irradiance on the detector over irradiance at the entrance, the latter "
    "{plane}; the published wording leaves the plane open",
    "irradiance": "irradiance on the detector, its mean over the area, of {light} light from an extended source: "
    "integral of L PST_n over solid angle",
    "throughput": "irradiance of the direct image per radiance of a uniform scene: integral of the direct PST_n over "
    "solid angle",
    "stray_radiance": "equivalent stray radiance: radiance of a uniform scene whose direct image is as bright as the "
    "stray light, E_stray over {throughput}",
    "stray_to_signal": "irradiance of stray light over that of the direct image of a uniform scene, means over the "
    "detector",
    "vgi": "veiling glare index: 100 E_black / E_white, E_black at {place} by a white source less a black patch, "
    "E_white by the same source with a white patch; after ISO 9358",
    "gsf": "glare spread function: irradiance at a point of the detector over the flux of the direct image of the "
    "source; after ISO 9358; {light}",
    "gsr": "ghost-to-signal ratio, integrated: flux of all stray light over that of the direct image",
    "gsr_peak": "ghost-to-signal ratio, peak: brightest pixel of the stray light over that of the direct image",
    "normalised_stray_light": "irradiance of stray light by a disc-shaped source, its mean over the detector, over "
    "irradiance within the direct image of that source (Imatest's direct reference image)",
    "flare_attenuation": "irradiance within the direct image of a disc-shaped source over the mean irradiance of its "
    "stray light on the detector. It is the reciprocal of the normalised stray light (IEEE P2020 draft, a Lambertian "
    "reference)",
    "contrast_factor": "contrast of the image with stray light over contrast without it: 1 / (1 + E_stray / E_signal)",
    "magnitude": "surface brightness of the equivalent stray radiance, magnitudes per square arcsecond, with the zero "
    "point {zero:.4g} W/mm2",
}
"""Definition of each number. Names in braces are filled in by the code that computes it."""


@dataclass(frozen=True)
class StrayMetric:
    """
    One stray-light metric with its standard error, unit and definition.

    Attributes
    ----------
    quantity : str
        Key of `DEFINITIONS`.
    value, se : float
        Value of the number and its standard error, in `unit`.
    unit : str
        Unit of the value; "1" for a ratio.
    definition : str
        Definition of the number, in words.
    covered : float
        Share of the source, by radiance times solid angle, that lies in cells of the PST; 1 where there is no source.
        Light that no cell covers counts as dark unless it is `interpolated`.
    interpolated : float
        Share of the source, weighted in the same way, that lies between the cells, where the PST was interpolated.
    facts : dict
        Numbers and settings that it was computed from, as JSON-serialisable values.
    """

    quantity: str
    value: float
    se: float
    unit: str
    definition: str
    covered: float = 1.0
    interpolated: float = 0.0
    facts: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(
        cls, quantity: str, estimate: Estimate, unit: str = "1", words: dict[str, Any] | None = None, **more: Any
    ) -> StrayMetric:
        """
        Create a metric from an estimate in `unit`.

        `words` fill the placeholders, by name, in the definition of `quantity`; `more` are further attributes.
        """
        value, se = estimate
        return cls(quantity, float(value), float(se), unit, DEFINITIONS[quantity].format(**(words or {})), **more)

    @property
    def estimate(self) -> Estimate:
        """Value and standard error, in `unit`."""
        return Estimate(self.value, self.se)

    def row(self) -> dict[str, Any]:
        """Return the metric as a table row: a dict of plain values, followed by `facts`."""
        names = ("quantity", "value", "se", "unit", "covered", "interpolated", "definition")
        return {name: getattr(self, name) for name in names} | self.facts

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        text = f"{self.quantity}: {self.value:.4g} ± {self.se:.2g}{unit} ({self.definition})"
        if self.covered < 1 - 1e-9:
            between = f", {100 * self.interpolated:.3g} % interpolated" if self.interpolated else ""
            text += f"; {100 * self.covered:.3g} % of the source lie in cells of the PST{between}"
        return text


@dataclass(frozen=True, eq=False)
class MetricCurve:
    """
    Stray-light metric over field angle, with its standard error, unit and definition.

    Attributes
    ----------
    quantity, unit, definition, facts
        Key of the quantity, unit of its values, definition in words and further facts, see `StrayMetric`.
    field_deg, value, se : (n,) float64
        Field angles, degrees; values and their standard errors, in `unit`.
    """

    quantity: str
    field_deg: np.ndarray
    value: np.ndarray
    se: np.ndarray
    unit: str
    definition: str
    facts: dict[str, Any] = field(default_factory=dict)

    def to_pandas(self) -> pd.DataFrame:
        """Return a DataFrame, one row per angle: angle_deg, quantity, value, se, unit, definition and the facts."""
        import pandas as pd

        columns = {"quantity": self.quantity, "value": self.value, "se": self.se, "unit": self.unit}
        return pd.DataFrame({"angle_deg": self.field_deg, **columns, "definition": self.definition, **self.facts})

    def to_csv(self, path: str | Path) -> None:
        """Write the table of `to_pandas` to a CSV file, numbers with nine significant digits."""
        self.to_pandas().to_csv(path, index=False, float_format="%.9g")

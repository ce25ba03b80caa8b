"""Result of an analysis of thermal emission: irradiance by emitter, narcissus and NETD."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from mistray.analyses.thermal.narcissus import NarcissusReturn, ZoneReturn
from mistray.analyses.thermal.netd import Netd, NoiseSource
from mistray.estimate import Estimate
from mistray.notes import Note
from mistray.result import KeyNumber, Result
from mistray.toolkit.rows import column, frame

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Emitter:
    """
    Surface or medium with the irradiance that its thermal light causes on the detector, W/mm².

    `share` and `emission` are dimensionless. `percent` is its part of the irradiance by all emitters, %.
    """

    name: str = column("Surface id, or the material of a medium", head="emitter")
    part: str = column('Part that a surface belongs to; "" for a medium', empty="(medium)")
    kind: str = column('"surface" or "medium"')
    temperature_K: float = column("Temperature, K", digits="g")
    hits: int = column("Rays that met a surface", head="rays")
    share: Estimate = column(
        "n² times the mean share of the detector's view that meets a surface; more where rays meet it repeatedly",
        head="share [n²]",
    )
    emission: Estimate = column(
        "n² times the mean share that it absorbs, weighted with the spectrum of its temperature, n being the index "
        "before the detector. That is a projected solid angle over π, times the emissivity",
        head="emission [n²]",
    )
    irradiance_W_mm2: Estimate = column("Irradiance on the detector, W/mm²")
    percent: float = column("Share of the total, %", math.nan, head="of total [%]", digits=".3g")


@dataclass(frozen=True, kw_only=True, repr=False)
class ThermalReport(Result, table=".page:part_table", figure=".figures:thermal_figure"):
    """
    Thermal light incident on the detector; irradiances are in W/mm² within the band.

    Attributes
    ----------
    emitters : list of Emitter
        Media, and surfaces that rays met, the strongest first; the detector is one if it sees itself.
    total_W_mm2 : Estimate
        Irradiance by all emitters, W/mm².
    scene_W_mm2 : Estimate
        Irradiance by a blackbody around the system at `scene_K`, by all paths, W/mm².
    image_W_mm2 : Estimate
        Part of it that forms the image, W/mm²: by the sequences of the design, or, without them, all light that is
        neither scattered nor reflected except at mirrors.
    to_image : Estimate
        Self-emission over the irradiance of the imaged scene, dimensionless; NaN if no scene is seen.
    lost_W_mm2 : float
        Irradiance that a blackbody at `temperature_K` would add by the paths that were not followed, W/mm².
    self_view : Estimate
        Emission of the detector in its own view (narcissus), as in `Emitter.emission`; 0 if it does not see itself.
    nitd_K : Estimate
        Narcissus-induced temperature difference, K: change of the scene's temperature at `scene_K` that would remove as
        much light as narcissus. Narcissus is the view by ghosts and scatter of everything colder than `temperature_K`,
        mainly the detector; see `mistray.physics.planck.narcissus_nitd`. NaN if no scene is seen or nothing is colder.
    temperature_K, detector_K, scene_K : float
        Temperatures of system, detector and scene, K.
    band_um : (float, float)
        Ends of the band, µm.
    wavelengths_um : tuple of float
        Wavelengths at which the optics were traced, µm.
    band_error : float
        Bound of the relative error of band integrals by these wavelengths, dimensionless, without that of scatter, see
        `TracedBand.error`. Divided by √3 it is part of the standard errors of means and integrals over the band. NaN if
        the optics are not known over the whole band.
    detector : str
        Id of the detector's shape.
    returned : list of NarcissusReturn
        Surfaces by which the cold detector sees itself and its shield, the strongest first; empty if it does not see
        itself or is not colder than the rest.
    zones_mm : tuple of float
        Distances from the middle of the detector that bound the zones of `NarcissusReturn.by_zone_K`, mm; empty like
        `returned`.
    netd : Netd or None
        Noise-equivalent temperature difference; None unless the noise of the detector is given.
    facts : dict
        Plain values: rays, seconds, settings.
    notes : list of Note
        Notes on the reliability of the results.

    Examples
    --------
    >>> found = mistray.thermal(mistray.load("cassegrain"), 293, (8, 12), wavelengths_um=10, rays=5000)
    >>> for part, irradiance in list(found.by_part().items())[:2]:
    ...     print(f"{part}: {irradiance.value / found.total_W_mm2.value:.0%} of the emission")
    inner_baffle: 51% of the emission
    inner_baffle_vane_5: 43% of the emission
    """

    emitters: list[Emitter]
    total_W_mm2: Estimate
    scene_W_mm2: Estimate
    image_W_mm2: Estimate
    to_image: Estimate
    lost_W_mm2: float
    self_view: Estimate
    nitd_K: Estimate
    temperature_K: float
    detector_K: float
    scene_K: float
    band_um: tuple[float, float]
    wavelengths_um: tuple[float, ...]
    band_error: float
    detector: str
    returned: list[NarcissusReturn] = field(default_factory=list)
    zones_mm: tuple[float, ...] = ()
    netd: Netd | None = None
    facts: dict[str, Any] = field(default_factory=dict)
    notes: list[Note] = field(default_factory=list)

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return self-emission, W/mm², its ratio to the imaged scene, NITD and NETD, K, if known, by label."""
        netd = (
            {"NETD by D* [K]": self.netd.by_detectivity_K, "NETD by photons [K]": self.netd.by_photons_K}
            if self.netd
            else {}
        )
        numbers = {
            "self-emission [W/mm²]": self.total_W_mm2,
            "over the image [1]": self.to_image,
            "narcissus difference [K]": self.nitd_K,
        }
        return {name: one for name, one in (numbers | netd).items() if math.isfinite(one.value)}

    def by_part(self) -> dict[str, Estimate]:
        """
        Return the irradiance by part, and by medium in parentheses, W/mm², the strongest first.

        Errors of surfaces of one part are added linearly, because rays of one trace share them; this is an upper bound.
        """
        sums: dict[str, Estimate] = {}
        for emitter in self.emitters:
            name = emitter.part if emitter.kind == "surface" else f"({emitter.name})"
            before = sums.get(name, Estimate(0.0, 0.0))
            more = emitter.irradiance_W_mm2
            sums[name] = Estimate(before.value + more.value, before.se + more.se)
        return dict(sorted(sums.items(), key=lambda item: -item[1].value))

    def to_pandas(self) -> pd.DataFrame:
        """Return a DataFrame with a row for each emitter and the columns of `Emitter`; ``_se``: standard errors."""
        return frame(Emitter, self.emitters)

    @property
    def noise_sources(self) -> list[NoiseSource]:
        """
        Contributions of all light sources to the photon noise.

        The list is empty without a quantum efficiency, or if no scene is seen.
        """
        return self.netd.sources if self.netd else []

    @property
    def by_zone(self) -> list[ZoneReturn]:
        """Narcissus-induced temperature difference, K, of each surface in each zone of the detector."""
        return [
            ZoneReturn(found.surface, low, high, nitd)
            for found in self.returned
            for (low, high), nitd in zip(pairwise(self.zones_mm), found.by_zone_K, strict=True)
        ]

"""Diffraction at the edge of an opening, as scatter by a thin ring inside it."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace

import numpy as np

from mistray.errors import MistrayError
from mistray.param import Param
from mistray.physics import diffraction
from mistray.ranges import SIZE_MM, Words
from mistray.scatter.lobe import EVENT, Lobe, Placement
from mistray.scatter.radial import OCTAVES, R_MAX

FIRST_R = R_MAX * 2.0**-OCTAVES  # radius below which the lobe and its table are constant
LEAST_WAVES = 25.0  # least width over wavelength; a narrower ring would scatter too much at grazing incidence

LAW = Param(
    "string",
    Words(tuple(diffraction.SPREADS)),
    "tail of a half plane, or Heisenberg's relation as in other programs, 1.25 times as much far from the beam",
)


@dataclass(frozen=True)
class EdgeDiffraction(Placement):
    """
    Transparent ring inside an edge that scatters passing light as the edge diffracts it: unpolarised, ring-averaged.

    The ring deflects all light that meets it, most of it by less than the angle λ/(16 w); beyond, the diffracted light
    does not depend on the width. A round aperture whose ring is lit evenly has the far field of its diffraction. β is
    taken in the medium of the diffracted light. Equations and sources: `mistray.physics.diffraction`.

    Attributes
    ----------
    width_mm : float
        Width w of the ring, mm, > 0: its area divided by the length of the edge. A ring from r0 to r1 has the width
        (r1² - r0²)/(2 r1) if r1 is the edge, and (r1² - r0²)/(2 r0) if r0 is the edge, as around an obstruction.
    law : {"half_plane", "heisenberg"}
        Far field of a half plane, or Heisenberg's relation with 1.25 times as much light far from the beam.
    event : {"transmission"}
        Event that scatters: transmission only.

    Raises
    ------
    MistrayError
        If a parameter is out of range. `lobes` raises it if the ring is narrower than 25 wavelengths.
    """

    width_mm: float = Param(
        "mm",
        SIZE_MM,
        "width w of the ring: its area over the length of the edge, (r1² - r0²)/(2 r1) where r1 is the edge",
        within="≥ 25 λ",
    ).field()
    law: str = LAW.field("half_plane")
    _: KW_ONLY
    event: str = replace(EVENT, within="transmission").field("transmission")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.event != "transmission":
            raise MistrayError(f"{self.title}: event is '{self.event}'; an edge diffracts what passes it: transmission")

    def event_lobes(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> tuple[Lobe, ...]:
        """Return the one lobe of an event, see `Placement.event_lobes`; raise `MistrayError` for too narrow a ring."""
        wavelength_mm = 1e-6 * wavelength_nm / n_out
        if self.width_mm < LEAST_WAVES * wavelength_mm:
            raise MistrayError(
                f"{self.title}: width_mm is {self.width_mm:g} mm at {wavelength_nm:g} nm; make the ring at least "
                f"{LEAST_WAVES:g} wavelengths wide"
            )
        return (
            Lobe(
                event,
                lambda r: diffraction.ring_bsdf(np.maximum(r, FIRST_R), self.width_mm, wavelength_mm, self.law),
                factor="edge",
                shares=self.shares,
            ),
        )

"""Phong model of a glossy surface, as in FRED."""

from __future__ import annotations

from dataclasses import dataclass, replace

from mistray.param import Param
from mistray.physics import phong
from mistray.ranges import EXPONENT
from mistray.scatter.lobe import Lobe, Placement
from mistray.scatter.numbers import PEAK, unusual


@dataclass(frozen=True)
class Phong(Placement):
    """
    BSDF = b0 cos^n α about the specular direction, the same in reflection and transmission and from both sides.

    α is the angle in the medium of the scattered light. Equation and sources: `mistray.physics.phong`.

    Attributes
    ----------
    b0 : float
        BSDF in the specular direction, 1/sr, ≥ 0. At (n + 2)/2π all light is scattered at normal incidence; a trace
        refuses more.
    exponent : float
        Exponent n, ≥ 1. The radial table that a trace reads has an error of 3e-4 in the total, because cos^n α falls
        faster than its linear pieces near 90°.

    Raises
    ------
    MistrayError
        If a parameter is out of range.
    """

    b0: float = replace(PEAK, doc="BSDF in the specular direction; TIS at normal incidence is 2π b0/(n + 2)").field()
    exponent: float = Param("1", EXPONENT, "exponent n of the cosine", tolerance=0.05).field()

    def event_lobes(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> tuple[Lobe, ...]:
        """Return the lobe of an event, or () if b0 is 0, see `Placement.event_lobes`."""
        if self.b0 == 0:
            return ()
        return (
            Lobe(
                event,
                lambda r: phong.bsdf(r, self.b0, self.exponent),
                measure="angle",
                shares=self.shares,
                factor="cosine",
                oblique_limit=1.0,
            ),
        )

    def advice(self) -> str | None:
        """Return a line of advice if the total scatter is unusual; None otherwise."""
        return unusual(self.title, total=phong.tis(self.b0, self.exponent))

"""Scatter model with a Gaussian lobe about the specular direction."""

from __future__ import annotations

from dataclasses import dataclass

from mistray.param import Param
from mistray.physics import gaussian
from mistray.ranges import LOBE_WIDTH, SHARE
from mistray.scatter.lobe import Lobe, Placement
from mistray.scatter.numbers import unusual


@dataclass(frozen=True)
class Gaussian(Placement):
    """
    Gaussian scatter, BSDF = f0 exp(-(|β - β0|/w)²), the same in both events and from both sides.

    β is taken in the medium of the scattered light. Equation and source: `mistray.physics.gaussian`.

    Attributes
    ----------
    total : float
        Fraction scattered at normal incidence, 0 … 1, of the light that `relative_to` names.
    width : float
        Value w of |β - β0| at which the BSDF has fallen to 1/e, > 0.

    Raises
    ------
    MistrayError
        If a parameter is out of range.
    """

    total: float = Param("1", SHARE, "fraction of R and T scattered at normal incidence").field()
    width: float = Param("1", LOBE_WIDTH, "w: r = |β - β0| at which the BSDF is 1/e of its peak").field()

    def event_lobes(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> tuple[Lobe, ...]:
        """Return the lobe of an event, or () if `total` is 0, see `Placement.event_lobes`."""
        if self.total == 0:
            return ()
        return (Lobe(event, lambda r: gaussian.bsdf(r, self.total, self.width), shares=self.shares),)

    def advice(self) -> str | None:
        """Return a line of advice if the width or the total scatter is unusual; None otherwise."""
        text = f"width {self.width:g} is more than the half space holds; a Lambertian surface is ABg of g 0"
        return unusual(self.title, text if self.width > 1 else None, total=self.total)

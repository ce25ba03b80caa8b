"""Model and plugin of the scatter model ``cosine_power``."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from mistray.param import Param
from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.ranges import NOT_NEGATIVE, SHARE
from mistray.scatter import Lobe, Placement


@dataclass(frozen=True)
class CosinePower(Placement):
    """BSDF = total (power + 1)/π (1 - r²)^power, with r = |β - β0|; at normal incidence its TIS is `total`."""

    total: float = Param("1", SHARE, "scattered share at normal incidence").field()
    power: float = Param("1", NOT_NEGATIVE, "power of the cosine", tolerance=0.05).field(2.0)

    def bsdf(self, r: np.ndarray) -> np.ndarray:
        """Return the BSDF, 1/sr, at distances |β - β0|."""
        return self.total * (self.power + 1) / np.pi * np.maximum(1 - r * r, 0.0) ** self.power

    def event_lobes(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> tuple[Lobe, ...]:
        """Return the lobe of an event; it depends on neither wavelength nor media."""
        return (Lobe(event, self.bsdf, shares=self.shares),)


class CosinePowerPlugin(Scatterer):
    """Scatter by a power of the cosine, ``{"type": "cosine_power", "total": 0.3, "power": 2}``."""

    kind = "cosine_power"
    model_type = CosinePower


mi.register_bsdf("cosine_power", CosinePowerPlugin)

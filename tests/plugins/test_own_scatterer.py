"""A scatter plugin that is not ours: nested, among the parameters, and refused in one line."""

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from refusals import refused

from mistray.metrics.parameters import parameters
from mistray.param import Param
from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.ranges import SHARE
from mistray.scatter import Lobe, Placement


@dataclass(frozen=True)
class Haze(Placement):
    """BSDF = share (depth + 1)/π (1 - r²)^depth."""

    share: float = Param("1", SHARE, "scattered share", tolerance=0.1).field()
    depth: float = Param().field()

    def value(self, r: np.ndarray) -> np.ndarray:
        inside = np.where(r < 1, 1 - r * r, 0.0)
        return np.where(r < 1, self.share * (self.depth + 1) / np.pi * inside**self.depth, 0.0)

    def lobes(self, wavelength_nm: float, n_in: float, n_out: float, from_front: bool) -> tuple[Lobe, ...]:
        return tuple(Lobe(event, self.value, shares=self.shares) for event in self.events(from_front))


class HazePlugin(Scatterer):
    kind = "haze"
    model_type = Haze


mi.register_bsdf("haze", lambda props: HazePlugin(props))


def scene(**scatter: Any) -> Any:
    interface = {"type": "interface", "R": 0.9, "scatter": {"type": "haze", **scatter}}
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 0.5},
        panel={"type": "asphere", "semi_diameter": 5.0, "bsdf": interface},
        detector=scene_dicts.detector(-20.0, semi_diameter=1.0, y=20.0),
    )


def test_its_values_are_parameters_and_its_errors_one_line() -> None:
    found = {key: p for key, p in parameters(scene(share=0.3, depth=2.0)).items() if p.kind == "scatter"}
    assert set(found) == {"panel.bsdf.haze.share", "panel.bsdf.haze.depth"}
    depth, share = found["panel.bsdf.haze.depth"], found["panel.bsdf.haze.share"]
    assert (depth.unit, depth.value[0], depth.shapes) == ("1", 2.0, ("panel",))
    assert (depth.low, depth.high, share.low, share.high) == (-np.inf, np.inf, 0.0, 1.0)
    assert (depth.tolerance, share.tolerance) == pytest.approx((0.4, 0.03))
    with refused(r"share is 1\.5"):
        scene(share=1.5, depth=2.0)

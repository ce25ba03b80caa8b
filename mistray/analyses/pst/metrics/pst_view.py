"""Computation of a point source transmittance for several metrics at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mistray.analyses.pst.metrics.pst_observation import PstObservation
from mistray.analyses.pst.request import USUAL_RAYS, PstRequest
from mistray.analyses.pst.run import pst_of_each
from mistray.errors import MistrayError
from mistray.metrics.views import TraceView, sorted_arguments

METHODS = ("joined", "adjoint")  # of a PST metric, the usual one first
# Arguments of `mistray.pst` that a metric refuses: it is computed from PST_normal, of `rays` rays, each time anew
NO_ARGUMENTS = (
    "relative_error", "error_up_to_deg", "state", "resume", "seconds", "map_pixels", "paths", "next_order",
    "convention",
)  # fmt: skip


@dataclass(frozen=True)
class PstView(TraceView):
    """
    Point source transmittance (PST) to be computed of a scene, as input of metrics.

    Attributes
    ----------
    arguments : dict
        Arguments of `mistray.pst`.
    plans : dict
        Plans of pilots by their arguments, for later calls. Their rays start from the same points, so that
        scenes which differ little are seen with the same noise.
    """

    plans: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in NO_ARGUMENTS:
            if name in self.arguments:
                raise MistrayError(f"{name} is not a setting of a PST metric, which traces `rays` rays; leave it out")
        method = self.arguments.get("method", METHODS[0])
        if method not in METHODS:
            raise MistrayError(f"method of a PST metric is '{method}'; use {' or '.join(map(repr, METHODS))}")

    def observe(self, scene: Any, times: float, changes: Mapping[str, Any]) -> PstObservation:
        """
        Return the PST of a scene, computed with `times` the number of rays.

        `changes` replace `arguments`; with ``paths`` the PST keeps its paths.
        """
        look = sorted_arguments(
            {name: value for name, value in changes.items() if name not in ("rays", "seed", "paths")}
        )
        arguments = {"method": METHODS[0], "paths": False, **self._arguments(scene, times, changes)}
        found = next(pst_of_each([scene], PstRequest.of(**arguments), plan=self.plans.get(look)))
        self.plans[look] = found.plan
        return PstObservation(found)

    def _usual_rays(self, scene: Any) -> int:
        return USUAL_RAYS[METHODS[0]]

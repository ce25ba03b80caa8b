"""Studies: what is to be made small, by which coatings, within which bounds."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from mistray.coatings import Stack
from mistray.optimize.metrics import Metric, ghost_to_signal, path_power

METRICS: dict[str, Callable[..., Metric]] = {"path_power": path_power, "ghost_to_signal": ghost_to_signal}


@dataclass(frozen=True)
class MetricStudy:
    """
    Section ``[metric]``: the number to be made small.

    Attributes
    ----------
    kind : {"path_power", "ghost_to_signal"}
        Functions of `mistray.optimize`.
    paths : str
        A kind of the path table ("ghost", "stray", …) or the events of one path.
    fields_deg : tuple of float or None
        Averaged; None: the source's own field.
    wavelength_nm : tuple of float or None
        Traced with `weights`; None: the source's own.
    weights : tuple of float or None
        Shares of the flux, equal by default.
    rays : int
        Start rays at each field.
    max_reflections : int
    flux_threshold : float
        0 by default: branches that are cut have no gradient.
    seed : int
        Of the optimisation; the verification takes others.
    """

    kind: str = "path_power"
    paths: str = "ghost"
    fields_deg: tuple[float, ...] | None = None
    wavelength_nm: tuple[float, ...] | None = None
    weights: tuple[float, ...] | None = None
    rays: int = 10_000
    max_reflections: int = 2
    flux_threshold: float = 0.0
    seed: int = 0

    def metric(self, scene: Any, selection: Any = None, **changes: Any) -> Metric:
        """The metric of a scene; `selection` instead of `paths`, `changes` instead of some of the settings."""
        settings = {
            "fields_deg": self.fields_deg,
            "wavelength_nm": self.wavelength_nm,
            "weights": self.weights,
            "rays": self.rays,
            "max_reflections": self.max_reflections,
            "flux_threshold": self.flux_threshold,
            "seed": self.seed,
            **changes,
        }
        return METRICS[self.kind](scene, self.paths if selection is None else selection, **settings)


@dataclass(frozen=True)
class CoatingGroup:
    """
    One of the sections ``[[coating]]``: a design that some surfaces share.

    Attributes
    ----------
    name : str
        Id of the coating in the scene.
    surfaces : tuple of str or None
        Ids of shapes; None: every transparent optical surface in air.
    start : Stack
        Design to start from.
    bounds_nm : tuple of (float, float)
        Smallest and largest thickness of each layer, nm.
    design_nm : float
        Wavelength at which the start design was made, nm.
    """

    name: str
    surfaces: tuple[str, ...] | None
    start: Stack
    bounds_nm: tuple[tuple[float, float], ...]
    design_nm: float = 550.0


@dataclass(frozen=True)
class Optimizer:
    """
    Section ``[optimizer]``.

    Attributes
    ----------
    steps : int
        Most steps of the search from each start.
    tolerance : float
        A search ends after two steps that each lower the metric by less than this, relative.
    starts : int
        Number of start designs that are traced, the given one included; 1 … 100.
    searches : int
        From so many of them, the best ones, a search begins; 1 … 100.
    """

    steps: int = 40
    tolerance: float = 1e-3
    starts: int = 4
    searches: int = 1


@dataclass(frozen=True)
class Study:
    """
    A study.

    Attributes
    ----------
    name : str
        File or other name, for messages.
    metric : MetricStudy
    coatings : tuple of CoatingGroup
    optimizer : Optimizer
    """

    name: str
    metric: MetricStudy
    coatings: tuple[CoatingGroup, ...]
    optimizer: Optimizer = Optimizer()

    @property
    def fingerprint(self) -> str:
        """Hash of what must agree for a search to go on: all but its length."""
        content = {**asdict(self), "name": None}
        for key in ("steps", "searches", "tolerance"):  # a search may go on with others
            content["optimizer"].pop(key)
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

"""Requests for a sensitivity analysis: metric, parameters, and length of the printed lists."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

from mistray.errors import MistrayError
from mistray.light import Light
from mistray.ranges import (
    CONE_DEG,
    EDGE_WIDTH,
    FACTOR,
    FIELD_DEG,
    FLAG,
    POLAR_DEG,
    POSITIVE,
    ROWS,
    SEED,
    TEXT,
    ByName,
    Each,
    Interval,
    Several,
    Words,
)
from mistray.settings import Settings
from mistray.toolkit.field_options import flag
from mistray.toolkit.fields import FieldSubset, Request, field

PATHS = ("path_power", "ghost_to_signal", "peak_irradiance", "ghost_rms_irradiance", "ghost_focus")
METRICS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(PATHS, ("paths", "field_deg")),
    "rms_spot": ("field_deg",),
    "transmission": ("field_deg",),
    "relative_illumination": ("field_deg",),
    "pst_bin": ("field_deg", "light"),
    "pst_band": ("band_deg", "light"),
    "veiling_glare": ("patch_deg",),
}
"""Metrics and the arguments that they take; some need the first."""
NEED_FIRST = ("relative_illumination", "pst_bin", "pst_band", "veiling_glare")
OWN = ("paths", "field_deg", "band_deg", "patch_deg", "light")
KINDS = ("coating", "share", "scatter", "curvature", "conic", "asphere", "rim", "position", "tilt", "index", "source")


@dataclass(frozen=True)
class MetricRequest(Request):
    """Request for a metric: its name, arguments and light."""

    metric: str = field(Words(tuple(METRICS)), "path_power", ", ".join(METRICS), metavar="NAME")
    paths: str | None = field(
        TEXT,
        None,
        "of path_power and the like: ghost, stray …, a name as 'L2_rear -> L1_front', all events of a path, or a "
        "filter (docs/rays.md); without it ghost",
        metavar="PATHS",
    )
    field_deg: tuple[float, ...] | None = field(
        Each(FIELD_DEG),
        None,
        "field angles, averaged, degrees; without them the source's own; of pst_bin one, that of the PST",
    )
    band_deg: tuple[float, float] | None = field(Interval(POLAR_DEG), None, "of pst_band: its ends, degrees")
    patch_deg: float | None = field(CONE_DEG, None, "of veiling_glare: half-width of the black patch, degrees")
    light: str | None = field(
        TEXT, None, "of a PST: stray, ghost, single_scatter, total …; without it stray", metavar="CLASS"
    )
    spectrum: Mapping[str, Any] = field(FieldSubset(Light, ("wavelength_nm", "weights")), None, "light of the metric")
    settings: Mapping[str, Any] = field(FieldSubset.but(Settings), None, "settings of the traces")

    def __post_init__(self) -> None:
        super().__post_init__()
        allowed = METRICS[self.metric]
        wrong = next((name for name in OWN if name not in allowed and getattr(self, name) is not None), None)
        if wrong is not None:
            takes = " and ".join(map(flag, allowed))
            raise MistrayError(f"{flag(wrong)} is not about the metric {self.metric}; it takes {takes}")
        if self.metric in NEED_FIRST and getattr(self, allowed[0]) is None:
            raise MistrayError(f"the metric {self.metric} needs {flag(allowed[0])}")
        if self.metric == "pst_bin" and len(self.field_deg or ()) > 1:
            raise MistrayError("the metric pst_bin is about one field angle; give one --field-deg")

    @property
    def keywords(self) -> dict[str, Any]:
        """Arguments for the function that makes the metric."""
        low, high = self.band_deg or (None, None)
        at = self.field_deg[0] if self.metric == "pst_bin" and self.field_deg else self.field_deg
        own = {"selection": self.paths, "field_deg": at, "low_deg": low, "high_deg": high}
        own |= {"patch_deg": self.patch_deg, "light": self.light}
        return {name: value for name, value in own.items() if value is not None} | {**self.spectrum, **self.settings}


@dataclass(frozen=True)
class SensitivityRequest(Request):
    """Request for a sensitivity analysis: parameters, tolerances and changes."""

    keys: tuple[str, ...] | None = field(
        Several(TEXT, least=0),
        None,
        "keys or patterns such as 'vane_*.r0'; without them all that have a derivative",
        option="--parameter",
        metavar="KEY",
    )
    _: KW_ONLY
    tolerances: Mapping[str, float] | None = field(
        ByName(POSITIVE, "L*_front.x=0.02"),
        None,
        "tolerances by key or pattern in the unit of the parameter, later ones win; without them the usual ones",
        option="--tolerance",
        metavar="KEY=VALUE",
    )
    together: tuple[str, ...] = field(
        Several(TEXT, least=0),
        (),
        "patterns of parameters that vary together, by one tolerance in the same sense, and count as one: a symmetric "
        "group, or a property of one batch",
        metavar="KEY",
    )
    factor: float = field(FACTOR, 10.0, "how much lower the metric shall be")
    change: tuple[str, ...] | None = field(
        Several(TEXT, least=0),
        None,
        "what may be changed to lower the metric; without it coatings, scatter and structure, not the optics",
        metavar="KEY",
    )
    reach: float = field(
        POSITIVE, 10.0, "largest change that is proposed, in tolerances; R and T alone have none", metavar="N"
    )
    check: bool = field(FLAG, True, "trace the changes that are proposed, on other seeds")
    monte_carlo: int = field(ROWS, 0, "number of perturbed systems to trace, at least 2; 0: none")
    seed: int = field(SEED, 0, "seed of the perturbations")
    edges: bool = field(FLAG, True, "count what rays gain and lose at rims")
    edge_width: float | None = field(
        EDGE_WIDTH,
        None,
        "width of the zone at a rim in which rays count, over its radius; without it that of the least error",
        metavar="W",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.monte_carlo == 1:
            raise MistrayError("monte_carlo is 1; give the number of perturbed systems, at least 2, or 0")


@dataclass(frozen=True)
class SensitivityList(Request):
    """Choice of the printed table: kinds of parameters, and number of rows."""

    kind: tuple[str, ...] | None = field(
        Several(Words(KINDS)), None, f"only these kinds: {', '.join(KINDS)}", metavar="KIND"
    )
    top: int = field(ROWS, 20, "rows of the table")

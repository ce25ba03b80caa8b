"""Requests for sweeps: over fields and wavelengths, of PSTs before and after edits, and for a ranking of edits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, MISSING, dataclass
from typing import Any

from mistray.analyses.pst.request import PstRequest
from mistray.errors import MistrayError
from mistray.light import Light
from mistray.ranges import (
    AZIMUTH_DEG,
    EDGE_WIDTH,
    FIELD_DEG,
    FINITE,
    FLAG,
    PST_FIELD_DEG,
    RELATIVE_ERROR,
    TEXT,
    ByName,
    Demand,
    Each,
    Several,
)
from mistray.settings import Settings
from mistray.toolkit.fields import FieldSubset, Request, field


class Step(Demand):
    """Parameter check for a step of an edit: a number in the parameter's unit, or a percentage as text."""

    demand = "must be a number, or per cent as text, '2 %'"
    also = ({"type": "number"}, {"type": "string", "minLength": 1})

    def check(self, name: str, value: Any, owner: str = "") -> Any:
        """Return the step; raise `MistrayError` if it is neither a finite number nor a string that is not empty."""
        return value if isinstance(value, str) and value else FINITE.check(name, value, owner)


@dataclass(frozen=True)
class SweepRequest(Request):
    """Request for a sweep: field angles and light of its traces, and their settings."""

    field_deg: tuple[float, ...] | None = field(
        Each(FIELD_DEG), None, "field angles, degrees; without them that of the scene's source"
    )
    light: Mapping[str, Any] = field(FieldSubset(Light, ("azimuth_deg", "wavelength_nm")), None, "light of the sweep")
    settings: Mapping[str, Any] = field(FieldSubset.but(Settings), None, "settings of the trace of each row")


@dataclass(frozen=True)
class EditsRequest(PstRequest):
    """Request for a comparison of point source transmittances (PSTs) before and after edits."""

    field_deg: tuple[float, ...] = field(
        Each(PST_FIELD_DEG),
        range(0, 81, 10),
        "field angles of the PSTs, degrees",
        option="--pst-field-deg",
    )
    _: KW_ONLY
    relative_error: float | None = field(RELATIVE_ERROR, None, "refused: it would give the runs different rays")
    next_order: bool = field(FLAG, False, "refused: it would give the runs different limits")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.next_order:
            raise MistrayError("next_order would give the runs different limits; give these instead")
        if self.relative_error is not None:
            raise MistrayError("relative_error would give the runs different rays; give rays instead")


@dataclass(frozen=True)
class RankingRequest(Request):
    """Request for a ranking of edits by the effect of one step of each on the PST."""

    field_deg: tuple[float, ...] = field(
        Each(PST_FIELD_DEG), MISSING, "field angles of the PST, degrees", option="--pst-field-deg"
    )
    light: tuple[str, ...] = field(
        Several(TEXT),
        "stray",
        "stray, total or classes of light, see `mistray.optimize.PstObservation`",
        metavar="CLASS",
    )
    _: KW_ONLY
    steps: Mapping[str, float | str] | None = field(
        ByName(Step(), "rim=0.5 or paint.reflectance=2%"),
        None,
        "of --rank: steps by kind, key or pattern, such as rim=0.5 or paint.reflectance=2%. Kinds with their usual "
        "steps are position, tilt, rim (0.1 mm or deg), scatter, share (1%) and coating (1 nm)",
        option="--step",
        metavar="KEY=STEP",
    )
    keys: tuple[str, ...] | None = field(
        Several(TEXT), None, 'keys or patterns such as "vane_*.r0"; without them all that can be edited', metavar="KEY"
    )
    edge_width: float | None = field(
        EDGE_WIDTH, None, "width of the zone at a rim, over its radius; without it each field angle has its own"
    )
    azimuth_deg: float | None = field(AZIMUTH_DEG, None, "azimuth of the PST, degrees; without it the mean over all")
    spectrum: Mapping[str, Any] = field(
        FieldSubset(Light, ("wavelength_nm", "weights", "detector")), None, "light and detector"
    )
    pst: Mapping[str, Any] = field(
        FieldSubset(PstRequest, ("method", "convention", "azimuths_deg", "cell_deg", "azimuth_cell_deg", "rays")),
        None,
        "directions and rays of the PST",
    )
    settings: Mapping[str, Any] = field(FieldSubset.but(Settings, "rays"), None, "settings of the trace")


@dataclass(frozen=True)
class SweepChoice(Request):
    """Options of `mistray sweep` alone: comparison of PSTs instead of fields, and a configuration by options."""

    pst_field_deg: tuple[float, ...] | None = field(
        Each(PST_FIELD_DEG),
        None,
        "instead of fields: the PST at these field angles, degrees, before and after what each configuration moves, "
        "paints, coats or blocks",
    )
    rank: bool = field(
        FLAG,
        False,
        "with --pst-field-deg: rank what can be moved, blocked, painted and coated by the derivatives of the stray "
        "PST; STUDY may be left out",
    )
    set: Mapping[str, float] | None = field(
        ByName(FINITE, "hood.z=-5"),
        None,
        "values of parameters, 'hood.z=-5' (a shift), 'L1_front.bsdf.R=0.01': keys, groups or patterns, in the unit of "
        "the parameter",
        metavar="KEY=VALUE",
    )

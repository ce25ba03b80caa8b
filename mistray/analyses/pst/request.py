"""Requests for a point source transmittance (PST): directions, light, rays, and choice of pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

from mistray.errors import MistrayError
from mistray.light import Light
from mistray.ranges import (
    AZIMUTH_DEG,
    AZIMUTH_WIDTH_DEG,
    CELL_WIDTH_DEG,
    FLAG,
    PIXELS,
    PIXELS_OR_NONE,
    POLAR_DEG,
    PST_FIELD_DEG,
    RAYS,
    RELATIVE_ERROR,
    ROWS,
    ByName,
    Each,
    Words,
)
from mistray.settings import Settings
from mistray.toolkit.fields import FieldSubset, Request, field

USUAL_RAYS = {"joined": 4_000_000, "adjoint": 4_000_000, "forward": 200_000}  # forward: at each angle
MOST_RAYS = 2_000_000_000  # limit of a call that requests an error, or has a time, and sets no limit of rays
CONVENTIONS = ("normal", "projected")


@dataclass(frozen=True)
class PstRequest(Request):
    """Request for a point source transmittance (PST): directions, light and rays."""

    field_deg: tuple[float, ...] = field(
        Each(PST_FIELD_DEG),
        range(0, 81, 2),
        "field angles, degrees, ascending, each the middle of a cell over which the PST is averaged; negative ones are "
        "at the opposite azimuth",
    )
    _: KW_ONLY
    method: str = field(
        Words(tuple(USUAL_RAYS)),
        "joined",
        "both directions at once, rays from the detector alone, or beams of each angle",
    )
    convention: str = field(Words(CONVENTIONS), "normal", "E_det/E_⊥ across the beam, or E_det/(E_⊥ cos θ)")
    azimuths_deg: tuple[float, ...] | None = field(
        Each(AZIMUTH_DEG), None, "azimuths of a map, degrees, from +y towards -x; without them the mean over all"
    )
    cell_deg: float | None = field(
        CELL_WIDTH_DEG, None, "width of the cells of field angle, degrees; without it 2, or the distance of two angles"
    )
    azimuth_cell_deg: float | None = field(
        AZIMUTH_WIDTH_DEG, None, "and of azimuth, degrees; without it the distance of two azimuths"
    )
    light: Mapping[str, Any] = field(
        FieldSubset(Light, ("wavelength_nm", "weights", "detector")), None, "light and detector"
    )
    rays: int | None = field(
        RAYS,
        None,
        "start rays in all, or for each angle (forward), with a relative error the most; without it 4e6, forward 2e5",
    )
    relative_error: float | None = field(
        RELATIVE_ERROR,
        None,
        "standard error over the PST at every angle, for which a pilot estimates the rays",
        metavar="E",
    )
    error_up_to_deg: float | None = field(
        POLAR_DEG,
        None,
        "largest field angle at which that error is required, degrees",
        option="--up-to-deg",
        needs="relative_error",
    )
    paths: bool = field(FLAG, True, "keep the strongest paths of each angle")
    map_pixels: int = field(PIXELS_OR_NONE, 0, "longer side of maps of the detector for each angle, pixels; 0: none")
    next_order: bool = field(
        FLAG,
        False,
        "measure the PST again with one more scatter event and, apart from that, with one more reflection, see "
        "`Pst.next_orders`. These have together as many rays as the first. If the stray light at some angle changes by "
        "more than 5 % and two errors, the result is the PST with that limit",
    )
    settings: Mapping[str, Any] = field(FieldSubset.but(Settings, "rays"), None, "settings of the trace")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.method == "adjoint" and self.relative_error is not None:  # the pilot needs both directions
            raise MistrayError(
                "relative_error is given with method 'adjoint', which has no pilot that says how many rays it takes; "
                "use 'joined', or give rays"
            )
        if self.method == "forward" and self.error_up_to_deg is not None and self.relative_error is None:
            raise MistrayError(
                "error_up_to_deg is given without relative_error; give the relative error that is requested"
            )

    def settings_for(self, scene: Any) -> Settings:
        """Return the trace settings for a scene: number of start rays, limits of paths, thresholds and seed."""
        usual = USUAL_RAYS[self.method] if self.relative_error is None else MOST_RAYS
        return Settings.without_sources(scene, "a PST", rays=usual if self.rays is None else self.rays, **self.settings)


@dataclass(frozen=True)
class FirstLevelRequest(PstRequest):
    """Request for a first-level analysis: one point source transmittance (PST) for each set of limits on its paths."""

    _: KW_ONLY
    limits: Mapping[str, Mapping[str, Any]] | None = field(
        ByName(FieldSubset.but(Settings), "{'no ghosts': {'max_reflections': 0}}"),
        None,
        "sets: name → limits of a trace that it changes; without it `LIMITS`. A limit that is given beside it holds "
        "where a set does not change it",
    )
    next_order: bool = field(FLAG, False, "refused: it would change the limits of the sets")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.limits == {}:
            raise MistrayError("limits is empty; give at least one set of limits")
        if self.next_order:
            raise MistrayError("next_order would change the limits of the sets; give another set of limits instead")


@dataclass(frozen=True)
class PstShown(Request):
    """Choice of the paths and maps that text and pages show of a PST."""

    paths_shown: int = field(ROWS, 4, "strongest stray paths of each angle; 0: no paths")
    map_field_deg: tuple[float, ...] | None = field(
        Each(PST_FIELD_DEG), None, "field angles of irradiance maps of the detector, degrees (need --out)"
    )
    map_azimuth_deg: float | None = field(
        AZIMUTH_DEG, None, "their azimuth, degrees; without it the first one", needs="map_field_deg"
    )
    map_pixels: int = field(PIXELS, 64, "pixels along their longer side", needs="map_field_deg")

    def maps_at(self, request: PstRequest) -> list[tuple[float, float]]:
        """
        Return the field angle and azimuth, degrees, of each irradiance map of the detector.

        A negative field angle becomes a positive one at the opposite azimuth.
        """
        azimuth = (request.azimuths_deg or (0.0,))[0] if self.map_azimuth_deg is None else self.map_azimuth_deg
        angles = dict.fromkeys(self.map_field_deg or ())
        return [(angle, azimuth) if angle >= 0 else (-angle, azimuth + 180) for angle in angles]

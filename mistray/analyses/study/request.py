"""Request for a stray-light study: its angles, light and rays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

from mistray.light import Light
from mistray.ranges import FIELD_DEG, FLAG, PST_FIELD_DEG, RAYS, RELATIVE_ERROR, Each, Words
from mistray.settings import Settings
from mistray.toolkit.fields import FieldSubset, Request, field


@dataclass(frozen=True)
class StudyRequest(Request):
    """Request for a stray-light study: angles, light and rays."""

    pst_field_deg: tuple[float, ...] = field(
        Each(PST_FIELD_DEG), range(0, 81, 2), "field angles of the PST, numbers and ranges first:last:step, degrees"
    )
    field_deg: tuple[float, ...] | None = field(
        Each(FIELD_DEG),
        None,
        "field angles of the ghosts, degrees; without them 0, 1/2, 1 and 5/4 of the half field",
    )
    _: KW_ONLY
    rays: int | None = field(
        RAYS,
        None,
        "start rays of the PST; objects get a fifth at each angle, ghosts a tenth and images of points a fiftieth at "
        "each field; without it 1e6, quick 1e5",
    )
    quick: bool = field(FLAG, False, "fewer rays, for a first look")
    relative_error: float | None = field(
        RELATIVE_ERROR,
        None,
        "go on until the standard error over the PST is below this at every angle, with `rays` as a limit",
        metavar="E",
    )
    convention: str = field(
        Words(("normal", "projected")), "normal", "PST as E_det/E_⊥ across the beam, or E_det/(E_⊥ cos θ)"
    )
    light: Mapping[str, Any] = field(
        FieldSubset(Light, ("azimuth_deg", "wavelength_nm", "weights")), None, "light of the study"
    )
    next_order: bool = field(
        FLAG, True, "measure the PST again with one more scatter event and one more reflection on each path"
    )
    settings: Mapping[str, Any] = field(FieldSubset.but(Settings, "rays"), None, "settings of the traces")

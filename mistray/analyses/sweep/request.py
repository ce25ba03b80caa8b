"""Requests of sweeps: fields and light, and edits that the command compares by their PST."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mistray.light import Light
from mistray.ranges import FIELD_DEG, FINITE, FLAG, PST_FIELD_DEG, TEXT, ByName, Each
from mistray.settings import Settings
from mistray.toolkit.fields import FieldSubset, Request, field


@dataclass(frozen=True)
class SweepRequest(Request):
    """Field angles and light of the traces of a sweep."""

    field_deg: tuple[float, ...] | None = field(
        Each(FIELD_DEG), None, "field angles, degrees; without them that of the scene's source"
    )
    light: Mapping[str, Any] = field(FieldSubset(Light, ("azimuth_deg", "wavelength_nm")), None, "light of the sweep")
    settings: Mapping[str, Any] = field(FieldSubset.but(Settings), None, "settings of the trace of each row")


@dataclass(frozen=True)
class EditsRequest(Request):
    """Edits of a scene that a command compares by their PST."""

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
    step: Mapping[str, str] | None = field(
        ByName(TEXT, "rim=0.5 or paint.reflectance=2%"),
        None,
        "of --rank: steps by kind, key or pattern, such as rim=0.5 or paint.reflectance=2%. Kinds with their usual "
        "steps are position, tilt, rim (0.1 mm or deg), scatter, share (1%) and coating (1 nm)",
        metavar="KEY=STEP",
    )
    set: Mapping[str, float] | None = field(
        ByName(FINITE, "hood.z=-5"),
        None,
        "values of parameters, 'hood.z=-5' (a shift), 'L1_front.bsdf.R=0.01': keys, groups or patterns, in the unit of "
        "the parameter",
        metavar="KEY=VALUE",
    )

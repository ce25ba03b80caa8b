"""Request for the live explorer: initial light, controls, and settings of its traces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

from mistray.ranges import FIELD_DEG, LIVE_RAYS, TEXT, WAVELENGTH_NM, Each, Several
from mistray.settings import Settings
from mistray.toolkit.fields import FieldSubset, Request, field

SCENE_FILE, STUDY_FILE = "explored_scene.xml", "explored_study.toml"  # that it saves


@dataclass(frozen=True)
class ExplorerRequest(Request):
    """Initial light of a live explorer, the numbers that its controls vary, and settings of its traces."""

    field_deg: tuple[float, ...] | None = field(
        Each(FIELD_DEG),
        None,
        "field angles that are traced ahead, degrees; the first is the one to start with; without them that of the "
        "scene, 0, 5, 10, 15, 20 and 25",
    )
    wavelength_nm: float | None = field(
        WAVELENGTH_NM, None, "wavelength to start with, nm; without it as the scene says"
    )
    control: Sequence[str] | None = field(
        Several(TEXT, 0),
        None,
        "numbers to turn, by keys or patterns such as 'vane_*.r1' (docs/parameters.md), instead of those that are "
        "chosen by themselves",
        metavar="KEY",
    )
    rays: int | None = field(
        LIVE_RAYS, None, "start rays of every trace; without them as many as take a second, at most 20 000"
    )
    _: KW_ONLY
    settings: Mapping[str, Any] = field(FieldSubset.but(Settings, "rays"), None, "settings of the traces")

"""What makes no sense of a random scene: each change must be refused, in one clear line."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from random_scenes import Scene


def _replace(old: str, new: str) -> Callable[[Scene], None]:
    """Replaces some text of the XML, which must be there."""

    def change(made: Scene) -> None:
        if old not in made.text:
            raise ValueError(f"scene {made.number} has no {old!r}")
        made.text = made.text.replace(old, new, 1)

    return change


def _setting(key: str, value: Any) -> Callable[[Scene], None]:
    """Sets an argument of the trace."""

    def change(made: Scene) -> None:
        made.settings[key] = value

    return change


NONSENSE: dict[str, Callable[[Scene], None]] = {
    "no detector": _replace("irradiancemeter", "thin"),
    "no source": _replace('<emitter type="collimated">', '<emitter type="constant">'),
    "ids": _replace('id="detector"', 'id="L0_0"'),
    "more than all": _replace('id="detector">', 'id="detector"><float name="R" value="1.5"/>'),
    "a beam of nothing": _replace('name="irradiance" value="', 'name="irradiance" value="-'),
    "a beam away": _replace('<emitter type="collimated">', '<emitter type="collimated"><transform name="to_world">'
                            '<translate x="1e7"/></transform>'),
    "a size of nothing": _replace('name="semi_diameter" value="', 'name="semi_diameter" value="-'),
    "a number that is none": _replace('name="semi_diameter" value="', 'name="semi_diameter" value="nan'),
    "beyond the conic": _replace('name="semi_diameter" value="', 'name="curvature" value="1e9"/><float '
                                 'name="semi_diameter" value="'),
    "wavelength": _setting("wavelength_nm", -550.0),
    "no wavelength": _setting("wavelength_nm", float("nan")),
    "rays": _setting("rays", 0),
    "reflections": _setting("max_reflections", -1),
    "threshold": _setting("flux_threshold", float("nan")),
    "events": _setting("max_events", 1001),
    "field": _setting("field_deg", 90.0),
}  # fmt: skip

"""What makes no sense of a random scene: each change must be refused, in one clear line."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from random_scenes import Scene


def _change(old: str = "", new: str = "", **settings: Any) -> Callable[[Scene], None]:
    """Replaces some text of the XML, which must be there, and sets arguments of the trace."""

    def change(made: Scene) -> None:
        if old not in made.text:
            raise ValueError(f"scene {made.number} has no {old!r}")
        made.text = made.text.replace(old, new, 1)
        made.settings.update(settings)

    return change


NONSENSE: dict[str, Callable[[Scene], None]] = {
    "no detector": _change("irradiancemeter", "thin"),
    "no source": _change('<emitter type="collimated">', '<emitter type="constant">'),
    "ids": _change('id="detector"', 'id="L0_0"'),
    "more than all": _change('id="detector">', 'id="detector"><float name="R" value="1.5"/>'),
    "a beam of nothing": _change('name="irradiance" value="', 'name="irradiance" value="-'),
    "a beam away": _change('<emitter type="collimated">', '<emitter type="collimated"><transform name="to_world">'
                            '<translate x="1e7"/></transform>'),
    "a size of nothing": _change('name="semi_diameter" value="', 'name="semi_diameter" value="-'),
    "a number that is none": _change('name="semi_diameter" value="', 'name="semi_diameter" value="nan'),
    "beyond the conic": _change('name="semi_diameter" value="', 'name="curvature" value="1e9"/><float '
                                 'name="semi_diameter" value="'),
    "wavelength": _change(wavelength_nm=-550.0),
    "no wavelength": _change(wavelength_nm=float("nan")),
    "rays": _change(rays=0),
    "reflections": _change(max_reflections=-1),
    "threshold": _change(flux_threshold=float("nan")),
    "events": _change(max_events=1001),
    "field": _change(field_deg=90.0),
}  # fmt: skip

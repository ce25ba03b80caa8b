"""Error messages for Mitsuba BSDFs that a trace does not support: their name, and a plugin to use instead."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

_NEST = "nest an 'interface' in it"
_LOAD = "load the scene by mistray.load"
_ROUGH = f"{_NEST}, with a 'harvey_shack' or 'k_correlation' of its roughness"
_PAINT = f"{_NEST}, with a 'paint' of b0, l, s and n"
# By the name that Mitsuba prints: name of the plugin, and remedy
_KNOWN: Mapping[str, tuple[str, str]] = {
    "SmoothDiffuse": ("diffuse", f"{_LOAD}, with a reflectance that is one number, or {_NEST}, with a 'paint'"),
    "SmoothDielectric": ("dielectric", f"{_LOAD}, without specular factors, or {_NEST}, with front and back"),
    "SmoothConductor": (
        "conductor",
        f"{_LOAD}, with eta and k of a metal as numbers or tables, or {_NEST}, with a metal such as 'Au' in front",
    ),
    "ThinDielectric": ("thindielectric", "draw both faces of the plate, each with an 'interface'"),
    "SmoothPlastic": ("plastic", _PAINT),
    "RoughPlastic": ("roughplastic", _PAINT),
    "RoughConductor": ("roughconductor", _ROUGH),
    "RoughDielectric": ("roughdielectric", _ROUGH),
    "Principled BSDF": ("principled", _PAINT),
    "The Thin Principled BSDF": ("principledthin", _PAINT),
    "Measured": ("measured", f"{_NEST}, with a 'tabulated'"),
    "Null": ("null", "take the shape out: an 'interface' names the media on both of its sides"),
}
_INSIDE = re.compile(r"TwoSided\[\s*brdf\[0\] = (.*)", re.DOTALL)


def remedy(bsdf: Any) -> str:
    """
    Return the name of a BSDF that is not an interface, and what to write instead, in one line.

    Parameters
    ----------
    bsdf : mi.BSDF or None
        BSDF of a shape.
    """
    text = str(bsdf)
    inside = _INSIDE.match(text)
    printed = (inside[1] if inside else text).split("[")[0].splitlines()[0].removesuffix(" :").strip()
    name, advice = _KNOWN.get(printed, (printed, _NEST))
    return f"'{name}'{' (twosided)' if inside else ''}, which the ray tree cannot split; {advice}"

"""Parts of scenes as dicts: places on the axis, films, black detectors."""

from typing import Any

import mitsuba as mi

import mistray

BLACK: dict[str, Any] = {"type": "interface", "R": 0.0}


def at(z: float) -> Any:
    return mi.ScalarTransform4d().translate([0, 0, z])


def film(width: int = 8, height: int | None = None, **more: Any) -> dict[str, Any]:
    size = {"width": width, "height": width if height is None else height}
    return {"type": "hdrfilm", **size, "rfilter": {"type": "box"}, **more}


def meter(width: int = 8, height: int | None = None) -> dict[str, Any]:
    """What makes a shape the detector."""
    return {"type": "irradiancemeter", "film": film(width, height)}


def detector(z: float, **more: Any) -> dict[str, Any]:
    """A black plane at z, by default; its size is given."""
    return {"type": "asphere", "to_world": at(z), "bsdf": BLACK, "sensor": meter()} | more


def load(**parts: Any) -> mi.Scene:
    return mistray.load({"type": "scene", **parts})

"""Sensors added to a scene, such as probes, far fields and maps of walls, from a string or a dict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.named_values import named_values
from mistray.ranges import PLACE_MM
from mistray.scene.other_sources import given_dict, keyed, parsed

NORMAL = {"probe": "normal", "far_field": "axis"}  # kind → what the z axis of its frame is called
FRAME = ("normal", "axis", "up")  # directions, three numbers each
COUNTS = ("directions", "azimuths")
# Sensors of surfaces: kind → properties
OF_SURFACES = {"surface_maps": ("azimuths", "lengths", "id", "surfaces"), "flux_split": ("id", "surfaces")}
PARALLEL = 1e-6  # sine of the angle below which two directions are one


def sensor_dict(sensor: str | Mapping[str, Any]) -> dict[str, Any]:
    """
    Return a sensor as the dict of its plugin.

    Parameters
    ----------
    sensor : str or mapping
        A dict, or text with the properties of the plugin, as
        ``"probe:0,0,17,half_width=20,half_height=20,normal=0 0 -1,pixels=32 32,id=stop"`` or
        ``"far_field:edges_deg=90:180:5,azimuths=8,axis=0 0 1,id=sky"``. Lengths are in mm, pixels are counts across
        and down, and directions are in the world frame. A probe counts light that travels towards its normal.
        ``"surface_maps:barrel* hood,azimuths=72,id=walls"`` and ``"flux_split:L1_* hood,id=split"`` have patterns of
        surfaces and parts. Without one they mean all walls, and all surfaces.

    Raises
    ------
    MistrayError
        If the text is not understood, or the dict has no type.
    """
    if not isinstance(sensor, str):
        return given_dict("sensor", sensor, "probe:0,0,17")
    if sensor.partition(":")[0].strip() in OF_SURFACES:
        return _of_surfaces(sensor)
    word, place, found = parsed("sensor", sensor, (*FRAME, "pixels"), ("id", "edges_deg"))
    if word not in NORMAL:
        raise MistrayError(f"sensor '{sensor}': '{word}' is none; give {' or '.join(NORMAL)}")
    owner = f"{word.replace('_', ' ')} '{sensor.partition(':')[2]}'"
    if word == "probe" and not place:
        raise MistrayError(f"{owner}: its place is missing; give x,y,z of its middle in mm, then names=values")
    if word == "far_field":
        found["edges_deg"] = str(found.get("edges_deg", "0:180:2")).replace(" ", ",")
        if place:
            raise MistrayError(f"{owner}: it has no place; leave out x,y,z, the light leaves the whole scene")
    z = _numbers(found.pop(NORMAL[word], "0,0,1"), NORMAL[word], owner)
    up = found.pop("up", None)
    y = _numbers(up, "up", owner) if up else np.eye(3)[1 if abs(z[1]) < 0.9 * np.linalg.norm(z) else 2]
    across = np.cross(y, z)
    if not np.linalg.norm(across) > PARALLEL * np.linalg.norm(y) * np.linalg.norm(z):
        raise MistrayError(
            f"{owner}: {NORMAL[word]} {z.tolist()} and up {y.tolist()} are not two directions; change one"
        )
    frame = np.eye(4)
    frame[:3, 2], frame[:3, 0] = z / np.linalg.norm(z), across / np.linalg.norm(across)
    frame[:3, 1] = np.cross(frame[:3, 2], frame[:3, 0])
    frame[:3, 3] = PLACE_MM.check_each("place", place, owner) if place else 0.0
    pixels = found.pop("pixels", None)
    if pixels is not None:
        width, height = _whole(pixels, owner)
        found["film"] = {"type": "hdrfilm", "width": width, "height": height}
    for key in COUNTS:
        if key in found and float(found[key]).is_integer():
            found[key] = int(found[key])
    return {"type": word, **found, "to_world": mi.ScalarTransform4d(frame)}


def _of_surfaces(text: str) -> dict[str, Any]:
    """
    Return the dict of a plugin `surface_maps` or `flux_split` from the text of `sensor_dict`.

    Raise `MistrayError` for an unknown name or a count that is not whole.
    """
    kind, _, rest = text.partition(":")
    kind = kind.strip()
    owner, known = f"{kind.replace('_', ' ')} '{rest}'", OF_SURFACES[kind]
    parts = [part.strip() for part in rest.replace(" ", ",").split(",") if part.strip()]
    found: dict[str, Any] = dict(named_values([part for part in parts if "=" in part], owner, known))
    patterns = [part for part in parts if "=" not in part]
    for key in ("azimuths", "lengths"):
        if key in found:
            try:
                found[key] = int(found[key])
            except ValueError:
                raise MistrayError(f"{owner}: {key} is '{found[key]}'; give a whole number") from None
    if "surfaces" in found:
        patterns.append(found["surfaces"])
    return {"type": kind, "surfaces": " ".join(patterns)} | {key: v for key, v in found.items() if key != "surfaces"}


def _numbers(text: str, what: str, owner: str) -> np.ndarray:
    """
    Return the vector, (3,), of three numbers in a string, scaled so that the largest magnitude is 1.

    Raise `MistrayError` if it is not three finite numbers, or all are 0; `what` and `owner` are for its message.
    """
    try:
        numbers = np.array([float(part) for part in text.split(",") if part])
    except ValueError:
        numbers = np.zeros(0)
    if numbers.shape != (3,) or not np.all(np.isfinite(numbers)) or not numbers.any():
        raise MistrayError(f"{owner}: {what} is '{text.replace(',', ' ')}'; give three numbers such as 0 0 -1")
    return numbers / np.abs(numbers).max()


def _whole(text: str, owner: str) -> tuple[int, int]:
    """
    Return the numbers of pixels across and down in a string; a single number stands for both.

    Raise `MistrayError` if they are not whole numbers above 0; `owner` is for its message.
    """
    parts = [part for part in text.split(",") if part]
    if not 1 <= len(parts) <= 2 or not all(part.isdecimal() and int(part) for part in parts):
        raise MistrayError(
            f"{owner}: pixels is '{text.replace(',', ' ')}'; give one or two whole numbers such as 64 48"
        )
    return int(parts[0]), int(parts[-1])


def sensor_dicts(sensors: Sequence[str | Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the dicts of sensors keyed by id; raise `MistrayError` for the reasons of `sensor_dict` and `keyed`."""
    described = [sensor_dict(sensor) for sensor in sensors]
    return keyed("sensor", described, [one["type"] for one in described])

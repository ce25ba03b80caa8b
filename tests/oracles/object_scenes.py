"""XML texts of tubes, vanes and walls whose critical and illuminated objects are known."""

import math
from collections.abc import Sequence

from .scatter_scenes import beam_xml, placed_xml, scatter_scene, wall_xml


def common_area(distance: float, radius_1: float, radius_2: float) -> float:
    if distance >= radius_1 + radius_2:
        return 0.0
    if distance <= abs(radius_1 - radius_2):
        return math.pi * min(radius_1, radius_2) ** 2
    a = math.acos((distance**2 + radius_1**2 - radius_2**2) / (2 * distance * radius_1))
    b = math.acos((distance**2 + radius_2**2 - radius_1**2) / (2 * distance * radius_2))
    return radius_1**2 * (a - math.sin(2 * a) / 2) + radius_2**2 * (b - math.sin(2 * b) / 2)


def open_tube_text(length: float, radius: float, detector_radius: float, wall: str | None = None) -> str:
    return scatter_scene(
        beam_xml(radius),
        placed_xml("frustum", "wall", wall, r0=radius, z0=0.0, r1=radius, z1=length),
        placed_xml("asphere", "detector", at=(0.0, 0.0, length), pixels=8, semi_diameter=detector_radius),
    )


def vane_text(vanes: Sequence[tuple[float, float]], length: float, radius: float, detector_radius: float) -> str:
    rings = [placed_xml("frustum", f"vane_{k}", r0=radius, z0=z, r1=r, z1=z) for k, (z, r) in enumerate(vanes, start=1)]
    return open_tube_text(length, radius, detector_radius).replace("</scene>", "".join(rings) + "</scene>")


def painted_tube_text(length: float, radius: float, detector_radius: float, rho: float) -> str:
    return open_tube_text(length, radius, detector_radius, wall_xml(rho))

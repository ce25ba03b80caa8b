"""Shapes with the attributes of the shape plugins that the layout reads."""

from types import SimpleNamespace

import numpy as np


class FakeShape:
    def __init__(self, name, part, profile, z, front="air", back="air", opaque=False, mirror=False, sensor=False):
        self.name, self.part, self.matrix = name, part, np.eye(4)
        self.matrix[2, 3] = z
        points = np.asarray(profile, dtype=float)
        bsdf = SimpleNamespace(front=front, back=back, opaque=opaque, mirror=mirror)
        self.id, self.profile = lambda: name, lambda: points
        self.bsdf, self.is_sensor = lambda: bsdf, lambda: sensor


def _dome(curvature, radius):
    r = np.linspace(0, radius, 33)
    return np.column_stack([r, 0.5 * curvature * r**2])


def lens_scene():
    shapes = [
        FakeShape("window_front", "window", _dome(0, 1.2), 0.0, "air", "N-BK7"),
        FakeShape("window_rear", "window", _dome(0, 1.2), 0.3, "N-BK7", "air"),
        FakeShape("L1_front", "L1", _dome(0.5, 1.0), 0.8, "air", "nd=1.6 Vd=30"),
        FakeShape("L1_rear", "L1", _dome(-0.2, 1.0), 1.6, "nd=1.6 Vd=30", "air"),
        FakeShape("L1_edge", "L1", [[1.0, 1.05], [1.0, 1.5]], 0.0, "nd=1.6 Vd=30", "air", opaque=True),
        FakeShape("stop_wall", "stop", [[0.9, 0.5], [0.9, 0.6]], 0.0, opaque=True),
        FakeShape("barrel", "barrel", [[1.3, -0.5], [1.8, 5.2]], 0.0, opaque=True),
        FakeShape("detector", "detector", _dome(0, 1.5), 5.0, opaque=True, sensor=True),
    ]
    return SimpleNamespace(shapes=lambda: shapes)

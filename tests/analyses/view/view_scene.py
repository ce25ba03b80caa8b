"""A scene with the surfaces of the fake traces, of every kind of shape that is drawn, and rays through it."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
from analyses.fake_trace import PARTS, FakeTrace
from oracles.scatter_scenes import scatter_scene
from oracles.small_scenes import interface_xml, shape_xml

RADIUS, CONIC, A4 = 4.0, -0.5, 1e-3  # of L1_front
EXACT = 1e-9  # mm, of points on their surface
TILT = 30.0  # of L1_rear about y, degrees


def placed(kind, name, z, bsdf, **numbers):
    bsdf += f'<string name="part" value="{PARTS[name]}"/>'
    return shape_xml(kind, name, z, bsdf, sensor=name == "detector", **numbers)


BLACK = interface_xml(R=0.0)
FRONT = {"radius": RADIUS, "conic": CONIC, "a4": A4, "semi_diameter": 2.0}
SCENE = scatter_scene(
    placed("asphere", "window_front", 0.0, interface_xml("air", "1.5"), half_width=3.0, half_height=2.0),
    placed("asphere", "window_rear", 1.0, interface_xml("1.5"), radius=-20.0, half_width=3.0, half_height=2.0),
    placed("asphere", "L1_front", 3.0, interface_xml("air", "1.6"), x=0.3, **FRONT),
    placed("asphere", "L1_rear", 6.0, interface_xml("1.6"), radius=-9.0, semi_diameter=2.0, tilt_y=TILT),
    placed("frustum", "stop_wall", 8.0, BLACK, r0=3.0, z0=0.0, r1=2.0, z1=4.0),
    placed("asphere", "detector", 14.0, BLACK, half_width=2.0, half_height=1.5),
)


def tilted(axis_tilt_deg):
    c, s = np.cos(np.radians(axis_tilt_deg)), np.sin(np.radians(axis_tilt_deg))
    matrix = np.eye(4)
    matrix[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    return matrix


def asphere_error(points, x, z, radius, conic=0.0, a4=0.0):
    r2 = (points[:, 0] - x) ** 2 + points[:, 1] ** 2
    sag = (r2 / radius) / (1 + np.sqrt(1 - (1 + conic) * r2 / radius**2)) + a4 * r2**2
    return np.abs(points[:, 2] - z - sag)


# Distance of a point from the formula of its surface, written out anew
FORMULAS = {
    "window_front": lambda p: np.abs(p[:, 2]),
    "window_rear": lambda p: asphere_error(p, 0.0, 1.0, -20.0),
    "L1_front": lambda p: asphere_error(p, 0.3, 3.0, RADIUS, CONIC, A4),
    "L1_rear": lambda p: np.abs(np.linalg.norm(p - [0, 0, 6.0] - tilted(TILT)[:3, 2] * -9.0, axis=1) - 9.0),
    "stop_wall": lambda p: np.abs(np.hypot(p[:, 0], p[:, 1]) - (3.0 - (p[:, 2] - 8.0) / 4.0)),
    "detector": lambda p: np.abs(p[:, 2] - 14.0),
}


class RayTrace(FakeTrace):
    """A fake trace whose rays have all that the ray history table has."""

    def history(self, path_id, n=8):
        row = self.paths[path_id]
        nodes = len(row.event_list) + 1
        rays = [
            np.random.default_rng([path_id, number]).uniform((-2.0, -2.0, 4.0), (2.0, 2.0, 8.0), (nodes, 3))
            for number in range(n)
        ]

        def to_pandas():
            table = pd.DataFrame(np.concatenate(rays), columns=["x_mm", "y_mm", "z_mm"])
            table["surface"], table["intercept"] = zip(*(n * [("-", "Emitted"), *row.event_list]), strict=True)
            table["ray"] = np.repeat(np.arange(n), nodes)
            table["flux_W"] = row.power_W / n * np.tile(np.geomspace(1.0, 0.3, nodes), n)
            return table.assign(start_ray=100 * path_id + table.ray, wavelength_nm=row.wavelength_nm)

        return SimpleNamespace(rays=rays, to_pandas=to_pandas)

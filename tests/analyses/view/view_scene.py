"""A scene with the surfaces of the fake traces, of every kind of shape that is drawn, and rays through it."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
from analyses.fake_trace import PARTS, FakeTrace

RADIUS, CONIC, A4 = 4.0, -0.5, 1e-3  # of L1_front
EXACT = 1e-9  # mm, of points on their surface
TILT = 30.0  # of L1_rear about y, degrees


def mm(x=0.0, y=0.0, z=0.0):
    return f'<transform name="to_world"><translate x="{x}" y="{y}" z="{z}"/></transform>'


def glass(front, back):
    return f'<bsdf type="interface"><string name="front" value="{front}"/><string name="back" value="{back}"/></bsdf>'


def part(name):
    return f'<string name="part" value="{PARTS[name]}"/>'


BLACK = '<bsdf type="interface"><float name="R" value="0"/></bsdf>'
METER = (
    '<sensor type="irradiancemeter"><film type="hdrfilm"><integer name="width" value="8"/>'
    '<integer name="height" value="8"/><rfilter type="box"/></film></sensor>'
)
SCENE = f"""<scene version="3.0.0">
<shape type="asphere" id="window_front"><float name="half_width" value="3"/><float name="half_height" value="2"/>
{part("window_front")}{mm()}{glass("air", "1.5")}</shape>
<shape type="asphere" id="window_rear"><float name="radius" value="-20"/><float name="half_width" value="3"/>
<float name="half_height" value="2"/>{part("window_rear")}{mm(z=1.0)}{glass("1.5", "air")}</shape>
<shape type="asphere" id="L1_front"><float name="radius" value="{RADIUS}"/><float name="conic" value="{CONIC}"/>
<float name="a4" value="{A4}"/><float name="semi_diameter" value="2"/>
{part("L1_front")}{mm(x=0.3, z=3.0)}{glass("air", "1.6")}</shape>
<shape type="asphere" id="L1_rear"><float name="radius" value="-9"/><float name="semi_diameter" value="2"/>
<float name="tilt_y" value="{TILT}"/>{part("L1_rear")}{mm(z=6.0)}{glass("1.6", "air")}</shape>
<shape type="frustum" id="stop_wall"><float name="r0" value="3"/><float name="z0" value="0"/>
<float name="r1" value="2"/><float name="z1" value="4"/>{part("stop_wall")}{mm(z=8.0)}{BLACK}</shape>
<shape type="asphere" id="detector"><float name="half_width" value="2"/><float name="half_height" value="1.5"/>
{mm(z=14.0)}{BLACK}{METER}</shape>
</scene>"""


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

"""Targets of scattered rays on the device: a direction towards one, and the density of such directions."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.trace.targets import AimSet
from mistray.trace.upload import upload

VECTORS = 6  # of four floats for each target
DENSITY_VECTORS = 4  # the first of them, which say where a direction meets the target
SHARES = 19  # place of the sum of shares among them
# Shapes as the kernel knows them; of an ellipse it is the hole, 0 … 1
PARALLELOGRAM, TRIANGLE = -1.0, -2.0


class DeviceTargets:
    """
    The targets of some sets, one set after the other.

    Parameters
    ----------
    sets : sequence of AimSet
    """

    def __init__(self, sets: Sequence[AimSet]) -> None:
        rows = [row for aim in sets for row in _rows(aim)]
        self._values = upload(mi.Float, np.array(rows if rows else [np.zeros(4 * VECTORS)]))

    def _row(self, number: mi.UInt32, count: int, active: mi.Bool) -> list[mi.Vector4f]:
        return [dr.gather(mi.Vector4f, self._values, VECTORS * number + k, active) for k in range(count)]

    def sample(
        self, aims: mi.Vector2u, u: list[mi.Float], p: mi.Vector3f, active: mi.Bool
    ) -> tuple[mi.Vector3f, mi.UInt32]:
        """A direction to a point of a target, which is chosen by its share; and the number of that target."""

        def later(k: mi.UInt32) -> mi.Bool:
            upto = dr.gather(mi.Float, self._values, 4 * VECTORS * (aims.x + k) + SHARES, active)
            return active & (k + 1 < aims.y) & (u[3] >= upto)

        (k,) = dr.while_loop(
            (dr.zeros(mi.UInt32, dr.width(u[3])),), later, lambda k: (k + 1,), mode="symbolic", label="choose a target"
        )
        centre, _, _, normal, first, second = self._row(aims.x + k, VECTORS, active)
        hole = centre.w
        ellipse, triangle = hole >= 0, hole == TRIANGLE
        root = dr.sqrt(dr.select(ellipse, dr.lerp(hole * hole, 1, u[0]), u[0]))
        sine, cosine = dr.sincos(2 * dr.pi * u[1])
        a = dr.select(ellipse, root * cosine, dr.select(triangle, root * (1 - u[1]), 2 * u[0] - 1))
        b = dr.select(ellipse, root * sine, dr.select(triangle, root * u[1], 2 * u[1] - 1))
        point = centre.xyz + a * first.xyz + b * second.xyz
        return dr.normalize((point - p) * normal.w), k

    def density(
        self,
        aims: mi.Vector2u,
        p: mi.Vector3f,
        direction: mi.Vector3f,
        aim: mi.Bool,
        own: mi.UInt32,
        active: mi.Bool,
    ) -> mi.Float:
        """Density of the aimed rays in a direction, 1/sr; `own` is the target of a ray that was aimed."""

        def step(k: mi.UInt32, density: mi.Float) -> tuple[mi.UInt32, mi.Float]:
            going = active & (k < aims.y)
            centre, along, beside, normal = self._row(aims.x + k, DENSITY_VECTORS, going)
            cosine = dr.dot(direction, normal.xyz)
            t = dr.dot(centre.xyz - p, normal.xyz) / cosine
            q = dr.fma(t, direction, p) - centre.xyz
            a, b = dr.dot(q, along.xyz), dr.dot(q, beside.xyz)
            radius = dr.sqrt(dr.fma(a, a, b * b))
            ring = (radius <= 1) & (radius >= centre.w)
            box = (dr.abs(a) <= 1) & (dr.abs(b) <= 1)
            inside = (a >= 0) & (b >= 0) & (a + b <= 1)
            on = dr.select(centre.w >= 0, ring, dr.select(centre.w == TRIANGLE, inside, box))
            # A ray that was aimed at a small or distant target need not find it again: its direction is rounded
            here = going & ((on & (t * normal.w > 0)) | (aim & (k == own)))
            density += dr.select(here, beside.w * along.w * t * t / dr.abs(cosine), 0)
            return k + 1, density

        width = dr.width(direction)
        _, density = dr.while_loop(
            (dr.zeros(mi.UInt32, width), dr.zeros(mi.Float, width)),
            lambda k, density: active & (k < aims.y),
            step,
            mode="symbolic",
            label="density of targets",
        )
        return density


def _rows(aim: AimSet) -> list[np.ndarray]:
    """
    Targets as the kernel reads them.

    Centre, shape | dual of u, 1/area | dual of v, share | normal, -1 if reverse | u, sum of shares | v, 0.
    """
    rows, so_far = [], 0.0
    for target in aim.targets:
        so_far += target.share
        normal = np.cross(target.u, target.v)
        along, beside = np.cross(target.v, normal), np.cross(normal, target.u)
        along, beside = along / np.dot(along, target.u), beside / np.dot(beside, target.v)
        rows.append(
            np.concatenate(
                [
                    [
                        *target.centre,
                        {"parallelogram": PARALLELOGRAM, "triangle": TRIANGLE}.get(target.shape, target.hole),
                    ],
                    [*along, 1 / target.area],
                    [*beside, target.share],
                    [*target.normal, -1.0 if target.reverse else 1.0],
                    [*target.u, so_far],
                    [*target.v, 0.0],
                ]
            )
        )
    return rows

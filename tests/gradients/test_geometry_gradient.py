"""The chain from columns of surfaces to parameters of shapes, against points that the parameters move."""

from __future__ import annotations

from collections.abc import Callable

import mitsuba as mi
import numpy as np
import pytest

from mistray.gradients.geometry_gradient import (
    column_derivatives,
    geometry_columns,
    shape_parameters,
)
from mistray.surfaces.families.cone import Cone
from mistray.surfaces.gradient_columns import GEOMETRY
from mistray.surfaces.surfaces import SurfaceTable

BLACK = {"type": "interface", "R": 0.0}
ORDERS = range(4, 21, 2)
POSE = ("x", "y", "z", "tilt_x", "tilt_y", "tilt_z")
TOLERANCE = 1e-3  # of the issue, for geometry on frozen paths; the chain itself is far better than that


def random_asphere(rng: np.random.Generator, rectangular: bool, flat: bool) -> dict[str, float]:
    outer = float(rng.uniform(2, 8))
    values = {"type": "asphere", "curvature": 0.0 if flat else float(rng.uniform(-0.5, 0.5) / outer)}
    values["conic"] = float(rng.uniform(-2, 1))
    for order in () if flat else ORDERS:
        values[f"a{order}"] = float(rng.uniform(-1, 1) * 0.01 * outer ** (1 - order))
    if rectangular:
        return values | {"half_width": outer, "half_height": float(rng.uniform(0.2, 0.9)) * outer}
    return values | {"semi_diameter": outer, "inner_semi_diameter": float(rng.uniform(0.1, 0.5)) * outer}


def random_frustum(rng: np.random.Generator, kind: str) -> dict[str, float]:
    r0, r1, z0, z1 = rng.uniform([2, 5, -3, 1], [4, 9, -1, 6])
    if kind == "backward":
        z0, z1 = z1, z0
    if kind == "inwards":
        r0, r1 = r1, r0
    if kind == "tip":
        r0 = 0.0
    if kind == "cylinder":
        r1 = r0
    if kind.endswith("annulus"):
        z1 = z0
    if kind == "outward annulus":
        r0, r1 = r1, r0
    return {"type": "frustum", "r0": float(r0), "z0": float(z0), "r1": float(r1), "z1": float(z1)}


KINDS: dict[str, Callable[[np.random.Generator], dict[str, float]]] = {
    "round": lambda rng: random_asphere(rng, False, False),
    "flat": lambda rng: random_asphere(rng, False, True),
    "rectangle": lambda rng: random_asphere(rng, True, False),
    **{
        kind: lambda rng, kind=kind: random_frustum(rng, kind)
        for kind in ("cone", "backward", "inwards", "tip", "cylinder", "annulus", "outward annulus")
    },
}


def random_shape(kind: str, seed: int) -> mi.Shape:
    """A shape of a kind with a random frame, displacement and tilt."""
    rng = np.random.default_rng(seed)
    values = KINDS[kind](rng)
    for name, size in zip(POSE, (0.3, 0.3, 0.3, 5, 5, 90), strict=True):
        values[name] = float(rng.uniform(-size, size))
    frame = mi.ScalarTransform4d().translate(rng.uniform(-20, 20, 3).tolist())
    axis = rng.normal(size=3)
    frame = frame.rotate((axis / np.linalg.norm(axis)).tolist(), float(rng.uniform(0, 180)))
    return mi.load_dict({**values, "to_world": frame, "bsdf": BLACK})


def to_world(shape: mi.Shape, values: dict[str, float], q: np.ndarray) -> np.ndarray:
    """Points of the shape's frame in the world, by Mitsuba's own transforms."""
    frame = mi.ScalarTransform4d(shape.base).translate([values[axis] for axis in "xyz"])
    for k, axis in enumerate("xyz"):
        frame = frame.rotate(np.eye(3)[k].tolist(), values[f"tilt_{axis}"])
    matrix = np.array(frame.matrix)
    return q @ matrix[:3, :3].T + matrix[:3, 3]


def sag(r2: np.ndarray, curvature: float, conic: float, coefficients: list[float]) -> np.ndarray:
    total = curvature * r2 / (1 + np.sqrt(1 - (1 + conic) * curvature**2 * r2))
    return total + sum(a * r2 ** (order // 2) for order, a in zip(ORDERS, coefficients, strict=True))


def by_parameters(shape: mi.Shape, u: np.ndarray, phi: np.ndarray) -> Callable[[dict[str, float]], np.ndarray]:
    """Points of the surface at places u (0 … 1) of the generatrix or of the rectangle, as a function of parameters."""
    fixed = dict(shape.values)

    def points(values: dict[str, float]) -> np.ndarray:
        if "r0" in values:
            r, z = (values[f"{k}0"] + u * (values[f"{k}1"] - values[f"{k}0"]) for k in "rz")
            q = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)
        else:
            size = fixed.get("semi_diameter", fixed.get("half_height"))
            x, y = u * size * np.cos(phi), u * size * np.sin(phi)
            z = sag(x * x + y * y, values["curvature"], values["conic"], [values[f"a{o}"] for o in ORDERS])
            q = np.stack([x, y, z], axis=1)
        return to_world(shape, values, q)

    return points


def rims(shape: mi.Shape, phi: np.ndarray) -> dict[str, Callable[[dict[str, float]], np.ndarray]]:
    """Points of the rims as functions of the parameters, by the column that the rim is."""

    def of_frustum(end: int) -> Callable[[dict[str, float]], np.ndarray]:
        def points(v: dict[str, float]) -> np.ndarray:
            r, z = v[f"r{end}"], v[f"z{end}"]
            return to_world(shape, v, np.stack([r * np.cos(phi), r * np.sin(phi), z + 0 * phi], axis=1))

        return points

    def of_asphere(key: str) -> Callable[[dict[str, float]], np.ndarray]:
        def points(v: dict[str, float]) -> np.ndarray:
            x, y = v[key] * np.cos(phi), v[key] * np.sin(phi)
            if key == "half_width":
                x, y = np.sign(np.cos(phi)) * v[key], 0.1 * np.sin(phi)
            if key == "half_height":
                x, y = 0.1 * np.cos(phi), np.sign(np.sin(phi)) * v[key]
            z = sag(x * x + y * y, v["curvature"], v["conic"], [v[f"a{o}"] for o in ORDERS])
            return to_world(shape, v, np.stack([x, y, z], axis=1))

        return points

    v = shape.values
    if "curvature" in v:
        columns = {"semi_diameter": "outer", "inner_semi_diameter": "inner"}
        columns |= {key: key for key in ("half_width", "half_height")}
        return {column: of_asphere(key) for key, column in columns.items() if key in v}
    if v["z0"] == v["z1"]:
        first = int(v["r1"] > v["r0"])
        return {"outer": of_frustum(first), "inner": of_frustum(1 - first)}
    first = int(v["z1"] > v["z0"])
    ends = {"high": first, "low": 1 - first}
    return {rim: of_frustum(end) for rim, end in ends.items() if v[f"r{end}"] > 0}  # a tip is no rim


class Columns:
    """The surface as its columns describe it, in the frame of its vertex."""

    def __init__(self, shape: mi.Shape) -> None:
        scene = mi.load_dict({"type": "scene", "one": shape, "detector": DETECTOR}, optimize=False)
        table = SurfaceTable(scene, 550.0)
        number = table.ids.index("one")
        self.values = dict.fromkeys(GEOMETRY, 0.0) | table.pieces[number].columns
        self.rotation, self.vertex = table.rotations[number], table.vertices[number]
        self.cone = isinstance(table.pieces[number], Cone)

    def local(self, p: np.ndarray) -> np.ndarray:
        return (p - self.vertex) @ self.rotation

    def moved(self, q: np.ndarray, columns: dict[str, float]) -> np.ndarray:
        moved = q - np.array([columns[axis] for axis in "xyz"])
        return moved - np.cross([columns[f"tilt_{axis}"] for axis in "xyz"], moved)

    def value(self, q: np.ndarray, columns: dict[str, float]) -> np.ndarray:
        """Zero on the surface; points of the world, the frame moved by its columns."""
        moved = self.moved(q, columns)
        r2 = moved[:, 0] ** 2 + moved[:, 1] ** 2
        if self.cone:
            return np.sqrt(r2) - columns["r0"] - columns["slope"] * moved[:, 2]
        return moved[:, 2] - sag(r2, columns["curvature"], columns["conic"], [columns[f"a{o}"] for o in ORDERS])

    def beyond(self, q: np.ndarray, columns: dict[str, float], rim: str) -> np.ndarray:
        """Zero at a rim."""
        moved = self.moved(q, columns)
        where = {
            "low": moved[:, 2], "high": moved[:, 2], "half_width": np.abs(moved[:, 0]),
            "half_height": np.abs(moved[:, 1]),
        }.get(rim, np.hypot(moved[:, 0], moved[:, 1]))  # fmt: skip
        return where - columns[rim]


DETECTOR = {
    "type": "asphere", "semi_diameter": 1.0, "bsdf": BLACK, "to_world": mi.ScalarTransform4d().translate([0, 0, 90]),
    "meter": {"type": "irradiancemeter", "film": {"type": "hdrfilm", "rfilter": {"type": "box"}}},
}  # fmt: skip


def residual(shape: mi.Shape, name: str, moves: np.ndarray) -> float:
    """
    How far the surface and its rims, as the columns move them, are off from where the parameter moves them.

    A point that the parameter carries along must stay on the surface of the moved columns, and one of a rim at its rim:
    the total derivatives of both equations vanish. In units of the largest of the two parts of those.
    """
    rng = np.random.default_rng(7)
    phi, u = rng.uniform(0, 2 * np.pi, 40), rng.uniform(0.1, 0.9, 40)
    columns = Columns(shape)
    step = {"tilt": 1e-4, "a": 1e-5}.get(name.split("_")[0].rstrip("0123456789"), 1e-5)
    if name == "curvature" or name.startswith("a"):
        size = shape.outer_radius
        step *= size ** (-1 if name == "curvature" else 1 - int(name[1:]))
    worst = scale = 0.0
    tests = [(by_parameters(shape, u, phi), [columns.value])]
    for rim, points in rims(shape, phi).items():
        tests.append((points, [columns.value, lambda q, c, rim=rim: columns.beyond(q, c, rim)]))
    for points, functions in tests:
        before, after = (points({**shape.values, name: shape.values[name] + s * step}) for s in (-1, 1))
        velocity = (after - before) / (2 * step) @ columns.rotation
        here = columns.local(points(shape.values))
        for function in functions:
            np.testing.assert_allclose(function(here, columns.values), 0, atol=1e-9)
            ahead, behind = (function(here + s * 1e-6 * velocity, columns.values) for s in (1, -1))
            carried = (ahead - behind) / 2e-6
            length = 1e-6 / max(np.abs(moves).max(), 1e-300)
            ahead, behind = (
                function(here, {c: v + s * length * m for (c, v), m in zip(columns.values.items(), moves, strict=True)})
                for s in (1, -1)
            )
            moved = (ahead - behind) / (2 * length)
            scale = max(scale, np.abs(velocity).max(), np.abs(moved).max())
            worst = max(worst, float(np.abs(carried + moved).max()))
    return worst / max(scale, 1e-300)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_points_and_rims_move_as_the_columns_say(kind: str) -> None:
    shape = random_shape(kind, 1)
    names = shape_parameters(shape)
    for name in names:
        moves = column_derivatives(shape, name)
        assert residual(shape, name, moves) < 1e-5, name  # the error of the differences here
        wrong = moves.copy()
        wrong[np.argmax(np.abs(wrong))] *= 1 + 10 * TOLERANCE
        if residual(shape, name, 0 * moves) > TOLERANCE:  # a tilt about the axis of revolution does nothing
            assert residual(shape, name, wrong) > 1e-4, name
        needed = {column for column, value in zip(GEOMETRY, moves, strict=True) if abs(value) > 1e-9}
        assert needed <= geometry_columns([name])
    assert set(POSE) <= set(names)


def test_a_flat_annulus_moves_as_a_whole() -> None:
    assert {"z0", "z1"} & set(shape_parameters(random_shape("annulus", 1))) == set()
    assert {"z0", "z1"} <= set(shape_parameters(random_shape("cylinder", 1)))
    assert shape_parameters(mi.load_dict({"type": "disk"})) == ()

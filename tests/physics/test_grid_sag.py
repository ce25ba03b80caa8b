"""Sags on grids, exact for bicubics, and Forbes's polynomials, against batoid, their definition and optiland."""

import math
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import peers
import pytest
import scene_dicts
from refusals import each_refused, refused
from scipy.integrate import quad

from mistray.physics.sags.forbes import q2d, q2d_values
from mistray.physics.sags.terms import half_turned, sag, slopes
from mistray.prescription import Grid, read_grid, save_grid
from mistray.surfaces.families.grid_patches import GridPatches

pytestmark = pytest.mark.quick

STEP, MIDDLE = (0.7, 0.9), (1.0, -2.0)
X, Y = (m + s * (np.arange(n) - (n - 1) / 2) for m, s, n in zip(MIDDLE, STEP, (21, 17), strict=True))
AT = np.random.default_rng(3).uniform(-6, 6, (2, 500)) + np.array(MIDDLE)[:, None]


def bicubic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A polynomial that is cubic in x and in y."""
    return 0.3 - 0.02 * x + 0.01 * x * y - 3e-3 * x**3 + 1e-4 * x**3 * y**3 - 2e-3 * y**2 * x


def grid() -> Grid:
    return Grid.of(bicubic(*np.meshgrid(X, Y)), STEP, MIDDLE)


def test_bicubics_kernels_and_patches_of_batoid() -> None:
    """Splines of cubics are those cubics, with all their slopes and twists."""
    x, y = AT
    z, by_x, by_y = grid().evaluate(x, y)
    assert z == pytest.approx(bicubic(x, y), abs=1e-12)
    assert by_x == pytest.approx(-0.02 + 0.01 * y - 9e-3 * x**2 + 3e-4 * x**2 * y**3 - 2e-3 * y**2, abs=1e-11)
    assert by_y == pytest.approx(0.01 * x + 3e-4 * x**3 * y**2 - 4e-3 * y * x, abs=1e-11)

    def error(count: int) -> float:
        u = np.linspace(-3, 3, count)
        wave = np.sin(2 * u)[:, None] * np.cos(1.5 * u)[None, :]
        step = (float(u[1] - u[0]),) * 2
        x, y = np.random.default_rng(1).uniform(-2.5, 2.5, (2, 400))
        return float(np.abs(Grid.of(wave, step).evaluate(x, y)[0] - np.sin(2 * y) * np.cos(1.5 * x)).max())

    assert error(31) / error(61) == pytest.approx(16, rel=0.25)
    x, y = AT
    exact = grid().evaluate(x, y)
    for kind, error in ((mi.Float64, 1e-13), (mi.Float, 2e-5)):
        for ours, theirs in zip(GridPatches(grid()).evaluate(kind(x), kind(y)), exact, strict=True):
            assert np.array(ours) == pytest.approx(theirs, abs=error)
    u = mi.Float64(x)
    dr.enable_grad(u)
    z, by_x, _ = GridPatches(grid()).evaluate(u, mi.Float64(y))
    dr.backward(dr.sum(z))
    assert np.array(u.grad) == pytest.approx(np.array(dr.detach(by_x)), abs=1e-12)
    batoid = pytest.importorskip("batoid")
    rng = np.random.default_rng(2)
    corners = 1e-3 * rng.normal(size=(len(Y), len(X), 4))
    theirs = batoid.Bicubic(X, Y, *np.moveaxis(corners, -1, 0))
    x, y = AT
    z, by_x, by_y = Grid(corners, STEP, MIDDLE).evaluate(x, y)
    assert z == pytest.approx(theirs.sag(x, y), abs=1e-14)
    normal = theirs.normal(x, y)
    assert by_x == pytest.approx(-normal[:, 0] / normal[:, 2], abs=1e-12)
    assert by_y == pytest.approx(-normal[:, 1] / normal[:, 2], abs=1e-12)
    # Scaled, moved and turned over, with slopes that jump at no cell
    numbers = {"curvature": 0.01, "grid": grid(), "grid_scale": -2.0, "grid_x": 0.3, "grid_y": -0.1}
    x, y = AT * 0.8
    base = sag(x, y, {"curvature": 0.01})
    assert sag(x, y, numbers) == pytest.approx(base - 2 * bicubic(x - 0.3, y + 0.1), abs=1e-11)
    assert sag(-x, y, half_turned(numbers)) == pytest.approx(-sag(x, y, numbers), abs=1e-12)
    h = 1e-6
    for found, (u, v) in zip(slopes(x, y, numbers, 1e-2), ((h, 0), (0, h)), strict=True):
        exact = (sag(x + u, y + v, numbers) - sag(x - u, y - v, numbers)) / (2 * h)
        assert found == pytest.approx(exact, abs=1e-7)


def text(heights: np.ndarray, head: str = "21 17 0.7 0.9 0 1 -2", tail: str = "") -> str:
    rows = "\n".join(f"{value!r} 0 0 0{tail}" for row in heights[::-1].tolist() for value in row)
    return f"! remark\n{head}\n{rows}\n"


def test_files_points_without_a_height_and_no_code(tmp_path: Path) -> None:
    """Text from the upper left corner on, in any unit, and our own archive; both know their file."""
    heights = bicubic(*np.meshgrid(X, Y))
    path = tmp_path / "with a blank.dat"
    path.write_text(text(heights))
    found = read_grid(path)
    assert found.corners == pytest.approx(grid().corners, abs=1e-12)
    again = save_grid(found, tmp_path / "grid.npz")
    assert again.path == str(tmp_path / "grid.npz")
    assert (read_grid(again.path).corners == found.corners).all()
    path.write_text(text(heights / 25.4, f"21 17 {0.7 / 25.4!r} {0.9 / 25.4!r} 2 {1 / 25.4!r} {-2 / 25.4!r}"))
    assert read_grid(path).corners == pytest.approx(grid().corners, abs=1e-12)
    with refused(r"written as \.npz"):
        save_grid(found, tmp_path / "grid.dat")
    heights = bicubic(*np.meshgrid(X, Y))
    heights[0, 0] = np.nan
    with refused(r"column 1, row 1 .* not finite"):
        Grid.of(heights, STEP)
    found = Grid.of(heights, STEP, MIDDLE, np.isnan(heights))
    assert np.isfinite(found.corners).all()
    assert not found.lacks(np.array([0.0]), np.array([0.0]))
    assert "no height near" in found.lacks(X[:1] + 0.1, Y[:1] + 0.1)
    assert "in x and" in found.lacks(X[-1:] + 0.1, Y[:1])
    assert read_grid(save_grid(found, tmp_path / "g.npz").path).lacks(X[:1] + 0.1, Y[:1] + 0.1)
    runs_code = tmp_path / "evil.npz"
    np.savez(runs_code, corners=np.array([print], dtype=object), step=[1, 1], middle=[0, 0], missing=[[False]])
    with refused("not a grid that mistray wrote"):
        read_grid(runs_code)


def test_scenes_say_what_is_wrong(tmp_path: Path) -> None:
    mirror = {"type": "freeform", "semi_diameter": 4.0, "bsdf": {"type": "interface", "R": 1.0}}
    given = {"grid": save_grid(grid(), tmp_path / "grid.npz").path}
    scene_dicts.load(mirror=mirror | given)
    each_refused(
        (given | {"semi_diameter": 8.0}, "'mirror': its outline leaves its grid '.*grid.npz': it reaches -6 to 8 mm"),
        (given | {"grid_x": 5.0}, "its outline leaves its grid"),
        ({"grid": str(tmp_path / "no.npz")}, "'mirror': grid '.*no.npz'.*check the path"),
        ({"grid_scale": 2.0}, "grid_scale needs grid"),
        ({"grid": 3.0}, "grid is 3.0; give the name of a file"),
        by=lambda more: scene_dicts.load(mirror=mirror | more),
    )


@pytest.mark.parametrize("m", [1, 2, 3, 7, 20])
def test_gradients_are_orthonormal(m: int) -> None:
    """Mean products of gradients over the disc with the weight 1/√(u² - u⁴), by adaptive quadrature over u = sin t."""
    step = 1e-5

    def gradient(n: int, u: float) -> tuple[float, float]:
        def value(u: float) -> float:
            return float(u**m * q2d_values(np.array(u * u), m, n)[n])

        return (value(u + step) - value(u - step)) / (2 * step), m * value(u) / u

    for j, k in ((0, 0), (1, 1), (4, 4), (0, 1), (1, 3), (2, 4)):

        def product(t: float, j: int = j, k: int = k) -> float:
            a, b = gradient(j, math.sin(t)), gradient(k, math.sin(t))
            return 0.5 * 2 / math.pi * (a[0] * b[0] + a[1] * b[1])  # half: the mean of cos² and of sin²

        mean = quad(product, 1e-6, math.pi / 2, epsabs=1e-10)[0]
        assert mean == pytest.approx(float(j == k), abs=1e-6)


def test_the_first_ones() -> None:
    x = np.linspace(0, 1, 7)
    assert q2d_values(x, 1, 0)[0] == pytest.approx(np.ones(7))
    assert q2d_values(x, 2, 0)[0] == pytest.approx(np.full(7, math.sqrt(0.5)))
    assert (np.diff(q2d_values(x, 1, 1)[1]) < 0).all()  # the leading coefficient is negative
    assert q2d(x, 0 * x, {(2, 0): 3.0}, {(2, 0): 5.0}) == pytest.approx(3 * math.sqrt(0.5) * x**2)
    assert q2d(x, x, {(2, 0): 3.0}, {(2, 0): 5.0}) == pytest.approx(5 * math.sqrt(0.5) * 2 * x**2)


@pytest.mark.parametrize("letter", ["a", "b"])
@pytest.mark.parametrize("m", [1, 2, 3, 6, 11])
def test_the_same_as_optiland(letter: str, m: int) -> None:
    forbes, frame = peers.optiland("geometries.forbes.geometry"), peers.optiland("coordinate_system")
    x, y = np.random.default_rng(1).uniform(-7, 7, (2, 60))
    for n in (0, 1, 2, 3, 5, 9, 14):
        config = forbes.ForbesSurfaceConfig(radius=40.0, conic=-0.4, terms={(letter, m, n): 1.0}, norm_radius=10.0)
        theirs = forbes.ForbesQ2dGeometry(frame.CoordinateSystem(), config).sag(x, y)
        name = f"q2d_{'cos' if letter == 'a' else 'sin'}_{m}_{n}"
        ours = sag(x, y, {"curvature": 1 / 40, "conic": -0.4, name: 1.0, "q_radius": 10.0})
        assert ours == pytest.approx(theirs, abs=1e-12)

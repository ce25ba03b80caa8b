"""Every sample lens of optiland: it is read, closed to a system, and its rays are optiland's own."""

import inspect
from pathlib import Path

import numpy as np
import peers
import pytest
from scipy.optimize import least_squares

from mistray.io.optiland import from_optiland
from mistray.prescription import Sequential, read_codev, to_optiland
from mistray.prescription import from_optiland as take_over
from mistray.prescription.closing.system import build
from mistray.prescription.sequential.rays import frames, to_world, trace

pytestmark = pytest.mark.validation

OBJECTIVES = pytest.param("objectives", marks=pytest.mark.long)  # as many as all others together
FILES = ("eyepieces", "infrared", "lithography", "microscopes", "miscellaneous", OBJECTIVES, "simple", "telescopes")

# An image plane that the light meets from behind, which is no table of surfaces in the order of light
NOT_BACK = ("Microscope20x",)


@pytest.mark.parametrize("file", FILES)
@pytest.mark.filterwarnings("ignore")
def test_samples(file: str) -> None:
    """A lens that was closed to a system and given back has the same rays, too, and the same clear apertures."""
    samples = peers.optiland(f"samples.{file}")
    kinds = [kind for _, kind in inspect.getmembers(samples, inspect.isclass) if kind.__module__ == samples.__name__]
    assert kinds
    for kind in kinds:
        optic = kind()
        nm, read = 1e3 * optic.primary_wavelength, from_optiland(optic)
        assert build(read).prescription.surfaces
        for field in (0.7, 1.0, 0.0):
            optic.trace(Hx=0, Hy=field, wavelength=optic.primary_wavelength, num_rays=6, distribution="hexapolar")
            there = {key: np.asarray(getattr(optic.surfaces, key), dtype=float) for key in "xyzLMN"}
            along, first, last = (
                np.stack([there[key][k] for key in keys]) for k, keys in ((0, "LMN"), (1, "xyz"), (-1, "xyz"))
            )
            hits, _ = trace(read, (first - along).T, along.T, nm)
            assert np.isfinite(last).all()
            assert to_world(read, hits)[-1] == pytest.approx(last.T, abs=1e-9), kind.__name__
        if kind.__name__ in NOT_BACK:
            continue
        lens = take_over(optic)
        back = to_optiland(lens)
        start, one = float(np.asarray(list(optic.surfaces)[1].geometry.cs.z)), np.ones(len(last.T))
        place = first - along - [[0.0], [0.0], [start]]
        rays = peers.optiland("rays").RealRays(*place, *along, one, one * optic.primary_wavelength)
        back.surfaces.trace(rays)
        assert np.stack([rays.x, rays.y]) == pytest.approx(last[:2], abs=1e-6), kind.__name__
        again = take_over(back)
        assert [s.outer_radius for s in again.surfaces] == pytest.approx([s.outer_radius for s in lens.surfaces])


DATA = Path(__file__).parents[1] / "data"


def wavefront_nm(lens: Sequential, field: tuple[float, float], radius: float) -> float:
    """Rms error of the wavefront of a beam about the chief ray, against a sphere about the centroid of its spot."""
    ahead = np.array([*np.tan(np.radians(field)), 1.0])
    ahead /= np.linalg.norm(ahead)
    across = np.cross([0, 1, 0], ahead)
    across /= np.linalg.norm(across)
    stop = next(k for k, row in enumerate(lens.rows) if row.stop)

    def miss(start: np.ndarray) -> np.ndarray:
        return trace(lens, [[*start, 0.0]], ahead[None])[0][stop][0, :2]

    straight = -600 * ahead[:2] / ahead[2]
    chief = np.array([*least_squares(miss, straight, x_scale=100.0, xtol=1e-14).x, 0.0])
    u, v = (radius * grid.ravel() for grid in np.meshgrid(*[np.linspace(-1, 1, 25)] * 2))
    inside = np.hypot(u, v) <= radius
    start = chief + u[inside, None] * across + v[inside, None] * np.cross(ahead, across)
    hits, onward = trace(lens, start, ahead)
    place, along, path = start, np.broadcast_to(ahead, start.shape), start @ ahead
    for row, hit, frame in zip(onward, to_world(lens, hits), frames(lens), strict=True):
        path = path + np.einsum("ij,ij->i", hit - place, along)
        place, along = hit, row @ frame[:3, :3].T
    error = path + np.einsum("ij,ij->i", place.mean(axis=0) - place, along)
    return 1e6 * float(error.std())


FIELDS = [(x, y) for x in (0.0, 5.0, 10.0, -10.0) for y in (12.0, 17.0, 22.0, 27.0, 32.0)]


def test_an_imager_of_zernike_mirrors_images_as_its_author_says() -> None:
    """His map of the whole field has 53 nm at most; polynomials in another order give thousands."""
    lens = read_codev(DATA / "offset_imager.seq")
    errors = [wavefront_nm(lens, field, 37.5) for field in FIELDS]
    assert np.isfinite(errors).all()
    assert 20 < max(errors) < 53


def test_a_bench_of_eight_parabolas_images_its_pinhole_to_a_point() -> None:
    """Thirty surfaces with BEN, DAR, shifts and turns; each parabola is used at its focus, so nothing may be left."""
    lens = read_codev(DATA / "coronagraph_bench.seq")
    stop = next(k for k, row in enumerate(lens.rows) if row.stop)

    def at(slopes: np.ndarray) -> np.ndarray:
        heading = np.column_stack([slopes, np.ones(len(slopes))])
        return trace(lens, np.zeros_like(heading), heading)[0]

    chief = least_squares(lambda slope: at(slope[None])[stop][0, :2], [0.0, 0.0]).x
    u, v = np.meshgrid(*[np.linspace(-0.00895, 0.00895, 9)] * 2)
    spot = at(chief + np.column_stack([u.ravel(), v.ravel()]))[-1]
    assert np.ptp(spot, axis=0) == pytest.approx([0, 0, 0], abs=1e-9)
    assert spot[0] == pytest.approx([0, 0, 0], abs=1e-9)

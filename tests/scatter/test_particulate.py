"""Particles: lobes against float64 test vectors, their energy; clouds and tables of scatter that a cache keeps."""

import hashlib
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from refusals import refused
from scipy.interpolate import CubicSpline

from mistray.cache.kept_results import forget
from mistray.kernel import scatter_tables
from mistray.kernel.scatter_tables import Side, make_side, side_of
from mistray.physics import contamination, mie
from mistray.physics.contamination import Cloud
from mistray.scatter import particle_clouds
from mistray.scatter.evaluate import bsdf
from mistray.scatter.lobe import Lobe, RatioTable
from mistray.scatter.particle_clouds import kept_cloud
from mistray.scatter.particulate import Particulate
from mistray.scatter.phong import Phong
from mistray.scatter.total import check_budget, lobe_total, totals

DATA = Path(__file__).parents[1] / "data"
VECTORS = 1e-3  # relative, as required
WAVELENGTH_NM = 550.0
COSINES = np.cos(np.radians([0, 20, 45, 60, 80, 88, 89.9, 90]))


def direction(theta: np.ndarray, phi: np.ndarray | float = 0.0) -> np.ndarray:
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


@pytest.mark.parametrize("level", [300, 400, 500])
def test_normal_incidence(level: int) -> None:
    """A window, T F/cos θs, and mirrors, [2 R F(θ) + (1 + R²) F(180° - θ)]/cos θs."""
    table = pd.read_csv(DATA / "contam_bsdf_055um_normal.csv", comment="#")
    table = table[table["CL"] == level]
    theta = np.radians(table["theta_s_deg"].to_numpy())
    lobes = Particulate(level=float(level)).lobes(WAVELENGTH_NM, 1.0, 1.0, True)
    # The table took F at 180° - θ from a coarser one, which does not have 173° and 165°
    exact = ~table["theta_s_deg"].isin([7.0, 15.0]).to_numpy()
    for event, share, column, rows in [
        ("transmission", 1.0, "BTDF_T1(single pass fwd)", slice(None)),
        ("transmission", 0.98, "BTDF_T0.98", slice(None)),
        ("reflection", 1.0, "BRDF_mirror_R1", exact),
        ("reflection", 0.95, "BRDF_mirror_R0.95", exact),
    ]:
        found = bsdf(lobes, event, 1.0, direction(theta), 1.0, 1.0, share)
        np.testing.assert_allclose(found[rows], table[column].to_numpy()[rows], rtol=VECTORS, err_msg=column)


class OneSize(Particulate):
    PER_UM2 = 1e-5

    def cloud(self, wavelength_nm: float) -> Cloud:
        u = np.linspace(np.log(5e-6), np.log(2e4), 6000)
        k = 2 * np.pi / 0.55
        answer = mie.spheres([k * 1.5], 1.53 + 0.0021j, 2 * np.arctan(np.exp(u)))
        area = self.PER_UM2 * np.pi * 1.5**2
        f = self.PER_UM2 * answer.intensity[0] / k**2
        return Cloud(answer.extinction[0] * area, answer.scattering[0] * area, CubicSpline(u, np.log(f)))


def test_light_that_meets_several_particles_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(OneSize, "PER_UM2", 0.03)
    with refused("take .* % of the light in two passages at 550 nm"):
        OneSize(level=300.0).lobes(WAVELENGTH_NM, 1.0, 1.0, True)


def test_mirrors_and_refracted_light_against_an_exact_calculation() -> None:
    """SCATMECH's double interaction, over heights: within 2 % where phases average out, twice as much where θs = θi."""
    table = pd.read_csv(DATA / "contam_double_interaction.csv", comment="#")
    table = table[table["substrate"] == "PEC-like"]
    lobes = OneSize(level=300.0).lobes(WAVELENGTH_NM, 1.0, 1.0, True)
    for row in table.itertuples():
        cos_i = float(np.cos(np.radians(row.theta_i)))
        out = direction(np.radians(row.theta_s), np.radians(row.phi_s))
        found = float(bsdf(lobes, "reflection", cos_i, out, 1.0, 1.0, 1.0)) / OneSize.PER_UM2
        assert found == pytest.approx(row.BRDF_incoherent_formula, rel=VECTORS), row
        if row.theta_i != row.theta_s:
            assert found == pytest.approx(row.BRDF_SCATMECH_dist_avg, rel=0.02), row
        elif row.phi_s == 0:
            assert 2 * found == pytest.approx(row.BRDF_SCATMECH_dist_avg, rel=0.02), row
    # Into glass a small deflection is divided by n and the peak is n² higher; out of glass it is as in air
    model = Particulate(level=300.0)
    cloud, n = model.cloud(WAVELENGTH_NM), 1.5
    into, out = (model.lobes(WAVELENGTH_NM, *indices, True)[0] for indices in ((1.0, n), (n, 1.0)))
    deflection = np.array([1e-4, 1e-3, 1e-2])
    chord = 2 * np.sin(deflection / 2)
    np.testing.assert_allclose(out.profile(chord), cloud.f(deflection), rtol=1e-9)
    np.testing.assert_allclose(into.profile(chord), n**2 * cloud.f(n * deflection), rtol=1e-3)
    forward = cloud.between(0, np.pi / 2)
    # The last ring of the table before the critical angle counts as dark: light that was scattered by more than 80°
    assert lobe_total(into, np.ones(1), 1.0, n)[0] == pytest.approx(cloud.between(0, np.radians(80)), rel=1e-2)
    assert lobe_total(out, np.ones(1), n, 1.0)[0] == pytest.approx(forward, rel=1e-3)


@pytest.mark.parametrize("particle", ["dust", "1.53", "1.7+0.2i"])
@pytest.mark.parametrize("indices", [(1.0, 1.0), (1.0, 1.77), (1.77, 1.0)])
def test_energy_is_kept_at_every_angle(particle: str, indices: tuple[float, float]) -> None:
    """Specular and scattered light are at most all light, all at normal incidence; absorbing particles take some."""
    sums = totals(Particulate(level=400.0, particle=particle).lobes(WAVELENGTH_NM, *indices, True), COSINES, *indices)
    for reflectance in (0.0, 0.01, 0.5, 1.0):
        r = np.full(len(COSINES), reflectance)
        absorbed = check_budget("surface", sums, COSINES, r, 1 - r)
        assert absorbed.min() > -1e-6
        if particle != "1.53" and indices[0] <= indices[1]:
            assert absorbed.min() > 1e-5
        if particle == "1.53" and indices == (1.0, 1.0) and not reflectance:  # the resonances of the spheres leave 1e-6
            assert absorbed[0] == pytest.approx(0, abs=2e-6)


def test_particles_of_a_file_that_changes_are_computed_again(tmp_path: Path) -> None:
    file = tmp_path / "soot.csv"
    models = (Particulate(level=300.0, particle=str(file), max_um=3.0),)
    found = []
    for k in (0.0, 0.5):
        file.write_text(f"wavelength_nm,n,k\n400,1.5,{k:.1f}\n700,1.5,{k:.6f}\n")
        found.append(side_of(models, WAVELENGTH_NM, 1.0, 1.0, True))
        exact = make_side(models, WAVELENGTH_NM, 1.0, 1.0, True)
        np.testing.assert_array_equal(found[-1].rows["reflection"], exact.rows["reflection"])
    assert side_of(models, WAVELENGTH_NM, 1.0, 1.0, True) is found[1]
    assert np.max(np.abs(found[0].rows["reflection"] / found[1].rows["reflection"] - 1)) > 0.1


def test_tables_that_parameters_change_are_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every step of a search makes new ones, of megabytes."""
    made = []

    def make(models: tuple[Any, ...], *key: Any) -> Side:
        lobe = Lobe("reflection", np.ones_like, ratio=RatioTable(np.ones((2, 2, 2))))
        lobe_total(lobe, np.ones(1), 1.0, 1.5)
        made.append(weakref.ref(lobe.ratio))
        return Side((lobe,), (), {})

    monkeypatch.setattr(scatter_tables, "make_side", make)
    for k in range(200):
        side_of((Phong(b0=1.0, exponent=2.0 + k),), 551.5, 1.0, 1.5, True)
    assert 0 < sum(ratio() is not None for ratio in made) <= 64


SMALL = (0.55, 1.53 + 0.002j, 2.0, 0.926, 1.0, None, 1.0)  # few sizes: quick
ANGLES = np.array([0.0, 1e-4, 0.01, 0.3, 1.5, 3.0, np.pi])


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MISTRAY_CACHE", str(tmp_path / "cache"))
    _forget()
    return tmp_path / "cache"


def _forget() -> None:
    forget()
    for function in (kept_cloud, contamination.cloud):
        function.cache_clear()


def test_the_same_numbers(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[Any] = []
    expected = contamination.cloud(*SMALL)
    monkeypatch.setattr(particle_clouds, "cloud", lambda *arguments: done.append(arguments) or expected)
    for _ in range(2):
        found = kept_cloud(*SMALL)
        assert (found.extinction, found.scattering) == (expected.extinction, expected.scattering)
        np.testing.assert_allclose(found.f(ANGLES), expected.f(ANGLES), rtol=1e-13)
        _forget()
    assert len(done) == 1
    assert len(list(folder.iterdir())) == 1


@pytest.mark.parametrize("place", range(7))
def test_every_argument_counts(place: int, monkeypatch: pytest.MonkeyPatch) -> None:
    other = list(SMALL)
    other[place] = 1.5 if SMALL[place] is None else SMALL[place] * (1 + 1e-9)
    made = contamination.cloud(*SMALL)
    done: list[Any] = []
    monkeypatch.setattr(particle_clouds, "cloud", lambda *arguments: done.append(arguments) or made)
    kept_cloud(*SMALL)
    kept_cloud(*other)
    assert done == [SMALL, tuple(other)]


@pytest.mark.parametrize("content", [None, b"null", b"{}", b"[1, 1, []]", b"[1, 2, [0]]", b"[NaN, 0, [0]]", b"\xff"])
def test_another_form(folder: Path, caplog: pytest.LogCaptureFixture, content: bytes | None) -> None:
    before = kept_cloud(*SMALL)
    (path,) = folder.iterdir()
    magic, key, _, _ = path.read_bytes().split(b"\n", 3)
    if content is None:
        path.write_bytes(path.read_bytes()[:-30])
    else:
        path.write_bytes(b"\n".join((magic, key, hashlib.sha256(content).hexdigest().encode(), content)))
    _forget()
    assert kept_cloud(*SMALL).extinction == before.extinction
    assert [f"'{path}' is damaged" in record.getMessage() for record in caplog.records] == [True]

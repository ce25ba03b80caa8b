"""Aimed scatter of six scenes: the answer as without aim, and how much sooner, by the ratio of variance × time; unaimed
hits carry nearly the same flux w, so that the variance of a power P without hits is P w."""

from pathlib import Path

import numpy as np
import pytest
from oracles import scatter_integrals as integrals
from oracles import scatter_scenes, scene_xml
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scattering_xml, target_xml
from oracles.small_scenes import write
from oracles.statistics import assert_z

import mistray

pytestmark = [pytest.mark.validation, pytest.mark.slow]

SCENES = Path(__file__).parents[2] / "scenes"
ROUGH = bsdf_xml("harvey_shack", b0=0.5, l=0.02, s=-1.5)
PAINT = bsdf_xml("paint", reflectance=0.05)
# field in degrees, start rays aimed and not
CASES = {
    "singlet_window_detector": (2.0, 100_000, 400_000),
    "cooke_triplet": (12.0, 150_000, 600_000),
    "double_gauss": (8.0, 150_000, 600_000),
    "newtonian": (0.3, 500_000, 6_000_000),
    "lens_and_reflector": (1.0, 200_000, 1_000_000),
    "phone_camera": (15.0, 40_000, 150_000),
}


def by_first_scatter(t: mistray.Trace) -> dict[str, tuple[float, float, int]]:
    found = {}
    for surface in sorted({row.scatter_1 for row in t.paths} - {"-"}):
        rows = [row for row in t.paths if row.scatter_1 == surface]
        found[surface] = (*t.paths.power([row.path_id for row in rows]), sum(row.rays for row in rows))
    return found


def scattered(t: mistray.Trace) -> tuple[float, float]:
    return t.paths.power([row.path_id for row in t.paths if row.scatter_1 != "-"])


@pytest.mark.parametrize("name", CASES)
def test_aimed_and_unaimed_agree(name: str, tmp_path: Path) -> None:
    """Totals within 3 standard errors (false alarm 2 % of six), surfaces within 4.5 (1e-2 for all scenes)."""
    field_deg, few, many = CASES[name]
    path = SCENES / name / "scene.xml"
    text = path.read_text(encoding="utf-8")
    model = scene_xml.parse_scene(text, path)
    scene = mistray.load(write(tmp_path, scatter_scenes.rough_and_painted(text, model, [ROUGH], [PAINT])))
    limits = {"field_deg": field_deg, "max_reflections": 1}
    aimed = mistray.trace(scene, rays=few, seed=5, aim="auto", **limits)
    unaimed = mistray.trace(scene, rays=many, seed=6, aim="none", **limits)
    assert aimed.aiming
    assert not unaimed.aiming
    a, b = scattered(aimed), scattered(unaimed)
    assert a[1] < 0.02 * a[0]
    assert_z(f"{name}, scattered", a[0], b[0], np.hypot(a[1], b[1]), k=3.0)
    mine, theirs = by_first_scatter(aimed), by_first_scatter(unaimed)
    strong = [surface for surface, (_, _, hits) in theirs.items() if hits >= 100 and mine[surface][2] >= 100]
    assert len(strong) >= 3
    measured, expected = np.array([[runs[surface][:2] for surface in strong] for runs in (mine, theirs)])
    se = np.hypot(measured[:, 1], expected[:, 1])
    assert_z(f"{name}, by surface", measured[:, 0], expected[:, 0], se, k=4.5, names=strong)
    for t in (aimed, unaimed):
        assert abs(t.energy.closure) < 1e-5


class TestWorldWithoutImportanceSampling:
    """TracePro's example: A = 2e-5, B = 1e-6, g = 2, a detector of 4e-6 sr 30° off gets 3.464e-11 of the light."""

    A, B, G = 2e-5, 1e-6, 2.0
    RAYS = 200_000

    def text(self, tilted: bool) -> str:
        """The detector 30° off an axial beam, or on axis and the beam 30° off; both see the same |β - β0| = 0.5."""
        lens = scattering_xml([bsdf_xml("abg", A=self.A, B=self.B, g=self.G, event="transmission")], R=0.0, T=1.0)
        radius, sine, cosine = 0.1, 0.5, 0.75**0.5
        along = (sine, 0.0, cosine) if tilted else (0.0, 0.0, 1.0)
        out = np.array([0.0, 0.0, 1.0] if tilted else [sine, 0.0, cosine])
        size = 0.1 * (cosine if tilted else 1.0) ** 0.5  # the same solid angle, projected onto the lens
        beam = radius * (8 * (cosine if tilted else 1.0)) ** 0.5
        place = {"at": 100 * out, "facing": out}
        return scatter_scenes.scatter_scene(
            beam_xml(beam, power=1.0, along=along),
            placed_xml("asphere", "lens", lens, semi_diameter=radius),
            placed_xml("frustum", "rim", r0=radius, z0=0.0, r1=1.0, z1=0.0),
            "" if tilted else target_xml("aim", "lens", "rectangle", scale=(size, size, 1.0), **place),
            placed_xml("asphere", "detector", pixels=4, half_width=size, half_height=size, **place),
        )

    @pytest.mark.parametrize("tilted", [False, True])
    def test_gain(self, tilted: bool, tmp_path: Path) -> None:
        scene = mistray.load(write(tmp_path, self.text(tilted)))
        aim = "auto" if tilted else "targets"
        mistray.trace(scene, rays=self.RAYS, aim=aim)  # compiles
        aimed = mistray.trace(scene, rays=self.RAYS, seed=1, aim=aim)
        mistray.trace(scene, rays=self.RAYS, aim="none")
        unaimed = mistray.trace(scene, rays=self.RAYS, seed=1, aim="none")
        power, se = scattered(aimed)
        expected = 3.464e-11
        # the lens of 0.1 mm takes the edge off the corners of the deck's estimate: 1e-4
        assert_z("light on the detector", power, expected, se, k=4.0, floor=5e-4 * expected)
        assert se < 0.02 * expected
        assert not [row for row in unaimed.paths if row.scatter_1 != "-"]  # 7e-6 hits are expected
        tis = integrals.total_scatter(integrals.abg(self.A, self.B, self.G), 0.5 if tilted else 0.0)
        variance = expected * tis / self.RAYS
        gain = variance * unaimed.seconds / (se**2 * aimed.seconds)
        assert gain > 100, f"gain {gain:.3g}"

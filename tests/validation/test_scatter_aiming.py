"""How much sooner aimed scatter has the answer, by the ratio of variance × time; unaimed hits carry nearly the same
flux w, so that the variance of a power P without hits is P w."""

from pathlib import Path

import numpy as np
import pytest
from oracles import scatter_integrals as integrals
from oracles import scatter_scenes
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scattering_xml, target_xml
from oracles.small_scenes import write
from oracles.statistics import assert_z

import mistray

pytestmark = [pytest.mark.validation, pytest.mark.slow]


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
        power, se = aimed.paths.power([row.path_id for row in aimed.paths if row.scatter_1 != "-"])
        expected = 3.464e-11
        # the lens of 0.1 mm takes the edge off the corners of the deck's estimate: 1e-4
        assert_z("light on the detector", power, expected, se, k=4.0, floor=5e-4 * expected)
        assert se < 0.02 * expected
        assert not [row for row in unaimed.paths if row.scatter_1 != "-"]  # 7e-6 hits are expected
        tis = integrals.total_scatter(integrals.abg(self.A, self.B, self.G), 0.5 if tilted else 0.0)
        gain = expected * tis / self.RAYS * unaimed.seconds / (se**2 * aimed.seconds)
        assert gain > 100, f"gain {gain:.3g}"

"""Lenses as objects of optiland: rays, coatings and clear apertures are kept both ways."""

from __future__ import annotations

import builtins
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import peers
import pytest

import mistray
from mistray.errors import MistrayError, MistrayWarning
from mistray.prescription import Coating, from_optiland, to_optiland


@pytest.fixture(scope="module")
def triplet() -> Any:
    """optiland's Cooke triplet with an ideal coating in front."""
    coatings = peers.optiland("coatings")
    optic = peers.optiland("samples.objectives").CookeTriplet()
    first = list(optic.surfaces)[1]
    first.interaction_model.coating = coatings.SimpleCoating(transmittance=0.97, reflectance=0.02)
    first.aperture = peers.optiland("physical_apertures").RadialAperture(r_max=9.5)
    return optic


def test_a_lens_there_and_back(triplet: Any) -> None:
    lens = from_optiland(triplet)
    assert lens.surfaces[0].coating == Coating(R=0.02, T=0.97)
    assert lens.surfaces[1].coating is None
    assert not any("oating" in line for line in lens.provenance)
    back = to_optiland(lens, field_deg=[0, 14, 20])
    surfaces = list(back.surfaces)
    assert [surface.comment for surface in surfaces[1:3]] == ["S1", "S2"]
    ideal = surfaces[1].interaction_model.coating
    assert (ideal.reflectance, ideal.transmittance) == (0.02, 0.97)
    assert surfaces[2].interaction_model.coating is None
    assert surfaces[1].aperture.r_max == 9.5
    assert float(np.ravel(back.paraxial.f2())[0]) == pytest.approx(float(np.ravel(triplet.paraxial.f2())[0]), rel=1e-9)
    again = from_optiland(back)
    assert [surface.coating for surface in again.surfaces] == [surface.coating for surface in lens.surfaces]
    assert [s.semi_diameter for s in again.surfaces] == pytest.approx([s.semi_diameter for s in lens.surfaces])
    assert [s.curvature for s in again.surfaces] == pytest.approx([s.curvature for s in lens.surfaces], rel=1e-12)
    power = []
    for each in (lens, again):  # the ghosts of the same rays
        t = mistray.trace(each.to_scene(), rays=2000, max_reflections=2)
        power.append([t.paths[0].power_W, t.paths.find("S2:R", "S1:R")[0].power_W / t.paths[0].power_W])
    assert power[1] == pytest.approx(power[0], rel=1e-3)


def test_layers_become_their_r_and_t(triplet: Any) -> None:
    lens = from_optiland(triplet)
    coated = mistray.coat(lens, {"S3": "MgF2 99.64"})
    with pytest.warns(MistrayWarning, match=r"surface 'S3': coating 'coating' becomes R = 0\.0\d+, T = 0\.9\d+, as at"):
        back = to_optiland(coated)
    found = list(back.surfaces)[3].interaction_model.coating
    assert found.reflectance + found.transmittance == pytest.approx(1, abs=1e-6)
    n = 1.6204  # SF2 of the sample's flint, roughly
    assert found.reflectance == pytest.approx(((n - 1.384**2) / (n + 1.384**2)) ** 2, abs=3e-3)


def test_what_has_no_counterpart(triplet: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    lens = from_optiland(triplet)
    first, *others = lens.surfaces
    freeform = replace(first, sag={"zernike_5": 1e-4, "zernike_radius": 9.5})
    with pytest.raises(MistrayError, match=r"surface 'S1' is a freeform \(zernike_5, zernike_radius\)"):
        to_optiland(replace(lens, surfaces=(freeform, *others)))
    with pytest.raises(MistrayError, match="surface 'S1' stands off the axis or is tilted"):
        to_optiland(replace(lens, surfaces=(replace(first, y=0.3), *others)))
    for name in [name for name in sys.modules if name.split(".")[0] == "optiland"]:
        monkeypatch.delitem(sys.modules, name)
    real = builtins.__import__

    def missing(name: str, *rest: Any) -> Any:
        if name.split(".")[0] == "optiland":
            raise ImportError("No module named 'optiland'")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", missing)
    monkeypatch.setattr("mistray.io.write_optiland.import_module", missing)
    with pytest.raises(MistrayError, match="to_optiland needs optiland"):
        to_optiland(lens)

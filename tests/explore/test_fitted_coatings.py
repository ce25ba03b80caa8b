"""Coatings of the live explorer are those that `mistray coat` puts on: fitted to each body, for the scene's light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mistray
from mistray.explore.controls import AS_IT_IS, COATING, controls_of
from mistray.explore.looks import Looks
from mistray.prescription import from_zemax
from mistray.surfaces.optics import unpolarized_shares

CHOSEN = {"cooke_triplet": ("L2", "bbar3", 550.0), "lwir": ("L2", "bbar4_lwir", 1e4)}


@pytest.fixture(params=CHOSEN)
def explored(request, tmp_path):
    """A scene file, its controls, a part whose glass is not that of the preset, the preset, a wavelength."""
    path = mistray.scene.find("cooke_triplet")
    if request.param == "lwir":
        path = tmp_path / "lwir.xml"
        from_zemax(Path(__file__).parents[2] / "examples" / "lwir_camera.zmx").to_xml(path)
    scene = mistray.load(path)
    return path, scene, controls_of(path, scene, [0.0], [CHOSEN[request.param][2]], ["detector.z"]), request.param


def test_an_estimate_has_the_coating_that_is_put_on(explored):
    path, scene, controls, name = explored
    part, preset, nm = CHOSEN[name]
    state = {key: control.start for key, control in controls.items()} | {f"coating {part}": preset}
    looks = Looks(scene, controls).of(state)
    coated = {shape.id(): shape.bsdf() for shape in mistray.coat(path, {part: preset}).shapes()}
    bare = {shape.id(): shape.bsdf() for shape in scene.shapes()}
    for surface in controls[f"coating {part}"].surfaces:
        sides = bare[surface].complex_indices(nm)
        shares = [
            np.array(unpolarized_shares(coating, nm, sides, False, True, np.array([1.0, 0.8])))
            for coating in (looks[surface].coating, coated[surface].coating, mistray.coatings.preset(preset))
        ]
        np.testing.assert_allclose(shares[0], shares[1], atol=1e-6)
        assert np.abs(shares[0] - shares[2]).max() > 1e-4, "the design is another one"


def test_choices_suit_the_body_and_the_light(explored):
    path, _, controls, name = explored
    visible = name == "cooke_triplet"
    for control in controls.values():
        if control.kind == COATING:
            presets = control.choices[2:]
            assert control.choices[0] == AS_IT_IS
            assert ("bbar4_lwir" in presets) != visible
            assert ("bbar3" in presets) == visible
            assert not (visible and any(preset.endswith("wir") for preset in presets))
            mistray.coat(path, {control.label: presets[0]})
            mistray.coat(path, {control.label: presets[-1]})

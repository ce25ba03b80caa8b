"""The phone camera with scatter: the models of the study's Tables 11 and 12."""

from __future__ import annotations

import pytest

import mistray
from mistray.scatter.harvey_shack import HarveyShack
from mistray.scatter.paint import Paint
from mistray.scatter.particulate import Particulate

OUTSIDE = {"window_front", "barrel_0_recess", "barrel_0_front_face"}


def test_every_face_has_its_models() -> None:
    """Table 12: polish on what light crosses, flat black on the structure, particles on everything."""
    for shape in mistray.load("phone_camera_scatter").shapes():
        found = {type(model): model for model in shape.bsdf().scatter}
        assert found[Particulate].level == (400 if shape.id() in OUTSIDE else 300), shape.id()
        assert found[Particulate].slope == pytest.approx(0.926)
        if shape.id() == "detector":
            assert len(found) == 1
        elif shape.bsdf().opaque:
            assert found[Paint].reflectance == pytest.approx(0.045)
            assert float(shape.bsdf().R[0]) == pytest.approx(0.07)
        else:
            polish = found[HarveyShack]
            assert (polish.rms_nm, polish.l, polish.s) == pytest.approx((4.0, 0.01, -1.5))

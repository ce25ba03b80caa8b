"""Polarised sources of prescriptions, in dicts, XML files and back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import mistray
from mistray.prescription import Detector, ObjectPoint, Prescription, Source, Surface
from mistray.scene.read_optics import read_optics

LENS = Prescription(
    name="plate",
    surfaces=(
        Surface("front", semi_diameter=10.0, back="1.5"),
        Surface("rear", z=4.0, semi_diameter=10.0, front="1.5"),
    ),
    detector=Detector(z=20.0, half_width=10.0, half_height=10.0),
)
STATES = [
    ({"stokes": (0.25, -0.5, 0.75)}, (0.25, -0.5, 0.75)),
    ({"jones": (1, -1j)}, (0, 0, 1)),
    ({"jones": (0.5 + 1j, 2)}, ((1.25 - 4) / 5.25, 2 / 5.25, 4 / 5.25)),
    ({"polarization_deg": 45.0}, (0, 1, 0)),
]


@pytest.mark.parametrize(("light", "stokes"), STATES)
@pytest.mark.parametrize("source", [Source(radius=2.0), ObjectPoint(distance=50.0)])
def test_scene_and_back(tmp_path: Path, source, light, stokes) -> None:
    lens = replace(LENS, source=replace(source, **light))
    file = tmp_path / "lens.xml"
    lens.to_xml(file)
    for scene in (lens.to_scene(), mistray.load(file)):
        (emitter,) = scene.emitters()
        assert emitter.stokes == pytest.approx(stokes, abs=1e-12)
    found, _ = read_optics(file)
    assert {key: getattr(found.source, key) for key in light} == light


def test_unpolarised_files_say_nothing(tmp_path: Path) -> None:
    file = tmp_path / "lens.xml"
    replace(LENS, source=Source(radius=2.0)).to_xml(file)
    text = file.read_text(encoding="utf-8")
    assert not any(key in text for key in ("stokes", "jones", "polarization"))


@pytest.mark.parametrize("kind", [Source, ObjectPoint])
def test_refusals(kind) -> None:
    size = {"radius": 2.0} if kind is Source else {"distance": 5.0}
    for light in ({"stokes": (1, 1, 1)}, {"jones": (0, 0)}, {"jones": (1, 0), "polarization_deg": 3.0}):
        with pytest.raises(mistray.MistrayError, match=next(iter(light))):
            kind(**size, **light)


def test_sources_of_a_call() -> None:
    scene = mistray.load("plate", sources=["beam:radius=2,stokes=0 0.6 0.8"])
    (emitter,) = scene.emitters()
    assert emitter.stokes == pytest.approx((0, 0.6, 0.8))
    assert mistray.trace(scene, rays=64).paths[0].s2 == pytest.approx(0.6, abs=1e-6)

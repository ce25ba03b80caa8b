"""Polarised sources of prescriptions, in dicts, XML files and back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import mistray
from mistray.prescription import Detector, ObjectPoint, Prescription, Source
from mistray.scene.read_optics import read_optics

EMPTY = Prescription(name="empty", surfaces=(), detector=Detector(z=20.0, half_width=10.0, half_height=10.0))
SOURCES = [Source(radius=2.0), ObjectPoint(distance=50.0)]
STATES = [
    ({"stokes": (0.25, -0.5, 0.75)}, (0.25, -0.5, 0.75)),
    ({"jones": (1, -1j)}, (0, 0, 1)),
    ({"jones": (0.5 + 1j, 2)}, ((1.25 - 4) / 5.25, 2 / 5.25, 4 / 5.25)),
    ({"polarization_deg": 45.0}, (0, 1, 0)),
    ({}, None),
]


@pytest.mark.parametrize(("light", "stokes"), STATES)
@pytest.mark.parametrize("source", SOURCES)
def test_scene_and_back(tmp_path: Path, source, light, stokes) -> None:
    lens = replace(EMPTY, source=replace(source, **light))
    file = tmp_path / "lens.xml"
    lens.to_xml(file)
    for scene in (lens.to_scene(), mistray.load(file)):
        (emitter,) = scene.emitters()
        assert emitter.stokes == pytest.approx(stokes, abs=1e-12)
    found, _ = read_optics(file)
    assert {key: getattr(found.source, key) for key in light} == light
    text = file.read_text(encoding="utf-8")
    assert any(key in text for key in ("stokes", "jones", "polarization")) == bool(light)


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize(
    "light", [{"stokes": (1, 1, 1)}, {"jones": (0, 0)}, {"jones": (1, 0), "polarization_deg": 3.0}]
)
def test_refusals(source, light) -> None:
    with pytest.raises(mistray.MistrayError, match=next(iter(light))):
        replace(source, **light)


def test_sources_of_a_call() -> None:
    scene = mistray.load("plate", sources=["beam:radius=2,stokes=0 0.6 0.8"])
    (emitter,) = scene.emitters()
    assert emitter.stokes == pytest.approx((0, 0.6, 0.8))
    assert mistray.trace(scene, rays=64).paths[0].s2 == pytest.approx(0.6, abs=1e-6)

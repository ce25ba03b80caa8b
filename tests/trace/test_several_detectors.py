"""Several detectors in one trace: each with its map, its paths and its share of the energy."""

from __future__ import annotations

import pickle
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray.prescription import Coating, Detector, Prescription, Source, Surface

pytestmark = pytest.mark.quick

SPLIT = 0.3  # reflectance of the splitter, whose transmittance is 0.7


def split_text(R: float = 0.0) -> str:
    splitter = shape_xml("asphere", "splitter", 0.0, interface_xml(R=SPLIT, T=1 - SPLIT), semi_diameter=20.0)
    splitter = splitter.replace('<translate z="0.0"/>', '<rotate x="1" angle="45"/>')
    back = shape_xml("asphere", "back", 9.0, interface_xml(R=R, T=0.0), sensor=True, half_width=3.0, half_height=2.0)
    side = (
        '<shape type="rectangle" id="side"><transform name="to_world"><scale x="4" y="5"/>'
        '<rotate x="1" angle="90"/><translate y="12" x="0.5"/></transform>'
        f"{interface_xml(R=0.0, T=0.0)}"
        '<sensor type="irradiancemeter"><film type="hdrfilm"><integer name="width" value="16"/>'
        '<integer name="height" value="20"/></film></sensor></shape>'
    )
    return scene_text(splitter, back, side, distance=2.0)


class TestSplitBeam:
    def test_each_detector(self, load_text) -> None:
        t = mistray.trace(load_text(split_text())[0], rays=20_000)
        assert t.detectors == ["back", "side"] == t.settings["detector"]
        for name, share in (("back", 1 - SPLIT), ("side", SPLIT)):
            assert t.energy.detected[name][0] == pytest.approx(share * np.pi, rel=1e-6)
        assert t.energy.detected_W == pytest.approx(np.pi, rel=1e-6)
        assert abs(t.energy.closure) < 1e-6
        powers = {("back", "TA"): (1 - SPLIT) * np.pi, ("side", "RA"): SPLIT * np.pi}
        assert {(row.detector, row.path): row.power_W for row in t.paths} == pytest.approx(powers, rel=1e-6)

    @pytest.mark.long
    def test_one_of_them_is_as_if_traced_alone(self, load_text) -> None:
        """Nothing is aimed here, so that the rays are the same."""
        scene, _ = load_text(split_text(R=0.4))
        both = mistray.trace(scene, rays=5000)
        for name in both.detectors:
            alone, view = mistray.trace(scene, rays=5000, detector=name), both.on(name)
            assert view.detectors == [name] == [view.settings["detector"]]
            np.testing.assert_allclose(view.irradiance, alone.irradiance, rtol=1e-12, atol=0)
            np.testing.assert_allclose(view.irradiance_se, alone.irradiance_se, rtol=1e-9, atol=0)
            assert view.extent == alone.extent
            pd.testing.assert_frame_equal(view.paths.to_pandas(), alone.paths.to_pandas(), rtol=1e-9)
            assert view.energy.detected_W == pytest.approx(alone.energy.detected_W, rel=1e-12)
            assert view.energy.absorbed.keys() == alone.energy.absorbed.keys()
            assert abs(view.energy.closure) < 1e-6
            ids = list(range(len(view.paths)))
            np.testing.assert_allclose(view.irradiance_of(ids)[0], view.irradiance, rtol=1e-12, atol=0)
            x0, x1, y0, y1 = view.extent
            assert view.box(x0, x1, y0, y1).column("power_W").sum() == pytest.approx(view.energy.detected_W, rel=1e-12)
            assert set(view.rays(n=50).type) <= {"SpecTran", "SpecRefl"}
            history = view.history(0, 2).to_pandas()
            assert history.object.tolist()[-1] == name


def test_wrong_and_missing_names(load_text) -> None:
    scene, _ = load_text(split_text())
    both = mistray.trace(scene, rays=500)
    asked, choose = r"2 detectors \(back, side\)", "'splitter' is no detector of this .*; choose from back, side"
    for call, words in (
        (lambda: both.irradiance, asked),
        (lambda: both.on("splitter"), choose),
        (lambda: mistray.ghosts(scene, rays=100), f"{asked}.* --detector"),
        (lambda: mistray.pst(scene, rays=100), f"{asked}.* --detector"),
        (lambda: mistray.trace(scene, rays=100, detector="splitter"), choose),
        (lambda: mistray.trace(scene, rays=100, detector=[]), "empty"),
    ):
        with pytest.raises(mistray.MistrayError, match=words):
            call()
    assert both.on("side").on("side").irradiance.shape == (20, 16)
    for t in (both, both.on("side")):  # through a pickle
        found = pickle.loads(pickle.dumps(t))
        assert found.detectors == t.detectors
        np.testing.assert_array_equal(found.on("side").maps([[0]]), t.on("side").maps([[0]]))
    assert mistray.ghosts(scene, rays=100, detector="back")[0.0].detectors == ["back"]


def scatter_text() -> str:
    """A beam on a Lambertian screen that reflects half of it, and two small discs that see it from one side."""
    screen = scattering_xml([bsdf_xml("abg", A=0.1, B=1.0, g=0.0)], R=0.5, T=0.0)
    shapes = [shape_xml("asphere", "screen", 0.0, screen, semi_diameter=3.0)]
    for name, x, y, z in (("left", -6.0, 1.0, -8.0), ("right", 3.0, 0.0, -5.0)):
        disc = shape_xml("asphere", name, z, sensor=True, semi_diameter=0.5)
        shapes.append(disc.replace(f'<translate z="{z!r}"/>', f'<translate x="{x}" y="{y}" z="{z}"/>'))
    return scene_text(*shapes, radius=0.01, distance=2.0)


def test_light_is_aimed_at_each(load_text) -> None:
    """The flux on small discs from a point of a Lambertian screen: dΩ cos θ f. False alarms: 1 in 16,000 (4 SE)."""
    t = mistray.trace(load_text(scatter_text())[0], rays=20_000, max_scatters=1)
    launched = np.pi * 0.01**2
    bsdf = 0.5 * 0.1 / 2  # R A/(B + 1) of an ABg of g = 0
    for name, at in (("left", (-6.0, 1.0, -8.0)), ("right", (3.0, 0.0, -5.0))):
        # Exact over the disc, by midpoints in polar coordinates
        r, phi = np.meshgrid((np.arange(200) + 0.5) / 400, (np.arange(200) + 0.5) * np.pi / 100)
        points = np.stack([at[0] + r * np.cos(phi), at[1] + r * np.sin(phi), np.full_like(r, at[2])], axis=-1)
        distance = np.linalg.norm(points, axis=-1)
        cos = -at[2] / distance
        flux = launched * bsdf * float((r * cos * cos / distance**2).sum() * 0.5 / 200 * 2 * np.pi / 200)
        found, se = t.energy.detected[name]
        assert 0 < se < 0.02 * flux
        assert abs(found - flux) < 4 * se + 1e-4 * flux
    assert abs(t.energy.closure) < 1e-5


def test_detectors_of_a_prescription(tmp_path) -> None:
    """Each has its light, and derivatives of what it alone detects; they come back from the file."""
    camera = Detector("camera", z=60.0, half_width=6.0, half_height=6.0)
    monitor = Detector("monitor", y=40.0, z=20.0, tilt_deg=(90.0, 0.0, 0.0), half_width=6.0, half_height=6.0)
    splitter = Surface("splitter", z=20.0, tilt_deg=(45.0, 0, 0), semi_diameter=12.0, coating=Coating(R=0.08, T=0.9))
    both = {"detector": camera, "more_detectors": (monitor,), "source": Source(radius=4.0)}
    design = Prescription(name="splitter", surfaces=(splitter,), **both)
    design.to_xml(tmp_path / "scene.xml")
    for scene in (design.to_scene(), mistray.load(tmp_path / "scene.xml")):
        energy = mistray.trace(scene, rays=500).energy
        shares = {name: power / energy.launched_W for name, (power, _) in energy.detected.items()}
        assert shares == pytest.approx({"camera": 0.9, "monitor": 0.08}, rel=1e-6)
        metric = mistray.optimize.path_power(scene, "all", detector="monitor", rays=500)
        found = mistray.gradient(metric, mi.traverse(scene), keys=["splitter.bsdf.R"])
        assert found.value == pytest.approx(0.08, rel=1e-6)  # of the light of the source
        assert found.gradient["splitter.bsdf.R"] == pytest.approx(1.0, rel=1e-5)
    for wrong, words in (((camera,), "2 shapes are called 'camera'"), (((1, 2),), "detector is a tuple")):
        with pytest.raises(mistray.MistrayError, match=words):
            replace(design, more_detectors=wrong)

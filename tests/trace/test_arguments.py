"""What a trace is asked for: colours, sources, detectors, arguments, and what it says when that is not to be had."""

from __future__ import annotations

import numpy as np
import pytest
from lit_detector import BLACK
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml

import mistray

pytestmark = pytest.mark.quick


def test_wavelengths_with_weights(load_text) -> None:
    colours = '<string name="wavelength_nm" value="486.1, 656.3"/><string name="weights" value="3, 1"/></emitter>'
    text = plates_text(1, index="N-BK7 k=0").replace("</emitter>", colours)
    t = mistray.trace(load_text(text)[0], rays=4000)
    assert t.settings["wavelength_nm"] == [486.1, 656.3]
    assert t.settings["rays"] == 4000
    direct = {row.wavelength_nm: row for row in t.paths if row.order == 0}
    assert set(direct) == {486.1, 656.3}
    for wavelength, share in ((486.1, 0.75), (656.3, 0.25)):
        n = mistray.materials.refractive_index("N-BK7", wavelength)
        r = ((n - 1) / (n + 1)) ** 2
        assert direct[wavelength].power_W == pytest.approx(np.pi * share * (1 - r) ** 2, rel=2e-6)
    assert direct[486.1].rays == 3 * direct[656.3].rays
    dark = mistray.trace(load_text(text.replace("3, 1", "1, 0"))[0], rays=100)
    assert {row.wavelength_nm for row in dark.paths if row.power_W > 0} == {486.1}
    assert np.isfinite([row.percent for row in dark.paths]).all()
    assert len({row.path_id for row in t.paths}) == len(t.paths) == 4
    assert sum(row.power_W for row in t.paths) == pytest.approx(t.energy.detected_W, rel=1e-9)
    assert t.energy.launched_W == pytest.approx(np.pi, rel=1e-12)
    assert abs(t.energy.closure) < 1e-6
    table = t.rays(n=10)
    assert set(table.wavelength_nm) == {486.1, 656.3}
    one = t.paths.find("p0_rear:R")[0]
    assert set(t.history(one.path_id, 3).to_pandas().wavelength_nm) == {one.wavelength_nm}
    total, _ = t.irradiance_of([row.path_id for row in t.paths])
    np.testing.assert_allclose(total, t.irradiance, rtol=1e-9, atol=1e-12)


class TestArguments:
    def test_the_scene_has_the_first_word_and_the_call_the_last(self, load_text) -> None:
        text = plates_text(1).replace(
            '<integrator type="straylight"/>',
            '<integrator type="straylight"><integer name="rays" value="77"/><integer name="max_reflections" value="4"/>'
            '<float name="flux_threshold" value="1e-6"/><string name="splitting" value="split"/>'
            '<integer name="seed" value="9"/></integrator>',
        )
        scene, _ = load_text(text)
        own = mistray.trace(scene).settings
        assert (own["rays"], own["max_reflections"], own["flux_threshold"], own["seed"]) == (77, 4, 1e-6, 9)
        given = mistray.trace(scene, rays=50, max_reflections=0, seed=0, flux_threshold=0.0).settings
        assert (given["rays"], given["max_reflections"], given["flux_threshold"], given["seed"]) == (50, 0, 0.0, 0)
        assert given["variant"] == "llvm_ad_rgb"
        assert set(given["versions"]) == {"mistray", "mitsuba", "drjit", "numpy"}
        steps: list[int] = []
        colours = {"wavelength_nm": [500, 600, 700]}
        t = mistray.trace(mistray.load("plate"), rays=3000, **colours, progress=lambda done, _: steps.append(done))
        assert (steps, steps[-1]) == (sorted(steps), t.rays_traced)
        assert {1000, 2000, 3000} <= set(steps)

    def test_what_is_missing_or_wrong(self, load_text) -> None:
        detector = shape_xml("asphere", "detector", 5.0, sensor=True, half_width=1.0, half_height=1.0)
        clear = shape_xml("asphere", "detector", 5.0, interface_xml(R=0.2, T=0.8), sensor=True, semi_diameter=2.0)
        wall = shape_xml("asphere", "wall", 0.0, semi_diameter=3.0)
        dark = mistray.load({"type": "scene", "d": {"type": "asphere", "semi_diameter": 1.0, "bsdf": BLACK}})
        for scene, words in (
            ("plate", "got str; load the scene first"),
            (load_text(scene_text(wall))[0], "no detector; nest an 'irradiancemeter'"),
            (load_text(scene_text(detector))[0], r"no ray of its light along \(0, 0.9848, 0.1736\) hits"),
            (dark, "no source; add an emitter"),
            (load_text(scene_text(clear))[0], r"detector 'detector' absorbs nothing .* R \(and T = 0\)"),
        ):
            with pytest.raises(mistray.MistrayError, match=words):
                mistray.trace(scene, rays=10, field_deg=None if scene is dark else 80.0 if "hits" in words else 0.0)
        text = plates_text(1)
        for name in ("p0_front", "p0_rear", "detector"):
            text = text.replace(f' id="{name}"', "")
        t = mistray.trace(load_text(text)[0], rays=10)
        assert t.paths[0].events == "shape_1:T shape_2:T shape_3:A"
        assert [row.part for row in t.surfaces] == ["shape_1", "shape_2", "shape_3"]
        assert t.paths[0].source == "source_1"

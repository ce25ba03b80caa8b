"""The beams of imported lenses: wider than the pupils of all fields, and what counts as launched of them."""

import math

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.errors import MistrayError
from mistray.optimize import path_power, transmission
from mistray.prescription import from_optiland
from mistray.prescription.closing.system import build, to_prescription
from mistray.prescription.sequential.edge_rays import edge_rays
from tests.peers import optiland
from tests.sequential_lenses import triplet

RAYS = 20_000


def test_the_beam_covers_the_pupils_of_all_fields_and_a_twentieth_more():
    lens = triplet()
    built = build(lens)
    source = built.prescription.source
    reach = np.hypot(*edge_rays(lens).pupils.T).max()
    assert reach > built.first_order.epd / 2  # the pupils off the axis are larger
    assert source.radius == pytest.approx(1.05 * reach)
    assert source.pupil_area == pytest.approx(math.pi * built.first_order.epd**2 / 4)
    assert source.irradiance == 1.0
    (note,) = [text for text in built.notes if "wider than the pupil" in text]
    assert "exact" in note
    exact = build(lens, beam="exact")
    assert exact.prescription.source.radius == built.first_order.epd / 2
    assert not any("wider" in text for text in exact.notes)


def test_its_numbers_are_those_of_the_pupil(tmp_path):
    """On axis, where both beams fill the same stop: 5 standard errors of the stop's share, once in 1e6."""
    values = {}
    for beam in ("exact", "pupil"):
        prescription = to_prescription(triplet(), beam=beam)
        prescription.to_xml(tmp_path / f"{beam}.xml")  # the area travels with the file
        scene = mistray.load(tmp_path / f"{beam}.xml")
        settings = {"field_deg": 0.0, "rays": RAYS, "max_reflections": 0}
        values[beam] = [metric(scene, **settings).value() for metric in (transmission, path_power)]
        t = mistray.trace(scene, **settings)
        share = (prescription.source.pupil_area or t.energy.launched_W) / t.energy.launched_W
        assert t.pupil_W == pytest.approx(t.energy.launched_W * min(share, 1.0))
        assert abs(t.energy.closure) < 1e-5
    assert values["pupil"] == pytest.approx(values["exact"], abs=5 * math.sqrt(0.3 / RAYS))


def test_light_beside_the_pupil_does_not_bypass_the_lens():
    """All that reaches the detector has met every lens, off the axis too; but for reflections nothing escapes."""
    scene = to_prescription(triplet()).to_scene()
    faces = {f"S{number}" for number in (1, 2, 3, 4, 6, 7)}
    for field_deg in (0.0, 14.0, 20.0):
        t = mistray.trace(scene, field_deg=field_deg, rays=RAYS)
        assert all(faces <= {event.split(":")[0] for event in row.events.split()} for row in t.paths)
        first = mistray.trace(scene, field_deg=field_deg, rays=RAYS, max_reflections=0)
        assert first.energy.escaped_W < 1e-6 * first.energy.launched_W


def test_a_source_states_its_pupil_whatever_its_size():
    for radius, share in ((5.0, 0.64), (4.0, 1.0), (3.0, 1.0)):
        source = {"type": "collimated", "radius": radius, "pupil_area": math.pi * 16}
        assert mi.load_dict(source).pupil_share == pytest.approx(share)
    with pytest.raises(MistrayError, match="pupil_area"):
        mistray.load({"type": "scene", "source": {"type": "collimated", "radius": 1.0, "pupil_area": 0.0}})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "field_deg", "beam", "steps"),
    [
        ("DoubleGauss", 0.0, "pupil", {"stop_front.r1": (0.1,), "S3.curvature": (3e-4,)}),
        ("DoubleGauss", 0.0, "exact", {"stop_front.r1": (0.1, 0.05), "S3.curvature": (5e-4, 2e-4), "S1.x": (0.2, 0.1)}),
        ("CookeTriplet", 20.0, "exact", {"S4.semi_diameter": (0.01, 0.005), "S2.curvature": (5e-4, 2e-4)}),
    ],
)
def test_derivatives_of_an_imported_lens(name, field_deg, beam, steps):
    """Against differences with the same rays, whose share is known to 6 %; 3 standard errors: once in 370 a key."""
    scene = from_optiland(getattr(optiland("samples.objectives"), name)(), beam=beam).to_scene()
    params = mi.traverse(scene)
    light = transmission(scene, field_deg=field_deg, wavelength_nm=587.6, rays=30_000)
    found = mistray.gradient(light, params, list(steps))
    for key, sizes in steps.items():
        for step in sizes:
            slopes = [(value - light.value()) / (sign * step) for sign, value in moved(light, params, key, step)]
            if beam == "exact":
                pairs = [(slope, side.value, side.se) for slope, side in zip(slopes, found.one_sided[key], strict=True)]
            else:
                assert not found.full
                pairs = [(np.mean(slopes), found.gradient[key][0], found.standard_error[key][0])]
            for slope, value, se in pairs:
                assert abs(slope - value) < 3 * math.hypot(se, 0.06 * abs(slope))


def moved(light, params, key: str, step: float) -> list[tuple[int, float]]:
    """The metric with a key a step lower, higher, and as it was."""
    at, found = np.array(params[key], dtype=np.float64), []
    for sign in (-1, 1, 0):
        params[key] = type(params[key])(at + sign * step)
        params.update()
        found.append((sign, light.value() if sign else 0.0))
    return found[:2]

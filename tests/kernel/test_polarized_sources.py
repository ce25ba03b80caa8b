"""Polarised sources: Mueller cascades against field vectors in float64 with amplitudes of `tmm`."""

import mitsuba as mi
import numpy as np
import pytest
import vectors
from lit_detector import BLACK, lit, square
from oracles.closed_forms import fresnel
from oracles.polarized import Hit, carry, ending, starting
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.skew_path import Face, skew_path
from oracles.small_scenes import plates_text, scene_text, shape_xml
from refusals import each_refused, refused

import mistray
from mistray.physics.polarization.state import jones_numbers, polarization_state

ALUMINIUM, SILVER = 0.958 + 6.69j, 0.055 + 3.32j
PROTECTED = ((1.46 + 0j, 180.0),)
ENHANCED = ((2.3 + 0j, 60.0), (1.38 + 0j, 110.0))
COATED = ((1.38 + 0j, 99.6),)
SPLITTER = ((2.35 + 0j, 58.5), (1.46 + 0j, 94.2), (2.35 + 0j, 58.5))

# How the source states it, and s1, s2, s3
STATES = {
    "0 deg": ({"polarization_deg": 0.0}, (1, 0, 0)),
    "45 deg": ({"polarization_deg": 45.0}, (0, 1, 0)),
    "90 deg": ({"polarization_deg": 90.0}, (-1, 0, 0)),
    "right circular": ({"jones": "1, -1i"}, (0, 0, 1)),
    "left circular": ({"stokes": "0, 0, -1"}, (0, 0, -1)),
    "elliptical": ({"jones": "2, 1-2i"}, (-1 / 9, 4 / 9, 8 / 9)),  # 2 ex ey* = 4 + 8i, of 9
    "partial": ({"stokes": "0.3, -0.2, 0.5"}, (0.3, -0.2, 0.5)),
}
PLATE, DENSE, LAST_MIRROR = Face(45, 20, "T", 1.5), Face(45, 10, "T", 1.7), Face(65, 250, "R", SILVER, PROTECTED)
PATHS = {
    "tilted plate": [Face(56, 90, "T", 1.5), Face(30, 90, "T", 1.0)],
    "plate across": [Face(60, 0, "T", 1.7, COATED), Face(25, 55, "T", 1.0, COATED)],
    "ghost in a plate": [PLATE, *(Face(*x, 1.0) for x in ((28, 140, "R"), (40, 250, "R"), (20, 60, "T")))],
    "bare mirrors": [Face(45, 90, "R", ALUMINIUM, PROTECTED), Face(60, 30, "R", SILVER, PROTECTED)],
    "coated mirrors": [*(Face(*x, "R", ALUMINIUM, ENHANCED) for x in ((45, 35), (30, 160))), LAST_MIRROR],
    "total reflection": [DENSE, *(Face(*x, 1.0) for x in ((50, 40, "I"), (60, 110, "I"), (30, 70, "T")))],
    "splitter": [Face(40, 75, "T", 1.5, COATED), Face(45, 15, "I", 1.0, SPLITTER), Face(35, 190, "T", 1.0, SPLITTER)],
}
MUELLER = 1e-6  # of the flux that starts


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("name", PATHS)
def test_flux_and_state_of_cascades(load_scene, name, state) -> None:
    """A polariser before plates, mirrors and total reflections: flux behind every event, the state at the end."""
    light, stokes = STATES[state]
    path = skew_path(PATHS[name], field_deg=12.0, azimuth_deg=35.0, **light)
    t = mistray.trace(load_scene(path.text), rays=32, max_reflections=4, flux_threshold=0.0)
    assert t.settings["polarization"] == "stokes"
    assert abs(t.energy.closure) < 1e-6
    (row,) = t.paths.find(*path.events)
    table, d = t.history(row.path_id, n=1).to_pandas(), path.directions
    measured = table.flux_W.to_numpy() / table.flux_W[0]
    np.testing.assert_allclose(table[["dx", "dy", "dz"]].to_numpy()[:-1], d, atol=1e-9)
    assert row.power_W / t.energy.launched_W == pytest.approx(measured[-1], abs=1e-7)
    flux, fields = carry(d, path.hits, 550.0, starting(d[0], path.u, stokes))
    np.testing.assert_allclose(measured[2:], flux, rtol=0, atol=MUELLER)
    expected = ending(fields, d[-1])
    # Relative to the flux of the path: of a weak one the angles of incidence are not known better
    allowed = 2 * MUELLER + 3e-7 / flux[-1]
    np.testing.assert_allclose((row.s1, row.s2, row.s3), expected, rtol=0, atol=allowed)
    assert row.polarization == pytest.approx(np.linalg.norm(expected), abs=allowed)


def test_rays_of_a_point() -> None:
    turned = mi.ScalarTransform4f().rotate([1, 0, 0], 50.0)
    face = {"type": "asphere", "semi_diameter": 40.0, "to_world": turned, "bsdf": {"type": "interface", "back": "1.7"}}
    detector = square(60.0, z=60.0, bsdf={**BLACK, "front": "1.7"})
    lamp = {"type": "point_source", "z": -30.0, "half_angle_deg": 35.0, "jones": "1, 0.5-0.5i"}
    t = mistray.trace(lit(lamp, face=face, detector=detector), rays=3000, max_reflections=0)
    (row,) = t.paths.find("face:T")
    normal = np.array(turned.matrix, dtype=float)[:3, 2]
    stokes = (1 / 3, 2 / 3, 2 / 3)  # 2 ex ey* = 1 + i, of 1.5
    states, fluxes = [], []
    for _, ray in t.history(row.path_id, n=200).to_pandas().groupby("ray"):
        d, measured = ray[["dx", "dy", "dz"]].to_numpy()[:-1], ray.flux_W.to_numpy()
        # x turned about z × d by the angle between z and the direction (Rodrigues)
        axis, x = np.cross([0.0, 0.0, 1.0], d[0]) / np.hypot(*d[0, :2]), np.array([1.0, 0.0, 0.0])
        u = d[0, 2] * x + np.hypot(*d[0, :2]) * np.cross(axis, x) + (1 - d[0, 2]) * (axis @ x) * axis
        flux, fields = carry(d, [Hit("T", 1.0, 1.7)], 550.0, starting(d[0], u, stokes))
        # The rounding of a cosine of incidence by 2e-7, times |dT / d cos θ| < 10, steeper close to grazing
        assert measured[2] / measured[0] == pytest.approx(flux[-1], abs=2e-6 / max(abs(d[0] @ normal), 0.05))
        states.append(ending(fields, d[-1]))
        fluxes.append(flux[-1] * measured[0])
    assert len(states) == 200
    # The rays of a history are some of the path's: 5 standard errors of a mean, 2e-6 by chance for three means
    mean, error = np.average(states, axis=0, weights=fluxes), np.std(states, axis=0) / np.sqrt(200)
    assert np.all(np.abs(np.subtract(mean, (row.s1, row.s2, row.s3))) < 5 * error + 1e-6)


def test_polarisation_of_sources_scatter_and_renderings(load_scene) -> None:
    text = plates_text(1).replace(
        "</emitter>", '</emitter><emitter type="collimated" id="laser"><float name="radius" value="1.0"/>'
        '<float name="polarization_deg" value="0"/></emitter>', 1,
    )  # fmt: skip
    t = mistray.trace(load_scene(text), rays=128, field_deg=45.0, max_reflections=0)
    by_source = {row.source: row for row in t.paths}
    laser = by_source.pop("laser")
    (plain,) = by_source.values()
    r_s, r_p = fresnel(45.0, 1.5)
    assert laser.power_W / np.pi == pytest.approx((1 - r_s) ** 2, rel=3e-6)
    assert plain.power_W / np.pi == pytest.approx(((1 - r_s) ** 2 + (1 - r_p) ** 2) / 2, rel=3e-6)
    assert (laser.s1, laser.polarization) == pytest.approx((1, 1), abs=1e-6)
    assert t.settings["source_stokes"] == {"laser": (1.0, 0.0, 0.0)}
    rough = scattering_xml([bsdf_xml("abg", A=0.1, B=1.0, g=0.0)], R=0.5)
    text = scene_text(
        shape_xml("asphere", "wall", 20.0, rough, semi_diameter=20.0),
        shape_xml("asphere", "detector", -10.0, sensor=True, semi_diameter=30.0, inner_semi_diameter=2.0),
        stokes="0, 0.6, 0.8",
    )
    t = mistray.trace(load_scene(text), rays=2000)
    scattered = [row for row in t.paths if row.scatters]
    assert scattered
    assert all(row.polarization == 0 for row in scattered)
    text = plates_text(1).replace("</emitter>", '<float name="polarization_deg" value="90"/></emitter>')
    scene = load_scene(text.replace('name="radius"', 'name="field_deg" value="45"/><float name="radius"'))
    image = np.array(mi.render(scene, integrator=mi.load_dict({"type": "straylight", "rays": 64})))
    assert image.sum() * 100.0**2 / 64**2 == pytest.approx(mistray.trace(scene, rays=64).energy.detected_W, rel=1e-5)
    text = plates_text(1)
    plain, none, scene = (
        load_scene(text.replace("</emitter>", f"{inside}</emitter>"))
        for inside in ("", '<string name="stokes" value="0, 0, 0"/>', '<string name="jones" value="1, 1i"/>')
    )
    for unpolarized in (plain, none):
        settings = mistray.trace(unpolarized, rays=64).settings
        assert (settings["polarization"], "source_stokes" in settings) == ("unpolarized", False)
    metric = mistray.optimize.path_power(scene, "ghost", rays=16)
    each_refused(
        (lambda: mistray.trace(scene, rays=64, polarization="unpolarized"), r"polarised.*'unpolarized'.*'stokes'"),
        (lambda: mistray.pst(scene, [10.0], rays=640, method="adjoint"), r"polarised.*polarization='unpolarized'"),
        (lambda: mistray.pst(scene, [10.0], rays=640, method="forward"), r"polarised.*polarization='unpolarized'"),
        (lambda: mistray.study(scene, quick=True), r"polarised.*PST"),
        (lambda: mistray.gradient(metric, mi.traverse(scene), keys=["p0_front.z"]), "sources without stokes"),
    )
    assert np.all(np.isfinite(mistray.pst(scene, [10.0], rays=640, polarization="unpolarized").value))
    mistray.thermal(scene, rays=640)  # has nothing to do with the source


@pytest.mark.parametrize("seed", range(20))
def test_jones_vectors_are_their_fields_in_time(seed) -> None:
    """s1 and s2 are the power through polarisers, the sign of s3 is the sense in which the field turns."""
    rng = np.random.default_rng(seed)
    ex, ey = rng.normal(size=2) + 1j * rng.normal(size=2)
    turn = np.exp(-1j * np.linspace(0, 2 * np.pi, 721))  # the real field Re(e exp(-iωt)) over a period
    x, y = (ex * turn).real, (ey * turn).real
    total = np.mean(x[:-1] ** 2 + y[:-1] ** 2)
    s1, s2, s3 = polarization_state("", jones=(ex, ey))
    assert s1 == pytest.approx(np.mean(x[:-1] ** 2 - y[:-1] ** 2) / total, abs=1e-12)
    assert s2 == pytest.approx(np.mean(2 * x[:-1] * y[:-1]) / total, abs=1e-12)
    assert s1**2 + s2**2 + s3**2 == pytest.approx(1, abs=1e-12)
    # With x to the right and y up the light comes to the observer: counter-clockwise is from x to y
    assert np.sign(np.sum(x[:-1] * np.diff(y) - y[:-1] * np.diff(x))) == -np.sign(s3)


def test_ways_to_state_it_and_what_no_light_can_be() -> None:
    for given, expected in (
        ({"polarization_deg": 0.0}, (1, 0, 0)),
        ({"polarization_deg": -45.0}, (0, -1, 0)),
        ({"polarization_deg": 90.0}, (-1, 0, 0)),
        ({"jones": "1, -1i"}, (0, 0, 1)),
        ({"jones": "1 +j"}, (0, 0, -1)),
        ({"jones": "0, 3e-12"}, (-1, 0, 0)),
        ({"jones": (1e30, 0)}, (1, 0, 0)),
        ({"jones": "0.6+0.8i, -0.6-0.8i"}, (0, -1, 0)),
        ({"stokes": "0.1, 0.2, -0.3"}, (0.1, 0.2, -0.3)),
        ({"stokes": (0.57735, 0.57735, 0.57736)}, (0.57735, 0.57735, 0.57736)),
        ({"stokes": np.array([0.0, 0.0, 1.0])}, (0, 0, 1)),
        ({"stokes": "0, 0, 0"}, None),
        ({}, None),
    ):
        assert polarization_state("", **given) == pytest.approx(expected, abs=1e-5)
    assert jones_numbers("", "1, 0.5-2i") == (1, 0.5 - 2j)
    known = vectors.toml("refusals.toml")["polarization of a source"]
    for given, fact in [*known, ({"jones": (complex("nan"), 1)}, "2 numbers")]:
        with refused("source 'laser'", fact):
            polarization_state("source 'laser'", **given)

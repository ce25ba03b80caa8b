"""Media that absorb and scatter: Beer and Lambert's law, slabs against float64 photons, quadratures."""

import mitsuba as mi
import numpy as np
import pytest
from oracles import bulk
from oracles.scatter_integrals import gauss_legendre
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml
from oracles.statistics import assert_z, z_limit, z_score
from scene_dicts import BLACK, at, detector, load

import mistray

THICKNESS, GAP = 10.0, 5.0  # mm


def slab_text(material: str) -> str:
    """A slab of 10 mm that does not refract, so wide that its black edge is dark, and a detector that is wider."""
    window = {"R": 0.0, "T": 1.0}
    return scene_text(
        shape_xml("asphere", "front", 0.0, interface_xml("air", material, **window), semi_diameter=300.0),
        shape_xml("asphere", "rear", THICKNESS, interface_xml(material, "air", **window), semi_diameter=300.0),
        shape_xml("frustum", "edge", r0=300.0, r1=300.0, z0=0.0, z1=THICKNESS),
        shape_xml("asphere", "detector", THICKNESS + 0.1, sensor=True, semi_diameter=310.0),
    )


@pytest.mark.parametrize(("albedo", "g"), [(1.0, 0.0), (1.0, 0.8), (0.7, -0.4)])
@pytest.mark.parametrize("splitting", ["split", "one"])
def test_slab_against_photons(load_scene, albedo: float, g: float, splitting: str) -> None:
    """Transmission of a slab of optical thickness 1.5, many scatters; false alarm 1e-3 for all six cases."""
    per_mm = 0.15
    k = (1 - albedo) * per_mm * 550e-6 / (4 * np.pi)
    scene = load_scene(slab_text(f"1.0+{k:.12g}i scatter={per_mm * albedo:.12g} g={g}"))
    limits = {"max_scatters": 60, "flux_threshold": 1e-12, "max_events": 64}
    energy = mistray.trace(scene, rays=100_000, splitting=splitting, ledger=False, **limits).energy
    photons = 1_000_000
    through, back, absorbed = bulk.slab(1.5, albedo, g, 1.0, photons, seed=3)
    assert through + back + absorbed == pytest.approx(1, abs=1e-9)
    measured, se = energy.detected_W / energy.launched_W, energy.detected_se_W / energy.launched_W
    assert abs(z_score(measured, through, np.hypot(se, np.sqrt(through * (1 - through) / photons)))) < z_limit(6)
    assert abs(energy.closure) < 1e-5
    (taken,) = energy.absorbed_in.values() if albedo < 1 else [(0.0, 0.0)]
    assert taken[0] / energy.launched_W == pytest.approx(absorbed, abs=5 * np.hypot(taken[1], 5e-4))


@pytest.mark.long
def test_what_a_thin_slab_takes(load_scene) -> None:
    """The optical depth, also where 1 - exp(-depth) is below the last bit of float32."""
    share = []
    for depth in (1e-8, 1e-7, 3e-5):
        k = 0.5 * depth / THICKNESS * 550e-6 / (4 * np.pi)
        scene = load_scene(slab_text(f"1.0+{k:.12g}i scatter={0.5 * depth / THICKNESS:.12g}"))
        energy = mistray.trace(scene, rays=1000, ledger=False).energy
        (absorbed, _), *_ = energy.absorbed_in.values()
        share.append([absorbed / energy.launched_W / depth, energy.escaped_W / energy.launched_W / depth])
    # A half each; of the scattered light the half that goes back escapes, but for 2 % that meet the edge
    assert np.array(share)[:, 0] == pytest.approx(0.5, rel=1e-4)
    assert np.array(share)[:, 1] == pytest.approx(0.25, rel=0.1)


@pytest.mark.long
def test_a_lamp_within_a_medium() -> None:
    """Its light is weakened from the lamp on, also where it goes to a black wall."""
    glass = f"1.0+{0.05 * 550e-6 / (4 * np.pi):.12g}i"
    front = {"type": "interface", "front": glass, "back": "air", "R": 0.0, "T": 1.0}
    body = {
        "front": {"type": "asphere", "semi_diameter": 5.0, "bsdf": front},
        "edge": {"type": "frustum", "z0": -20.0, "z1": 0.0, "r0": 5.0, "r1": 5.0, "bsdf": BLACK},
        "back": {"type": "asphere", "to_world": at(-20.0), "semi_diameter": 5.0, "bsdf": BLACK},
        "detector": detector(1.0, semi_diameter=10.0),
    }
    for along, seen, length in ((1.0, np.exp(-0.75), 15.0), (-1.0, 0.0, 5.0)):
        turned = mi.ScalarTransform4d().rotate([0, 1, 0], 90 - 90 * along)
        lamp = {"type": "point_source", "to_world": turned, "z": -15.0 * along, "half_angle_deg": 1.0}
        energy = mistray.trace(load(lamp=lamp, **body), rays=1000, ledger=False).energy
        assert energy.detected_W / energy.launched_W == pytest.approx(seen, rel=1e-3)
        (absorbed, _), *_ = energy.absorbed_in.values()
        assert absorbed / energy.launched_W == pytest.approx(1 - np.exp(-0.05 * length), rel=1e-3)


@pytest.mark.long
def test_a_lamp_far_away_within_a_medium() -> None:
    """Its light is weakened on all of its way, also by many diameters of the scene."""
    front = {"type": "interface", "front": f"1.0+{5e-3 * 550e-6 / (4 * np.pi):.12g}i", "R": 0.0, "T": 1.0}
    scene = load(
        lamp={"type": "point_source", "z": -200.0, "half_angle_deg": 0.1},
        front={"type": "asphere", "semi_diameter": 1.0, "bsdf": front},
        detector=detector(0.5, semi_diameter=1.0),
    )
    energy = mistray.trace(scene, rays=1000, ledger=False).energy
    assert energy.detected_W / energy.launched_W == pytest.approx(np.exp(-1), rel=1e-4)


@pytest.mark.long
def test_scatter_close_to_a_mesh() -> None:
    """Light that is scattered within some roundings of a stock mirror meets it as it meets one of our own."""
    haze = {"type": "interface", "front": "air", "back": "1.0 scatter=5", "R": 0.0, "T": 1.0}
    found = []
    for kind in ({"type": "asphere", "half_width": 60.0, "half_height": 60.0}, {"type": "rectangle"}):
        place = at(0.1) if "half_width" in kind else at(0.1).scale([60.0, 60.0, 1.0])
        scene = load(
            front={"type": "asphere", "semi_diameter": 50.0, "bsdf": haze},
            mirror={**kind, "to_world": place, "bsdf": {"type": "interface", "R": 0.8}},
            detector=detector(-20.0, semi_diameter=200.0),
            beam={"type": "collimated", "radius": 1.0, "distance": 10.0},
        )
        found.append(mistray.trace(scene, rays=3000, max_scatters=20, splitting="one", ledger=False).energy.escaped_W)
    assert found[1] == pytest.approx(found[0], rel=1e-4)


@pytest.mark.parametrize("depth", [60.0, 2000.0])
def test_what_a_dense_slab_sends_back(load_scene, depth: float) -> None:
    """1 - H(1) √(1 - ω) of a half space (Chandrasekhar, Radiative Transfer, section 38); false alarm 1e-4 each."""
    albedo, per_mm = 0.8, depth / THICKNESS
    mu, weight = gauss_legendre(np.array([0.0, 1.0]), 64)
    h, root = np.ones_like(mu), np.sqrt(1 - albedo)
    for _ in range(100):  # 1/H(μ) = √(1 - ω) + ω/2 ∫ μ' H(μ')/(μ + μ') dμ'
        h = 1 / (root + 0.5 * albedo * (weight * mu * h / (mu[:, None] + mu)).sum(axis=1))
    h_1 = 1 / (root + 0.5 * albedo * np.sum(weight * mu * h / (1 + mu)))
    k = (1 - albedo) * per_mm * 550e-6 / (4 * np.pi)
    scene = load_scene(slab_text(f"1.0+{k:.12g}i scatter={per_mm * albedo:.12g}"))
    trace = mistray.trace(scene, rays=30_000, splitting="one", ledger=False, max_scatters=60, flux_threshold=1e-12)
    energy = trace.energy
    back, se = energy.escaped_W / energy.launched_W, energy.escaped_se_W / energy.launched_W
    assert se < 0.01
    assert_z("sent back", back, 1 - h_1 * root, se, false_alarm=1e-4)


@pytest.mark.parametrize("splitting", ["split", "one"])
def test_one_child_of_a_surface_leaves_the_medium_alone(load_scene, splitting: str) -> None:
    """Its lobe takes 30 % of what the medium before it has scattered once, whoever gets the flux; false alarm 1e-4."""
    medium, through = "1.0 scatter=0.05 g=0.9", []
    for lobes in ([], [bsdf_xml("gaussian_lobe", total=0.3, width=0.05, event="transmission")]):
        rear = scattering_xml(lobes, medium, "air", R=0.0, T=1.0)
        rear = rear.removesuffix("</bsdf>") + f'<string name="splitting" value="{splitting}"/></bsdf>'
        scene = load_scene(slab_text(medium).replace(interface_xml(medium, "air", R=0.0, T=1.0), rear))
        (row,) = (row for row in mistray.trace(scene, rays=20_000, max_scatters=1).paths if row.path == "TtTA")
        through.append((row.power_W, row.power_se_W))
    (bare, bare_se), (rough, se) = through
    assert_z("scattered in the medium", rough, 0.7 * bare, np.hypot(se, 0.7 * bare_se), false_alarm=1e-4)


def test_thin_media_keep_their_digits(load_scene) -> None:
    """An optical thickness of 1e-6 scatters 1e-6 of the light, nearly all of it forward if g = 0.95."""
    trace = mistray.trace(load_scene(slab_text("1.0 scatter=1e-7 g=0.95")), rays=100_000)
    row = max(trace.paths.find("(1.0_scatter=1e-7_g=0.95):t"), key=lambda row: row.power_W)
    (direct,) = (row for row in trace.paths if row.kind == "direct")
    assert row.power_W / direct.power_W == pytest.approx(1e-6, rel=0.1)  # float32: 1 - 1e-6 is rounded to 6e-8
    assert (row.kind, row.scatter_1) == ("single scatter", "(1.0_scatter=1e-7_g=0.95)")


def test_rays_turn_within_the_medium(load_scene) -> None:
    """Recorded rays have a node inside of the slab, at depths that fall off as exp(-τ)."""
    trace = mistray.trace(load_scene(slab_text("1.0 scatter=0.1 g=0.9")), rays=50_000)
    row = max(trace.paths.find("(1.0_scatter=0.1_g=0.9):t"), key=lambda row: row.power_W)
    assert row.path == "TtTA"
    history = trace.history(row.path_id, 400).to_pandas()
    inside = history[history.surface.str.startswith("(")]
    assert (len(inside), set(inside.intercept)) == (400, {"RandTran"})
    assert inside.z_mm.between(0, THICKNESS).all()
    # Density of the depth of the one event on the way to the far face; each ray counts with the flux that arrives
    arriving = history.groupby("ray").flux_W.last().to_numpy()
    z = np.linspace(0, THICKNESS, 20001)
    cosines = np.linspace(1e-6, 1, 2001)
    phase = (1 - 0.81) / (1 + 0.81 - 1.8 * cosines) ** 1.5
    leaves = np.array([np.trapezoid(phase * np.exp(-0.1 * (THICKNESS - d) / cosines), cosines) for d in z[::100]])
    density = np.exp(-0.1 * z) * np.interp(z, z[::100], leaves)
    mean = np.trapezoid(z * density, z) / np.trapezoid(density, z)
    spread = np.sqrt(np.trapezoid(z * z * density, z) / np.trapezoid(density, z) - mean**2)
    assert abs(np.average(inside.z_mm, weights=arriving) - mean) < 5 * spread / np.sqrt(400)


def once_into_disc(sigma: float, g: float, radius: float) -> float:
    """Share of an axial beam that is scattered once in a slab of the index around it, and leaves it into a disc."""
    z, wz = gauss_legendre(np.linspace(0.0, THICKNESS, 9), 16)
    total = 0.0
    for depth, weight in zip(z, wz, strict=True):
        least = np.cos(np.arctan2(radius, THICKNESS - depth + GAP))
        mu, wm = gauss_legendre(1 - (1 - least) * np.linspace(1.0, 0.0, 17) ** 4, 16)
        phase = (1 - g * g) / (2 * (1 + g * g - 2 * g * mu) ** 1.5)  # Henyey and Greenstein's, over the azimuth
        inner = np.sum(wm * phase * np.exp(-sigma * (THICKNESS - depth) / mu))
        total += weight * sigma * np.exp(-sigma * depth) * inner
    return float(total)


@pytest.mark.parametrize(("sigma", "g"), [(0.02, 0.0), (0.05, 0.8), (0.05, -0.5), (0.2, 0.95)])
@pytest.mark.parametrize("radius", [2.0, 20.0])
@pytest.mark.parametrize("splitting", ["split", "one"])
def test_single_scatter(load_scene, sigma: float, g: float, radius: float, splitting: str) -> None:
    """What is not scattered, and what is scattered once into a disc: 4 standard errors, false alarm 6e-5 each."""
    settings = {"rays": 400_000, "max_scatters": 1, "aim": "none", "splitting": splitting}
    medium, window = f"1.0 scatter={sigma!r} g={g!r}", {"R": 0.0, "T": 1.0}
    rear = {"at": (0.0, 0.0, THICKNESS), "semi_diameter": 500.0}
    text = scatter_scene(
        beam_xml(1e-3, power=1.0, distance=5.0),
        placed_xml("asphere", "front", interface_xml("air", medium, **window), semi_diameter=500.0),
        placed_xml("asphere", "rear", interface_xml(medium, **window), **rear),
        placed_xml("asphere", "detector", at=(0.0, 0.0, THICKNESS + GAP), pixels=4, semi_diameter=radius),
    )
    t = mistray.trace(load_scene(text), **settings)
    power, se = t.paths.power([row.path_id for row in t.paths if row.scatter_1 == "-"])
    assert_z("straight on", power, np.exp(-sigma * THICKNESS), se, k=4.0, floor=1e-6)
    power, se = t.paths.power([row.path_id for row in t.paths if row.scatter_1 != "-"])
    expected = once_into_disc(sigma, g, radius)
    assert_z("scattered once", power, expected, se, k=4.0)
    assert se < 0.06 * expected
    assert abs(t.energy.closure) < 1e-6


TAU = 0.9  # of 5 mm at 550 nm
K = float(-np.log(TAU) * 550e-6 / (4 * np.pi * 5.0))
DARK = f"1.5+{K!r}i"


def coated_plate() -> str:
    text = plates_text(1, index=DARK, R=0.02, T=0.98)
    rear = interface_xml(DARK, "air", R=0.02, T=0.98)
    assert rear in text
    return text.replace(rear, interface_xml(DARK, "air", R=0.05, T=0.95))


@pytest.mark.quick
class TestPlate:
    @pytest.mark.parametrize("how", [{}, {"splitting": "one"}, {"polarization": "stokes"}])
    def test_all_orders(self, load_scene, how: dict[str, str]) -> None:
        """T = (1-R1)(1-R2)τ/(1-R1R2τ²), R = R1 + (1-R1)²R2τ²/(1-R1R2τ²), the rest stays in the glass."""
        settings = {"rays": 20_000, "max_reflections": 12, "flux_threshold": 0.0}
        e = mistray.trace(load_scene(coated_plate()), **settings, **how).energy
        many = 1 - 0.02 * 0.05 * TAU**2
        through = 0.98 * 0.95 * TAU / many
        back = 0.02 + 0.98**2 * 0.05 * TAU**2 / many
        assert through == pytest.approx(0.8385792491918453, rel=1e-12)
        # False-alarm probability of what is sampled: 4.5 σ, 7e-6
        assert_z("T", e.detected_W / e.launched_W, through, e.detected_se_W / e.launched_W, k=4.5, floor=2e-6 * through)
        assert_z("R", e.escaped_W / e.launched_W, back, e.escaped_se_W / e.launched_W, k=4.5, floor=1e-5 * back)
        assert set(e.absorbed_in) == {DARK}
        (value, se), stays = e.absorbed_in[DARK], 1 - through - back
        assert_z("absorbed", value / e.launched_W, stays, se / e.launched_W, k=4.5, floor=1e-5 * stays)
        assert "splitting" in how or se / e.launched_W < 1e-6
        assert sum(v for v, _ in e.absorbed.values()) == pytest.approx(0, abs=1e-6)
        assert abs(e.closure) < 1e-6
        assert f"absorbed in {DARK}" in str(e)

    def test_slanted_in_two_wavelengths(self, load_scene) -> None:
        """The way through the plate is 5 mm/cos θ', and the same k absorbs more at a shorter wavelength: τ^(550/λ)."""
        settings = {"wavelength_nm": [400.0, 550.0], "field_deg": 40.0, "max_reflections": 0}
        t = mistray.trace(load_scene(coated_plate()), rays=900, **settings)
        way = 1 / np.sqrt(1 - (np.sin(np.radians(40)) / 1.5) ** 2)
        for wavelength in (400.0, 550.0):
            (row,) = (row for row in t.paths if row.wavelength_nm == wavelength)
            expected = 0.98 * 0.95 * TAU ** (way * 550 / wavelength)
            assert row.power_W / (t.energy.launched_W / 2) == pytest.approx(expected, rel=3e-6)
            assert abs(t.energy_at(wavelength).closure) < 1e-6
        total = sum(t.energy_at(w).absorbed_in[DARK][0] for w in (400.0, 550.0))
        assert t.energy.absorbed_in[DARK][0] == pytest.approx(total, rel=1e-12)


@pytest.mark.quick
def test_light_lost_at_walls_and_in_metal(load_scene) -> None:
    """A painted rear face (R = 0.6) sends the light back through the glass: 1 - τ and again R τ (1 - τ)."""
    text = scene_text(
        shape_xml("asphere", "front", 0.0, interface_xml("air", DARK, R=0.0, T=1.0), semi_diameter=20.0),
        shape_xml("asphere", "paint", 5.0, interface_xml(R=0.6), semi_diameter=20.0),
        shape_xml("asphere", "detector", 50.0, sensor=True, half_width=5.0, half_height=5.0),
    )
    e = mistray.trace(load_scene(text), rays=100).energy
    assert e.absorbed_in[DARK][0] / e.launched_W == pytest.approx((1 - TAU) * (1 + 0.6 * TAU), rel=1e-5)
    assert e.absorbed["paint"][0] / e.launched_W == pytest.approx(TAU * 0.4, rel=1e-5)
    assert e.escaped_W / e.launched_W == pytest.approx(TAU**2 * 0.6, rel=1e-5)
    assert abs(e.closure) < 1e-6
    t = mistray.trace(load_scene(coated_plate()), rays=100, max_reflections=2)
    (ghost,) = (row for row in t.paths if row.order == 2)
    flux = t.history(ghost.path_id, n=1).to_pandas().flux_W.to_numpy()
    np.testing.assert_allclose(flux / flux[0], np.cumprod([1, 1, 0.98 * TAU, 0.05 * TAU, 0.02 * TAU, 0.95]), rtol=3e-6)
    n = 0.958 + 6.69j
    text = scene_text(
        shape_xml("asphere", "mirror", 0.0, interface_xml("air", "0.958+6.69i"), semi_diameter=20.0),
        shape_xml("asphere", "detector", 50.0, sensor=True, half_width=5.0, half_height=5.0),
    )
    for field in (0.0, 60.0):
        e = mistray.trace(load_scene(text), rays=100, field_deg=field).energy
        c = np.cos(np.radians(field))
        q = np.sqrt(n * n - np.sin(np.radians(field)) ** 2)
        r_s, r_p = (c - q) / (c + q), (n * n * c - q) / (n * n * c + q)
        R = (abs(r_s) ** 2 + abs(r_p) ** 2) / 2
        assert e.absorbed["mirror"][0] / e.launched_W == pytest.approx(1 - R, abs=2e-6)
        assert e.escaped_W / e.launched_W == pytest.approx(R, abs=2e-6)
        assert abs(e.closure) < 1e-6

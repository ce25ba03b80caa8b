"""R and T in the kernel against tmm, light through bodies that absorb, and stock shapes beside analytic surfaces."""

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
import tmm
from oracles import nonsequential
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import interface_xml, meter_xml, scene_text, shape_xml
from refusals import each_refused

import mistray
from mistray.coatings import CoatingTable, Ideal, Layer, Stack
from mistray.gradients.coating_gradient import layer_row_derivatives, row_derivatives
from mistray.kernel.interaction import interact
from mistray.mechanics.ply import ply_bytes
from mistray.report import main_table
from mistray.surfaces import optics
from mistray.surfaces.surfaces import SurfaceTable

BOUND = 1e-5
ROUNDING = 4 * 2.0**-24  # of the squared cosine, by float32 directions of unit length
Layers = list[tuple[complex, float]]


def random_stack(rng: np.random.Generator, most: int = 40) -> tuple[Layers, float]:
    """1 to `most` layers, one in four absorbing, and the index of the glass."""
    layers = []
    for _ in range(rng.integers(1, most + 1)):
        k = 10 ** rng.uniform(-4, 0.5) if rng.random() < 0.25 else 0.0
        layers.append((rng.uniform(1.3, 2.4) + 1j * k, rng.uniform(5.0, 200.0)))
    return layers, float(rng.choice([1.0, 1.45, 1.5168, 1.8]))


def scene_with(layers: Layers, glass: float, reverse: bool) -> str:
    """One coated plane; the first layer touches air; glass behind, or in front if `reverse`."""
    text = ", ".join(f"{n.real!r}+{n.imag!r}i {d!r}" for n, d in layers)
    sides = ("air", repr(glass)) if not reverse else (repr(glass), "air")
    film = bsdf_xml("thinfilm", layers=text, first="back" if reverse else "front")
    return scene_text(
        shape_xml("asphere", "film", 0.0, scattering_xml([film], *sides), semi_diameter=5.0),
        shape_xml("asphere", "detector", 20.0, sensor=True, half_width=9.0, half_height=9.0),
    )


def kernel(table: SurfaceTable, cosines: np.ndarray, from_front: bool, stokes: bool) -> tuple[np.ndarray, ...]:
    """What the kernel finds at the plane: R, T and in Stokes mode the coefficients of both children."""
    c = mi.Float(cosines)
    d = mi.Vector3f(dr.sqrt(1 - c * c), 0, c if from_front else -c)
    surface = dr.full(mi.UInt32, table.ids.index("film"), len(cosines))
    vector = dr.zeros(mi.Vector3f, len(cosines)) if stokes else None
    it = interact(table, dr.zeros(mi.Vector3f, len(cosines)), d, surface, None, vector, mi.Bool(True))
    if not stokes:
        return np.array(it.R), np.array(it.T)
    assert it.polarized is not None
    return tuple(np.array(m.coefficients) for m in (it.polarized.reflection, it.polarized.transmission))


def oracle(layers: Layers, n_in: float, n_out: float, cosines: np.ndarray) -> np.ndarray:
    """(8, m): R, T of s and of p; real and imaginary parts of r_s r_p* and of the same for T."""
    values = []
    for c in cosines.astype(float):
        angle = np.arccos(c)
        index, d = [n_in, *(n for n, _ in layers), n_out], [np.inf, *(t for _, t in layers), np.inf]
        s, p = (tmm.coh_tmm(pol, index, d, angle, 550.0) for pol in "sp")
        product = s["r"] * np.conj(p["r"])
        through = s["t"] * np.conj(p["t"])
        through = np.sqrt(max(s["T"] * p["T"], 0.0)) * through / abs(through) if abs(through) > 0 else 0j
        values.append([s["R"], p["R"], s["T"], p["T"], product.real, product.imag, through.real, through.imag])
    return np.array(values).T


@pytest.mark.parametrize("seed", range(8))
def test_random_stacks(load_scene, seed) -> None:
    rng = np.random.default_rng(seed)
    layers, glass = random_stack(rng)
    for reverse in (False, True):
        scene = load_scene(scene_with(layers, glass, reverse))
        for stokes in (False, True):
            table = SurfaceTable(scene, 550.0, stokes=stokes)
            for from_front in (True, False):
                in_air = from_front != reverse
                n_in, n_out = (1.0, glass) if in_air else (glass, 1.0)
                ordered = layers if in_air else layers[::-1]
                cosines = rng.uniform(np.cos(np.radians(89.9)), 1.0, 20).astype(np.float32)
                expected = oracle(ordered, n_in, n_out, cosines)
                # What a change of the cosine's square by a few float32 roundings does: the angle is not known better
                square = cosines.astype(float) ** 2
                near = [np.sqrt(np.clip(square + step, 0, 1)) for step in (-ROUNDING, ROUNDING)]
                allowed = sum(np.abs(oracle(ordered, n_in, n_out, c) - expected) for c in near)
                total = (n_in / n_out) ** 2 * (1 - square) >= 1
                made = table.optics.tables[table.ids.index("film")]
                assert made is not None
                assert made.refraction_error <= BOUND / 5
                allowed += np.where(total, max(BOUND, made.total_error), BOUND)
                found = kernel(table, cosines, from_front, stokes)
                if stokes:
                    found = (*found[0][:2], *found[1][:2], *found[0][2:], *found[1][2:])
                else:
                    expected, allowed = (x[:4].reshape(2, 2, -1).mean(axis=1) for x in (expected, allowed))
                for k, row in enumerate(np.array(found)):
                    assert np.all(np.abs(row - expected[k]) < allowed[k]), (k, stokes, from_front, reverse)


def test_fixed_shares_are_the_same_up_to_the_critical_angle_and_beyond() -> None:
    """Where R leaps from R to R + T, the node itself lies on either side by the rounding of its cosine."""
    columns = {"wavelength_nm": 550.0, "angle_deg": 0.0, "R": 0.02, "T": 0.97}
    table = CoatingTable.from_columns("t", {key: np.array([value]) for key, value in columns.items()})
    for n in np.linspace(1.4, 2.5, 41).round(3).tolist():
        for sides in ((1 + 0j, n + 0j), (n + 0j, 1.33 + 0j)):
            for coating in (Ideal(0.02, 0.97), table):
                found = optics.angle_table(coating, 550.0, *sides, False, False)
                np.testing.assert_allclose(found.refraction[..., 0], [[0.02, 0.02, 0.97]] * 2, atol=1e-12)
                np.testing.assert_allclose(found.total[..., 0], [[0.99, 0.99, 0.0]] * 2, atol=1e-12)


def test_a_mirror_in_air_has_equal_derivatives_from_both_sides(load_text) -> None:
    """Its layers face the light; what moves is the thickness and the index of both, and the air of either side."""
    layers = bsdf_xml("thinfilm", layers="1.6+0.05i 172, 0.1+3.6i 20", opaque=True)
    shape = shape_xml("asphere", "mirror", 5.0, scattering_xml([layers]), semi_diameter=3.0)
    film = shape_xml("asphere", "film", 9.0, sensor=True, semi_diameter=3.0)
    table = SurfaceTable(load_text(scene_text(shape, film))[0], 550.0)
    surface, used = table.ids.index("mirror"), np.array([40, 100, 200])
    (by_layers,) = layer_row_derivatives(table.optics, [(surface, used, ["thickness_nm", "n_shift"])])
    by_air = [row_derivatives(table.optics, surface, side)[used] for side in (0, 1)]
    assert np.abs(by_layers).max() > 1e-3 < np.abs(by_air).max()
    np.testing.assert_allclose(by_layers[:, :, 0], by_layers[:, :, 1], atol=1e-12)
    np.testing.assert_allclose(by_air[0][:, 0], by_air[1][:, 1], atol=1e-12)


def test_a_film_of_a_file_that_changes_is_tabulated_again(tmp_path: Path) -> None:
    """In one process, under the same name: the disk cache would keep the old numbers as those of the new file."""
    stack = Stack((Layer(str(tmp_path / "film.csv"), 99.6),), "front")
    shares = []
    for n in (1.38, 2.3, 2.3):
        (tmp_path / "film.csv").write_text(f"wavelength_nm,n,k\n400,{n},0\n700,{n:.6f},0\n")
        known = optics.angle_table(stack, 550.0, 1 + 0j, 1.5 + 0j, False, False)
        there = stack.response(550.0, 1 + 0j, 1.5 + 0j, np.ones(1), True).R.mean()
        assert known.refraction[-1, optics.REFLECTION_FRONT, 0] == pytest.approx(there, rel=1e-9)
        shares.append(there)
    assert shares[0] < 0.05 < shares[1]
    assert shares[1] == shares[2]
    assert optics.angle_table(stack, 550.0, 1 + 0j, 1.5 + 0j, False, False) is known, "evaluated once"


def plate(medium: str, thickness_mm: float, wavelength_nm: float) -> mi.Scene:
    """A plate with its edge in a beam; everything that the faces and the edge do is Fresnel's."""
    face = {"type": "asphere", "semi_diameter": 5.0}
    edge = {"type": "frustum", "r0": 5.0, "z0": 0.0, "r1": 5.0, "z1": thickness_mm}
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 1.0, "wavelength_nm": wavelength_nm},
        face=face | {"bsdf": {"type": "interface", "back": medium}},
        rear=face | {"z": thickness_mm, "bsdf": {"type": "interface", "front": medium}},
        edge=edge | {"bsdf": {"type": "interface", "front": medium, "R": 0.0}},
        detector=scene_dicts.detector(thickness_mm + 5, semi_diameter=20.0),
    )


@pytest.mark.parametrize("case", [(10_000.0, 0.1, 0.0), (13.5, 2e-4, 0.0), (4000.0, 0.02, 0.0), (10_000.0, 0.1, 40.0)])
def test_transmittance_of_a_plate(case: tuple[float, float, float]) -> None:
    """Beer and Lambert times Fresnel for every k, without a jump at any of them; aside the path is longer."""
    wavelength_nm, thickness_mm, field_deg = case
    inside = np.cos(np.arcsin(np.sin(np.radians(field_deg)) / 1.5))
    settings = {"rays": 100, "max_reflections": 0, "field_deg": field_deg}
    clear = mistray.trace(plate("1.5", thickness_mm, wavelength_nm), **settings).energy.detected_W
    for k in (0.0009, 0.001, 0.0011, 0.005, 0.03) if field_deg == 0 else (0.004,):
        t = mistray.trace(plate(f"1.5+{k}i", thickness_mm, wavelength_nm), **settings)
        beer = np.exp(-4e6 * np.pi * k * thickness_mm / wavelength_nm / inside)
        if field_deg == 0:
            once = 1 - (0.5**2 + k**2) / (2.5**2 + k**2)
            assert t.energy.detected_W / t.energy.launched_W == pytest.approx(once**2 * beer, rel=5e-5), k
        else:
            assert t.energy.detected_W / clear == pytest.approx(beer, rel=5e-5)
        assert abs(t.energy.closure) < 1e-6
        assert t.own_notes == []


def test_dark_bodies_metals_and_cubes() -> None:
    """0.5 mm of a black glass leave e^-57 of the light; the note says so in the report, too."""
    scene = plate("1.5+0.005i", 0.5, 550.0)
    t = mistray.trace(scene, rays=100, max_reflections=0)
    assert t.energy.detected_W == 0
    assert t.energy.absorbed["face"][0] == pytest.approx(0.96 * t.energy.launched_W, rel=1e-3)
    weak = mistray.trace(plate("1.5+0.0005i", 10.0, 550.0), rays=100, max_reflections=0)
    assert weak.energy.absorbed["face"][0] == pytest.approx(0.96 * weak.energy.launched_W, rel=1e-5)
    note, lost = t.own_notes
    assert lost == "no light reaches the detector: 'face' takes 96 % of it"
    assert "'face' takes 96 %" in repr(t)
    assert all(word in note for word in ("1.5+0.005i", "0.5 mm"))
    report = mistray.ghosts(scene, rays=100)
    assert note in report.notes
    assert note in main_table(report)
    assert note in mistray.pst(plate("1.5+0.005i", 0.5, 550.0), field_deg=[0, 10], rays=100).facts["notes"]
    # A mirror of aluminium absorbs what it does not reflect, at the surface; a leaf of gold is told of
    mirror = {"type": "asphere", "semi_diameter": 5.0, "bsdf": {"type": "interface", "back": "Al", "mirror": True}}
    beam, film = {"type": "collimated", "radius": 1.0, "distance": 2.0}, scene_dicts.detector(-5, semi_diameter=20.0)
    t = mistray.trace(scene_dicts.load(beam=beam, mirror=mirror, detector=film), rays=100)
    n = mistray.materials.complex_index("Al", 550.0)
    R = abs((n - 1) / (n + 1)) ** 2
    assert t.energy.detected_W / t.energy.launched_W == pytest.approx(R, rel=1e-5)
    assert t.energy.absorbed["mirror"][0] / t.energy.launched_W == pytest.approx(1 - R, rel=1e-4)
    assert t.own_notes == []
    leaf = mistray.trace(plate("Au", 1e-4, 550.0), rays=100, max_reflections=0)
    assert leaf.energy.detected_W == 0
    note, lost = leaf.own_notes
    assert lost.startswith("no light reaches the detector: max_reflections cuts")
    assert all(word in note for word in ("Au", "0.0001 mm"))
    # The silicon of a detector is as thick as may be: dark at 550 nm, where its k is below that of a metal
    film = scene_dicts.detector(0, semi_diameter=5.0, bsdf={"type": "interface", "back": "Si"})
    t = mistray.trace(scene_dicts.load(beam={"type": "collimated", "radius": 1.0}, detector=film), rays=100)
    n = mistray.materials.complex_index("Si", 550.0)
    assert 1e-3 < n.imag < 0.05
    assert t.energy.detected_W / t.energy.launched_W == pytest.approx(1 - abs((n - 1) / (n + 1)) ** 2, rel=1e-5)
    (note,) = t.own_notes
    assert "Si" in note
    # The bodies of meshes are measured, too: a stock cube of 2 mm, 1.5 + 0.0005i at 550 nm, that is dark

    def scene(k: float) -> mi.Scene:
        return scene_dicts.load(
            beam={"type": "collimated", "radius": 0.3},
            cube={"type": "cube", "bsdf": {"type": "interface", "back": "air", "front": f"1.5+{k}i"}},
            detector=scene_dicts.detector(5, semi_diameter=9.0),
        )

    t = mistray.trace(scene(1e-5), rays=100, max_reflections=0)
    assert t.energy.detected_W / t.energy.launched_W == pytest.approx(0.96**2 * np.exp(-0.08 * np.pi / 0.55), rel=1e-4)
    dark = mistray.trace(scene(1e-3), rays=100, max_reflections=0)
    table = dark.runs[0].table
    assert table.bodies.thickness(table.ids.index("cube"))[0] == pytest.approx(2.0, rel=1e-4)
    assert dark.energy.detected_W == 0
    note, lost = dark.own_notes
    assert "cube" in note
    assert lost.startswith("no light reaches the detector: 'cube' takes")


GLASS = interface_xml("air", "1.5")
BALL = interface_xml("1.5", "air")  # the normal of a sphere points outwards


def stock(kind: str, shape_id: str, inside: str, transform: str = "", bsdf: str | None = None) -> str:
    """A stock shape's XML with its own parameters and steps of to_world."""
    pose = f'<transform name="to_world">{transform}</transform>' if transform else ""
    return f'<shape type="{kind}" id="{shape_id}">{inside}{pose}{bsdf or interface_xml(R=0.0)}</shape>'


SCREEN = shape_xml("asphere", "detector", 9.0, sensor=True, half_width=2.0, half_height=2.0)


def by_events(t: Any) -> dict[str, Any]:
    return {row.events: row for row in t.paths}


class TestDetector:
    @pytest.mark.parametrize("turn", ["", '<rotate z="1" angle="30"/><rotate x="1" angle="20"/>'])
    def test_rectangle_and_asphere_see_the_same(self, load_text, turn: str) -> None:
        lens = [
            shape_xml("asphere", "front", 0.0, GLASS, radius=40.0, semi_diameter=8.0),
            shape_xml("asphere", "rear", 4.0, interface_xml("1.5", "air"), radius=-40.0, semi_diameter=8.0),
        ]
        place = f'{turn}<translate x="0.5" z="30"/>'
        ours = shape_xml("asphere", "detector", 30.0, sensor=True, half_width=6.0, half_height=4.0)
        ours = ours.replace('<translate z="30.0"/>', place)
        a, b = (
            mistray.trace(load_text(scene_text(*lens, d, radius=6.0))[0], rays=4000, field_deg=2.0)
            for d in (ours, stock("rectangle", "detector", meter_xml(64), f'<scale x="6" y="4"/>{place}'))
        )
        assert a.extent == pytest.approx(b.extent, rel=1e-6)
        assert set(by_events(a)) == set(by_events(b))
        for events, row in by_events(a).items():
            other = by_events(b)[events]
            assert abs(other.rays - row.rays) <= 1
            assert other.power_W == pytest.approx(row.power_W, rel=1e-3)
            assert (other.x_mm, other.y_mm) == pytest.approx((row.x_mm, row.y_mm), abs=1e-3)
            assert other.rms_radius_mm == pytest.approx(row.rms_radius_mm, abs=1e-3)
        rough = np.abs(a.irradiance - b.irradiance).sum() / a.irradiance.sum()
        assert rough < 2e-3  # rays that change the pixel

    def test_what_is_refused(self, load_scene) -> None:
        each_refused(
            (stock("sphere", "detector", meter_xml(8)), "detector 'detector' is Sphere"),
            (stock("sphere", "ball", "", bsdf='<bsdf type="plastic"/>') + SCREEN, "shape 'ball' carries the BSDF .*"),
            (stock("sphere", "ball", "", bsdf="<!-- none -->") + SCREEN, "nest an 'interface' in it"),
            by=lambda ball: mistray.trace(load_scene(scene_text(ball)), rays=10),
        )


def test_ball_lens_against_the_float64_oracle(load_text) -> None:
    ball = stock("sphere", "ball", '<float name="radius" value="5"/>', bsdf=BALL)
    screen = shape_xml("asphere", "detector", 9.0, sensor=True, half_width=12.0, half_height=12.0)
    scene, model = load_text(scene_text(ball, screen, radius=3.0))
    t = mistray.trace(scene, rays=400, max_reflections=4, polarization="unpolarized")
    (run,) = t.runs
    rays = (*run.start_rays(np.arange(400)), np.full(400, run.unit))
    ledger = nonsequential.trace(model, *rays, 550.0, max_reflections=4, max_events=64, flux_threshold=1e-8)
    theirs = {record.text.replace(":TIR", ":I"): record for record in ledger.paths}
    assert set(by_events(t)) == set(theirs)
    for events, row in by_events(t).items():
        record = theirs[events]
        assert (row.rays, row.power_W) == (record.rays, pytest.approx(record.power_W, rel=1e-4))
        assert row.x_mm == pytest.approx(record.x_mm, abs=1e-3)
        assert row.rms_radius_mm == pytest.approx(record.rms_radius_mm, abs=1e-3)


def test_prism_turns_the_light_by_total_reflection(load_scene, tmp_path: Path) -> None:
    """Of 10 mm: entrance at z = 0, hypotenuse from (y -5, z 0) to (y 5, z 10), exit at y = -5."""
    prism = tmp_path / "prism.ply"
    corners = [(x, y, z) for x in (-5.0, 5.0) for y, z in ((-5.0, 0.0), (5.0, 0.0), (-5.0, 10.0))]
    # outward normals: entrance -z, exit -y, hypotenuse +y +z, and the two sides
    quads = [(0, 1, 4, 3), (0, 3, 5, 2), (1, 2, 5, 4)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))] + [(0, 2, 1), (3, 4, 5)]
    prism.write_bytes(ply_bytes(np.array(corners), np.array(triangles)))
    mesh = stock("ply", "prism", f'<string name="filename" value="{prism}"/>', bsdf=BALL)
    below = shape_xml("asphere", "detector", 0.0, sensor=True, half_width=4.0, half_height=4.0)
    below = below.replace('<translate z="0.0"/>', '<rotate x="1" angle="90"/><translate y="-9" z="5"/>')
    t = mistray.trace(load_scene(scene_text(mesh, below, radius=2.0)), rays=5000)
    direct = t.paths[0]
    assert (direct.events, direct.kind, direct.rays) == ("prism:T prism:I prism:T detector:A", "TIR", 5000)
    assert (direct.power_W / t.energy.launched_W, t.energy.cut["medium"]) == (pytest.approx(0.96**2, rel=1e-5), 0)
    assert abs(t.energy.closure) < 1e-6
    # y of the entrance becomes z of the exit, and the prism does not scale
    assert direct.rms_radius_mm == pytest.approx(2 / np.sqrt(2), abs=4 * direct.rms_radius_se_mm)
    for points in t.history(0, 10).rays:
        x, y = points[0, :2]
        np.testing.assert_allclose(points[1:4], [[x, y, 0], [x, y, 5 - y], [x, -5, 5 - y]], atol=1e-4)
    rows = {row.id: row for row in t.surfaces}
    # entrance, hypotenuse, exit; then back and forth between exit and entrance once more
    assert rows["prism"].hits == 5000 * 7


class TestMixtures:
    def test_nearest_of_both_kinds(self, load_text) -> None:
        """Planes of both kinds in turn, in an order that differs from the file's: each ray meets them by distance."""
        weak = interface_xml(R=0.1, T=0.9)
        ours = [shape_xml("asphere", f"ours_{z}", float(z), weak, semi_diameter=3.0) for z in (6, 2, 4)]
        places = {z: f'<scale value="3"/><translate z="{z}"/>' for z in (5, 1, 3)}
        theirs = [stock("rectangle", f"theirs_{z}", "", place, weak) for z, place in places.items()]
        screen = shape_xml("asphere", "detector", 8.0, sensor=True, half_width=3.0, half_height=3.0)
        scene, model = load_text(scene_text(*theirs, *ours, screen))
        t = mistray.trace(scene, rays=300, flux_threshold=0.0)
        order = ["theirs_1", "ours_2", "theirs_3", "ours_4", "theirs_5", "ours_6"]
        assert (t.paths[0].events, len(t.paths)) == (" ".join(f"{name}:T" for name in order) + " detector:A", 1 + 15)
        (run,) = t.runs
        rays = (*run.start_rays(np.arange(300)), np.full(300, run.unit))
        ledger = nonsequential.trace(model, *rays, 550.0, flux_threshold=0.0)
        assert {row.events for row in t.paths} == {record.text for record in ledger.paths}
        for row in t.paths:
            assert row.power_W == pytest.approx(ledger.find(*row.events.split()).power_W, rel=1e-6)

    def test_cylinder(self, load_scene) -> None:
        """A stock cylinder and a frustum as the wall of a rod: the normal of both points outwards."""
        ends = [
            shape_xml("asphere", "rod_front", 0.0, GLASS, semi_diameter=2.0),
            shape_xml("asphere", "rod_rear", 20.0, interface_xml("1.5", "air"), semi_diameter=2.0),
            shape_xml("asphere", "detector", 20.5, sensor=True, half_width=8.0, half_height=8.0),
        ]
        ends_of_side = '<point name="p0" x="0" y="0" z="0"/><point name="p1" x="0" y="0" z="20"/>'
        theirs = stock("cylinder", "rod_side", f'{ends_of_side}<float name="radius" value="2"/>', bsdf=BALL)
        ours = shape_xml("frustum", "rod_side", 0.0, BALL, r0=2.0, z0=0.0, r1=2.0, z1=20.0)
        scenes = (load_scene(scene_text(*ends, wall, radius=1.5)) for wall in (ours, theirs))
        a, b = (mistray.trace(scene, rays=3000, field_deg=30.0) for scene in scenes)
        assert b.energy.detected_W == pytest.approx(a.energy.detected_W, rel=2e-3)
        assert b.energy.cut["medium"] < 1e-3 * b.energy.launched_W
        assert b.paths[0].events == a.paths[0].events

    def test_mesh_in_a_dict(self) -> None:
        mesh = mi.Mesh("wall", 4, 2)
        params = mi.traverse(mesh)
        params["vertex_positions"] = [-2, -2, 1, 2, -2, 1, 2, 2, 1, -2, 2, 1]
        params["faces"] = [0, 1, 2, 0, 2, 3]
        params.update()
        mesh.set_bsdf(mi.load_dict({"type": "interface", "R": 0.25, "T": 0.75}))
        beam, film = {"type": "collimated", "radius": 1.0}, scene_dicts.detector(3, type="rectangle")
        t = mistray.trace(scene_dicts.load(beam=beam, wall=mesh, detector=film), rays=100)
        assert t.paths[0].events == "wall:T detector:A"
        assert t.paths[0].power_W / t.energy.launched_W == pytest.approx(0.75, rel=1e-6)
        assert t.paths[0].source == "beam"

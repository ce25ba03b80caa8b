"""Imported lenses as the renderer traces them, and systems whose light does not run along one axis in one sense."""

import math
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from peers import optiland
from refusals import refused
from sequential_lenses import BORED, by_name, lens, newtonian, triplet

import mistray
from mistray.optimize import path_power, transmission
from mistray.prescription import Coating, Decentre, Row, Sequential, circle, from_optiland, to_prescription
from mistray.prescription.closing.system import build
from mistray.prescription.sequential.edge_rays import edge_rays
from mistray.prescription.sequential.rays import trace

RAYS = 40_000
CLEAR = Coating(R=0.0, T=1.0)


def coated(table: Sequential) -> Sequential:
    """The lens with a coating by name on all that is no mirror."""
    return table.with_rows([row if row.mirror else replace(row, coating="clear") for row in table.rows])


TRIPLET, NEWTONIAN, BORED_MANGIN = coated(triplet()), newtonian(), coated(BORED)


def beam(prescription, field_deg: float, count: int = 201) -> tuple[np.ndarray, np.ndarray]:
    """A square grid over the source's disc, in its plane across the axis."""
    source = prescription.source
    x, y = np.meshgrid(*[np.linspace(-source.radius, source.radius, count)] * 2)
    inside = np.hypot(x, y) <= source.radius
    positions = np.column_stack([x[inside], y[inside], np.full(inside.sum(), source.z)])
    angle = math.radians(field_deg)
    return positions, np.tile([0.0, math.sin(angle), math.cos(angle)], (len(positions), 1))


@pytest.mark.parametrize("field_deg", [0.0, 14.0])
def test_a_triplet_images_as_its_table_does(field_deg):
    prescription = to_prescription(TRIPLET, coatings={"clear": CLEAR})
    t = mistray.trace(prescription.to_scene(), rays=RAYS, field_deg=field_deg, max_reflections=0)
    (path,) = t.paths
    hits, _ = trace(TRIPLET, *beam(prescription, field_deg))
    clear = {"S5": prescription.stop.radius, **{face.name: face.semi_diameter for face in prescription.surfaces}}
    radii = np.array([clear.get(f"S{row.number}", np.inf) for row in TRIPLET.rows])
    passed = (np.hypot(hits[..., 0], hits[..., 1]) <= radii[:, None]).all(axis=0)
    assert t.energy.detected_W / t.energy.launched_W == pytest.approx(passed.mean(), abs=4 * math.sqrt(0.25 / RAYS))
    image = hits[-1][passed]
    spread = image[:, 1].std() / math.sqrt(RAYS)
    assert (path.y_mm, path.x_mm) == pytest.approx((image[:, 1].mean(), 0.0), abs=5 * spread + 1e-5)


def test_newtonian_and_mangin_mirror_image_as_their_tables():
    prescription = to_prescription(NEWTONIAN, beam="exact")
    t = mistray.trace(prescription.to_scene(), rays=RAYS, field_deg=0.5)
    image = next(path for path in t.paths if path.order == 0)
    hits, _ = trace(NEWTONIAN, *beam(prescription, 0.5))
    # The flat's body shadows the middle; coma makes the mean depend on that a little
    assert math.hypot(image.x_mm, image.y_mm) == pytest.approx(abs(hits[-1, :, 1].mean()), abs=0.01)
    flat = next(surface for surface in prescription.surfaces if surface.name == "flat")
    shadow = flat.semi_diameter**2 * math.cos(math.radians(45)) / 100.0**2
    assert image.power_W / t.energy.launched_W == pytest.approx(1 - shadow, abs=0.02)
    # Light passes the secondary, meets the glass outside of its bore, and comes back through the lens within that
    prescription = to_prescription(BORED_MANGIN, coatings={"clear": CLEAR})
    t = mistray.trace(prescription.to_scene(), rays=RAYS, max_reflections=2)
    assert abs(t.energy.closure) < 1e-5
    faces = {surface.name: surface for surface in prescription.surfaces}
    hits, _ = trace(BORED_MANGIN, *beam(prescription, 0.0))
    r = np.hypot(hits[..., 0], hits[..., 1])
    within = [(r[k] > faces[name].inner_semi_diameter) & (r[k] <= faces[name].semi_diameter)
              for k, name in enumerate(["S2", "S3", "S2", "S5", "S6", "S7"], start=1)]  # fmt: skip
    passed = np.all(within, axis=0) & (r[0] > faces["S5"].semi_diameter)
    image, share = next(path for path in t.paths if path.order == 0), passed.mean()
    assert 0.4 < share < 0.8
    assert image.power_W / t.energy.launched_W == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / RAYS))


@pytest.mark.parametrize("field_deg", [0.0, 25.0, 45.0])
def test_no_light_leaves_a_closed_lens(field_deg):
    """Surfaces that transmit all: what enters the front ends in the glass' edges, the barrel or the image plane."""
    escaped = {}
    for edges in ("blackened", "open"):
        prescription = to_prescription(TRIPLET, coatings={"clear": CLEAR}, edges=edges)
        front = prescription.surfaces[0]
        source = replace(prescription.source, radius=0.5 * front.semi_diameter, z=front.z)
        scene = replace(prescription, source=source).to_scene()
        energy = mistray.trace(scene, rays=20_000, field_deg=field_deg, max_reflections=0).energy
        assert abs(energy.closure) < 1e-5 or edges == "open"
        escaped[edges] = energy.escaped_W
    assert (escaped["blackened"], escaped["open"] > 0.0) == (0.0, field_deg > 0.0)


def test_ground_edges_send_light_back():
    """The edges together absorb half of what meets them, and a part of what they send to one another."""
    absorbed = {}
    for edges in ("blackened", "ground"):
        prescription = to_prescription(TRIPLET, coatings={"clear": CLEAR}, edges=edges, beam="front")
        t = mistray.trace(prescription.to_scene(), rays=20_000, field_deg=40.0, max_reflections=1)
        own = {name: watts for name, (watts, _) in t.energy.absorbed.items() if name.startswith("L")}
        assert own["L1_edge"] > 0.0
        absorbed[edges] = sum(own.values())
    assert 0.5 <= absorbed["ground"] / absorbed["blackened"] < 0.9


def test_a_newtonian_with_coordinate_breaks():
    """Closed form: the focus 1000 mm before the primary is folded by 90° at 800 mm, to 200 mm beside the axis."""
    built = build(newtonian())
    shapes = by_name(built.prescription)
    assert (shapes["primary"].z, shapes["flat"].z, shapes["flat"].tilt_deg) == (1000.0, 200.0, (45.0, 0.0, 0.0))
    detector = shapes["detector"]
    assert (detector.x, abs(detector.y), detector.z) == pytest.approx((0.0, 200.0, 200.0), abs=1e-9)
    assert (detector.tilt_deg, shapes["primary"].semi_diameter) == ((90.0, 0.0, 0.0), pytest.approx(100.0))
    assert (built.first_order.efl, built.prescription.source.z) == pytest.approx((1000.0, 1000.0))
    assert built.prescription.source.radius == pytest.approx(105.0, rel=1e-3)  # pupils off the axis differ a little
    assert built.prescription.source.pupil_area == pytest.approx(math.pi * 100.0**2)
    # The flat lies 200 mm before the focus: its beam is an ellipse of 1/cos 45° in the plane of the tilt
    assert shapes["flat"].semi_diameter > 200.0 / 1000.0 * 100.0 * math.sqrt(2)
    (shadow,) = [note for note in built.notes if note.startswith("mirror 'flat' stands in the beam on its way to sur")]
    # Its own area across the beam, of rays that sample the beam in five rings
    share = shapes["flat"].semi_diameter ** 2 * math.cos(math.radians(45.0)) / 100.0**2
    assert float(shadow.split("about ")[1].split(" %")[0]) == pytest.approx(100 * share, abs=5.0)
    # The image of 0.5°: f tan θ, within coma
    assert detector.half_width == pytest.approx(1.02 * 1000 * math.tan(math.radians(0.5)), rel=0.02)


CASSEGRAIN = (
    Row(1, radius=-2000.0, conic=-1.0, mirror=True, stop=True, thickness=-700.0, label="primary"),
    Row(2, radius=-800.0, conic=-((7 / 3) ** 2), mirror=True, thickness=1000.0, label="secondary"),
    Row(3, kind="image"),
)


def test_holes_mangin_mirrors_and_lenses_after_mirrors():
    """The beam comes to the focus 200 mm behind the primary at F/20, from a secondary 700 mm before it."""
    built = build(lens(*CASSEGRAIN, aperture=200.0), margin=0.0)
    shapes = by_name(built.prescription)
    # Of similar triangles with the paraxial cone; the focus lies 1200 mm behind the secondary
    assert shapes["primary"].inner_semi_diameter == pytest.approx(30.0 * (1200 - 700) / 1200, rel=0.02)
    assert any("mirror 'primary' has a hole of radius" in note for note in built.notes)
    assert any("mirror 'secondary' stands in the beam on its way to surface 1" in note for note in built.notes)
    assert shapes["secondary_rear"].z < -700 < 0 < shapes["primary_rear"].z
    hole, bore = shapes["primary"].inner_semi_diameter, shapes["primary_bore"]
    assert shapes["primary_rear"].inner_semi_diameter == bore.r0 == bore.r1 == hole
    assert (bore.z0, bore.z1 - bore.z0) == pytest.approx((-(hole**2) / 4000.0, 5.0), abs=1e-9)
    # Light comes past the detector; a wall from it to the lens would stand in the incoming beam
    mangin = lens(
        Row(1, radius=-150.0, thickness=5.0, material="1.5168", stop=True),
        Row(2, radius=-220.0, thickness=-5.0, mirror=True, material="1.5168"),
        Row(3, radius=-150.0, thickness=-170.0),
        Row(4, kind="image"),
        aperture=40.0,
    )
    built = build(mangin)
    shapes = by_name(built.prescription)
    assert [surface.name for surface in built.prescription.surfaces] == ["S1", "S2"]
    assert shapes["L1_edge"].front == "1.5168"
    assert not any(name.startswith(("barrel", "board")) for name in shapes)
    for note in ("surface 3 is 'S1' on the way back", "there is no wall in space 1: it would stand in the beam"):
        assert note in built.notes
    assert any(note.startswith("the detector stands in the beam on its way to surface 1") for note in built.notes)
    catadioptric = lens(
        Row(1, radius=-400.0, mirror=True, stop=True, thickness=-120.0),
        Row(2, radius=-80.0, thickness=-4.0, material="1.6"),
        Row(3, radius=200.0, thickness=-40.0),
        Row(4, kind="image"),
        aperture=30.0,
    )
    built = build(catadioptric)
    shapes = by_name(built.prescription)
    # It stands in the light that comes to the mirror: 0.41² of it, of five rings
    note = "the lens between 'S3' and 'S2' stands in the beam on its way to surface 1 and takes about 20 % of it"
    assert note in built.notes
    assert (shapes["S2"].front, shapes["S2"].back) == ("1.6", "air")
    assert (shapes["S3"].front, shapes["S3"].back) == ("air", "1.6")
    edge = shapes["L1_edge"]
    assert (edge.front, shapes["barrel_1_wall"].front) == ("1.6", "air")
    assert edge.z0 < edge.z1 < -120.0


def test_a_spot_on_a_lens_and_an_image_on_a_surface_are_moved_by_a_micrometre():
    gregory = lens(
        Row(1, radius=-60.0, thickness=5.0, material="1.5168", stop=True),
        Row(2, radius=-62.0, thickness=100.0),
        Row(3, radius=-220.0, mirror=True, thickness=-100.0),
        Row(4, radius=-62.0, mirror=True, thickness=120.0),
        Row(5, kind="image"),
        aperture=40.0,
    )
    built = build(gregory)
    shapes = by_name(built.prescription)
    assert shapes["S4"].z == pytest.approx(5.001)
    assert "mirror 'S4' is a spot on 'S2': it stands 1 µm before it" in built.notes
    assert "S4_rear" not in shapes
    built = build(lens(Row(1, thickness=1.0, material="1.5", stop=True), Row(2), Row(3, kind="image")))
    assert by_name(built.prescription)["detector"].z == pytest.approx(1.001)
    assert any("the image lies on surface 2" in note for note in built.notes)


@pytest.mark.parametrize("stated", [True, False])
def test_a_mirror_off_its_axis_lets_the_beam_pass_beside_it(stated):
    """A paraboloid used at y = 60, 25 in radius, whose focus lies behind a whole paraboloid of the same axis."""
    pieces = (circle(25.0, y=60.0), circle(40.0, y=45.0)) if stated else (None, None)
    rows = (
        Row(1, stop=True, thickness=150.0, decentre=Decentre(y=60.0, returns=True)),
        Row(2, radius=-400.0, conic=-1.0, mirror=True, thickness=-140.0, aperture=pieces[0]),
        Row(3, radius=-150.0, conic=-1.0, mirror=True, thickness=90.0, aperture=pieces[1]),
        Row(4, kind="image"),
    )
    gregory = Sequential("gregory", rows, aperture=40.0)
    built = build(gregory)
    first, second = built.prescription.surfaces
    # The beam is 20 mm in radius; on the second mirror, 60 mm before the focus at 200 mm, 0.3 times that
    if stated:
        assert (first.outline, second.outline) == pieces
    else:
        for mirror, radius, y in ((first, 20.0, 60.0), (second, 6.0, 18.0)):
            (disc,) = mirror.outline.figures
            assert (disc.x, disc.y) == pytest.approx((0.0, y), rel=0.05, abs=1e-6)
            assert radius < disc.sizes[0] < 1.1 * radius
    source = built.prescription.source
    assert (source.x, source.y, source.radius) == pytest.approx((0.0, 60.0, 21.0), abs=1e-9)
    assert "the source is centred at (0, 60) mm, where the beam of the first field comes in" in built.notes
    if not stated:
        light = mistray.trace(build(gregory, beam="exact").prescription.to_scene(), rays=5_000)
        assert max(row.power_W for row in light.paths) == pytest.approx(light.energy.launched_W, rel=1e-6)


def test_a_lens_that_another_stands_in_is_bored():
    """A field lens within the Mangin mirror; the bore reaches from face to face, 2 % wider than the field lens."""
    built = build(BORED)
    shapes = by_name(built.prescription)
    front, rear, guest, bore = shapes["S2"], shapes["S3"], shapes["S6"], shapes["L1_bore"]
    radius = 1.02 * max(guest.semi_diameter, shapes["S7"].semi_diameter)
    assert front.inner_semi_diameter == rear.inner_semi_diameter == bore.r0 == bore.r1 == pytest.approx(radius)
    assert (bore.z + bore.z0, bore.z + bore.z1) == pytest.approx((front.z_at(radius), rear.z_at(radius)), abs=1e-9)
    assert (bore.front, bore.back, bore.coating, bore.part) == ("air", "1.5168", Coating(R=0.0), "L1")
    assert f"the lens between 'S2' and 'S3' has a bore of radius {radius:.6g} mm for 'S6', 'S7'" in built.notes
    assert by_name(to_prescription(BORED, edges="open"))["L1_bore"].coating is None
    assert [s.name for s in by_name(to_prescription(BORED, edges="ground"))["L1_bore"].scatter] == ["ground_edge"]


@pytest.mark.parametrize("kept", [True, False])
def test_an_aperture_on_a_leg_of_a_folded_beam_leaves_the_other_legs_alone(kept):
    """Light from the sky crosses the plane too: towards the secondary the other way, towards the focus the same way."""
    rows = [Row(1, thickness=800.0, label="entrance"), *CASSEGRAIN]
    opening = Row(5, semi_diameter=40.0, semi_diameter_fixed=True, label="opening")
    leg, own = (1, -600.0) if kept else (2, 100.0)  # from the mirror before it
    rest = replace(opening, thickness=rows[leg].thickness - own)
    table = [*rows[:leg], replace(rows[leg], thickness=own), rest, *rows[leg + 1 :]]
    built = build(lens(*(replace(row, number=k) for k, row in enumerate(table, start=1)), aperture=200.0), beam="exact")
    shapes = by_name(built.prescription)
    assert ("opening_aperture" in shapes) == kept
    words = "only light that goes as the design's" if kept else "no plate of its aperture"
    assert any(words in note for note in built.notes)
    if kept:
        assert shapes["opening_aperture"].meets == "-z"
    t = mistray.trace(built.prescription.to_scene(), rays=4000, max_reflections=0)
    direct = sum(row.power_W for row in t.paths if row.kind == "direct")
    # The secondary takes 30²/100² of the light and more with its rim
    assert 0.85 < direct / t.energy.launched_W < 0.92


FEWER = 20_000


def test_the_beam_covers_the_pupils_of_all_fields_and_a_twentieth_more():
    lens = triplet()
    built = build(lens)
    source = built.prescription.source
    reach = np.hypot(*edge_rays(lens).pupils.T).max()
    assert reach > built.first_order.epd / 2  # the pupils off the axis are larger
    assert (source.radius, source.pupil_area) == pytest.approx((1.05 * reach, math.pi * built.first_order.epd**2 / 4))
    assert source.irradiance == 1.0
    assert ["exact" in text for text in built.notes if "wider than the pupil" in text] == [True]
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
        settings = {"field_deg": 0.0, "rays": FEWER, "max_reflections": 0}
        values[beam] = [metric(scene, **settings).value() for metric in (transmission, path_power)]
        t = mistray.trace(scene, **settings)
        share = (prescription.source.pupil_area or t.energy.launched_W) / t.energy.launched_W
        assert t.pupil_W == pytest.approx(t.energy.launched_W * min(share, 1.0))
        assert abs(t.energy.closure) < 1e-5
    assert values["pupil"] == pytest.approx(values["exact"], abs=5 * math.sqrt(0.3 / FEWER))


def test_light_beside_the_pupil_and_the_pupil_of_a_source():
    """All that reaches the detector has met every lens, off the axis too; but for reflections nothing escapes."""
    scene = to_prescription(triplet()).to_scene()
    faces = {f"S{number}" for number in (1, 2, 3, 4, 6, 7)}
    for field_deg in (0.0, 14.0, 20.0):
        t = mistray.trace(scene, field_deg=field_deg, rays=FEWER)
        assert all(faces <= {event.split(":")[0] for event in row.events.split()} for row in t.paths)
        first = mistray.trace(scene, field_deg=field_deg, rays=FEWER, max_reflections=0)
        assert first.energy.escaped_W < 1e-6 * first.energy.launched_W
    for radius, share in ((5.0, 0.64), (4.0, 1.0), (3.0, 1.0)):
        source = {"type": "collimated", "radius": radius, "pupil_area": math.pi * 16}
        assert mi.load_dict(source).pupil_share == pytest.approx(share)
    with refused("pupil_area"):
        mistray.load({"type": "scene", "source": source | {"pupil_area": 0.0}})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "field_deg", "beam", "steps"),
    [
        ("DoubleGauss", 0.0, "pupil", {"stop_front.r1": (0.1,), "S3.curvature": (3e-4,)}),
        ("DoubleGauss", 0.0, "exact", {"stop_front.r1": (0.1, 0.05), "S3.curvature": (5e-4, 2e-4), "S1.x": (0.2, 0.1)}),
        ("CookeTriplet", 20.0, "exact", {"L2_flange_2.r0": (0.01, 0.005), "S2.curvature": (5e-4, 2e-4)}),
    ],
)
def test_derivatives_of_an_imported_lens(name, field_deg, beam, steps):
    """Against differences with the same rays, whose share is known to 6 %; 3 standard errors: once in 370 a key."""
    scene = from_optiland(getattr(optiland("samples.objectives"), name)(), beam=beam).to_scene()
    params = mi.traverse(scene)
    light = transmission(scene, field_deg=field_deg, wavelength_nm=587.6, rays=30_000)
    found, start = mistray.gradient(light, params, list(steps)), light.value()
    for key, sizes in steps.items():
        at = np.array(params[key], dtype=np.float64)
        for step in sizes:
            slopes = []
            for sign in (-1, 1, 0):  # in the end the lens is as it was
                params[key] = type(params[key])(at + sign * step)
                params.update()
                slopes += [(light.value() - start) / (sign * step)] if sign else []
            if beam == "exact":
                pairs = [(slope, side.value, side.se) for slope, side in zip(slopes, found.one_sided[key], strict=True)]
            else:
                assert not found.full
                pairs = [(np.mean(slopes), found.gradient[key][0], found.standard_error[key][0])]
            for slope, value, se in pairs:
                assert abs(slope - value) < 3 * math.hypot(se, 0.06 * abs(slope))

"""STEP files: their numbers against float64 formulas, and bodies as OpenCASCADE reads them against closed forms."""

import json
import re
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from command_line import fails, succeeds
from refusals import each_refused
from scipy.interpolate import BSpline

import mistray
from mistray.analyses.export.beams import BeamFinder
from mistray.analyses.export.faces import loops_of
from mistray.io.cad.part import CadPart
from mistray.io.cad.step import read_step
from mistray.mechanics import read_mechanics
from mistray.prescription import Outline, OutlineFigure, circle
from mistray.report import rays_of_paths

TOL = 5e-3  # mm: largest distance of the facets from the faces
SINGLE = 2.0**-24  # rounding of a number of single precision, in which cascadio gives points
GLASS = {"type": "interface", "back": "1.5"}
GLASS_BACK = {"type": "interface", "front": "1.5"}
BLACK = {"type": "interface", "R": 0.0}
MIRROR = {"type": "interface", "R": 1.0, "mirror": True}


def scene_of(**shapes: dict) -> mi.Scene:
    return mi.load_dict({"type": "scene"} | shapes, optimize=False)


class Text:
    """The entities of a STEP file, by their numbers."""

    def __init__(self, path: Path) -> None:
        found = re.findall(r"^#(\d+)=(.*);$", path.read_text("ascii"), re.MULTILINE)
        self.entities = {int(number): body for number, body in found}

    def of(self, kind: str) -> list[str]:
        return [body for body in self.entities.values() if re.match(rf"\(?(.*\))?{kind}\(", body)]

    def point(self, number: str) -> np.ndarray:
        return np.array(self.entities[int(number)].split("(", 2)[2].strip("()").split(","), dtype=float)

    def points(self, listed: str) -> np.ndarray:
        return np.array([self.point(number) for number in re.findall(r"#(\d+)", listed)])

    def curve(self, body: str, count: int) -> np.ndarray:
        """Points of a B-spline curve, (count, 3)."""
        lists = re.findall(r"\(([^()]*)\)", body)
        poles = self.points(next(part for part in lists if part.startswith("#")))
        degree = int(re.search(r"(?:WITH_KNOTS\('',|B_SPLINE_CURVE\()(\d+)", body)[1])
        place = lists.index(next(part for part in lists if re.fullmatch(r"\d+(,\d+)*", part)))
        both = lists[place], lists[place + 1].split(",.")[0]
        counts, values = (np.array(part.split(","), dtype=float) for part in both)
        weights = np.ones(len(poles))
        if "RATIONAL" in body:
            weights = np.array(re.search(r"RATIONAL_B_SPLINE_CURVE\(\(([^)]*)\)", body)[1].split(","), dtype=float)
        knots = np.repeat(values, counts.astype(int))
        u = np.linspace(knots[0], knots[-1], count)
        return BSpline(knots, poles * weights[:, None], degree)(u) / BSpline(knots, weights, degree)(u)[:, None]


def volume(part: CadPart) -> float:
    """mm³ by the divergence theorem; negative where normals point inwards."""
    a, b, c = (part.vertices[part.triangles[:, k]] for k in range(3))
    return float(np.sum(np.cross(a, b) * c)) / 6


def area(part: CadPart, flat: float = 1.0) -> float:
    """mm²; with 0, seen along z."""
    a, b, c = (part.vertices[part.triangles[:, k]] * [1, 1, flat] for k in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def closed(part: CadPart) -> bool:
    """Whether every side of a triangle belongs to two, corners of faces that lie in one place taken as one."""
    size = np.ptp(part.vertices, axis=0).max()
    _, welded = np.unique(np.round(part.vertices / (1e-5 * size)).astype(int), axis=0, return_inverse=True)
    triangles = welded.ravel()[part.triangles]
    sides = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, counts = np.unique(sides[sides[:, 0] != sides[:, 1]], axis=0, return_counts=True)
    return bool(np.all(counts == 2))


def parts_of(path: Path, tolerance_mm: float = TOL) -> dict[str, CadPart]:
    return {part.title: part for part in read_step(path, tolerance_mm=tolerance_mm)[0]}


def sag(r: np.ndarray, radius: float, conic: float, terms: dict[int, float]) -> np.ndarray:
    c = 1 / radius
    return c * r**2 / (1 + np.sqrt(1 - (1 + conic) * c**2 * r**2)) + sum(a * r**n for n, a in terms.items())


def cap(radius: float, height: float) -> float:
    return np.pi * height**2 * (3 * radius - height) / 3


@pytest.mark.quick
@pytest.mark.parametrize(("scale", "seed"), [(1.0, 0), (1.0, 1), (1e-3, 2), (1e4, 3)])
def test_aspheres_are_within_a_nanometre_of_their_sag(tmp_path, scale, seed):
    rng = np.random.default_rng(seed)
    radius, outer = scale * rng.uniform(8, 20) * rng.choice([-1, 1]), scale * 5.0
    conic = float(rng.uniform(-3, 1))
    terms = {n: float(rng.normal() * 0.02 * outer ** (1 - n)) for n in (4, 6, 8, 10, 14, 20)}
    asphere = {"type": "asphere", "radius": radius, "conic": conic, "semi_diameter": outer, "bsdf": MIRROR}
    scene = scene_of(lone=asphere | {f"a{n}": a for n, a in terms.items()})
    written = mistray.export_step(scene, tmp_path / "lone.step")
    text = Text(written.path)
    (curve,) = text.of("B_SPLINE_CURVE_WITH_KNOTS")
    x, y, z = text.curve(curve, 3001).T
    allowed = min(1e-6, 1e-7 * outer)
    assert np.abs(y).max() == x[0] == 0
    assert abs(x[-1] - outer) <= 1e-12 * outer
    # The comparison has the rounding of both sides
    assert np.abs(z - sag(np.clip(x, 0, outer), radius, conic, terms)).max() <= allowed + 1e-13 * scale
    assert written.error_mm <= allowed
    assert len(text.of("SURFACE_OF_REVOLUTION")) == 1


@pytest.mark.quick
@pytest.mark.parametrize(("conic", "inner"), [(-1.0, 0.0), (-2.5, 3.0), (0.6, 0.0), (0.6, 2.0), (-0.5, 0.0)])
def test_conics_are_exact(tmp_path, conic, inner):
    values = {"radius": -40.0, "conic": conic, "semi_diameter": 15.0, "inner_semi_diameter": inner}
    scene = scene_of(lone={"type": "asphere", "bsdf": MIRROR} | values)
    text = Text(mistray.export_step(scene, tmp_path / "c.step").path)
    (curve,) = text.of("RATIONAL_B_SPLINE_CURVE")
    x, _, z = text.curve(curve, 501).T
    np.testing.assert_allclose([x[0], x[-1]], [inner, 15.0], rtol=1e-14)
    np.testing.assert_allclose(z, sag(x, -40.0, conic, {}), atol=1e-13)


def test_a_lens_is_a_solid_of_the_volume_of_its_formula(tmp_path):
    pose = mi.ScalarTransform4d().translate([3, -2, 50]).rotate([1, 0, 0], 30)
    back = pose @ mi.ScalarTransform4d().translate([0, 0, 6])
    front, rear = 20 - np.sqrt(20**2 - 8**2), 30 - np.sqrt(30**2 - 8**2)
    face, edge = {"type": "asphere", "semi_diameter": 8.0, "part": "my lens"}, GLASS_BACK | {"R": 0.0}
    cylinder = {"type": "frustum", "r0": 8.0, "z0": front, "r1": 8.0, "z1": 6 - rear, "part": "my lens", "bsdf": edge}
    scene = scene_of(
        a={**face, "radius": 20.0, "to_world": pose, "bsdf": GLASS},
        b={**face, "radius": -30.0, "to_world": back, "bsdf": GLASS_BACK},
        c={**cylinder, "to_world": pose},
    )
    written = mistray.export_step(scene, tmp_path / "lens.step", name="a system")
    assert (written.solids, written.sheets, written.notes) == (("my_lens",), (), ())
    body = parts_of(written.path)["my_lens"]
    exact = np.pi * 8**2 * (6 - front - rear) + cap(20, front) + cap(30, rear)
    assert closed(body)
    # Facets are within the tolerance of the faces, single precision within its rounding
    assert abs(volume(body) - exact) <= area(body) * (TOL + SINGLE * np.abs(body.vertices).max())
    assert body.path == "a system/optics/my_lens"
    text = Text(written.path)
    assert {re.match(r"ADVANCED_FACE\('(\w+)'", face)[1] for face in text.of("ADVANCED_FACE")} == {"a", "b", "c"}
    assert {float(face.rsplit(",", 1)[1].rstrip(")")) for face in text.of("SPHERICAL_SURFACE")} == {20.0, 30.0}
    assert len(text.of("CYLINDRICAL_SURFACE")) == 1


def test_gas_between_lenses_and_a_bsdf_of_mitsuba(tmp_path):
    """Air is no solid, whatever its name, and a ball with a BSDF of Mitsuba's own is a solid like any other."""
    faces = {
        f"{name}_{k}": {"type": "asphere", "semi_diameter": 4.0, "z": z + k, "part": name, "bsdf": bsdf}
        for name, z in (("A", 0.0), ("B", 20.0))
        for k, bsdf in enumerate((GLASS | {"front": "1.0"}, GLASS_BACK | {"back": "1.0"}))
    }
    ball = {"type": "sphere", "center": [0, 0, 40], "radius": 2.0, "bsdf": {"type": "roughconductor"}}
    assert set(mistray.export_step(scene_of(**faces, ball=ball), tmp_path / "gap.step").solids) == {"A", "B", "ball"}


def test_aspheres_as_opencascade_reads_them_lie_on_their_sag(tmp_path):
    scene = mistray.load("phone_camera")
    written = mistray.export_step(scene, tmp_path / "phone.step")
    parts = parts_of(written.path)
    shapes = {shape.id(): shape for shape in scene.shapes()}
    lenses = [f"L{k}" for k in range(1, 6)]
    assert ({*lenses, "window", "filter"}, {}) == (set(written.solids), written.left_out)
    for name in lenses:
        body = parts[name]
        assert closed(body)
        assert volume(body) > 0
        ends, (x, y, z) = np.zeros(len(body.vertices), dtype=bool), body.vertices.T
        r, faces = np.hypot(x, y), [shapes[f"{name}_{face}"] for face in ("front", "rear")]
        for shape in faces:
            outer, top = shape.values["semi_diameter"], shape.matrix[2, 3]
            off = np.abs(z - top - shape.sag(np.minimum(r, outer)))
            # 1e-6 mm, and the rounding of cascadio's points in r, times the slope, and in z; twice for the transform
            slope = np.abs(np.gradient(shape.sag(np.linspace(0, outer, 999)), outer / 998)).max()
            rounding = 2 * SINGLE * (outer * slope + np.abs(z).max())
            ends |= (off <= 1e-6 + rounding) & (r <= outer * (1 + 2 * SINGLE))
        # All points of both faces do: the others are those of the edge
        edge = r >= min(shape.values["semi_diameter"] for shape in faces) * (1 - 1e-6)
        assert np.all(ends | edge)
        assert ends.sum() > 500


def test_volumes_of_cemented_lenses_are_those_of_their_profiles(tmp_path):
    scene = mistray.load("double_gauss")
    parts = parts_of(mistray.export_step(scene, tmp_path / "gauss.step").path)
    shapes = {shape.id(): shape for shape in scene.shapes()}

    def profile(name: str) -> np.ndarray:
        return np.asarray(shapes[name].profile(20_001)) + np.array([0, shapes[name].matrix[2, 3]])

    corner = np.array([[11.5, shapes["L3_edge"].values["z1"]]])
    for name, front, rear, edge in (("L2", "L2_front", "L2_L3", corner[:0]), ("L3", "L2_L3", "L3_rear", corner)):
        r, z = np.concatenate([profile(front), edge, profile(rear)[::-1]]).T
        r1, z1 = np.roll(r, -1), np.roll(z, -1)
        exact = abs(np.pi / 3 * np.sum((r * r + r * r1 + r1 * r1) * (z1 - z)))
        assert abs(volume(parts[name]) - exact) <= 1.1 * TOL * area(parts[name])


def test_walls_come_back_as_the_frusta_that_they_are(tmp_path):
    scene = mistray.load("baffle_tube")
    back = read_mechanics(mistray.export_step(scene, tmp_path / "tube.step").path).structures(tmp_path)
    found = np.array([[[s.r0, s.z0 + s.z], [s.r1, s.z1 + s.z]] for s in back if hasattr(s, "r0")])
    for shape in scene.shapes():
        if {"r0", "z0"} <= set(getattr(shape, "values", {})):
            v = shape.values
            ends = np.array([[v["r0"], v["z0"]], [v["r1"], v["z1"]]])
            off = [np.abs(found - way).max(axis=(1, 2)).min() for way in (ends, ends[::-1])]
            assert min(off) <= 2e-5 + 4 * SINGLE * np.abs(ends).max(), shape.id()


def test_freeforms_are_within_their_tolerance(tmp_path):
    sags = {"radius": -60.0, "conic": -1.0, "xy_2_1": 2e-4, "xy_0_3": -1e-4, "zernike_7": 0.02, "zernike_radius": 10.0}
    outline = {"clip_1": "+circle", "clip_1_y": 14.0, "clip_1_radius": 9.0, "clip_2": "-rectangle", "clip_2_y": 14.0,
               "clip_2_half_width": 2.0, "clip_2_half_height": 1.0, "clip_2_angle_deg": 20.0}  # fmt: skip
    scene = scene_of(piece={"type": "freeform", "bsdf": MIRROR} | sags | outline)
    written = mistray.export_step(scene, tmp_path / "piece.step", freeform_tolerance_mm=1e-6)
    assert written.error_mm <= 1e-6
    shape = scene.shapes()[0]
    part = parts_of(written.path, 0.01)["piece"]
    x, y, z = part.vertices.T
    assert np.abs(z - shape.height(x, y)).max() <= 1e-6 + 2 * SINGLE * 30 * 2
    assert len(x) > 200
    assert shape.outline.touches(x, y, 1e-4).all()
    whole = np.pi * 9**2 - 8.0  # over x and y
    assert area(part, flat=0.0) == pytest.approx(whole, abs=2 * np.pi * 9 * 0.01)


@pytest.mark.parametrize("kind", ["circle", "rectangle"])
def test_narrow_freeforms_are_not_flat(tmp_path, kind):
    """Of a coarse grid over them few points are within, all at one height."""
    sizes = {"radius": 9.8} if kind == "circle" else {"half_width": 7.0, "half_height": 7.0}
    outline = {"radius": 30.0, "clip_1": "+circle", "clip_1_radius": 10.0, "clip_2": f"-{kind}"}
    outline |= {f"clip_2_{key}": size for key, size in sizes.items()}
    scene = scene_of(piece={"type": "freeform", "bsdf": MIRROR} | outline)
    x, y, z = parts_of(mistray.export_step(scene, tmp_path / "piece.step").path, 0.01)["piece"].vertices.T
    assert np.abs(z - scene.shapes()[0].height(x, y)).max() <= 1e-5 + 4e-6


def test_holes_whose_corners_touch_the_rim_are_left_out():
    for half, found in ((6.0, True), (8.0, False)):
        hole = OutlineFigure("rectangle", "-", sizes=(half, 6.0))
        assert (loops_of(Outline((*circle(10.0).figures, hole))) is not None) == found


def test_mirrors_are_sheets_or_solids_of_the_thickness_that_is_asked_for(tmp_path):
    scene = mistray.load("newtonian")
    assert "primary" in mistray.export_step(scene, tmp_path / "sheet.step").sheets
    written = mistray.export_step(scene, tmp_path / "solid.step", mirror_thickness_mm=20.0)
    assert "primary" in written.solids
    shape = next(shape for shape in scene.shapes() if shape.id() == "primary")
    r = shape.values["semi_diameter"]
    depth = abs(float(shape.sag(np.array([r]))[0]))
    assert shape.values["conic"] == -1  # half a cylinder is below a paraboloid
    body = parts_of(written.path, 0.05)["primary"]
    assert abs(volume(body) - np.pi * r * r * (20 + depth / 2)) <= 0.055 * area(body)
    assert body.vertices[:, 2].max() == pytest.approx(20.0, abs=1e-4)  # behind the mirror, seen along the light
    scene = scene_of(
        ball={"type": "sphere", "radius": 2.0, "center": [1, 2, 3], "bsdf": BLACK},
        disc={"type": "disk", "bsdf": BLACK},
        pane={"type": "rectangle", "bsdf": BLACK},
        can={"type": "cylinder", "p0": [0, 0, 0], "p1": [0, 0, 4], "radius": 1.5, "bsdf": BLACK},
        lump={"type": "cube", "bsdf": BLACK},
    )
    written = mistray.export_step(scene, tmp_path / "stock.step")
    assert (written.solids, set(written.left_out)) == (("ball",), {"lump"})
    assert set(written.sheets) == {"disc", "pane", "can"}
    body = parts_of(written.path, 1e-3)["ball"]
    assert abs(volume(body) - 4 / 3 * np.pi * 8) <= 1.1e-3 * area(body)


def test_a_beam_through_a_plate_is_a_cylinder_that_snells_law_shifts(tmp_path):
    scene = mistray.load("plate")
    written = mistray.export_step(scene, tmp_path / "plate.step", [0.0, 10.0], paths=2, rays=2000, rays_per_path=3)
    shapes = {shape.id(): shape for shape in scene.shapes()}
    radius = shapes["plate_front"].values["semi_diameter"]
    front, rear = (shapes[f"plate_{side}"].matrix[2, 3] for side in ("front", "rear"))
    assert written.beams == ("beam 0 deg", "beam 10 deg")
    assert written.rim_error_mm < 1e-4 * radius
    parts = parts_of(written.path)
    # Its facets on the axis: between the plate's faces a cylinder of the plate's radius
    beam = parts["beam 0 deg"].vertices
    inner = beam[(beam[:, 2] >= front - 1e-4) & (beam[:, 2] <= rear + 1e-4)]
    assert np.hypot(inner[:, 0], inner[:, 1]).max() == pytest.approx(radius, rel=2e-5)
    # Aslant, the rims on both faces are the same figure, moved by what Snell's law says
    beam = parts["beam 10 deg"].vertices
    rims = [beam[np.abs(beam[:, 2] - z) < 1e-4] for z in (front, rear)]
    index = float(mistray.materials.refractive_index(shapes["plate_front"].bsdf().back, 550.0))
    shift = (rear - front) * np.tan(np.arcsin(np.sin(np.radians(10)) / index))
    for axis, moved in ((0, 0.0), (1, shift)):
        for edge in (np.min, np.max):
            assert edge(rims[1][:, axis]) - edge(rims[0][:, axis]) == pytest.approx(moved, abs=1e-3)
    text = Text(written.path)
    assert len(text.of("MANIFOLD_SOLID_BREP")) == 1 + 3 + 3  # the plate, and three stretches of each beam
    # Stray paths are the rays of the trace
    members = r"GEOMETRIC_CURVE_SET\('(?:[^']|'')*',\(([^)]*)\)"
    sets = [re.match(members, body)[1] for body in text.of("GEOMETRIC_CURVE_SET")]
    numbers = [int(number) for listed in sets for number in re.findall(r"#(\d+)", listed)]
    lines = [text.points(text.entities[number].split("(", 2)[2]) for number in numbers]
    t = mistray.trace(scene, rays=2000, field_deg=0.0)
    row = next(row for row in t.paths if row.kind != "direct")
    for ray in rays_of_paths(t, [row.path_id], 3):
        assert any(np.array_equal(line, ray.points) for line in lines)
    assert len(written.paths) == len({*written.paths})


@pytest.mark.quick
def test_what_closes_a_body(tmp_path):
    scene = scene_of(
        a={"type": "asphere", "radius": 20.0, "semi_diameter": 5.0, "part": "L", "bsdf": GLASS},
        b={"type": "asphere", "semi_diameter": 4.0, "z": 3.0, "part": "L", "bsdf": GLASS_BACK},
        c={"type": "asphere", "radius": 6.0, "semi_diameter": 5.0, "z": 9.0, "part": "M", "bsdf": GLASS},
        d={"type": "asphere", "radius": -6.0, "semi_diameter": 5.0, "z": 10.0, "part": "M", "bsdf": GLASS_BACK},
    )
    written = mistray.export_step(scene, tmp_path / "bare.step")
    assert (written.solids, written.sheets) == (("L",), ("M",))
    assert any("L" in note for note in written.notes)
    assert any("M" in note and "cross" in note for note in written.notes)
    height = 20 - np.sqrt(20**2 - 5**2)
    exact = cap(20, height) + np.pi / 3 * (3 - height) * (25 + 20 + 16)
    body = parts_of(written.path)["L"]
    assert abs(volume(body) - exact) <= 1.1 * TOL * area(body)
    written = mistray.export_step(mistray.load("head_up_display"), tmp_path / "hud.step")
    assert set(written.solids) == {"windscreen", "cover"}
    cover = parts_of(written.path, 0.1)["cover"]
    assert closed(cover)
    assert volume(cover) == pytest.approx(60 * 44 * 1.1, rel=1e-5)  # 60 mm × 44 mm × 1.1 mm


@pytest.mark.quick
def test_wrong_numbers_are_refused_and_nothing_is_written(tmp_path):
    target = tmp_path / "no.step"
    each_refused(
        (lambda: mistray.export_step(mistray.load("plate"), target, rays_per_path=0), "rays_per_path"),
        (lambda: mistray.export_step(mistray.load("singlet_window_detector"), target, 80.0), "80 deg"),
    )
    assert not target.exists()


def test_the_command_writes_a_file_once(tmp_path, capsys):
    target = tmp_path / "cassegrain.step"
    command = ["export", "cassegrain", "-o", target]
    shown = json.loads(succeeds(capsys, *command, "--mirror-thickness-mm", 8, "--json"))
    assert shown["solids"] == ["primary", "secondary"]
    before = target.read_bytes()
    assert "exists" in fails(capsys, *command)
    assert "--paths" in fails(capsys, *command, "--force", "--rays", 100)
    assert "--wavelength-nm" in fails(capsys, *command, "--force", "--wavelength-nm", 500, 600, "--field-deg", 0)
    assert target.read_bytes() == before
    assert "--paths" in fails(capsys, "export", "plate", "-o", tmp_path / "plate.zmx", "--paths", 2)


@pytest.mark.parametrize("field", [pytest.param(0.0, marks=pytest.mark.long), 14.0])
def test_beams_hold_the_rays_that_the_tree_traces(field):
    """Direct rays of the ray tree, which knows no rim, lie within the rim on every surface, and come near to it."""
    scene = mistray.load("double_gauss")
    beam = BeamFinder(scene).beam(field)
    t = mistray.trace(scene, rays=4000, field_deg=field, max_reflections=0)
    image = max((row for row in t.paths if row.kind == "direct"), key=lambda row: row.power_W)
    rays = np.array(t.history(image.path_id, 3000).rays)
    assert beam.places[1:] == [step.rpartition(":")[0] for step in image.events.split()]
    for k in range(1, len(beam.places) - 1):
        rim, middle = beam.caps[k, :, -1, :2], beam.middle[k, :2]
        points = rays[:, k, :2] - middle
        turn = np.arctan2(*(rim - middle).T[::-1])
        order = np.argsort(turn)
        reach = np.interp(
            np.arctan2(points[:, 1], points[:, 0]), turn[order], np.linalg.norm(rim - middle, axis=1)[order],
            period=2 * np.pi,
        )  # fmt: skip
        share = np.linalg.norm(points, axis=1) / reach
        # Between 72 rays at the rim the radius is taken as linear: off by 1/8 (2π/72)² of it at most, single precision
        assert share.max() < 1 + 2e-3, beam.places[k]
        assert share.max() > 0.97, beam.places[k]  # of 3000 even rays none within 3 %: e^-180

"""The 3-D view, the layout, surfaces that they cut open, and files of rays: all is what was traced."""

import importlib
import json
import re
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from analyses.explorer.chromium import needs_chromium, page
from analyses.fake_trace import SHARES, paths_at, scatter_trace_at, trace_in_colours
from analyses.view.view_scene import A4, CONIC, EXACT, FORMULAS, RADIUS, SCENE, RayTrace, tilted
from matplotlib import colormaps
from matplotlib.colors import to_hex
from oracles.scatter_scenes import scatter_scene
from oracles.small_scenes import interface_xml, shape_xml
from refusals import each_refused, refused

import mistray
from mistray.analyses.view.controls import NO_LIGHT, FluxScale
from mistray.analyses.view.drawing import LEGEND_LETTERS, legend_text
from mistray.analyses.view.ray_files import read_rays, write_rays
from mistray.toolkit.drawings import section_layout as layouts
from mistray.toolkit.drawings.cut_open import CutPlane, clip, open_surfaces, triangulate, turned
from mistray.toolkit.drawings.path_polylines import RayLine, rays_of_paths, row_name
from mistray.toolkit.drawings.section_layout import glass_bodies, layout_figure, meridional, section, write_layout

view = mistray.view


@pytest.fixture(scope="module")
def scene(load_scene):
    return load_scene(SCENE)


@pytest.fixture(scope="module")
def trace():
    return RayTrace(paths_at(10.0), 10.0)


@pytest.fixture(scope="module")
def shown(scene, trace):
    return view(scene, trace, paths=3, rays=5, title="<plate> & lens")


def points(drawn):
    return np.column_stack([drawn.x, drawn.y, drawn.z])


def of(figure, key):
    return {drawn.meta[key]: drawn for drawn in figure.data if key in (drawn.meta or {})}


def test_surfaces_are_meshes_and_legend_rows_those_of_the_path_table(scene, shown, trace):
    meshes = of(shown.figure, "surface")
    assert set(meshes) == set(FORMULAS)
    for name, mesh in meshes.items():
        assert FORMULAS[name](points(mesh)).max() < EXACT, name
        assert points(mesh)[:, 0].min() > -EXACT
    # Axes are equal and hold the scene
    axes = shown.figure.layout.scene
    low, high = np.transpose([axis.range for axis in (axes.xaxis, axes.yaxis, axes.zaxis)])
    ratios = np.array([axes.aspectratio.x, axes.aspectratio.y, axes.aspectratio.z]) / (high - low)
    assert np.ptp(ratios) < 1e-12 * ratios.max()
    assert all((low < points(mesh)).all() and (points(mesh) < high).all() for mesh in meshes.values())
    drawn = of(shown.figure, "path_id")
    names = ["0 direct image, 3 W", "1 detector → window_rear, 0.0002 W", "2 detector → L1_rear, 0.0001 W"]
    assert [lines.name for lines in drawn.values() if lines.showlegend] == names
    assert len({lines.line.color for lines in drawn.values()}) == 3
    for path_id, lines in drawn.items():
        exact = [part for ray in trace.history(path_id, 5).rays for part in (ray, np.full((1, 3), np.nan))]
        np.testing.assert_array_equal(points(lines), np.concatenate(exact))
    # one row of the other legend for each role, which switches all of its surfaces, outlines and cut faces
    roles = [row.name for row in shown.figure.data if row.showlegend and row.legend == "legend2"]
    assert roles == ["glass", "mechanics", "detector"]
    found = {name: mesh.legendgroup for name, mesh in meshes.items()}
    assert found == {**dict.fromkeys(meshes, "glass"), "stop_wall": "structure", "detector": "detector"}
    text = meshes["L1_front"].hovertemplate
    assert "<b>L1_front</b>, part L1<br>glass air | 1.6" in text
    assert "incident 4.000 ± 0.010 W, 1 000 hits<br>absorbed 0.1000 ± 0.0010 W<br>" in text
    assert drawn[0].text[1].startswith("window_front:T, ")
    beside = RayTrace(paths_at(10.0), 10.0)
    beside.settings = {**trace.settings, "azimuth_deg": 90.0, "rays": 7}
    assert "field 10°, 10° at azimuth 90°, 550 nm, 1 000, 7 start rays" in view(scene, [trace, beside], rays=1).note


def test_colours_follow_the_flux(scene, trace):
    surfaces = open_surfaces(scene, None)
    flux = {row.id: row for row in trace.surfaces}
    scale = FluxScale(surfaces, flux, "incident")
    assert scale.top == pytest.approx(np.log10(5.0))
    assert scale.floor == pytest.approx(np.log10(min(row.incident_W for row in trace.surfaces)))
    by_name = dict(zip([surface.name for surface in surfaces], scale.colours, strict=True))
    brightest = max(flux.values(), key=lambda row: row.incident_W).id
    assert by_name[brightest] == "#fde725"  # the upper end of viridis
    assert of(view(scene, trace, rays=1).figure, "surface")[brightest].color == "#fde725"
    # Surfaces without light have a colour of their own
    rows = (SimpleNamespace(incident_W=value) for value in (0.0, 1.0, 1e-3, 1e-30, 1e-5, 0.0))
    scale = FluxScale(surfaces, dict(zip(by_name, rows, strict=True)), "incident")
    assert (scale.floor, scale.top, scale.decades) == (-8.0, 0.0, list(range(-8, 1)))
    assert [colour == NO_LIGHT for colour in scale.colours] == [True, False, False, False, False, True]


@pytest.mark.parametrize("cut_deg", [0.0, 90.0, 180.0, 270.0, 30.0])
def test_the_camera_looks_into_the_open_side_and_light_goes_to_the_right(scene, cut_deg):
    camera = view(scene, cut_deg=cut_deg).figure.layout.scene.camera
    eye, up = (np.array([side.x, side.y, side.z]) for side in (camera.eye, camera.up))
    assert eye @ CutPlane(cut_deg).normal > 1.0
    right = np.cross(-eye, up)
    assert right[2] / np.linalg.norm(right) > 0.8


def test_cut_glass_has_faces_and_a_rare_path_says_so(scene):
    """The plane x = 0 cuts the window; its rear surface is a cap of 0.1001 mm sagitta at 2 mm."""
    figure = view(scene).figure
    (face,) = [drawn for drawn in figure.data if "face" in (drawn.meta or {})]
    assert np.abs(face.x).max() == 0.0
    whole = area(points(face), np.column_stack([face.i, face.j, face.k]))
    depth = np.sqrt(20.0**2 - 2.0**2)  # from the centre of curvature to the rim
    assert whole == pytest.approx(2 * 2.0 * (depth - 19.0) + segment(20.0, depth), rel=1e-4)
    assert not [drawn for drawn in view(scene, cut_deg=40.0).figure.data if "face" in (drawn.meta or {})]

    class Rare(RayTrace):
        def history(self, path_id, n=8):
            found = super().history(path_id, n)
            table = found.to_pandas()
            return found if path_id else type(found)(rays=[], to_pandas=lambda: table[:0])

    shown = view(scene, Rare(paths_at(0.0)), paths=2, rays=1)
    assert of(shown.figure, "path_id")[0].name == "0 direct image, 3 W, too rare to draw"
    several = RayTrace(trace_in_colours(0.0).fakes, shares=SHARES)
    names = [lines.name for lines in of(view(scene, several, paths=2, rays=1).figure, "path_id").values()]
    assert names[0] == "0 direct image, 550 nm, 1.5 W"


def test_without_a_trace(scene, trace, tmp_path, monkeypatch):
    shown = view(scene)
    assert not any((of(shown.figure, "path_id"), of(shown.figure, "scale"), shown.rays))
    meshes = of(shown.figure, "surface")
    assert meshes["L1_front"].opacity < meshes["stop_wall"].opacity == 1
    wall = re.search('<shape type="frustum" id="stop_wall">.*?</shape>', SCENE, re.DOTALL).group()
    (tmp_path / "other.xml").write_text(SCENE.replace(wall, ""), encoding="utf-8")
    other = mistray.load(tmp_path / "other.xml")
    with refused("surface 'stop_wall' is not both in scene and trace"):
        view(other, trace)
    each_refused(
        ({"paths": -1}, "paths is -1; it must be a whole number between 0 and"),
        ({"rays": 0}, "rays is 0; it must be a whole number between 1 and"),
        ({"colour": "red"}, "colour is 'red'; choose from flux, absorbed, irradiance, role"),
        ({"cut_mm": float("nan")}, "cut_mm is nan; it must lie between"),
        ({"cut_mm": -100.0}, "leaves no surface; move the cut"),
        ({"path_ids": [99]}, "path_id 99 does not exist"),
        ({"trace": None, "path_ids": [1]}, "path_ids without a trace"),
        by=lambda arguments: view(scene, **({"trace": trace} | arguments)),
    )
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    with refused(r"needs plotly, which is not installed; run: pip install 'mistray\[view\]'"):
        view(scene)


def test_the_buttons_recolour_and_the_page_needs_no_network(shown, tmp_path):
    looks, colours, rays = shown.figure.layout.updatemenus
    assert [button.label for button in looks.buttons] == ["3-D", "side", "from the light"]
    _, absorbed, by_role = colours.buttons
    values, _, targets = by_role.args
    meshes = [shown.figure.data[k] for k in targets]
    assert [mesh.meta["surface"] for mesh in meshes] == [surface.name for surface in shown.surfaces]
    assert len(values["color"]) == len(targets)
    assert absorbed.args[1] == {"coloraxis.showscale": False, "coloraxis2.showscale": True}
    ratio = shown.figure.layout.scene.aspectratio
    for look in looks.buttons:  # axes stay equal
        sides = look.args[0]["scene.aspectratio"]
        assert sides["x"] / ratio.x == pytest.approx(sides["y"] / ratio.y) == pytest.approx(sides["z"] / ratio.z)
    hidden = [[axis for axis in "xyz" if not look.args[0][f"scene.{axis}axis.visible"]] for look in looks.buttons]
    assert hidden == [[], ["x"], ["z"]]
    assert [shown.figure.data[k] for k in rays.buttons[1].args[1]] == [*of(shown.figure, "path_id").values()]
    path = shown.write(tmp_path / "view.html", command="mistray view <scene>")
    text = path.read_text(encoding="utf-8")
    assert path.stat().st_size < 6_000_000
    assert "<title>&lt;plate&gt; &amp; lens</title>" in text
    assert "mistray view &lt;scene&gt;" in text
    assert shown._repr_html_().startswith("<iframe srcdoc=")
    assert "--paper: #15191e" in text
    assert "--paper: #15191e" not in shown._repr_html_()  # a notebook has a theme of its own
    library = importlib.import_module("plotly.offline").get_plotlyjs()
    assert not re.findall(r"<(?:script|link|img|iframe)[^>]+(?:src|href)\s*=", text.replace(library, ""))
    assert text.count(library[:2000]) == 1


def segment(radius, distance):
    """Area of a disc beyond a chord at a distance from its centre."""
    return radius**2 * np.arccos(distance / radius) - distance * np.sqrt(radius**2 - distance**2)


def area(vertices, faces):
    a, b, c = np.asarray(vertices, dtype=float)[np.asarray(faces)].transpose(1, 0, 2)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


@pytest.mark.parametrize("cut", [None, CutPlane(), CutPlane(90.0), CutPlane(37.0, 0.4)], ids=str)
def test_points_lie_on_the_surfaces_and_on_the_kept_side(scene, cut):
    surfaces = {surface.name: surface for surface in open_surfaces(scene, cut)}
    assert set(surfaces) == set(FORMULAS)
    for name, surface in surfaces.items():
        assert len(surface.faces) > 0
        assert FORMULAS[name](surface.vertices).max() < EXACT, name
        assert all(FORMULAS[name](line).max() < EXACT for line in surface.lines), name
        if cut is not None:
            # a curved rectangle is lifted along its own axis, which lies in these planes
            assert cut.height(surface.vertices).max() < EXACT, name
            assert [line for line in surface.lines if np.abs(cut.height(line)).max() < EXACT], name


def test_halves_have_the_area_of_the_whole(scene):
    def areas(cut):
        return {surface.name: area(surface.vertices, surface.faces) for surface in open_surfaces(scene, cut)}

    whole, near, far = areas(None), areas(CutPlane(0.0)), areas(CutPlane(180.0))
    for name in ("L1_front", "stop_wall", "window_front", "window_rear"):
        assert near[name] + far[name] == pytest.approx(whole[name], rel=2e-3)
    for name, exact in (("stop_wall", np.pi * 5.0 * np.hypot(1.0, 4.0)), ("window_front", 24.0)):
        assert whole[name] == pytest.approx(exact, rel=2e-3)
        assert areas(CutPlane(180.0, 50.0))[name] == pytest.approx(exact, rel=5e-3)
    assert all(len(surface.faces) == 0 for surface in open_surfaces(scene, CutPlane(180.0, -50.0)))
    # A tube of radius 2 cut at x = 1: the arc that is left spans 240 degrees
    vertices, faces, lines = turned([[2.0, 0.0], [2.0, 5.0]], np.eye(4), 400, CutPlane(0.0, 1.0))
    assert area(vertices, faces) == pytest.approx(5.0 * 2.0 * np.radians(240.0), rel=1e-4)
    corners = sorted(line[0, :2].tolist() for line in lines if np.ptp(line[:, 2]) > 1.0)
    np.testing.assert_allclose(corners, [[1.0, -np.sqrt(3)], [1.0, np.sqrt(3)]], atol=1e-12)
    # A disc whose plane is not that of any ring of the cut: half of it is left whatever its tilt
    matrix, r = tilted(25.0), np.linspace(0.0, 3.0, 33)
    vertices, faces, _ = turned(np.column_stack([r, 0.0 * r]), matrix, 200, CutPlane(180.0))
    assert area(vertices, faces) == pytest.approx(np.pi * 9.0 / 2, rel=1e-3)
    assert np.abs(vertices @ matrix[:3, 2]).max() < 1e-11


def shape_of(kind, place="", **numbers):
    values = "".join(f'<float name="{key}" value="{value}"/>' for key, value in numbers.items())
    return f'<shape type="{kind}" id="it">{values}{place}{interface_xml("air", "1.5")}</shape>'


def test_what_is_left_of_a_surface_whose_vertex_is_gone(load_scene):
    """Segments of discs, half of cylinders whose middle lies in the plane, and the parts on both sides of a plane."""

    def opened(kind, numbers, cut, place=""):
        (it,) = open_surfaces(load_scene(scatter_scene(shape_of(kind, place, **numbers))), cut)
        return it.vertices, area(it.vertices, it.faces)

    fold = {"semi_diameter": 10.0, "x": -3.0, "tilt_y": 45.0}
    assert opened("asphere", fold, CutPlane())[1] == pytest.approx(segment(10.0, 3 * np.sqrt(2)), rel=5e-3)
    disk = '<transform name="to_world"><scale value="3"/><translate y="1"/></transform>'
    assert opened("disk", {}, CutPlane(90.0, 0.3), disk)[1] == pytest.approx(segment(3.0, 0.7), rel=5e-3)
    for tilt in (90.0, 45.0):
        tube = {"r0": 2.0, "z0": -5.0, "r1": 2.0, "z1": 5.0, "tilt_y": tilt}
        assert opened("frustum", tube, CutPlane())[1] == pytest.approx(20 * np.pi, rel=1e-2)
    for kind, shape, place in (
        ("asphere", {"radius": 40.0, "semi_diameter": 10.0, "x": -3.0, "tilt_y": 30.0}, ""),
        ("sphere", {"radius": 3.0}, '<point name="center" x="-1" y="0" z="0"/>'),
    ):
        parts = [opened(kind, shape, cut, place) for cut in (None, CutPlane(180.0), CutPlane(0.0))]
        (_, whole), (vertices, near), (_, far) = parts
        assert near + far == pytest.approx(whole, rel=2e-3)
        centre = [40 * 0.5 - 3, 0.0, 40 * np.cos(np.radians(30.0))] if "x" in shape else [-1.0, 0, 0]
        np.testing.assert_allclose(np.linalg.norm(vertices - centre, axis=1), shape["radius"], atol=1e-6)


CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (0, 2) for z in (5, 6)], dtype=float)
BOX = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
       [1, 5, 7], [1, 7, 3]]  # fmt: skip


@pytest.mark.parametrize("offset", [-0.5, 0.0, 0.25])
def test_clipped_box(offset):
    """2 × 2 × 1 mm: what is left of it lies at x ≤ offset; its walls keep their winding."""
    vertices, faces, lines = clip(CORNERS, BOX, CutPlane(0.0, offset))
    depth = 1.0 + offset
    assert area(vertices, faces) == pytest.approx(2.0 * 1.0 + depth * 2 * (2.0 + 1.0), rel=1e-12)
    assert sum(np.linalg.norm(line[1] - line[0]) for line in lines) == pytest.approx(2 * (2.0 + 1.0))
    normals = np.cross(*(np.diff(vertices[faces], axis=1)).transpose(1, 0, 2))
    outward = vertices[faces].mean(axis=1) - [(offset - 1) / 2, 1.0, 5.5]
    assert (np.einsum("ij,ij->i", normals, outward) > 0).all()
    assert clip(CORNERS.astype(np.float32), BOX, CutPlane(0.0, offset))[0].dtype == np.float32


def test_triangles_of_a_polygon():
    """An L from both sides, corners twice and on edges, a comb, and the segment between two parabolas."""
    y = np.linspace(-1.0, 1.0, 129)
    bent = [[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]]
    comb = [[0, 0], [5, 0], [5, 2], [4, 2], [4, 1], [3, 1], [3, 2], [2, 2], [2, 1], [1, 1], [1, 2], [0, 2]]
    meniscus = np.concatenate([np.column_stack([0.5 * y**2, y]), np.column_stack([0.3 + 0.2 * y**2, y])[::-1]])
    for outline, exact, error in (
        (bent, 5.0, 1e-12),
        (bent[::-1], 5.0, 1e-12),
        ([[0, 0], [1, 0], [1, 0], [2, 0], [2, 2], [0, 2], [0, 1]], 4.0, 1e-12),
        (comb, 8.0, 1e-12),
        (meniscus, 0.4, 2e-4),
    ):
        points = np.column_stack([np.array(outline, dtype=float), np.zeros(len(outline))])
        assert area(points, triangulate(outline)) == pytest.approx(exact, rel=error)
    values = {"id": "dust", "is_sensor": False, "is_mesh": False, "bsdf": None, "__str__": "SDFGrid[\n]"}
    dust = type("Dust", (), {name: lambda _, value=value: value for name, value in values.items()})()
    with refused("shape 'dust' is SDFGrid, which has no triangles to draw"):
        open_surfaces(SimpleNamespace(shapes=lambda: [dust]), None)


STOCK = {
    "rectangle": ('<transform name="to_world"><scale x="2" y="1"/><translate z="5"/></transform>', 8.0),
    "disk": ('<transform name="to_world"><scale value="2"/><translate z="5"/></transform>', np.pi * 4),
    "sphere": ('<float name="radius" value="2"/><point name="center" x="0" y="0" z="5"/>', 4 * np.pi * 4),
    "cylinder": (
        '<float name="radius" value="2"/><point name="p0" x="0" y="0" z="4"/><point name="p1" x="0" y="0" z="7"/>',
        2 * np.pi * 2 * 3,
    ),
    "cube": ('<transform name="to_world"><translate z="5"/></transform>', 24.0),
}


@pytest.mark.parametrize("kind", STOCK)
def test_shapes_of_mitsuba(kind, load_scene):
    inside, exact = STOCK[kind]
    scene = load_scene(scatter_scene(shape_of(kind, inside)))
    for cut, share in ((None, 1.0), (CutPlane(), 0.5)):
        (it,) = open_surfaces(scene, cut)
        assert area(it.vertices, it.faces) == pytest.approx(exact * share, rel=5e-3)
        if kind == "sphere":
            np.testing.assert_allclose(np.linalg.norm(it.vertices - [0, 0, 5.0], axis=1), 2.0, atol=EXACT)


def test_a_layout_has_the_rays_of_the_history_and_the_rows_asked_for(trace, scene, tmp_path):
    figure = layout_figure(scene, trace, paths=2, rays=4)
    axes = figure.axes[0]
    handles, labels = axes.get_legend_handles_labels()
    assert labels == ["0 direct image, 3 W", "1 detector → window_rear, 0.0002 W"]
    for path_id, handle in enumerate(handles):
        drawn = [line for line in axes.lines if line.get_color() == handle.get_color() and len(line.get_xdata())]
        assert len(drawn) == 4
        for line, ray in zip(drawn, meridional(trace.history(path_id, layouts.CANDIDATES * 4).rays, 4), strict=True):
            np.testing.assert_array_equal(line.get_xydata(), ray[:, [2, 1]])
    labels = layout_figure(scene, trace, path_ids=[3, 0], rays=1).axes[0].get_legend_handles_labels()[1]
    assert [label.split()[0] for label in labels] == ["3", "0"]
    nine = RayTrace(trace_in_colours(10.0).fakes, 10.0, shares=SHARES)
    handles, _ = layout_figure(scene, nine, path_ids=range(9), rays=1).axes[0].get_legend_handles_labels()
    looks = [(handle.get_color(), handle.get_linestyle()) for handle in handles]
    assert len(set(looks)) == 9
    assert looks[8] == (looks[0][0], "--")
    axes = layout_figure(scene).axes[0]
    assert (axes.get_legend_handles_labels(), axes.get_title()) == (([], []), "")
    each_refused(
        (trace, {"path_ids": [99]}, "path_id 99 does not exist"),
        (None, {"path_ids": [1]}, "path_ids without a trace"),
        (trace, {"rays": 0}, "rays is 0"),
        (trace, {"paths": -2}, "paths is -2"),
        by=lambda given, options: layout_figure(scene, given, **options),
    )
    # Text as text, so that a paper's own font and a search find it; the same file every time
    text = write_layout(figure, tmp_path / "layout.svg").read_text(encoding="utf-8")
    assert "".join(ET.fromstring(text).itertext()).count("0 direct image, 3 W") == 1
    assert "<image" not in text
    again = write_layout(layout_figure(scene, trace, paths=2, rays=4), tmp_path / "again.svg")
    assert again.read_text(encoding="utf-8") == text
    for ending, start in (("pdf", b"%PDF"), ("eps", b"%!PS"), ("png", b"\x89PNG")):
        assert write_layout(figure, tmp_path / f"layout.{ending}").read_bytes().startswith(start)


def test_section_of_a_surface_of_revolution_is_exact(scene):
    """A window on the axis; the lens beside the plane is cut through its triangles, which are chords of it."""
    lines = {surface.name: surface.lines for surface in section(scene)}
    (rear,) = lines["window_rear"]
    np.testing.assert_allclose(rear[:, 0], 1.0 - 20.0 + np.sqrt(20.0**2 - rear[:, 1] ** 2), atol=1e-12)
    lens = np.concatenate(lines["L1_front"])
    r2 = 0.3**2 + lens[:, 1] ** 2
    sag = (r2 / RADIUS) / (1 + np.sqrt(1 - (1 + CONIC) * r2 / RADIUS**2)) + A4 * r2**2
    assert np.abs(lens[:, 0] - 3.0 - sag).max() < 2e-3


def test_sections_of_a_turned_rectangle_of_air_gaps_and_of_other_bsdfs(load_scene):
    """The gap between two lenses is no glass, whatever its name; a BSDF of Mitsuba is drawn as structure."""
    sides = (0.0, "1.0", "N-BK7"), (3.0, "N-BK7", "1.0"), (20.0, "Air", "N-BK7"), (23.0, "N-BK7", "1.0")
    lenses = [shape_xml("asphere", f"L{z:g}", z, interface_xml(*media), semi_diameter=4.0) for z, *media in sides]
    ball = shape_xml("sphere", "ball", 40.0, '<bsdf type="roughconductor"/>')
    rectangle = shape_xml("asphere", "turned", 30.0, half_width=2.0, half_height=10.0, tilt_z=90.0)
    scene = load_scene(scatter_scene(*lenses, rectangle, ball))
    bodies = sorted((body[:, 0].min(), body[:, 0].max()) for body in glass_bodies(scene))
    np.testing.assert_allclose(bodies, [(0, 3), (20, 23)], atol=1e-9)
    lines = {surface.name: np.concatenate(surface.lines) for surface in section(scene)}
    assert (lines["turned"][:, 1].min(), lines["turned"][:, 1].max()) == pytest.approx((-2, 2), abs=1e-6)
    assert {surface.name: surface.role for surface in open_surfaces(scene, None)}["ball"] == "structure"
    assert layout_figure(scene) is not None


def test_hits_lie_on_their_surfaces_and_pages_are_small():
    triplet = mistray.load("cooke_triplet")
    traced = mistray.trace(triplet, rays=2_000, field_deg=10.0, max_reflections=2, max_scatters=0)
    seen = mistray.view(triplet, traced, paths=3, rays=4)
    surfaces, met = {shape.id(): shape for shape in triplet.shapes()}, set()
    assert {ray.path_id for ray in seen.rays} == {0, 1, 2}
    for ray in seen.rays:
        assert ray.events == traced.paths[ray.path_id].events
        for point, event in zip(ray.points[1:], ray.events.split(), strict=True):
            name = event.rpartition(":")[0]
            curvature, vertex = surfaces[name].values["curvature"], surfaces[name].matrix[2, 3]
            depth = point[2] - vertex
            # the sphere about (0, 0, vertex + 1/c) by its equation c (x² + y² + z²) = 2 z
            error = curvature * (point @ point - point[2] ** 2 + depth**2) / 2 - depth
            assert abs(error) < 1e-9, name
            met.add(name)
    assert {"L1_front", "L3_rear", "detector"} <= met
    for ray in rays_of_paths(traced, [0, 1], n=2):
        assert (np.diff(ray.flux_W) <= 0).all()
        assert ray.flux_W[0] == pytest.approx(traced.energy.launched_W / 2_000)
    seen = mistray.view(mistray.load("phone_camera"))
    assert len(seen.surfaces) > 60
    assert len(seen.html().encode()) < 6_000_000
    for given in (traced, None):
        with refused("irradiance"):
            mistray.view(triplet, given, colour="irradiance")


def test_walls_are_coloured_by_the_irradiance_of_their_cells():
    scene = mistray.load("plate_and_wall", sensors=["surface_maps:housing* screen,azimuths=12,lengths=5,id=walls"])
    traced = mistray.trace(scene, rays=3000, field_deg=20.0, max_reflections=1, max_scatters=1)
    seen = mistray.view(scene, traced, paths=1, rays=1, cut_deg=None)
    maps = traced.recorders["walls"].maps
    drawn = {one.meta["wall"]: one for one in seen.figure.data if "wall" in (one.meta or {})}
    assert set(drawn) == set(maps) == {"housing_wall", "housing_face", "screen"}
    for name, mesh in drawn.items():
        corners = maps[name].corners.reshape(-1, 3)
        np.testing.assert_array_equal(np.column_stack([mesh.x, mesh.y, mesh.z]), corners)
        middles = np.mean([corners[np.array(k)] for k in (mesh.i, mesh.j, mesh.k)], axis=0)
        cells = 0.5 * (middles[:60] + middles[60:])  # two triangles each
        # Corners of a facet lie on the tube, so that its middle is within it by 1 - cos 15°
        assert np.linalg.norm(cells - maps[name].places.reshape(-1, 3), axis=1).max() < 0.04 * np.abs(corners).max()
        assert list(mesh.facecolor[:60]) == list(mesh.facecolor[60:])
        value = maps[name].irradiance[0].ravel()
        assert {colour for colour, lit in zip(mesh.facecolor, value > 0, strict=False) if not lit} <= {NO_LIGHT}
    lit = np.concatenate([one.irradiance[0].ravel() for one in maps.values()])
    ends = [colour for mesh in drawn.values() for colour in mesh.facecolor[:60]]
    assert ends[int(np.argmax(lit))] == to_hex(colormaps["viridis"](1.0))
    # A button shows cells in the place of their walls
    seen = mistray.view(scene, traced, paths=1, rays=1, colour="flux")
    data = seen.figure.data
    buttons = {button.label: button.args for button in seen.figure.layout.updatemenus[1].buttons}
    assert list(buttons) == ["incident flux", "absorbed flux", "irradiance", "role"]
    for label, (values, bars, targets) in buttons.items():
        cells = label == "irradiance"
        for k, visible in zip(targets, values["visible"], strict=True):
            mapped = data[k].meta.get("surface") in maps
            assert visible == (cells if "wall" in data[k].meta else not (cells and mapped))
        assert bars["coloraxis3.showscale"] == cells
        if label == "incident flux":  # as it is seen at first
            assert [data[k].visible for k in targets] == list(values["visible"])
    cut = {one.meta["wall"]: one for one in data if "wall" in (one.meta or {})}["housing_wall"]
    assert len(cut.i) == 12 * 5  # half of the cells, two triangles each


@pytest.fixture(scope="module")
def rays(trace):
    return rays_of_paths(trace, [0, 2, 1], n=3)


def test_rays_are_those_of_the_history(trace, rays):
    assert [ray.path_id for ray in rays] == [0] * 3 + [2] * 3 + [1] * 3
    for ray in rays:
        row = trace.paths[ray.path_id]
        assert (ray.events, ray.wavelength_nm) == (row.events, row.wavelength_nm)
        assert len(ray.points) == len(ray.flux_W) == len(row.event_list) + 1
    for ray, exact in zip(rays[3:6], trace.history(2, 3).rays, strict=True):
        np.testing.assert_array_equal(ray.points, exact)
    assert {ray.path_id for ray in rays_of_paths(trace, n=1)} == set(range(len(trace.paths)))
    assert {"0 direct image, 3 W", "1 detector → window_rear, 0.0002 W"} <= {row_name(row) for row in trace.paths}
    labels = [row.label for row in scatter_trace_at(0.0).paths if row.kind == "single scatter"]
    assert labels.count("scatter at window_rear") == labels.count("window_rear:i") == 1
    assert len(set(labels)) == len(labels)


@pytest.mark.parametrize("ending", ["ply", "obj", "json"])
def test_round_trip_is_exact(rays, ending, tmp_path):
    again = read_rays(write_rays(rays, tmp_path / f"rays.{ending}"))
    assert again == rays
    assert [ray.start_ray for ray in again] == [0, 1, 2, 200, 201, 202, 100, 101, 102]
    assert read_rays(write_rays([], tmp_path / f"none.{ending}")) == []
    odd = np.array([[1 / 3, -0.0, 5e-324], [np.pi * 1e300, np.nextafter(1.0, 2.0), -1e-17]])
    ray = RayLine(7, "gläserne_Platte:T detector:A", 632.8, 2**31 - 1, odd, np.array([1e-300, 0.1 + 0.2]))
    (again,) = read_rays(write_rays([ray], tmp_path / f"odd.{ending}"))
    assert again == ray
    assert np.signbit(again.points[0, 1])
    blocked = [replace(ray, path_id=-1, events=events) for events in ("L1:R stop:A", "tube:A", "")]
    assert read_rays(write_rays(blocked, tmp_path / f"blocked.{ending}")) == blocked


def test_ply_is_as_viewers_read_it(rays, tmp_path):
    content = write_rays(rays, tmp_path / "rays.ply").read_bytes()
    events = b"".join(f"comment path {ray.path_id} {ray.events}\n".encode() for ray in rays)  # as in mistray 0.2
    (tmp_path / "older.ply").write_bytes(re.sub(b"(?s)comment ray.*(?=element vertex)", events, content))
    assert read_rays(tmp_path / "older.ply") == rays
    head, _, body = content.partition(b"end_header\n")
    lines = head.decode().splitlines()
    vertices = sum(len(ray.points) for ray in rays)
    at = lines.index(f"element vertex {vertices}")
    assert lines[at + 1 : at + 4] == [f"property double {axis}" for axis in "xyz"]
    at = lines.index(f"element edge {vertices - len(rays)}")
    assert lines[at + 1 :] == ["property int vertex1", "property int vertex2"]
    edges = np.frombuffer(body[-8 * (vertices - len(rays)) :], dtype="<i4").reshape(-1, 2)
    ray_of = np.repeat(np.arange(len(rays)), [len(ray.points) for ray in rays])
    assert (ray_of[edges[:, 0]] == ray_of[edges[:, 1]]).all()
    assert len(set(map(tuple, edges.tolist()))) == len(edges)
    text = write_rays(rays, tmp_path / "rays.obj").read_text(encoding="utf-8")
    words = [line.split() for line in text.splitlines()]
    points = np.array([[float(x) for x in line[1:]] for line in words if line[0] == "v"])
    polylines = [points[np.array(line[1:], dtype=int) - 1] for line in words if line[0] == "l"]
    assert [line[1] for line in words if line[0] == "g"] == ["path_0", "path_2", "path_1"]
    for polyline, ray in zip(polylines, rays, strict=True):
        np.testing.assert_array_equal(polyline, ray.points)
    with refused("check the folder and its permissions"):
        write_rays(rays, tmp_path / "nowhere" / "rays.json")
    with refused(r"ray file .*none.ply': No such file or directory"):
        read_rays(tmp_path / "none.ply")


BROKEN = {
    "ply": [b"", b"ply\nformat ascii 1.0\n", b"\x00\xff"],
    "obj": [b"", b"v 1 2 3\n", b"\xff\xfe", b"# mistray rays 1, mm\nl 1 2\n", b"# mistray rays 1, mm\nv a\n"],
    "json": [b"", b"[]", b"{", b'{"format": "mistray rays 1"}', b'{"format": "mistray rays 1", "rays": [{}]}'],
}


@pytest.mark.parametrize("ending", BROKEN)
def test_other_files_are_refused_in_one_line(ending, rays, tmp_path):
    path = tmp_path / f"broken.{ending}"
    whole = write_rays(rays, path).read_bytes()
    for content in [*BROKEN[ending], whole[: len(whole) // 2 - 3]]:
        path.write_bytes(content)
        with refused(r"^ray file .*write_rays wrote$", str(path)):
            read_rays(path)
    if ending == "json":
        data = json.loads(whole)
        data["rays"][0]["flux_W"].pop()
        path.write_text(json.dumps(data), encoding="utf-8")
        with refused("a ray of path 0 has 6 points and 5 fluxes"):
            read_rays(path)


BOXES = """
[".updatemenu-button", ".colorbar", ".legend", ".legend2"]
  .flatMap((name) => [...document.querySelectorAll(`#view ${name}`)])
  .map((part) => part.getBoundingClientRect()).filter((box) => box.width > 0)
  .map(({ left, right, top, bottom }) => [left, right, top, bottom])
"""
LONG = "17 multiple scatter at third_barrel_wall_2, scatter at the_inner_retaining_ring_of_the_window, 550 nm, 1e-05 W"
COLOURS = "[plot._fullLayout.paper_bgcolor, plot._fullLayout.font.color, plot.data.at(-1).line.color]"


@pytest.mark.long
@needs_chromium
@pytest.mark.parametrize(("width", "scheme"), [(390, "dark"), (1100, "light"), (1280, "dark")])
def test_parts_of_a_view_lie_apart(width, scheme, tmp_path):
    """Down to a telephone, light and dark: nothing lies upon another thing or is cut off."""
    scene = mistray.load("plate")
    seen = mistray.view(scene, mistray.trace(scene, field_deg=5, rays=2000), title="plate")
    seen.figure.data[-1].update(name=legend_text(LONG), line={"color": "#000000"})
    file = seen.write(tmp_path / "view.html", "mistray view plate")
    with page(tmp_path / "profile") as shown:
        shown.like(scheme)
        shown.open(file.as_uri(), width, 844)
        shown.until("document.querySelector('#view .legend')")
        shown.run("new Promise((done) => setTimeout(done, 1000))")
        assert shown.run("document.documentElement.scrollWidth") <= width
        boxes = shown.run(BOXES)
        assert len(boxes) > 6
        for k, (left, right, top, bottom) in enumerate(boxes):
            assert -2 <= left < right <= width + 2
            for west, east, north, south in boxes[k + 1 :]:
                assert right <= west + 2 or east <= left + 2 or bottom <= north + 2 or south <= top + 2
        assert shown.run("plot._fullLayout._size.w") > 0.6 * width
        light = ["white", "#2a3f5f", "#000000"]
        assert (shown.run(COLOURS) == light) == (scheme == "light")
        assert shown.is_white() == (scheme == "light")
        assert shown.violations() == []
        # The page follows a change of the colours, there and back
        shown.like("light")
        shown.run("new Promise((done) => setTimeout(done, 500))")
        assert shown.run(COLOURS) == light
        assert shown.errors == []


def test_names_of_a_legend_break():
    assert legend_text("0 direct image, 3 W") == "0 direct image, 3 W"
    lines = legend_text(LONG).split("<br>")
    assert (len(lines), lines[0]) == (3, "17 multiple scatter at")
    assert lines[2].startswith("…")
    assert lines[2].endswith("_of_the_window, 550 nm, 1e-05 W")
    assert max(map(len, lines)) <= LEGEND_LETTERS
    assert legend_text("<a> & b") == "&lt;a&gt; &amp; b"
    for letters in (100, 200):
        assert max(map(len, legend_text("x" * letters).split("<br>"))) == LEGEND_LETTERS

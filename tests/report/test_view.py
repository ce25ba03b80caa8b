"""The 3-D view: what stands in the figure is what the scene and the trace have."""

from __future__ import annotations

import importlib
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from report.fake_trace import SHARES, paths_at, trace_in_colours
from report.view_scene import EXACT, FORMULAS, SCENE, RayTrace

import mistray
from mistray.errors import MistrayError
from mistray.report.figures.cut_open import CutPlane, open_surfaces
from mistray.report.view3d.controls import NO_LIGHT, FluxScale

view = mistray.view


@pytest.fixture(scope="module")
def shown(scene, trace):
    return view(scene, trace, paths=3, rays=5, title="<plate> & lens")


def points(drawn):
    return np.column_stack([drawn.x, drawn.y, drawn.z])


def of(figure, key):
    return {drawn.meta[key]: drawn for drawn in figure.data if key in (drawn.meta or {})}


def test_surfaces_are_meshes_and_legend_rows_those_of_the_path_table(shown, trace):
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
    # Paths
    drawn = of(shown.figure, "path_id")
    names = ["0 direct image, 3 W", "1 detector → window_rear, 0.0002 W", "2 detector → L1_rear, 0.0001 W"]
    assert [lines.name for lines in drawn.values() if lines.showlegend] == names
    assert len({lines.line.color for lines in drawn.values()}) == 3
    for path_id, lines in drawn.items():
        exact = [part for ray in trace.history(path_id, 5).rays for part in (ray, np.full((1, 3), np.nan))]
        np.testing.assert_array_equal(points(lines), np.concatenate(exact))
    # one row of the other legend for each role, which switches all of its surfaces, outlines and cut faces
    roles = [drawn for drawn in shown.figure.data if drawn.showlegend and drawn.legend == "legend2"]
    assert [drawn.name for drawn in roles] == ["glass", "mechanics", "detector"]
    for surface in shown.surfaces:
        assert of(shown.figure, "surface")[surface.name].legendgroup == surface.role
    # Hovering says id, part and flux
    text = of(shown.figure, "surface")["L1_front"].hovertemplate
    assert "<b>L1_front</b>, part L1<br>glass air | 1.6" in text
    assert "incident 4.000 ± 0.010 W, 1 000 hits<br>absorbed 0.1000 ± 0.0010 W<br>" in text
    ray = of(shown.figure, "path_id")[0].text
    assert ray[0].startswith("start, 0.6 W")
    assert ray[1].startswith("window_front:T, ")


def test_colours_follow_the_flux(scene, trace):
    surfaces = open_surfaces(scene, None)
    flux = {row.id: row for row in trace.surfaces}
    scale = FluxScale(surfaces, flux, "incident")
    assert scale.top == pytest.approx(np.log10(5.0))
    assert scale.floor == pytest.approx(np.log10(min(row.incident_W for row in trace.surfaces)))
    by_name = dict(zip([surface.name for surface in surfaces], scale.colours, strict=True))
    brightest = max(flux.values(), key=lambda row: row.incident_W).id
    assert by_name[brightest] == "#fde725"  # the upper end of viridis
    figure = view(scene, trace, rays=1).figure
    assert of(figure, "surface")[brightest].color == "#fde725"
    assert [mark.marker.coloraxis for mark in of(figure, "scale").values()] == ["coloraxis", "coloraxis2"]
    bar, other = figure.layout.coloraxis, figure.layout.coloraxis2
    assert (bar.cmin, bar.cmax, bar.showscale, other.showscale) == (scale.floor, scale.top, True, False)

    # Surfaces without light have a colour of their own
    def scaled(*values):
        rows = (SimpleNamespace(incident_W=value) for value in values)
        return FluxScale(surfaces, dict(zip(by_name, rows, strict=True)), "incident")

    scale = scaled(0.0, 1.0, 1e-3, 1e-30, 1e-5, 0.0)
    assert (scale.floor, scale.top, scale.decades) == (-8.0, 0.0, list(range(-8, 1)))
    assert [colour == NO_LIGHT for colour in scale.colours] == [True, False, False, False, False, True]
    assert set(scaled(*[0.0] * 6).colours) == {NO_LIGHT}


@pytest.mark.parametrize("cut_deg", [0.0, 90.0, 180.0, 270.0, 30.0])
def test_the_camera_looks_into_the_open_side_and_light_goes_to_the_right(scene, cut_deg):
    camera = view(scene, cut_deg=cut_deg).figure.layout.scene.camera
    eye, up = (np.array([side.x, side.y, side.z]) for side in (camera.eye, camera.up))
    assert eye @ CutPlane(cut_deg).normal > 1.0
    right = np.cross(-eye, up)
    assert right[2] / np.linalg.norm(right) > 0.8


def test_glass_has_faces_where_it_is_cut(scene):
    """The plane x = 0 cuts the window; its rear surface is a cap of 0.1001 mm sagitta at 2 mm."""
    figure = view(scene).figure
    (face,) = [drawn for drawn in figure.data if "face" in (drawn.meta or {})]
    assert np.abs(face.x).max() == 0.0
    corners = points(face)[np.column_stack([face.i, face.j, face.k])]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    half = 2.0
    segment = 20.0**2 * np.arcsin(half / 20.0) - half * np.sqrt(20.0**2 - half**2)  # between arc and chord
    sagitta = 20.0 - np.sqrt(20.0**2 - half**2)
    assert areas.sum() == pytest.approx(2 * half * (1.0 - sagitta) + segment, rel=1e-4)
    # In a plane where the glass is not known there are none
    assert not [drawn for drawn in view(scene, cut_deg=40.0).figure.data if "face" in (drawn.meta or {})]


def test_without_a_trace(scene, trace, tmp_path, monkeypatch):
    shown = view(scene)
    assert not of(shown.figure, "path_id")
    assert not of(shown.figure, "scale")
    assert not shown.rays
    assert len(shown.figure.layout.updatemenus) == 1
    assert of(shown.figure, "surface")["L1_front"].opacity < 1
    assert of(shown.figure, "surface")["stop_wall"].opacity == 1
    # A trace of another scene
    wall = re.search('<shape type="frustum" id="stop_wall">.*?</shape>', SCENE, re.DOTALL).group()
    (tmp_path / "other.xml").write_text(SCENE.replace(wall, ""), encoding="utf-8")
    other = mistray.load(tmp_path / "other.xml")
    with pytest.raises(MistrayError, match="surface 'stop_wall' is not both in scene and trace"):
        view(other, trace)
    # Without plotly one line says what to do
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    with pytest.raises(MistrayError, match=r"needs plotly, which is not installed; pip install 'mistray\[view\]'"):
        view(scene)


def test_the_buttons_recolour_and_the_page_needs_no_network(shown, tmp_path):
    looks, colours, rays = shown.figure.layout.updatemenus
    assert [button.label for button in looks.buttons] == ["3-D", "side", "from the light"]
    _, absorbed, by_role = colours.buttons
    values, bars, targets = by_role.args
    meshes = [shown.figure.data[k] for k in targets]
    assert [mesh.meta["surface"] for mesh in meshes] == [surface.name for surface in shown.surfaces]
    assert len(values["color"]) == len(targets)
    assert bars == {"coloraxis.showscale": False, "coloraxis2.showscale": False}
    assert absorbed.args[1] == {"coloraxis.showscale": False, "coloraxis2.showscale": True}
    ratio = shown.figure.layout.scene.aspectratio
    for look in looks.buttons:  # axes stay equal
        sides = look.args[0]["scene.aspectratio"]
        assert sides["x"] / ratio.x == pytest.approx(sides["y"] / ratio.y) == pytest.approx(sides["z"] / ratio.z)
    hidden = [[axis for axis in "xyz" if not look.args[0][f"scene.{axis}axis.visible"]] for look in looks.buttons]
    assert hidden == [[], ["x"], ["z"]]
    assert list(rays.buttons[1].args[1]) == [
        k for k, drawn in enumerate(shown.figure.data) if "path_id" in (drawn.meta or {})
    ]

    path = shown.write(tmp_path / "view.html", command="mistray view <scene>")
    text = path.read_text(encoding="utf-8")
    assert path.stat().st_size < 6_000_000
    assert "<title>&lt;plate&gt; &amp; lens</title>" in text
    assert "mistray view &lt;scene&gt;" in text
    assert shown._repr_html_().startswith("<iframe srcdoc=")
    assert repr(shown) == "View('<plate> & lens', 6 surfaces, 15 rays)"
    library = importlib.import_module("plotly.offline").get_plotlyjs()
    assert not re.findall(r"<(?:script|link|img|iframe)[^>]+(?:src|href)\s*=", text.replace(library, ""))
    assert text.count(library[:2000]) == 1


def test_wrong_arguments(scene, trace):
    for arguments, message in (
        ({"paths": -1}, "paths is -1; give the number of rows"),
        ({"rays": 0}, "rays is 0; ask for at least one"),
        ({"colour": "red"}, "colour is 'red'; choose flux, absorbed, irradiance or role"),
        ({"cut_mm": float("nan")}, "both must be finite"),
        ({"cut_mm": -100.0}, "leaves no surface; move the cut"),
        ({"path_ids": [99]}, "path_id 99 does not exist"),
        ({"trace": None, "path_ids": [1]}, "path_ids without a trace"),
        ({"trace": None, "colour": "flux"}, "nothing was traced; give the trace, or colour='role'"),
    ):
        with pytest.raises(MistrayError, match=message):
            view(scene, **({"trace": trace} | arguments))


def test_a_path_that_no_ray_is_found_of_says_so(scene):
    class Rare(RayTrace):
        def history(self, path_id, n=8):
            found = super().history(path_id, n)
            table = found.to_pandas()
            return found if path_id else type(found)(rays=[], to_pandas=lambda: table[:0])

    shown = view(scene, Rare(paths_at(0.0)), paths=2, rays=1)
    assert of(shown.figure, "path_id")[0].name == "0 direct image, 3 W, too rare to draw"
    # Wavelengths are named where there are several
    several = RayTrace(trace_in_colours(0.0).fakes, shares=SHARES)
    names = [lines.name for lines in of(view(scene, several, paths=2, rays=1).figure, "path_id").values()]
    assert names[0] == "0 direct image, 550 nm, 1.5 W"

"""Optics and files as a scene file names them."""

from pathlib import Path

import numpy as np
import pytest
import vectors
from oracles.small_scenes import write
from refusals import each_refused, refused

from mistray.physics.geometry.outline import Outline, OutlineFigure, circle, rectangle
from mistray.physics.geometry.pose import moved
from mistray.physics.sags.grid import Grid
from mistray.prescription import Coating, Detector, Prescription, Scatter, Source, Stop, Surface
from mistray.scene.depth import check_source
from mistray.scene.files import scene_files
from mistray.scene.load import shipped_scenes
from mistray.scene.read_optics import read_optics
from mistray.scenes.newtonian.prescription import build as newtonian
from mistray.scenes.phone_camera.prescription import build as phone_camera

pytestmark = pytest.mark.quick

GLASS = '<bsdf type="interface"><string name="back" value="N-BK7"/></bsdf>'
BLIND = '<bsdf type="interface"><string name="table" value="blind.csv"/></bsdf>'
SCENE = vectors.text("optics.xml")
KEYS = ("name", "curvature", "conic", "coefficients", "semi_diameter", "half_width", "front", "back", "mirror")


@pytest.fixture
def read(tmp_path):
    def reader(*shapes: str):
        (tmp_path / "camera.xml").write_text(SCENE.format(shapes="\n".join(shapes)))
        return read_optics(tmp_path / "camera.xml")

    return reader


def shape(*parts: str, name: str = "front", bsdf: str = GLASS, kind: str = "asphere") -> str:
    return f'<shape type="{kind}" id="{name}"><float name="semi_diameter" value="5"/>{"".join(parts)}{bsdf}</shape>'


def scene_file(folder: Path, body: str, name: str = "scene.xml") -> Path:
    return write(folder, f'<scene version="3.0.0">{body}</scene>', name)


def number(name: str, value: float | str) -> str:
    return f'<float name="{name}" value="{value}"/>'


@pytest.mark.parametrize(("name", "build"), [("newtonian", newtonian), ("phone_camera", phone_camera)])
def test_surfaces_of_a_shipped_scene_are_those_of_its_prescription(name, build):
    found, left_out = read_optics(name)
    expected = build()
    for ours, theirs in zip((*found.surfaces, found.detector), (*expected.surfaces, expected.detector), strict=True):
        for key in KEYS if theirs is expected.detector else (*KEYS, "coating"):
            assert getattr(ours, key) == getattr(theirs, key), (theirs.name, key)
        np.testing.assert_allclose(ours.to_world(), theirs.to_world(), atol=1e-12)
    assert {shape.name for shape in expected.structures} == set(left_out)
    for key in ("radius", "z_front", "z_rear") if expected.stop is not None else ():
        assert getattr(found.stop, key) == getattr(expected.stop, key)
    assert (found.source.radius, found.source.wavelength_nm) == (expected.source.radius, expected.source.wavelength_nm)


def test_what_a_scene_may_say_and_its_coatings(read, tmp_path):
    (tmp_path / "COATING.DAT").write_text("MATE MGF2\n0.55 1.38 0\nCOAT AR\nMGF2 0.25\n")
    (tmp_path / "blind.csv").write_text("wavelength_nm,angle_deg,R,T\n550,0,0.1,0\n550,90,0.1,0\n")
    steps = '<rotate x="-1" angle="20"/><rotate z="1" angle="30"/><translate value="1 2 3"/>'
    shifted = (number("x", 0.5), number("tilt_y", 5), f'<transform name="to_world">{steps}</transform>')
    frustum = "".join(number(key, value) for key, value in {"r0": 3, "z0": 9, "r1": 8, "z1": 9}.items())
    prescription, left_out = read(
        shape(number("radius", "$R"), number("a4", 1e-6), number("a8", 2e-9), *shifted),
        shape(number("curvature", -0.02), name="rear", bsdf='<bsdf type="interface"><ref id="AR"/></bsdf>'),
        shape(name="board", bsdf='<bsdf type="interface"><float name="R" value="0.1"/></bsdf>'),
        shape(frustum, '<string name="part" value="stop"/>', name="stop_front", kind="frustum"),
        shape(name="wall", kind="frustum"),
    )  # fmt: skip
    front, rear = prescription.surfaces
    assert (front.radius, front.coefficients, front.back) == (50.0, (1e-6, 0.0, 2e-9), "N-BK7")
    steps = (1, 2, 3, 0, 0, 30), (0, 0, 0, -20, 0, 0), (0.5, 0, 0, 0, 5, 0)
    expected = np.linalg.multi_dot([moved(np.eye(4), *step) for step in steps])
    np.testing.assert_allclose(front.to_world(), expected, atol=1e-12)
    assert (rear.radius, rear.coating, left_out) == (-50.0, Coating(preset="bbar3", name="AR"), ("board", "wall"))
    assert prescription.stop == Stop(3.0, 9.0, 9.0, 8.0, 8.0)
    detector, source = prescription.detector, prescription.source
    assert (detector.half_width, detector.half_height, detector.z) == (2.0, 1.0, 60.0)
    assert (source.radius, source.field_deg) == (4.0, 10.0)
    assert (source.wavelength_nm, source.weights, prescription.name) == ((486.1, 656.3), (1.0, 3.0), "camera")
    melt = GLASS.replace("/></bsdf>", f"/>{number('n_back_shift', 5e-4)}</bsdf>")
    assert read(shape(bsdf=melt))[0].surfaces[0].back == "N-BK7 shift=0.0005"
    polish = f'/><bsdf type="harvey_shack">{number("rms_nm", 4)}</bsdf></bsdf>'
    scattering = read(shape(bsdf=GLASS.replace("/></bsdf>", polish)))[0]
    assert scattering.surfaces[0].scatter == (Scatter("harvey_shack", {"rms_nm": 4.0}),)
    assert read(shape(bsdf=BLIND), shape(name="rear"))[1] == ("front",)
    films = {
        '<string name="preset" value="bbar3"/>': Coating(preset="bbar3", name="ar"),
        '<string name="layers" value="MgF2 100"/>': Coating(layers="MgF2 100", name="ar"),
        '<string name="table" value="COATING.DAT:AR"/>': Coating(table="COATING.DAT:AR", name="ar"),
        '<float name="R" value="0.1"/><float name="T" value="0.9"/>': Coating(R=0.1, T=0.9, name="ar"),
    }
    for recipe, expected in films.items():
        film = f'<bsdf type="thinfilm" id="ar">{recipe}</bsdf>'
        prescription, _ = read(shape(bsdf=f'<bsdf type="interface">{film}</bsdf>'))
        assert prescription.surfaces[0].coating == expected
    second = shape(number("radius", "$R2"), name="rear")
    prescription, _ = read('<default name="R2" value="-70"/>', shape(number("radius", "$R")), second)
    assert [surface.radius for surface in prescription.surfaces] == [50.0, -70.0]


def test_freeforms_come_back(tmp_path):
    polygon = OutlineFigure("polygon", "&", x=0.5, angle_deg=10.0, sizes=(-8.0, -8.0, 8.0, -8.0, 0.0, 8.0))
    surfaces = (
        Surface("zernike", semi_diameter=10.0, back="1.5", sag={"zernike_6": 0.01, "zernike_radius": 12.0, "a2": 1e-4}),
        Surface("cylinder", z=5.0, outline=Outline((*circle(9.0, 2.0).figures, polygon)), sag={"curvature_x": -0.01},
                front="1.5", meets="+z"),
        Surface("toroid", z=8.0, radius=90.0, half_width=5.0, half_height=4.0, sag={"toroid_curvature": -0.01}),
        Surface("grid", z=9.0, semi_diameter=4.0, sag={"grid": Grid.of(np.eye(9), (1.0, 1.0)), "grid_scale": 1e-3}),
    )  # fmt: skip
    spider = Surface("spider", z=30.0, outline=rectangle(9.0, 0.1), coating=None)
    detector = Detector(z=60.0, half_width=4.0, half_height=3.0, front="1.5")
    source = Source(radius=5.0, y=1.0, tilt_deg=(-10.0, 0.0, 20.0))
    lens = Prescription(name="x", surfaces=surfaces, structures=(spider,), detector=detector, source=source)
    lens.to_xml(tmp_path / "lens.xml")
    text = (tmp_path / "lens.xml").read_text()
    (tmp_path / "lens.xml").write_text(text.replace('name="curvature_x" value="-0.01"', 'name="radius_x" value="-100"'))
    found, left_out = read_optics(tmp_path / "lens.xml")
    for ours, theirs in zip(found.surfaces, surfaces, strict=True):
        for key in (*KEYS, "outline", "meets"):
            assert getattr(ours, key) == getattr(theirs, key), (theirs.name, key)
        assert {**ours.sag, "grid": None} == {**theirs.sag, "grid": None}
    np.testing.assert_allclose(found.surfaces[3].sag["grid"].corners, surfaces[3].sag["grid"].corners)
    assert found.detector.front == "1.5"
    np.testing.assert_allclose(found.source.to_world(), source.to_world(), atol=1e-12)
    assert left_out == ("spider",)  # mechanics, though light gets through


ORDERS = (
    ('<path value="a"/>{}', ("x.xml", "a/x.xml")),
    ('<path value="a"/><path value="b"/>{}', ("b/x.xml", "a/b/x.xml", "a/x.xml")),
    ('<path value="a"/><path value="b"/>{}', ("a/b/x.xml", "a/x.xml")),
    ('<path value="a"/><include filename="in/y.xml"/>', ("in/x.xml", "in/a/x.xml", "x.xml", "a/x.xml")),
    ('<path value="a"/><include filename="in/y.xml"/>', ("in/a/x.xml", "x.xml", "a/x.xml")),
    ('<path value="a"/><include filename="in/y.xml"/>', ("a/x.xml", "x.xml")),
)


@pytest.mark.parametrize(("text", "files"), ORDERS)
def test_a_file_in_several_folders_is_that_of_mitsuba(tmp_path, text, files):
    """The first one of each list; the others are searched later, as `mi.load_file` 3.9.1 does."""
    include = '<include filename="x.xml"/>'
    for name in files:
        scene_file(tmp_path, shape(name=name.replace("/", "_")[:-4]), name)
    scene_file(tmp_path, f'<path value="a"/>{include}', "in/y.xml")
    scene_file(tmp_path, text.format(include))
    found, _ = read_optics(tmp_path / "scene.xml")
    assert [surface.name for surface in found.surfaces] == [files[0].replace("/", "_")[:-4]]
    (tmp_path / files[0]).write_text((tmp_path / files[0]).read_text().replace('value="5"', 'value="five"'))
    with refused("semi_diameter is 'five'"):
        check_source(tmp_path / "scene.xml")


def test_light_and_stop_are_those_of_the_trace(read, tmp_path):
    frustum = "".join(number(key, value) for key, value in {"r0": 3, "z0": 5, "r1": 8, "z1": 5, "z": 4}.items())
    stop = shape(frustum, '<string name="part" value="stop"/>', name="stop_front", kind="frustum")
    prescription, _ = read(shape(), stop)
    assert prescription.stop == Stop(3.0, 9.0, 9.0, 8.0, 8.0)
    text = (tmp_path / "camera.xml").read_text()
    for key in ("x", "tilt_y"):
        with refused(rf"scene '.*camera\.xml'.*aperture stop.*: its {key} is 0\.5; leave it out"):
            read(stop.replace('"z"', f'"{key}"').replace('"4"', '"0.5"'))
    lines = text.replace('wavelength_nm" value="486.1, 656.3"', 'spectrum" value="F d C"').replace('"1 3"', '"1 2 1"')
    (tmp_path / "lines.xml").write_text(lines)
    found, _ = read_optics(tmp_path / "lines.xml")
    assert found.source.light.wavelengths_nm == pytest.approx([486.1, 587.6, 656.3], abs=0.1)
    band = '<string name="band_nm" value="500, 600"/><integer name="bands" value="2"/>'
    lines = lines.replace("F d C", "blackbody:3000").replace('<string name="weights" value="1 2 1"/>', band)
    (tmp_path / "lines.xml").write_text(lines)
    source = read_optics(tmp_path / "lines.xml")[0].source
    assert (source.spectrum, source.band_nm, source.bands) == ("blackbody:3000", (500.0, 600.0), 2)


@pytest.mark.parametrize(
    ("kind", "light", "nm"),
    [
        ("sky", {"spectrum": "F C"}, (486.1, 656.3)),
        ("point", {"wavelength_nm": "450 550"}, (450.0, 550.0)),
        ("thermal", {"band_nm": "3000 5000"}, (3000.0, 5000.0)),
        ("sky", {}, (550.0,)),
    ],
)
def test_of_other_sources_the_wavelengths_are_read(tmp_path, kind, light, nm):
    values = "".join(f'<string name="{key}" value="{value}"/>' for key, value in light.items())
    prescription, _ = read_optics(scene_file(tmp_path, f'<emitter type="{kind}">{values}</emitter>{shape()}'))
    assert prescription.source.light.wavelengths_nm == pytest.approx(nm, abs=0.1)
    assert prescription.provenance == f"the source, '{kind}', is left out but for its wavelengths"


def test_surfaces_with_a_thinfilm_alone_and_in_an_included_scene(read, tmp_path):
    """A film that the scene says is opaque makes a wall; without that it is a clear coating."""
    metal = '<bsdf type="thinfilm">{}<string name="layers" value="Al 100"/><string name="back" value="N-BK7"/></bsdf>'
    opaque = metal.format('<boolean name="opaque" value="True"/>')
    nested = f'<bsdf type="interface">{opaque.replace("back", "first").replace("N-BK7", "front")}</bsdf>'
    scene_file(tmp_path, shape(name="blind", bsdf=opaque), "parts/wall.xml")
    lens = shape(number("radius", "$R"), name="L1")
    inner = f'<scene version="3.0.0"><default name="R" value="7"/>{{}}{lens}</scene>'
    (tmp_path / "parts" / "lens.xml").write_text(inner.format('<include filename="wall.xml"/>'))
    include = '<path value="parts"/><include filename="lens.xml"/>'
    prescription, left_out = read(include, shape(name="L2", bsdf=metal.format("")), shape(name="B", bsdf=nested))
    assert [surface.name for surface in prescription.surfaces] == ["L1", "L2"]
    assert prescription.surfaces[0].radius == 50.0  # the first default of a name holds, that of the scene
    assert (prescription.surfaces[1].coating, prescription.surfaces[1].back) == (Coating(layers="Al 100"), "N-BK7")
    assert left_out == ("blind", "B")
    with refused(r"there is no file 'none\.xml' for its <include>; correct the name"):
        read('<include filename="none.xml"/>')
    (tmp_path / "parts" / "lens.xml").write_text(inner.format('<include filename="lens.xml"/>'))
    with refused("lies within itself"):
        read(include)


def test_order_waves_and_mirrors_of_a_thinfilm(read):
    values = '<string name="layers" value="1.6 0.5w, Al 100"/><string name="first" value="back"/>'
    values += '<string name="n_shift" value="0.01, 0"/>'
    film = f'<bsdf type="thinfilm">{values}{number("design_nm", 940)}<boolean name="opaque" value="true"/></bsdf>'
    mirror = f'<bsdf type="interface"><boolean name="mirror" value="true"/>{film}</bsdf>'
    (surface,) = read(shape(bsdf=mirror))[0].surfaces
    waves = {"layers": "1.6 0.5w, Al 100", "design_nm": 940.0, "n_shift": (0.01, 0.0)}
    assert surface.coating == Coating(**waves, first="back", mirror=True)


def test_errors_name_file_and_shape(read):
    each_refused(
        ('<emitter type="collimated"/>', "it has two sources; remove one"),
        (shape("<sensor type='irradiancemeter'/>", name="second"), "detectors 'second' and 'film'; a lens has one"),
        (shape(number("radius", "wide")), r"shape 'front': radius is 'wide'; give a number"),
        (shape('<transform name="to_world"><scale value="2"/></transform>'), "shape 'front': its to_world has <scale>"),
        (shape('<transform name="to_world"><rotate y="1"/></transform>'), r"shape 'front': angle is missing"),
        (shape('<string name="part" value="stop"/>', kind="frustum"), r"aperture stop \(part 'stop'\): r0 is missing"),
        by=read,
        pattern=r"scene '.*camera\.xml'.*{}",
    )


def named(tmp_path: Path, body: str, *files: str) -> list[str]:
    """Files of a scene with this body, relative to its folder; `files` exist."""
    for name in files:
        scene_file(tmp_path / "scene", "", name)
    scene = scene_file(tmp_path / "scene", body)
    first, *others = scene_files(scene)
    assert first == scene.resolve()
    return [path.relative_to(scene.parent.resolve()).as_posix() for path in others]


def test_values(tmp_path: Path) -> None:
    for value, file in (
        ("part.ply", "part.ply"),
        ("./glass.agf:F2", "glass.agf"),
        ("parts/my lens part.ply", "parts/my lens part.ply"),
        ("MgF2 99.6, my film.csv 20.5, coating.dat:TIO2 0.25w", "my film.csv coating.dat"),
        ("glass.agf:F2 k=0 shift=1e-4", "glass.agf"),
        ("data=table.csv", "table.csv"),
        ("a:b.csv", "a:b.csv"),
        ("no_such_file.csv", ""),
        (".", ""),
        ("1.5 " * 500, ""),
    ):
        files = {"my film.csv coating.dat": ["coating.dat", "my film.csv"], "": []}.get(file, [file])
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        assert sorted(named(folder, f'<string name="front" value="{value}"/>', *files, "other.csv")) == files


def test_includes_paths_and_parameters_of_all_scenes(tmp_path: Path) -> None:
    body = """<default name="where" value="data"/><default name="where_else" value="more"/>
              <path value="found"/><include filename="inner/part.xml"/>
              <string name="a" value="$where/one.csv"/><string name="b" value="$where_else/two.csv"/>
              <string name="c" value="three.csv"/>"""
    files = ["data/one.csv", "more/two.csv", "found/three.csv", "inner/part.xml", "inner/four.csv", "inner/five.xml"]
    named(tmp_path, "", *files)
    inner = "<scene version='3.0.0'><string name='d' value='four.csv'/><include filename='inner/five.xml'/></scene>"
    (tmp_path / "scene" / "inner" / "part.xml").write_text(inner)
    assert sorted(named(tmp_path, body)) == sorted(files)
    elsewhere = write(tmp_path, "1", "elsewhere.csv")
    scene = scene_file(tmp_path / "scene", f"<string name='a' value='{elsewhere}:entry'/>")
    assert scene_files(scene)[1:] == [elsewhere.resolve()]
    # As in Mitsuba: in a scene that is included, behind it, and the first of a name wins; also all round
    again = tmp_path / "again"
    part = """<scene version='3.0.0'><default name='where' value='other'/><default name='more' value='$where'/>
              <string name='a' value='$where/one.csv'/></scene>"""
    write(again, part.replace("</scene>", "<include filename='scene.xml'/></scene>"), "scene/part.xml")
    body = """<default name="where" value="data"/><include filename="part.xml"/>
              <string name="b" value="$more/two.csv"/>"""
    found = named(again, body, "data/one.csv", "other/one.csv", "data/two.csv", "other/two.csv")
    assert found == ["part.xml", "data/one.csv", "data/two.csv"]


def test_shipped_scenes() -> None:
    """Those of which the files are known: the phone camera and most others stand in one file each."""
    for name, path in shipped_scenes().items():
        found = scene_files(path)
        assert found[0] == path.resolve(), name
        assert {file for file in path.parent.iterdir() if file.suffix in (".ply", ".obj")} <= set(found), name

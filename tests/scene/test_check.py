"""Overlaps are found, scenes of the infrared are evaluated there, and what is refused is told in one line."""

import math
import time
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
import vectors
from oracles.small_scenes import plates_text, write
from refusals import each_refused, refused

import mistray
from mistray.cli import main
from mistray.scene.check import check_overlaps
from mistray.scene.depth import check_source
from mistray.scene.load import shipped_scenes
from mistray.scene.messages import explain
from mistray.scene.xml_file import DEEPEST

T = mi.ScalarTransform4f


def asphere(z: float = 0.0, front: str = "air", back: str = "air", opaque: bool = False, **values: Any) -> dict:
    place = T().translate([values.pop("x", 0.0), 0.0, z]) @ T().rotate([1, 0, 0], values.pop("turn", 0.0))
    values = {"semi_diameter": 5.0} | values if "half_width" not in values else values
    bsdf = {"type": "interface", "front": front, "back": back, **({"R": 0.0} if opaque else {})}
    return {"type": "asphere", "to_world": place, "bsdf": bsdf, **values}


def frustum(r0: float, z0: float, r1: float, z1: float, **bsdf: Any) -> dict[str, Any]:
    return {"type": "frustum", "r0": r0, "z0": z0, "r1": r1, "z1": z1, "bsdf": {"type": "interface", **bsdf}}


def lens(thickness: float = 3.0, rear: dict[str, Any] | None = None, move: Any = None) -> dict[str, Any]:
    """Biconvex, of R = 20 mm; its rear may be given in another way, or all of it moved."""
    rear = rear or asphere(thickness, front="1.5", radius=-20.0)
    made = {"L1_front": asphere(0.0, back="1.5", radius=20.0), "L1_rear": rear}
    for shape in made.values() if move is not None else ():
        shape["to_world"] = move @ shape["to_world"]
    return made


def in_the_glass(**more: Any) -> dict[str, Any]:
    return {"inside": asphere(10.0, front="1.5", back="1.5"), "before": asphere(5.0), **more}


@pytest.mark.parametrize("name", sorted(shipped_scenes()))
def test_shipped_scenes_pass_quickly(name: str) -> None:
    scene = mistray.load(name)
    started = time.process_time()
    for _ in range(5):
        check_overlaps(scene)
    assert (time.process_time() - started) / 5 < 0.02


def test_telescopes_pass() -> None:
    batoid = pytest.importorskip("batoid")
    for file in ("LSST_r.yaml", "ComCam_g.yaml", "HSC_no_obsc.yaml", "donsoptikz1.yaml"):
        mistray.prescription.from_batoid(batoid.Optic.fromYaml(file), wavelength_nm=620.0).to_scene()


SAG = 20 - np.sqrt(20**2 - 5**2)
ASKEW = T().translate([7, -3, 2]) @ T().rotate([0.6, 0.0, 0.8], 40)  # an axis that is no world axis
BOWL = asphere(0.0, radius=20.0, semi_diameter=6.0, opaque=True)
BOARD = float(20 - np.sqrt(20**2 - 3**2))  # height of the bowl at 3 mm


@pytest.mark.parametrize(
    "shapes",
    [
        lens(1.3),
        lens(3.0, move=ASKEW),
        lens(rear=asphere(3.0, turn=180.0, back="1.5", radius=20.0)),  # in a frame that looks the other way
        # Materials are compared by their index
        {"a": asphere(0.0, back="1.50"), "b": asphere(2.0, front="1.5", back="vacuum"), "c": asphere(4.0)},
        # Touching at the vertex, at the rim, and structure in contact with a lens or drawn into it
        {**lens(), "window": asphere(3.0, back="1.5"), "window_rear": asphere(4.0, front="1.5")},
        lens(2 * SAG),
        # Along a circle: h = 1e-3 (r² - 4)²
        {"bowl": BOWL | {"radius": -1 / 0.016, "conic": -1.0, "a4": 1e-3}, "board": asphere(-0.016, opaque=True)},
        {
            **lens(),
            "edge": frustum(5.0, SAG, 5.0, 3.0 - SAG, R=0.0),
            "flange": frustum(4.0, 3.0 - SAG, 5.0, 3.0 - SAG, R=0.0),
            "seat": frustum(4.0, 3.0 - SAG, 6.0, 3.0 - SAG, R=0.0),
            "tube": frustum(4.9, -5.0, 4.9, 8.0, R=0.0),
        },
        # Rings side by side may share heights
        {
            "M1": asphere(radius=100.0, semi_diameter=10.0, inner_semi_diameter=6.0, opaque=True),
            "M3": asphere(-0.1, radius=20.0, semi_diameter=6.0, inner_semi_diameter=1.0, opaque=True),
        },
        # Other axes do not count
        {
            "front": asphere(0.0, back="1.5"),
            "rear": asphere(2.0, front="1.5"),
            "fold": asphere(1.0, turn=45.0, opaque=True),
            "aside": asphere(1.0, x=20.0, opaque=True),
        },
        # What refracts on the axis besides aspheres is not followed
        in_the_glass(
            ball={"type": "sphere", "center": [0, 0, 10], "radius": 2.0, "bsdf": {"type": "interface", "front": "1.5"}}
        ),
        in_the_glass(disc=frustum(0.0, 7.0, 5.0, 7.0, back="1.5")),
        # Rectangles count to their inscribed circle
        {"bowl": BOWL, "board": asphere(BOARD + 0.01, half_width=3.0, half_height=4.0, opaque=True)},
    ],
)
def test_allowed(shapes: dict[str, Any]) -> None:
    scene_dicts.load(**shapes)


@pytest.mark.parametrize(
    ("shapes", "words"),
    [
        (lens(1.0), "'L1_front' and 'L1_rear' cross at r = 4.4"),
        (lens(1.0, move=ASKEW), "cross at r = 4.4"),
        (lens(rear=asphere(1.0, turn=180.0, back="1.5", radius=20.0)), "cross"),
        ({**lens(), "L2_front": asphere(2.9, back="1.6", radius=15.0), "L2_rear": asphere(6.0, front="1.6")},
         "'L2_front' and 'L1_rear' cross"),
        # No surface crosses another, but the second lens begins inside of the first
        ({"a": asphere(0.0, back="1.5"), "b": asphere(4.0, front="1.5"),
          "c": asphere(3.0, back="1.6"), "d": asphere(7.0, front="1.6")},
         "'a' at z = 0 mm and 'c' at z = 3 mm: the material between them is '1.5' for one and 'air'"),
        ({"a": asphere(radius=30.0), "b": asphere(radius=30.0)}, "'a' and 'b' coincide; remove one"),
        ({"front": asphere(1.0, radius=20.0), "beside": asphere(1.2)}, "'front' and 'beside' cross"),
        (in_the_glass(), "'1.5'"),
        ({"bowl": BOWL, "board": asphere(BOARD - 0.1, half_width=3.0, half_height=4.0, opaque=True)}, "cross"),
    ],
)  # fmt: skip
def test_refused(shapes: dict[str, Any], words: str) -> None:
    with refused(r"\A[^\n]*\Z", words):
        scene_dicts.load(**shapes)


@pytest.mark.parametrize("detector", ["asphere", "rectangle"])
@pytest.mark.parametrize(("front", "rear"), [(0.0, -3.0), (5.0, 3.0), (20.0, 3.0), (1e9, 3.0)])
def test_a_rear_ahead_of_its_front(detector: str, front: float, rear: float) -> None:
    """Light would start in the glass; not where the detector is in it as well, nor for a gap of air in glass."""
    size = {"semi_diameter": 5.0} if detector == "asphere" else {}

    def shapes(**around: str) -> dict[str, Any]:
        image = scene_dicts.detector(10, type=detector, bsdf={"type": "interface", "R": 0.0, **around}, **size)
        return {"front": asphere(front, back="1.5"), "rear": asphere(rear, front="1.5"), "image": image}

    test_refused(shapes(), "light starts in '1.5'")
    scene_dicts.load(**shapes(front="1.5"))
    if rear < min(front, 8.0):
        straight = {"front": asphere(rear, back="1.5"), "rear": asphere(min(front, 8.0), front="1.5")}
        scene_dicts.load(**shapes() | straight)


# Painted walls, each with a paint of its own, and tiles on axes of their own: overlaps had been looked for pair by pair
WALL = """<shape type="frustum" id="wall_{k}"><float name="r0" value="20"/><float name="z0" value="{k}"/>
<float name="r1" value="20"/><float name="z1" value="{k}.9"/>
<bsdf type="paint"><float name="reflectance" value="0.05"/></bsdf></shape>"""
TILE = """<shape type="asphere" id="tile_{k}"><float name="half_width" value="0.4"/>
<float name="half_height" value="0.4"/><transform name="to_world"><translate x="{k}"/></transform>
<bsdf type="interface"><float name="R" value="0"/></bsdf></shape>"""


def row(folder: Path, shape: str, count: int) -> Path:
    return scene_of(folder, "".join(shape.format(k=k) for k in range(count)), f"{count}.xml")


def seconds(path: Path) -> float:
    """Processor time, which other programs on the machine do not lengthen."""
    begun = time.process_time()
    mistray.load(path)
    return time.process_time() - begun


@pytest.mark.parametrize(("shape", "count"), [(WALL, 60), (TILE, 150)])
def test_loading_grows_in_proportion_to_the_number_of_shapes(tmp_path: Path, shape: str, count: int) -> None:
    few, many = row(tmp_path, shape, count), row(tmp_path, shape, 4 * count)
    mistray.load(few)
    assert min(seconds(many) for _ in range(2)) < 1.6 * 4 * min(seconds(few) for _ in range(3))


# Far more dispersion than germanium has, so that an index of another wavelength shows
BODY = "n(8000)=4.4 n(10000)=4.0 n(12000)=3.6 k=0"
TWO = "n(8000)=2 n(12000)=3 k=0"


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plane window and its light."""
    light = '<string name="wavelength_nm" value="8000, 10000, 12000"/><string name="weights" value="1, 2, 1"/>'
    text = plates_text(1, index=BODY).replace('<float name="radius"', f'{light}<float name="radius"', 1)
    return write(tmp_path_factory.mktemp("infrared"), text)


def test_each_wavelength_has_its_own_index(scene_file: Path, tmp_path: Path) -> None:
    """What passes a plane window directly is (4n/(n + 1)²)², by Fresnel's equations; nothing is left to chance."""
    scene = mistray.load(scene_file)
    for wavelength, n in ((8000.0, 4.4), (12000.0, 3.6)):
        t = mistray.trace(scene, rays=500, wavelength_nm=wavelength, max_reflections=0)
        assert t.paths[0].power_W / t.energy.launched_W == pytest.approx((4 * n / (n + 1) ** 2) ** 2, rel=2e-5)
    unlit = mistray.load(write(tmp_path, plates_text(1, index=BODY)))  # its light is taken to be 550 nm
    assert mistray.trace(unlit, rays=500, wavelength_nm=1e4, max_reflections=0).paths[0].power_W > 0
    # Light of 550 nm is what has no index, when it is traced
    with pytest.raises(mistray.MistrayError, match=r"surface '.*550 nm is outside its 8000 … 12000 nm") as error:
        mistray.trace(scene, rays=500, wavelength_nm=550.0)
    assert "extrapolate" not in str(error.value)
    # Thicknesses in nm are what they are; only those in waves need the index at `design_nm`
    body = {"type": "interface", "coating": {"type": "thinfilm", "layers": f"{BODY} 600, 2.2 1100"}}
    coating = mi.load_dict(body).coating
    assert (coating.indices(8000.0)[0], coating.indices(12000.0)[0]) == pytest.approx((4.4, 3.6))


@pytest.mark.parametrize(("more", "n"), [({}, 2.0), ({"wavelength_nm": 12000.0}, 3.0)])
def test_stock_integrators_take_the_wavelength_of_the_source(more: dict[str, float], n: float) -> None:
    """From within glass the sky has n² of its radiance where the face passes it, and 1 where it reflects the open."""
    scene = scene_dicts.load(
        beam={"type": "collimated", "radius": 3.0, "wavelength_nm": "8000, 12000"},
        sky={"type": "constant", "radiance": 1.0},
        face={"type": "asphere", "semi_diameter": 50.0, "bsdf": {"type": "interface", "back": TWO, **more}},
    )
    look = mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
    film = scene_dicts.film(2, pixel_format="luminance")
    camera = mi.load_dict({"type": "perspective", "fov": 1.0, "to_world": look, "film": film})
    path = mi.load_dict({"type": "path", "max_depth": 2})
    seen = np.array(mi.render(scene, sensor=camera, integrator=path, spp=4096))
    passed = 4 * n / (n + 1) ** 2
    # The mean of 16384 samples has a relative error of 4e-3 at most: it fails by chance in 6e-7 of runs
    assert seen.mean() == pytest.approx(n**2 * passed + 1 - passed, rel=2e-2)


def test_a_lens_of_the_infrared_is_exported(scene_file: Path, tmp_path: Path, capsys: Any) -> None:
    """A body without F, d and C lines goes into a Zemax file with its index at the primary wavelength, and is named."""
    assert main(["export", str(scene_file), "-o", str(tmp_path / "again.zmx")]) == 0
    assert "index at 10000 nm alone" in capsys.readouterr().out
    again = tmp_path / "again.xml"
    assert main(["import", str(tmp_path / "again.zmx"), "-o", str(again)]) == 0
    assert mistray.load(again).shapes()[0].bsdf().indices(8000.0)[1] == pytest.approx(4.0)


def nested(levels: int) -> str:
    """A scene with elements within each other, the outermost included."""
    return '<scene version="3.0.0">\n' + "<bsdf>" * (levels - 1) + "</bsdf>" * (levels - 1) + "\n</scene>"


def test_deep_files_are_refused(tmp_path: Path) -> None:
    path, whole = tmp_path / "deep.xml", tmp_path / "scene.xml"
    scene_of(tmp_path, '<include filename="deep.xml"/><include filename="scene.xml"/>')
    for levels in (DEEPEST + 1, 20_000):
        path.write_text(nested(levels))
        said = f"scene '{path}', line 2: <bsdf> lies within 100 other elements; close them first"
        for file in (path, whole):
            with refused() as caught:
                mistray.load(file)
            assert str(caught.value) == said
    for data in (nested(DEEPEST).encode(), b"<scene", b"", b"\x00\xff", b'<?xml encoding="?"?><a/>'):
        path.write_bytes(data)
        check_source(path)


def scene_of(folder: Path, text: str, name: str = "scene.xml") -> Path:
    """A file with these elements in a scene."""
    return write(folder, f'<scene version="3.0.0">{text}</scene>', name)


def refusal(folder: Path, text: str) -> str:
    """What `mistray.load` says of these elements: one line."""
    with refused() as caught:
        mistray.load(scene_of(folder, text))
    assert len(str(caught.value)) < 500
    return str(caught.value)


LENS = '<shape type="asphere" id="L1">{}<float name="semi_diameter" value="5"/></shape>'


def test_what_is_no_number_is_refused_and_others_stay(tmp_path: Path) -> None:
    """Mitsuba makes 0 of what is empty, a plane of an empty radius, and inf or 0 of what it cannot hold."""
    defaults = '<default name="none" value=""/><default name="blank" value="$none $none"/>'
    for value in ("", "\t", "$none", "$blank", "5x", "1,5", "1e400", "1e-400"):
        said = refusal(tmp_path, defaults + LENS.format(f'<float name="radius" value="{value}"/>'))
        assert "shape 'L1': radius is '" in said
        assert "must be a number" in said or "beyond the range" in said
    for operation, words in vectors.toml("refusals.toml")["transforms"]:
        said = refusal(tmp_path, LENS.format(f'<transform name="to_world">{operation}</transform>'))
        assert "shape 'L1': to_world: " in said
        assert words in said
    look_at = '<transform name="to_world"><lookat origin="0 0 0" target="0 0 1" up=""/></transform>'
    matrix = '<transform name="to_world"><matrix value="1 0 0, 0 1 0, 0 0 1"/><translate/></transform>'
    values = ('<float name="radius" value=" -1.5e+01 "/>', '<float name="radius" value="inf"/>', look_at, matrix)
    defaults = '<default name="a" value="5"/><default name="ab" value="$a."/>'
    for text in (*values, f'{defaults}<float name="z" value="-$ab"/>'):
        assert mistray.load(scene_of(tmp_path, LENS.format(text))) is not None


def test_includes_that_multiply(tmp_path: Path) -> None:
    """Fourteen files of two kilobytes, six includes each: 1.6e10 files; Mitsuba would not end."""
    for k in range(14):
        scene_of(tmp_path, (f'<include filename="part{k + 1}.xml"/>' if k < 13 else "") * 6, f"part{k}.xml")
    began = time.monotonic()
    with refused(r"part0\.xml': it includes more than 1000 files, .*; put"):
        mistray.load(tmp_path / "part0.xml")
    assert time.monotonic() - began < 20


def test_parameters_that_double(tmp_path: Path) -> None:
    """Each of 26 lines is twice as long as the one before: Mitsuba took 4 GB. No value is made that is too long."""
    lines = "".join(f'<default name="p{k + 1}" value="$p{k}$p{k}"/>' for k in range(40))
    said = refusal(tmp_path, f'<default name="p0" value="{"x" * 64}"/>{lines}')
    assert "<default> 'p" in said
    assert "more than 32 MiB" in said
    with (tmp_path / "large.xml").open("wb") as file:
        file.truncate(1 << 40)  # sparse: a terabyte of nothing
    with refused("more than 32 MiB of text"):
        mistray.load(tmp_path / "large.xml")


def test_files_within_each_other(tmp_path: Path) -> None:
    """Mitsuba ends at fifteen files, with as many lines and no name of a file."""
    for k in range(16):
        scene_of(tmp_path, f'<include filename="{k + 1}.xml"/>' if k < 15 else "", f"{k}.xml")
    assert mistray.load(tmp_path / "1.xml") is not None
    with refused(r"14\.xml', line 1: <include> '15\.xml' lies within 15 files"):
        mistray.load(tmp_path / "0.xml")
    assert "'scene.xml' lies within itself" in refusal(tmp_path, '<include filename="scene.xml"/>')
    folder = tmp_path / "my scenes (old)"
    write(folder, '<scene version="3.0.0">\n' + LENS.replace("5", "x").format("") + "</scene>", "lens.xml")
    scene_of(folder, '<include filename="lens.xml"/>')
    for file in ("lens.xml", "scene.xml"):
        with refused() as caught:
            mistray.load(folder / file)
        expected = f"scene '{folder / 'lens.xml'}', line 2: shape 'L1': semi_diameter is 'x'; it must be a number"
        assert expected in str(caught.value)


def test_messages(tmp_path: Path) -> None:
    for text, words in (
        (LENS.format('<transform name="0"><translate z="5"/></transform>'), "unknown parameter '0' of shape 'L1'"),
        (LENS.format(f'<string name="layers" value="{"MgF2 100 " * 20_000}"/>'), "'layers' = MgF2 100"),
        (LENS.format('<float name="z" value="1"/><float name="z" value="1"/>'), "'L1': z is given twice"),
        (LENS.format('<float name="Radius" value="1"/>'), "did you mean 'radius'?"),
        ('<shape type="sphere" id="${jndi}"/>', "holds $"),
        ('<string name="x" value="1"/>', "unknown parameter 'x' = 1 of <scene>"),
        # Mitsuba takes a property for known once somebody has read it, whoever it was
        *((LENS.format(f'<string name="{name}" value="x"/>'), f"unknown parameter '{name}'")
          for name in ("filename", "prt", "r")),
    ):  # fmt: skip
        assert words in refusal(tmp_path, text), text[:300]


def test_numbers_of_dicts() -> None:
    box = {"type": "interface", "R": 0.0}
    tipped = mi.ScalarTransform4f([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0]])
    for part, words in (
        ({"type": "sphere", "radius": math.nan, "bsdf": box}, "radius is nan"),
        ({"type": "sphere", "to_world": mi.ScalarTransform4f().translate([0, 0, math.inf]), "bsdf": box}, "to_world"),
        ({"type": "cube", "to_world": tipped, "bsdf": box}, "last row"),
        ({"type": "point", "intensity": {"type": "rgb", "value": [1.0, 2.0, math.inf]}}, "intensity holds inf"),
        ({"type": "point", "intensity": {"type": "spectrum", "value": math.nan}}, "intensity holds nan"),
        ({"type": "asphere", "semi_diameter": ""}, "semi_diameter is ''"),
        ({"type": "asphere", "semi_diameter": 5.0, "part": "a\ud800"}, "half of a character"),
        ({"type": "part_mesh", "filename": ""}, "filename is ''"),
        ({"type": "collimated", "radius": 1.0, "wavelength_nm": "550,,600"}, "wavelength_nm is '550,,600'"),
    ):
        with refused("", "'one'", words):
            mistray.load({"type": "scene", "one": part})


def test_dicts() -> None:
    good = {"type": "asphere", "semi_diameter": 5.0, "bsdf": {"type": "interface", "back": "1.5"}}
    for shape, words in vectors.toml("refusals.toml")["shapes of dicts"]:
        given = {key: value for key, value in good.items() if key != "semi_diameter" or "semidiameter" not in shape}
        with refused("", words):
            mistray.load({"type": "scene", "L1": given | shape})
    each_refused(
        ({"type": "sphere"}, 'the dict describes a Shape; add "type": "scene"'),
        ({"type": "scene", "L1": {"semi_diameter": 5.0}}, "'L1' has no type"),
        by=mistray.load,
    )


def test_what_is_not_known_is_passed_on_in_one_line(tmp_path: Path) -> None:
    """Of an error in Python inside of a plugin its last line, not its frames."""
    error = RuntimeError("[scene.cpp:12] Something\n  new went wrong")
    assert explain(error, tmp_path / "a.xml") == f"scene '{tmp_path}/a.xml': Something new went wrong; correct the file"
    assert explain(RuntimeError(""), {}) == "scene: RuntimeError; correct the dict"
    text = (
        'failed to instantiate shape plugin of type "asphere": Traceback (most recent call last):\n'
        '  File "/x/asphere.py", line 97, in __init__\n    self._finish(props, values)\n'
        "FloatingPointError: overflow encountered in cast\n"
    )
    line = explain(RuntimeError(text), {"type": "scene"})
    assert line == "scene: FloatingPointError: overflow encountered in cast; correct the dict"

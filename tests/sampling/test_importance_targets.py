"""Cones of aimed scatter beside the oracle, all kinds of rays beside unaimed light, and the check of the sampling."""

import importlib
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import vectors
from lit_detector import BLACK, discs, hazy_block, lit, square, towards_origin
from oracles import nonsequential
from oracles.scatter_scenes import beam_xml, bsdf_xml, lenses_text, placed_xml, scatter_scene, scattering_xml, wall_xml
from oracles.scene_xml import read_scene
from oracles.statistics import assert_z, z_limit
from refusals import each_refused

import mistray
from mistray import MistrayError
from mistray.kernel.targets import AimSet, Target
from mistray.sampling import importance_targets as importance_module
from mistray.sampling import kept_targets
from mistray.sampling.design_path import DesignPath, find_design_path
from mistray.sampling.detector_images import FAR, DetectorImages
from mistray.sampling.importance_targets import automatic_targets, importance_targets
from mistray.settings import Settings
from mistray.surfaces.host_points import surface_points
from mistray.surfaces.surfaces import SurfaceTable
from mistray.time_budget import within
from mistray.trace.reliability import AimedSurface, SilentPlace, sampling_check, sampling_notes

D_LINE_NM = 587.5618


def images_of(scene: Any, wavelength_nm: float = 550.0) -> DetectorImages:
    path = find_design_path(SurfaceTable(scene, wavelength_nm), scene)
    assert path is not None
    return DetectorImages(path)


def space_of(path: DesignPath, name: str) -> int:
    return 1 + [path.table.ids[step.surface] for step in path.steps].index(name)


def aims_of(scene: Any, **settings: Any) -> dict[tuple[str, str], AimSet]:
    """By name of the surface and side."""
    table = SurfaceTable(scene, 550.0)
    found = importance_targets(table, scene, Settings(**settings))
    return {(table.ids[surface], "back" if to_back else "front"): value for (surface, to_back), value in found.items()}


def test_targets_of_the_disk_cache(tmp_path, monkeypatch) -> None:
    """Targets are read again to the last digit; they are searched anew if a surface moves or an entry is broken."""
    monkeypatch.setenv("MISTRAY_CACHE", str(tmp_path))
    searches: list[Any] = []
    monkeypatch.setattr(
        importance_module, "automatic_targets", lambda *of: searches.append(of) or automatic_targets(*of)
    )

    def plain(target: Any) -> list[Any]:
        return [getattr(target, field.name).tolist() if isinstance(getattr(target, field.name), np.ndarray)
                else getattr(target, field.name) for field in fields(target)]  # fmt: skip

    def found(**values: float) -> dict[Any, list[Any]]:
        scene = mistray.load("baffle_tube")
        for key, value in values.items():
            params = mi.traverse(scene)
            params[key.replace("__", ".")] += value
            params.update()
        monkeypatch.setattr(importance_module, "_known", {})  # of this process
        monkeypatch.setattr(importance_module, "_known_sets", {})
        table = SurfaceTable(scene, 550.0)
        aims = importance_targets(table, scene, Settings(aimed_rays=2))
        return {place: [plain(target) for target in aim.targets] for place, aim in aims.items()}

    scene = mistray.load("baffle_tube")
    before = kept_targets._stated(scene)
    mistray.trace(scene, rays=100)
    assert kept_targets._stated(scene) == before  # whatever a trace keeps with the scene
    assert " object at " not in before
    first = found()
    assert len(searches) == 1
    assert found() == first
    assert len(searches) == 1
    assert found(lens_front__z=1e-3) != first
    assert len(searches) == 2
    for path in tmp_path.iterdir():
        path.write_bytes(path.read_bytes()[:-9])
    assert found() == first
    assert len(searches) == 3
    with within(3600.0):  # such a search might end early
        assert found().keys() == first.keys()
    assert len(searches) == 4


def test_paraxial_images_are_those_of_the_audited_table():
    """With the detector in the paraxial focus and as large as the image: ISL and ISH of the table, to 1e-3."""
    rows = vectors.rows("table15_audit.csv")
    prescription = importlib.import_module("mistray.scenes.phone_camera.prescription").build()
    system = prescription.paraxial(D_LINE_NM)
    last = rows[-1]
    size = float(last["ISH_correct"])
    focus = prescription.surfaces[-1].z + system.bfl
    assert system.bfl == pytest.approx(float(last["ISL_correct=-y_k/u'_k"]), rel=1e-3)
    detector = replace(prescription.detector, z=focus, half_width=size, half_height=size)
    images = images_of(replace(prescription, detector=detector).to_scene(), D_LINE_NM)
    # Rows 5 … 16 are the lenses and the filter; row 3 is the window's rear, behind which the detector's image is far
    (window,) = (row for row in rows if row["surface"] == "3")
    far = images.paraxial[space_of(images.path, "window_rear")]
    assert np.linalg.norm(far.centre) == pytest.approx(FAR * images.size, rel=1e-3)
    assert np.linalg.norm(far.u) / np.linalg.norm(far.centre) == pytest.approx(float(window["ubar_after"]), rel=1e-3)
    first = space_of(images.path, "L1_front")
    assert len(images.path.steps) - first == len(rows[2:])
    for number, row in enumerate(rows[2:], start=first):
        target, vertex = images.paraxial[number], images.path.steps[number - 1].point
        assert target.centre[2] - vertex[2] == pytest.approx(float(row["ISL_correct=-y_k/u'_k"]), rel=1e-3)
        for half in (target.u, target.v):
            assert np.linalg.norm(half) == pytest.approx(float(row["ISH_correct"]), rel=1e-3)
        assert not target.reverse


def test_images_in_coaxial_and_folded_systems():
    """The Cooke triplet surface by surface: refraction equation backwards from the detector, float64, 1e-7."""
    prescription = importlib.import_module("mistray.scenes.cooke_triplet.prescription").build()
    images = images_of(prescription.to_scene())
    system = prescription.paraxial(550.0)
    at, size, n = prescription.detector.z, prescription.detector.half_width, 1.0
    for number in reversed(range(1, len(images.path.steps))):
        target = images.paraxial[number]
        assert target.centre[2] == pytest.approx(at, rel=1e-7)
        assert np.linalg.norm(target.u) == pytest.approx(abs(size), rel=1e-7)
        assert target.reverse == (at < images.path.steps[number - 1].point[2])
        k = number - 1
        before, power = system.index[k], system.curvature[k] * (n - system.index[k])
        vergence = n / (at - system.z[k]) - power  # n'/s' = n/s + φ, light runs to s'
        distance = before / vergence
        size *= distance / before * n / (at - system.z[k])
        at, n = system.z[k] + distance, before
    # A Newtonian: from the primary, the image unfolded, at the focus on its axis; the diagonal sees the real one
    images = images_of(mistray.load("newtonian"))
    primary, diagonal = images.paraxial[1], images.paraxial[2]
    np.testing.assert_allclose(primary.centre, [0, 0, -1270], atol=1e-6)
    np.testing.assert_allclose(np.abs(primary.normal), [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(diagonal.centre, [0, -127, -1143], atol=1e-6)
    np.testing.assert_allclose(np.abs(diagonal.normal), [0, 1, 0], atol=1e-9)
    for target in (primary, diagonal):
        assert target.shape == "ellipse"
        assert (np.linalg.norm(target.u), np.linalg.norm(target.v)) == pytest.approx((12.7, 12.7), rel=1e-7)
    # The space before the paraboloid: the detector lies in its focus, so its image at infinity has the field's angle
    distance = np.linalg.norm(images.paraxial[0].centre)
    assert np.linalg.norm(images.paraxial[0].u) / distance == pytest.approx(12.7 / 1270, rel=1e-3)


# From these no target of one shape for all points catches 10 % of its rays: the window is wider than the entrance
WIDE = {"window_front": 0.05}
LENS_SCENES = ["cooke_triplet", "double_gauss", "singlet_window_detector", "newtonian", "lens_and_reflector", "plate"]


def oracle_lands(images: DetectorImages, name: str, number: int, origins: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Which rays that leave the surface before step `number` reach the detector by the path, by the float64 oracle."""
    steps, ids = images.path.steps, images.path.table.ids
    model = read_scene(Path(__file__).parents[2] / "scenes" / name / "scene.xml")
    left = steps[number - 1]
    interface = model.by_id[ids[left.surface]].interface
    medium = "air" if interface.opaque or interface.mirror else interface.back if left.to_back else interface.front
    ledger = nonsequential.trace(
        model, origins + 1e-7 * d, d, np.ones(len(d)), 550.0, max_reflections=0, start_material=medium, flux_threshold=0
    )
    landed = np.zeros(len(d), dtype=bool)
    for path in ledger.paths:
        if [surface for surface, _ in path.events] == [ids[step.surface] for step in steps[number:]]:
            landed[path.start_rays] = True
    return landed


@pytest.mark.parametrize("name", [*LENS_SCENES, "phone_camera"])
def test_targets_hold_the_light_that_reaches_the_detector(name):
    """At least 98 % of the light that lands (5 % less of diffuse light) lies within; 10 % of the aimed rays land."""
    images = images_of(mistray.load(name))
    table = images.path.table
    rng = np.random.default_rng(5)
    found = automatic_targets(table, images.path, [step.surface for step in images.path.steps[:-1]])
    for number, step in enumerate(images.path.steps[:-1], start=1):
        surface = table.ids[step.surface]
        points, normals = surface_points(table, step.surface, 3000, rng)
        outward = normals if step.to_back else -normals
        (target,) = found[step.surface, step.to_back]
        wide = replace(target, u=1.4 * target.u, v=1.4 * target.v)
        ends = wide.points(rng.random((len(points), 2)))
        d = (ends - points) * (-1 if target.reverse else 1)
        length = np.linalg.norm(d, axis=1)
        d /= length[:, None]
        cosine = np.einsum("ij,ij->i", d, outward)
        go = np.flatnonzero(cosine > 0)
        landed = np.zeros(len(d), dtype=bool)
        landed[go] = oracle_lands(images, name, number, points[go], d[go])
        projected = wide.area * np.where(landed, cosine * np.abs(d @ wide.normal) / length**2, 0.0)
        held, diffuse = target.holds(ends), np.mean(projected) / np.pi
        assert projected[held].sum() > (0.98 - 0.05 * diffuse) * projected.sum(), surface
        assert np.mean(landed[held]) > WIDE.get(surface, 0.1), surface


def test_a_wall_before_a_lens_aims_at_what_the_lens_shows(load_scene):
    lens = [
        placed_xml("asphere", name, scattering_xml([], *media), at=(0, 0, z), radius=radius, semi_diameter=8.0)
        for name, media, z, radius in (("front", ("air", "1.5"), 0, 50.0), ("rear", ("1.5", "air"), 4, -50.0))
    ]
    tube = placed_xml("frustum", "tube", wall_xml(0.1), r0=8.5, z0=-60.0, r1=8.5, z1=-1.0)
    vane = placed_xml("frustum", "vane", wall_xml(0.1), r0=7.0, z0=-40.0, r1=8.5, z1=-40.0)

    def scene(half: float) -> Any:
        meter = placed_xml("asphere", "detector", at=(0, 0, 54.0), pixels=8, half_width=half, half_height=half)
        return load_scene(scatter_scene(beam_xml(6.0), *lens, tube, vane, meter))

    seen = aims_of(scene(5.5))
    assert set(seen) == {("tube", "front"), ("vane", "back")}  # the side of the vane to the sky sees nothing
    for aim in seen.values():
        assert all(target.shape == "parallelogram" for target in aim.targets)  # images of the square detector
    unseen = aims_of(scene(0.01))  # of no light from the wall: the lens itself
    for aim in unseen.values():
        (target,) = aim.targets
        assert (target.shape, np.linalg.norm(target.u)) == ("ellipse", pytest.approx(8.0))
        assert target.centre[2] == pytest.approx(50 - np.sqrt(50**2 - 8**2), rel=1e-6)


def test_what_is_hidden_is_no_target(load_scene):
    plate = placed_xml("asphere", "plate", wall_xml(0.1), semi_diameter=3.0)
    meter = placed_xml("asphere", "detector", at=(0, 0, 30), facing=(0, 0, 1), pixels=8, semi_diameter=2.0)
    shield = placed_xml("asphere", "shield", at=(0, 0, 15), semi_diameter=40.0)
    beam = beam_xml(1.0, at=(0, 0, -5), along=(0, 0, 1))
    assert aims_of(load_scene(scatter_scene(beam, plate, meter, shield))) == {}
    found = aims_of(load_scene(scatter_scene(beam, plate, meter)))
    assert set(found) == {("plate", "back")}
    np.testing.assert_allclose(found["plate", "back"].targets[0].centre, [0, 0, 30], atol=1e-6)


def given(name: str, kind: str = "disk", place: dict[str, Any] | None = None, **properties: Any) -> str:
    return placed_xml(kind, name, bsdf_xml("target", **properties), **(place or {"at": (0.0, 0.0, 20.0)}))


@pytest.fixture(scope="module")
def aims(load_scene: Any) -> Callable[..., dict[tuple[str, str], AimSet]]:
    def found(*targets: str, **settings: Any) -> dict[tuple[str, str], AimSet]:
        text = lenses_text(bsdf_xml("abg", A=1e-3, B=1e-4, g=2.0))
        return aims_of(load_scene(text.replace("</scene>", "".join(targets) + "</scene>")), **settings)

    return found


def test_targets_of_the_scene_replace_the_automatic_ones_and_share_the_rays(aims) -> None:
    one = given("t", surfaces="a_*", rays=7, scale=2.0, hole=0.25)
    found = aims(one, aimed_rays=2)
    for name in ("a_front", "a_rear"):
        (target,) = found[name, "back"].targets
        assert (found[name, "back"].rays, target.shape, target.hole, target.reverse) == (7, "ellipse", 0.25, False)
        np.testing.assert_allclose(target.centre, [0, 0, 20], atol=1e-6)
        assert np.linalg.norm(target.u) == pytest.approx(2.0, rel=1e-6)
    assert found["b_front", "back"].rays == found["b_rear", "back"].rays == 2
    assert {name for name, _ in aims(one, aim="targets", aimed_rays=0)} == {"a_front", "a_rear"}
    both = given("t", surfaces="a_front", rays=3), given("u", surfaces="*_front", rays=1)
    found = aims(*both, aim="targets")
    assert (found["a_front", "back"].rays, found["b_front", "back"].rays) == (4, 1)
    assert [target.share for target in found["a_front", "back"].targets] == [0.75, 0.25]


def test_settings_and_sides_of_targets(aims) -> None:
    """A target behind is for light that leaves to the front; a virtual one there is for the other side."""
    found = aims(aimed_rays=3)
    assert set(found) == {(name, "back") for name in ("a_front", "a_rear", "b_front", "b_rear")}
    assert {aim.rays for aim in found.values()} == {3}
    for nothing in ({"aim": "none"}, {"aim": "targets"}, {"aimed_rays": 0}):
        assert aims(**nothing) == {}
    behind = {"at": (0.0, 0.0, -30.0)}
    for reverse, side in ((False, "front"), (True, "back")):
        found = aims(given("t", place=behind, surfaces="a_front", reverse=reverse), aim="targets")
        assert set(found) == {("a_front", side)}
        assert found["a_front", side].targets[0].reverse == reverse


def mesh(file: Path, vertices: str, faces: str) -> str:
    file.write_text("\n".join([*(f"v {v}" for v in vertices.split(", ")), *(f"f {v}" for v in faces.split(", "))]))
    target = bsdf_xml("target", surfaces="a_front", rays=5, scale=0.5)
    return f'<shape type="obj" id="t"><string name="filename" value="{file}"/>{target}</shape>'


def test_shapes_of_targets(aims, tmp_path) -> None:
    triangles = mesh(tmp_path / "square.obj", "-1 -1 20, 1 -1 20, 1 1 20, -1 3 20", "1 2 3, 1 3 4")
    ring = placed_xml("frustum", "t", bsdf_xml("target", surfaces="a_front"), r0=1.0, z0=20.0, r1=4.0, z1=20.0)
    square = given("t", "rectangle", surfaces="a_front", place={"at": (0.0, 0.0, 20.0), "scale": (2.0, 3.0, 1.0)})
    aim, ring, square = (aims(one, aim="targets")["a_front", "back"] for one in (triangles, ring, square))
    assert sum(t.area for t in aim.targets) == pytest.approx(0.25 * (2 + 4), rel=1e-6)
    assert ([t.share for t in aim.targets], aim.rays) == (pytest.approx([1 / 3, 2 / 3]), 5)
    assert (ring.targets[0].hole, np.linalg.norm(ring.targets[0].u)) == (0.25, 4.0)
    assert (square.targets[0].shape, square.targets[0].area) == ("parallelogram", pytest.approx(24.0, rel=1e-6))
    rim = [f"{np.cos(x):.6f} {np.sin(x):.6f} 20" for x in np.linspace(0, 6, 67)]
    fan = ", ".join(f"1 {k} {k + 1}" for k in range(2, 68))
    with pytest.raises(MistrayError, match="66 triangles"):
        aims(mesh(tmp_path / "fan.obj", ", ".join(["0 0 20", *rim]), fan))


def test_impossible_targets(aims) -> None:
    each_refused(
        (given("t", surfaces="c_*"), r"target 't': no surface of the scene is called 'c_\*'"),
        (given("t", "cylinder", surfaces="*"), "target 't' is Cylinder; use a disk"),
        (given("t", "sphere", surfaces="*", hole=0.5), "target 't': hole is 0.5"),
        (given("t", surfaces="*", half_axes="1, 2, 3"), "target 't' is Disk; half_axes are those of a sphere"),
        (given("t", surfaces="*", entity="c"), "target 't': no surface of the scene is called 'c'"),
        (given("t", surfaces="*", entity="*_front"), "target 't': entity '.*' fits 2 surfaces; name one"),
        (given("t", "sphere", surfaces="*", about="direction", cone_deg=3.0), "target 't' is Sphere, which has no"),
        (given("t", "rectangle", surfaces="a_front", hole=0.5), "target 't': hole is 0.5"),
        (given("t", surfaces="a_front", rays=200) + given("u", surfaces="a_front", rays=200), "400 aimed rays"),
        by=lambda target: aims(target),
    )


KINDS = vectors.toml("tables.toml")["targets"]


def sheet(*targets: str) -> str:
    diffuser = bsdf_xml("paint", reflectance=0.5, event="transmission", relative_to="specular")
    return scatter_scene(
        beam_xml(1.0),
        placed_xml("asphere", "sheet", scattering_xml([diffuser], R=0.0, T=1.0), semi_diameter=2.0),
        placed_xml("asphere", "detector", at=(0.0, 0.0, 10.0), pixels=8, semi_diameter=2.0),
        *targets,
    )


@pytest.mark.parametrize("kinds", [*([kind] for kind in KINDS), list(KINDS)])
def test_every_kind_of_target_gives_the_same_light(load_scene, kinds):
    """Half of that from disc to disc within 3.9 errors, false alarm 1e-4 each; all on one surface count once."""
    targets = []
    for number, name in enumerate(kinds):
        values = {"kind": "disk", "at": (0.0, 0.0, 10.0)} | KINDS[name]
        kind, place = values.pop("kind"), {"at": values.pop("at")}
        targets.append(given(f"t{number}", kind, place, surfaces="sheet", rays=1 + (number + 1) % 3, **values))
    t = mistray.trace(load_scene(sheet(*targets)), rays=20_000, aim="targets")
    measured, se = t.paths.power([row.path_id for row in t.paths if row.scatters])
    expected = 0.5 * discs(10.0, 1.0, 2.0) * t.energy.launched_W
    assert abs(measured - expected) < 3.9 * se
    assert se < (0.05 if len(kinds) == 1 else 0.01) * expected


@pytest.mark.parametrize("reverse", [False, True])
def test_share_of_aimed_rays_that_land(load_scene, reverse):
    """A target of twice the area of the detector, in its plane: half of the rays land; 5 standard errors (6e-7)."""
    place = {"at": (0.0, 0.0, -10.0 if reverse else 10.0), "scale": (np.sqrt(2) * 2,) * 2 + (1.0,)}
    beam = beam_xml(1e-4 if reverse else 1.0)  # from one point the virtual target is the same cone
    text = sheet(given("t", place=place, surfaces="sheet", reverse=reverse)).replace(beam_xml(1.0), beam)
    (row,) = mistray.trace(load_scene(text), rays=20_000, aim="targets").aiming
    assert (row.id, row.aimed) == ("sheet", pytest.approx(20_000, rel=1e-3))
    assert abs(row.landed / row.aimed - 0.5) < 5 * 0.5 / np.sqrt(row.aimed)
    aimed, blind = (mistray.trace(load_scene(sheet()), rays=40_000, aim=aim) for aim in ("auto", "none"))
    (row,) = aimed.aiming  # automatic ones catch all
    assert row.landed == row.aimed > 0
    assert blind.aiming == []


CENTRE, U, V = np.array([1.0, 2.0, 3.0]), np.array([2.0, 0.5, 0.0]), np.array([0.3, 1.0, 0.4])
SAMPLES = np.random.default_rng(0).random((40_000, 2))
# Mean of a² over the shape: radius²/4 of a disc with a hole, 1/3 of -1 … 1, and 1/6 of a triangle of unit legs; places
# that lie on it, and others
SHAPES = [
    ("ellipse", 0.0, np.pi, 0.25, [(0, 0), (0.7, 0.7), (-0.99, 0)], [(0.72, 0.72), (1.01, 0)]),
    ("ellipse", 0.6, 0.64 * np.pi, 0.25 * (1 + 0.36), [(0.61, 0), (0, -0.99)], [(0.59, 0), (0, 0), (1.01, 0)]),
    ("parallelogram", 0.0, 4.0, 1 / 3, [(0, 0), (0.99, -0.99)], [(1.01, 0), (0, -1.01)]),
    ("triangle", 0.0, 0.5, 1 / 6, [(0.01, 0.01), (0.49, 0.5)], [(0.51, 0.5), (-0.01, 0.2), (0.2, -0.01)]),
]


@pytest.mark.quick
@pytest.mark.parametrize(("shape", "hole", "area", "square", "inner", "outer"), SHAPES)
def test_points_are_uniform_on_the_target(shape, hole, area, square, inner, outer):
    """Second moments within 5 standard errors (false alarm 1e-5 for all)."""
    target = Target(shape, CENTRE, U, V, hole=hole)
    assert target.area == pytest.approx(area * np.linalg.norm(np.cross(U, V)), rel=1e-12)
    points = target.points(SAMPLES)
    (a, b), residual, *_ = np.linalg.lstsq(np.stack([U, V], axis=1), (points - CENTRE).T, rcond=None)
    assert np.max(residual) < 1e-20
    for x in (a, b):
        assert abs(np.mean(x**2) - square) < 5 * np.std(x**2) / np.sqrt(len(x))
    assert np.all(target.holds(CENTRE + (1 - 1e-9) * (points - CENTRE)) | (np.hypot(a, b) < hole * (1 + 1e-6)))
    np.testing.assert_allclose(np.abs((points - CENTRE) @ target.normal), 0, atol=1e-14)
    for places, on in ((inner, True), (outer, False)):
        assert np.all(target.holds(CENTRE + np.array(places) @ np.stack([U, V])) == on)
    assert not target.holds(np.full((1, 3), np.nan))[0]


TARGET: dict[str, Any] = {"shape": "ellipse", "centre": CENTRE, "u": U, "v": V, "share": 0.5}
HALF = Target(**TARGET)


@pytest.mark.quick
def test_impossible_shapes() -> None:
    each_refused(
        (lambda: Target(**TARGET | {"shape": "hexagon"}), "shape is 'hexagon'"),
        (lambda: Target(**TARGET | {"centre": [0.0, np.nan, 0.0]}), "centre is"),
        (lambda: Target(**TARGET | {"u": [1.0, 2.0]}), "u is"),
        (lambda: Target(**TARGET | {"v": 2 * U}), "has no area"),
        (lambda: Target(**TARGET | {"hole": 1.0}), "hole is 1"),
        (lambda: Target(**TARGET | {"shape": "triangle", "hole": 0.5}), "only an ellipse"),
        (lambda: Target(**TARGET | {"share": 0.0}), "share is 0"),
        (lambda: AimSet((HALF,), 1), r"add up to 0\.5"),
        (lambda: AimSet((HALF, HALF), 0), "0 aimed rays"),
    )


FAR_MM = 200.0  # mm: the detector from the origin
BEAM = {"type": "collimated", "radius": 1.0}
BACK = {**BEAM, "to_world": mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, -1], [0, 1, 0])}
PAINT = {**BLACK, "haze": {"type": "paint", "reflectance": 0.2}}
PLATE = {"type": "asphere", "semi_diameter": 2.0, "z": -1.0, "bsdf": PAINT}
EDGE = {"type": "interface", "R": 0.0, "T": 1.0, "model": {"type": "edge_diffraction", "width_mm": 0.02}}
RING = {"type": "frustum", "r0": 0.98, "z0": 0.0, "r1": 1.0, "z1": 0.0, "bsdf": EDGE}
BESIDE = square(2.0, to_world=towards_origin(4, FAR_MM))
# The parts of each scene, and the share of the launched light that is emitted, scattered or diffracted
FIVE: dict[str, tuple[dict[str, Any], float]] = {
    "emitted": ({"lamp": {"type": "point_source"}}, 1.0),
    "in a cone": ({"lamp": {"type": "point_source", "half_angle_deg": 60.0}}, 1.0),
    "by a cosine": ({"lamp": {"type": "point_source", "exponent": 5.0}}, 1.0),
    "surface source": ({"lamp": {"type": "surface_source", "radius": 3.0}}, 1.0),
    "scattered": ({"lamp": BACK, "plate": PLATE}, 0.2),
    "diffracted": ({"lamp": {**BEAM, "inner_radius": 0.98}, "edge": RING, "detector": BESIDE}, 1.0),
    "bulk": ({"lamp": BEAM, **hazy_block("1.0 scatter=0.01 g=0.5")}, 1 - np.exp(-0.1)),
}


@pytest.mark.quick
@pytest.mark.parametrize("kind", FIVE)
def test_aimed_rays_of_every_kind(kind: str) -> None:
    """Within 3 errors of the run without aim (2.7e-3 each), with half of the gain 1/p that a share p on the detector
    promises; an error of 32 batches is itself good to 1/8, so that 3 of these are given away."""
    parts, sent = FIVE[kind]
    aside = square(10.0, to_world=towards_origin(30, FAR_MM))
    scene = mistray.load({"type": "scene", "detector": aside} | parts)
    limits = {"ledger": False, "scatter_threshold": 0.0}
    aimed = mistray.trace(scene, rays=20_000, seed=1, **limits).energy
    blind = mistray.trace(scene, rays=1_000_000, seed=2, aim="none", **limits).energy
    assert blind.detected_se_W < 0.1 * blind.detected_W
    assert_z(kind, aimed.detected_W, blind.detected_W, float(np.hypot(aimed.detected_se_W, blind.detected_se_W)), k=3.0)
    share = aimed.detected_W / aimed.launched_W / sent
    assert (1 - share) / (20_000 * share) / (aimed.detected_se_W / aimed.detected_W) ** 2 > 0.5 / share * (1 - 3 / 8)


INDEX, THICK, RADIUS = 1.5, 6.0, 12.5  # of the window, mm
DIFFUSE, BEAM_MM, AWAY, ASIDE_MM, HALF_DEG = 0.02, 2.0, 100.0, 40.0, 1.0  # share scattered; beam and detector, mm


def window(scattering: str, z: float, **more: Any) -> mi.Scene:
    # Without reflections, so that the closed form has one term
    faces = {"front": {"type": "interface", "back": f"{INDEX}", "R": 0.0, "T": 0.9},
             "rear": {"type": "interface", "front": f"{INDEX}", "R": 0.0, "T": 1.0}}  # fmt: skip
    faces.get(scattering, {})["paint"] = {"type": "paint", "reflectance": DIFFUSE, "event": "transmission"}
    shapes = {
        "front": {"type": "asphere", "semi_diameter": RADIUS, "bsdf": faces["front"]},
        "rear": {"type": "asphere", "semi_diameter": RADIUS, "z": THICK, "bsdf": faces["rear"]},
        "edge": {"type": "frustum", "r0": RADIUS, "z0": 0.0, "r1": RADIUS, "z1": THICK, "bsdf": BLACK},
    }
    beam = {"type": "collimated", "radius": BEAM_MM, "irradiance": 1 / (np.pi * BEAM_MM**2)}
    given = {"lamp": beam, **shapes, "detector": square(HALF_DEG, y=ASIDE_MM, z=z)}
    return mistray.load({"type": "scene"} | given | more)


def through_the_window() -> float:
    """Power at the detector for 1 W: light at g in the glass lands at r(g) = t tan g + z tan(asin(n sin g)) from where
    it is scattered, so that a Lambertian share ρ gives dP/dA = ρ/π · cos g · sin g / (r dr/dg)."""
    g = np.linspace(1e-4, 0.9999 * np.arcsin(1 / INDEX), 200_001)
    r = THICK * np.tan(g) + AWAY * np.tan(np.arcsin(INDEX * np.sin(g)))
    density = DIFFUSE / np.pi * np.cos(g) * np.sin(g) / (r * np.gradient(r, g))
    x, w = np.polynomial.legendre.leggauss(6)
    rho, phi = BEAM_MM * np.sqrt(0.5 * (x + 1)), 2 * np.pi * (np.arange(12) + 0.5) / 12
    total = 0.0
    for a, w_a in zip(x, w, strict=True):
        for b, w_b in zip(x, w, strict=True):
            px, py = rho[:, None] * np.cos(phi), rho[:, None] * np.sin(phi)
            away = np.hypot(HALF_DEG * a - px, ASIDE_MM + HALF_DEG * b - py)
            total += HALF_DEG**2 * w_a * w_b * float(0.5 * w @ np.interp(away, r, density).mean(axis=1))
    return total


def measured(scene: mi.Scene, rays: int, **settings: str) -> tuple[float, float]:
    energy = mistray.trace(scene, rays=rays, **settings).energy
    assert abs(energy.closure) < 1e-6
    return energy.detected_W, energy.detected_se_W


def test_light_finds_the_detector_through_windows() -> None:
    """The closed form within a z of two-sided chance 1e-4 and within 2 %; unaimed, this many rays find nothing."""
    scene, expected = window("front", THICK + AWAY), through_the_window()
    power, se = measured(scene, 10_000)
    assert se < 0.02 * expected
    assert abs(power - expected) < z_limit(1, 1e-4) * se
    # An opaque wall that sees the detector through both faces: as by rays without aim, 4 errors (6e-5) of a fifth
    paint = {**BLACK, "paint": {"type": "paint", "reflectance": 0.5}}
    beam = {"type": "collimated", "radius": BEAM_MM, "to_world": mi.ScalarTransform4f().translate([0, 0, -10])}
    scene = window("none", -AWAY, lamp=beam, wall={"type": "asphere", "semi_diameter": 10.0, "z": 20.0, "bsdf": paint})
    (aimed, se), (blind, error) = measured(scene, 10_000), measured(scene, 100_000, aim="none")
    assert abs(aimed - blind) < 4 * np.hypot(se, error)
    assert se < 0.2 * error


def traced(rays: float = 1.0, largest: float = 0.001, aiming: Any = (), silent: Any = ()) -> Any:
    numbers = {"scattered_rays_per_start": rays, "largest_ray_share": largest, "effective_scattered_rays": 5000.0}
    return SimpleNamespace(aiming=list(aiming), silent=list(silent), **numbers)


def aimed(aimed: float, landed: float, at_detector: bool = True) -> dict[str, Any]:
    return {"aiming": [AimedSurface("window", aimed, landed, at_detector)]}


def two_surfaces(a: float, b: float) -> list[AimedSurface]:
    return [AimedSurface("a", 1000, a), AimedSurface("b", 1000, b)]


def silent(count: int, share: float) -> dict[str, Any]:
    return {"silent": [SilentPlace(f"wall_{k}", share) for k in range(count)]}


def test_what_is_told() -> None:
    """One line for each cause, with the worst surfaces first, or none."""
    four = [AimedSurface(f"s{k}", 1000, 10 * k) for k in (3, 2, 1, 0)]
    for values, words in (
        (aimed(1000, 250), ()),
        (aimed(1000, 199), ("window 20 %",)),
        (aimed(1000, 200), ()),
        (aimed(99, 0), ()),  # of a few rays no reason to warn
        (aimed(100, 0), ("window 0 %",)),
        (aimed(1000, 1000, False), ("window",)),  # all land, so that the target is too small, unless it is the detector
        (aimed(1000, 1000), ()),
        (aimed(1000, 999, False), ()),
        ({"aiming": four}, ("s0 0 %, s1 1 %, s2 2 % and 1 more",)),
        ({"rays": 0.099}, ("at least 0.1",)),
        ({"rays": 0.1}, ()),
        ({**aimed(1000, 500), "rays": 0.0}, ("at least 0.1",)),
        ({"rays": 10.0}, ()),
        ({"rays": 10.1}, ("at most 10",)),
        ({"rays": 0.0, "largest": float("nan")}, ()),  # nothing scatters
        ({"largest": 0.049}, ()),
        ({"largest": 0.2}, ("20 %",)),
        (silent(1, 0.9e-3), ()),
        (silent(1, 1e-3), ("wall_0",)),
        (silent(7, 0.5), ("7 surfaces", "wall_2 50 % and 4 more")),
    ):
        notes = sampling_check(traced(**values)).notes
        assert len(notes) == bool(words)
        assert all(word in notes[0] for word in words)
    # Several traces share a line of each kind, with the worst figures of any of them
    wall, dim, edge = SilentPlace("wall", 0.5), SilentPlace("wall", 0.02), SilentPlace("edge", 0.1)
    several = [
        traced(40.0, 0.2, two_surfaces(100, 900), [dim]),
        traced(50.0, 0.001, two_surfaces(150, 50)),
        traced(0.0, float("nan")),
        traced(0.01, 0.3, two_surfaces(500, 900), [wall, edge]),
    ]
    found = sampling_notes(several)
    words = ("b 5 %, a 10 %", "wall 50 %, edge 10 %", "0.01", "50", "30 %")
    assert [numbers for numbers, _ in found] == [[0, 1], [0, 3], [3], [0, 1], [0, 3]]
    assert all(word in text for word, (_, text) in zip(words, found, strict=True))
    assert sampling_notes([]) == []


def hazy_scene(target: dict[str, Any] | None = None) -> Any:
    place = towards_origin(40.0, 100.0)
    more = {} if target is None else {"aim": target | {"to_world": place}}
    block = hazy_block("1.0 scatter=0.01")
    return lit({"type": "collimated", "radius": 1.0}, **block, detector=square(0.3, 8, to_world=place), **more)


def test_a_medium_whose_light_is_not_found_is_named():
    """Without aim no ray finds the detector (2e-6 of them would): the trace says so instead of 0 ± 0 alone."""
    blind = mistray.trace(hazy_scene(), rays=5000, aim="none")
    assert blind.energy.detected_W == 0
    (place,) = blind.silent
    assert place.id == "(1.0_scatter=0.01)"
    assert 0.9 < place.share < 1.1  # the whole beam, less what is scattered before, and once more what comes back
    assert any("(1.0_scatter=0.01)" in text for text in sampling_check(blind).notes)
    aimed = mistray.trace(hazy_scene(), rays=5000)
    assert aimed.silent == []
    assert not any("(1.0_scatter=0.01)" in text for text in sampling_check(aimed).notes)


@pytest.mark.parametrize(("scale", "low", "tight"), [(0.1, False, True), (0.35, False, False), (9.0, True, False)])
def test_targets_of_a_wrong_size_are_named(scale, low, tight):
    disc = {"type": "disk", "bsdf": {"type": "target", "surfaces": "*", "scale": scale}}
    (row,) = sampling_check(mistray.trace(hazy_scene(disc), rays=5000)).rows
    assert (row.low, row.tight) == (low, tight)

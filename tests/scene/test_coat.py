"""Coatings, paint and scatter put on surfaces by patterns: what they do to light, what changes in a file."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import tmm
import vectors
from command_line import Captured, Patch, fails, run, succeeds
from oracles.small_scenes import interface_xml, scene_text, shape_xml, write
from refusals import each_refused, refused
from scene.test_rewrite import changes

import mistray
from mistray.coatings import Layer, Stack, fitted_preset, preset
from mistray.materials import refractive_index
from mistray.prescription import Coating, Detector, Prescription, Source, Stop, Structure, Surface
from mistray.scene import Rules, add_structures, find, write_coated
from mistray.scene.coat import coated_prescription
from mistray.scene.read_optics import read_optics
from mistray.scene.recoat import SharedCoating, recoated, write_recoated
from mistray.scene.source import source_of

pytestmark = pytest.mark.quick

AIR, GLASS = "air", "1.5168"


def lens() -> Prescription:
    """A cemented plate in two parts, with a blank in a name."""
    surfaces = (
        Surface("A front", z=0.0, semi_diameter=8.0, front=AIR, back=GLASS, part="A"),
        Surface("A_B", z=3.0, semi_diameter=8.0, front=GLASS, back="1.7", part="A"),
        Surface("B_rear", z=6.0, semi_diameter=8.0, front="1.7", back=AIR, part="B"),
    )
    stop = Stop(3.0, 8.0, 8.0, 9.0, 9.0, part="iris")
    detector = Detector(z=20.0, half_width=6.0, half_height=6.0)
    return Prescription(name="plate", surfaces=surfaces, stop=stop, detector=detector, source=Source(radius=2.0))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    lens().to_xml(tmp_path / "plate.xml")
    return tmp_path / "plate.xml"


def bsdfs(scene: object) -> dict[str, object]:
    return {shape.id(): shape.bsdf() for shape in scene.shapes()}


def glass(path: Path, n: float) -> None:
    write(path.parent, f"wavelength_nm,n,k\n400,{n},0\n700,{n},0\n", path.name)


def plate(folder: Path, front: str, rear: str, *more: str) -> Path:
    """A plate, the faces of which name their glass each."""
    faces = ("front", 0.0, interface_xml(back=front)), ("rear", 2.0, interface_xml(front=rear))
    shapes = [shape_xml("asphere", name, z, bsdf, semi_diameter=5.0) for name, z, bsdf in faces]
    return write(folder, scene_text(*more, *shapes, shape_xml("asphere", "d", 9.0, sensor=True, semi_diameter=4.0)))


def passed(n: float, m: float) -> float:
    """Transmittance between two indices at normal incidence, by Fresnel's equations."""
    return 1 - ((n - m) / (n + m)) ** 2


def texts(scene: object) -> dict[str, str]:
    return {name: str(bsdf) for name, bsdf in bsdfs(scene).items()}


def direct(scene: object) -> float:
    """Share of the light that arrives without a reflection; the rays do not matter, all have the same way."""
    t = mistray.trace(scene, rays=256, max_reflections=0, wavelength_nm=550.0)
    return t.paths[0].incident_W / t.energy.launched_W


class TestLight:
    def test_transmission_of_layers(self, file: Path) -> None:
        """The direct light is the product of what `tmm` says of each surface."""
        scene = mistray.coat(file, {"A front": "1.38 99.6, 2.1 0.5w", "B": "bbar3"})
        first = tmm.coh_tmm("s", [1, 1.38, 2.1, 1.5168], [float("inf"), 99.6, 550 / 2 / 2.1, float("inf")], 0, 550)["T"]
        layers = fitted_preset("bbar3", "1.7").stack.layers  # of the body that it is put on
        stack = [float("inf"), *(layer.thickness_nm for layer in layers), float("inf")]
        last = tmm.coh_tmm("s", [1, *(float(layer.material) for layer in layers), 1.7], stack, 0, 550)["T"]
        expected = first * passed(1.5168, 1.7) * last
        assert direct(scene) == pytest.approx(expected, rel=2e-6)  # tables hold R and T to 1e-6

    def test_prescription_and_file_are_the_same(self, file: Path, tmp_path: Path) -> None:
        rules = {"A*": "bbar3", "B_rear": "R=0.02 T=0.9"}
        paint, scatter = {"iris": "flat_black"}, {"A front": ["harvey_shack rms_nm=3", "particulate level=300"]}
        one = mistray.coat(file, rules, paint=paint, scatter=scatter)
        assert texts(one) == texts(mistray.coat(lens(), rules, paint=paint, scatter=scatter).to_scene())
        assert len(bsdfs(one)["A front"].scatterers) == 2
        assert bsdfs(one)["iris_front"].scatterers[0].model.name == "flat_black"

    def test_a_scene_that_travels(self, file: Path) -> None:
        scene = mistray.coat(file, {"B_rear": "bbar4"}, sources="beam:radius=1")
        again = source_of(scene).load()
        assert texts(again) == texts(scene)
        assert [e.size[0] for e in again.emitters()] == [1.0]
        assert bsdfs(mistray.load(file))["B_rear"].film is None, "the file stays as it is"

    def test_a_dict_travels_as_it_was_loaded(self) -> None:
        given = lens().to_dict()
        scene = mistray.load(given)
        given["source"]["wavelength_nm"] = 700.0
        assert source_of(scene).load().emitters()[0].wavelengths_nm == [550.0]

    def test_files_of_the_current_folder_travel(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """The faces of a plate name its glass by a file there, and by one in a path there."""
        for name in ("1.csv", "glasses/2.csv"):
            glass(tmp_path / "here" / name, 1.4)
        file = plate(tmp_path / "scene", "1.csv", "2.csv", '<path value="glasses"/>')
        monkeypatch.chdir(tmp_path / "here")
        scene = source_of(mistray.load(file))
        monkeypatch.chdir("/")
        assert direct(scene.load()) == pytest.approx(passed(1, 1.4) ** 2, rel=2e-6)


class TestPatterns:
    def test_clear_surfaces_of_a_pattern(self, file: Path, tmp_path: Path) -> None:
        found = write_coated(file, tmp_path / "new.xml", Rules({"*": "bbar3"}))
        assert set(found.changes) == {"A front", "B_rear"}
        left = {("A_B", "lies in cement"), ("iris_front", "is opaque"), ("detector", "is opaque")}
        assert {(item.surface, item.why) for item in found.left} == left
        text = (tmp_path / "new.xml").read_text(encoding="utf-8")
        for name in ("bbar3", "bbar3_1_7"):  # one for each body
            assert (text.count(f'<ref id="{name}"/>'), text.count(f'id="{name}"')) == (1, 2)

    def test_a_name_means_one_surface(self, file: Path) -> None:
        """Cement is coated by its name; a later pattern goes over an earlier one, paint and scatter over coatings."""
        scene = mistray.coat(file, {"A_B": "mgf2_quarter_wave", "?*": "bbar3", "B": "bare"})
        found = {name: str(bsdf.coating.name) for name, bsdf in bsdfs(scene).items() if bsdf.film is not None}
        assert (found["A_B"], found["A front"]) == ("mgf2_quarter_wave", "bbar3")
        assert "B_rear" not in found
        scatter = {"B_rear": "particulate level=200", "A front": "none"}
        rear = bsdfs(mistray.coat(file, {"B": "bbar3"}, paint={"B_*": 0.1}, scatter=scatter))["B_rear"]
        assert (rear.opaque, [item.kind for item in rear.scatterers]) == (True, ["paint", "particulate"])

    def test_mirrors(self, tmp_path: Path) -> None:
        """A mirror takes an opaque coating by a pattern, what is black does not."""
        found = write_coated("newtonian", tmp_path / "new.xml", Rules({"*": "protected_ag"}))
        assert set(found.changes) == {"primary", "diagonal"}
        with refused("'primary=bbar3': 'primary' is opaque; give an opaque coating"):
            write_coated("newtonian", tmp_path / "no.xml", Rules({"primary": "bbar3"}))

    def test_what_a_table_blocks(self, tmp_path: Path, monkeypatch: Patch) -> None:
        """A detector whose table transmits nothing is no clear surface."""
        (tmp_path / "t.csv").write_text("wavelength_nm,angle_deg,R,T\n550,0,0.1,0\n550,90,0.1,0\n")
        monkeypatch.chdir(tmp_path)
        detector = replace(lens().detector, coating=Coating(table="t.csv"))
        system, rules = replace(lens(), detector=detector), Rules({"*": "bbar3"})
        system.to_xml("t.xml")
        for found in coated_prescription(system, rules)[1], write_coated("t.xml", "new.xml", rules):
            assert set(found.changes) == {"A front", "B_rear"}

    def test_names_of_the_scene(self, file: Path, tmp_path: Path) -> None:
        """What the scene has by a name is referred to; a new one of the same values too; another one gets a number."""
        layers, shared = tmp_path / "1.xml", tmp_path / "2.xml"
        write_coated(file, layers, Rules({"A front": "1.4 100"}, scatter={"A front": "harvey_shack rms_nm=3"}))
        rules = Rules({"B": "coating", "A front": "1.5 90"}, scatter={"B": "harvey_shack rms_nm=3"})
        write_coated(layers, shared, rules)
        text = shared.read_text(encoding="utf-8")
        assert text.count('id="coating"') == 2, "the coating, and B_rear that refers to it"
        assert (text.count('id="coating_2"'), text.count('<ref id="harvey_shack_rms_nm_3"/>')) == (2, 2)
        films = bsdfs(mistray.load(shared))
        assert [layer.thickness_nm for layer in films["B_rear"].coating.layers] == [100]
        assert [layer.thickness_nm for layer in films["A front"].coating.layers] == [90]

    def test_names_in_included_scenes_are_taken(self, file: Path, tmp_path: Path) -> None:
        film = '<bsdf type="thinfilm" id="bbar3"><string name="preset" value="bbar3"/></bsdf>'
        (tmp_path / "part.xml").write_text(f'<scene version="3.0.0">{film}</scene>')
        text = file.read_text(encoding="utf-8").replace("</scene>", '<include filename="part.xml"/></scene>')
        file.write_text(text, encoding="utf-8")
        found = write_coated(file, tmp_path / "new.xml", Rules({"A front": "bbar3"}))
        assert found.changes["A front"].coating.name == "bbar3_2"
        assert 'id="bbar3_2"' in recoated(file, [SharedCoating("bbar3", preset("v_coat"), ("B_rear",))], tmp_path)
        shade = Structure("shade", 14, -30, 14, -1, coating=Coating(preset="bbar3", name="bbar3"))
        assert bsdfs(mistray.load(add_structures(file, [shade], tmp_path / "shaded.xml")))["shade"].film.id() == "bbar3"

    def test_files_lie_where_they_are(self, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Paths count from the current folder; the new scene finds them from its own."""
        (tmp_path / "t.csv").write_text("wavelength_nm,angle_deg,R,T\n550,0,0.1,0.8\n550,90,0.1,0.8\n")
        glass(tmp_path / "g.csv", 1.5)
        (tmp_path / "out").mkdir()
        monkeypatch.chdir(tmp_path)
        write_coated(file, "out/new.xml", Rules({"B": "t.csv", "A front": "g.csv 80"}))
        monkeypatch.chdir("/")
        scene = mistray.load(tmp_path / "out" / "new.xml")
        film = tmm.coh_tmm("s", [1, 1.5, 1.5168], [float("inf"), 80, float("inf")], 0, 550)["T"]
        assert direct(scene) == pytest.approx(film * passed(1.5168, 1.7) * 0.8, rel=2e-6)

    @pytest.mark.parametrize("folder", ["data", "."])
    def test_names_in_the_scene_count_from_it(self, folder: str, tmp_path: Path, monkeypatch: Patch) -> None:
        """Not from the current folder, though it has such a path and a file; the file has a blank in its name."""
        glass(tmp_path / "scene" / folder / "my glass.csv", 1.4)
        glass(tmp_path / folder / "my glass.csv", 1.9)
        file = plate(tmp_path / "scene", *2 * ["my glass.csv k=0"], f'<path value="{folder}"/>' * (folder != "."))
        monkeypatch.chdir(tmp_path)
        (tmp_path / "scene" / "out").mkdir()
        rules, expected = {"rear": "R=0 T=1"}, pytest.approx(passed(1, 1.4), rel=2e-6)
        assert direct(mistray.coat(file, rules)) == expected
        assert refractive_index(read_optics("scene/scene.xml")[0].surfaces[0].back, 550.0) == 1.4
        fitted = mistray.coat(file, {"rear": "bbar3"})  # to the index of the glass
        assert direct(fitted) == pytest.approx(passed(1, 1.4), abs=5e-3)
        write_coated("scene/scene.xml", "scene/out/new.xml", Rules(rules))
        assert direct(mistray.load("scene/out/new.xml")) == expected
        monkeypatch.chdir("/")
        assert direct(mistray.load(tmp_path / "scene" / "out" / "new.xml")) == expected

    def test_capitals_and_ids_within_a_shared_interface(self, tmp_path: Path) -> None:
        """Mitsuba takes "True" as well; the copy of an interface for one surface has no id of the original."""
        numbers = {"rms_nm": 2, "B_um": 20, "slope": 3, "reference_nm": 550}
        rough = "".join(f'<float name="{k}" value="{v}"/>' for k, v in numbers.items())
        shared = (
            '<bsdf type="interface" id="glass"><string name="back" value="1.5"/>'
            '<bsdf type="thinfilm" id="ar"><string name="preset" value="bbar3"/></bsdf></bsdf>'
            f'<bsdf type="k_correlation" id="polish">{rough}<boolean name="band_limited" value="True"/></bsdf>'
        )
        mirror = interface_xml(R=0.9, mirror=True).replace('"true"', '"True"')
        glass = '<ref id="glass"/>'
        lenses = [shape_xml("asphere", "LK"[k], 0.0, glass, semi_diameter=5.0, x=20.0 * k) for k in (0, 1)]
        film = shape_xml("asphere", "d", 20.0, sensor=True, semi_diameter=2.0)
        shapes = (*lenses, shape_xml("asphere", "M", 9.0, mirror, semi_diameter=5.0), film)
        file = write(tmp_path, scene_text(shared, *shapes))
        found = bsdfs(mistray.coat(file, {"M*": "protected_al"}, scatter={"L": "harvey_shack rms_nm=1"}))
        assert (found["M"].coating.name, [len(found[name].scatter) for name in "LK"]) == ("protected_al", [1, 0])
        assert found["L"].coating.layers == found["K"].coating.layers
        assert len(found["L"].coating.layers) == len(preset("bbar3").layers)


def test_wrong_rules(file: Path, tmp_path: Path) -> None:
    for rules, words in vectors.toml("refusals.toml")["rules of coat"]:
        with refused(words):
            write_coated(file, tmp_path / "new.xml", Rules(**rules))
        assert not (tmp_path / "new.xml").exists()


def test_wrong_rules_by_all_ways_in(file: Path, capsys: Captured) -> None:
    words = "'Z=bbar3' fits no surface and no part"
    each_refused((lens(), words), (file, words), by=lambda system: mistray.coat(system, {"Z": "bbar3"}))
    assert words in fails(capsys, "coat", file, "Z=bbar3")
    assert words in fails(capsys, "ghosts", file, "--coating", "Z=bbar3")
    assert "scatter 'smooth': there is none" in fails(capsys, "ghosts", file, "--scatter", "A=smooth")
    assert "nothing to put on; give PATTERN=COATING" in fails(capsys, "coat", file)
    assert "'bbar3' is not a coating; write PATTERN=COATING" in fails(capsys, "coat", file, "bbar3")
    with refused("coat: int is given; give a scene file"):
        mistray.coat(3, {"a": "bbar3"})  # type: ignore[call-overload]
    with refused("sources and sensors are for scenes"):
        mistray.coat(lens(), {"A": "bbar3"}, sources="sun")  # type: ignore[call-overload]


class TestCommand:
    def test_writes_a_scene(self, file: Path, tmp_path: Path, capsys: Captured) -> None:
        new = tmp_path / "new.xml"
        words = ["coat", file, "*=bbar3", "--paint", "iris=flat_black", "--scatter", "A front=particulate level=9"]
        out = succeeds(capsys, *words, "-o", new)
        assert "bbar3 + particulate_level_9: A front" in out
        assert "left alone, because it lies in cement: A_B" in out
        fails(capsys, *words, "-o", new)  # nothing is overwritten unasked
        fails(capsys, *words, "-o", file, "--force")  # and what is read never
        record = json.loads(succeeds(capsys, *words, "-o", new, "--force", "--json"))
        expected = {"surface": "A front", "recoated": True, "coating": "bbar3", "scatter": ["particulate_level_9"]}
        assert record["changes"][0] == expected
        assert {"surface": "A_B", "pattern": "*", "why": "lies in cement"} in record["left"]
        assert record["files"] == [str(new)]
        out = succeeds(capsys, "coat", file, *("A front=R=0 T=0.9", "B=R=0.02 T=0.98"), "-o", new, "--force")
        assert "R = 0, T = 0.9: A front\nR = 0.02, T = 0.98: B_rear" in out

    def test_options_of_a_trace(self, file: Path, tmp_path: Path, capsys: Captured) -> None:
        succeeds(capsys, "coat", file, "?*=bbar3", "-o", tmp_path / "new.xml")
        results = []
        for words in ([tmp_path / "new.xml"], [file, "--coating", "?*=bbar3"]):
            out = run(capsys, "ghosts", *words, "--rays", "500", "--max-reflections", "2", "--json", "--quiet")[1]
            results.append(json.loads(out)["fields"][0])
        names = ("direct_power_W", "direct_rms_radius_mm", "paths")
        assert [results[0][name] for name in names] == pytest.approx([results[1][name] for name in names], rel=1e-9)

    def test_import(self, tmp_path: Path, capsys: Captured) -> None:
        source = find("phone_camera").with_name("prescription.json")
        rules = [
            "--coating",
            "L*=bbar4",
            "--paint",
            "barrel_*=good_black_paint",
            "--scatter",
            "L1=harvey_shack rms_nm=1",
        ]
        assert run(capsys, "import", source, "-o", tmp_path / "a.xml", *rules)[0] == 0
        scene = bsdfs(mistray.load(tmp_path / "a.xml"))
        assert str(scene["L1_front"].coating.name) == "bbar4_nd_1_544_Vd_56_1_k_0"
        assert [item.kind for item in scene["L1_rear"].scatterers] == ["harvey_shack"]
        assert scene["barrel_0_cone"].scatterers[0].model.name == "good_black_paint"


AR = Stack((Layer("1.38", 99.5), Layer("2.1", 131.25)), name="AR")
TRIPLET = find("cooke_triplet")
SCENE = vectors.text("coat.xml")


class TestWhatChanges:
    def test_only_the_new_lines_and_every_way_to_have_a_coating(self, tmp_path: Path) -> None:
        before = TRIPLET.read_text(encoding="utf-8")
        after = recoated(TRIPLET, [SharedCoating("AR", AR, ("L1_front", "L3_rear"))], TRIPLET.parent, "for a test -- x")
        gone, new = changes(before, after)
        assert gone == []
        coating = ['<bsdf type="thinfilm" id="AR">', '<string name="layers" value="1.38 99.5, 2.1 131.25"/>', "</bsdf>"]
        note = "<!-- Coatings put on by mistray: for a test - - x -->"
        assert [line for line in new if line] == [note, *coating, *2 * ['<ref id="AR"/>']]
        # Shared interface, shared coating, nested coating, coating alone, nothing: all end with the new design
        source = write(tmp_path, SCENE)
        done = write_recoated(source, [SharedCoating("AR", AR, ("a", "b", "c", "d", "e"))], tmp_path / "new.xml")
        text = done.read_text(encoding="utf-8")
        bsdfs = {shape.id(): shape.bsdf() for shape in mistray.load(done).shapes()}
        assert len({id(bsdfs[name].film) for name in "abcde"}) == 1, "one design, one object"
        for name, sides in {"a": ("air", "1.5"), "b": ("1.5", "air"), "c": ("air", "1.6"), "d": ("1.6", "air")}.items():
            assert ((bsdfs[name].front, bsdfs[name].back), bsdfs[name].coating.layers) == (sides, AR.layers)
        assert bsdfs["detector"].opaque
        # Others may refer to the shared interface, nobody refers to the old coating any more, a surface keeps its name
        assert [f'id="{name}"' in text for name in ("glass", "old", "alone")] == [True, False, True]
        for kept in ('<!-- a > b, "quoted" -->', "<!-- crown -->", "<!-- the lens -->"):
            assert kept in text

    def test_again(self, tmp_path: Path) -> None:
        """Other designs replace the first ones under the same names, with their note."""
        source = write(tmp_path, SCENE)

        def coatings(name: str) -> list[SharedCoating]:
            return [SharedCoating("AR", preset(name), ("a", "b")), SharedCoating("c", preset(name), ("c",))]

        first = write_recoated(source, coatings("v_coat"), tmp_path / "1.xml", "first")
        second = recoated(first, coatings("bbar3"), tmp_path, "second")
        assert second == recoated(source, coatings("bbar3"), tmp_path, "second")
        assert second.count('id="AR"') == 3
        assert "first" not in second
        infrared = SharedCoating("IR", Stack((Layer("Ge", 300.0),), first="back"), ("L1_front",), 10600.0)
        text = recoated(TRIPLET, [infrared], tmp_path)
        assert '<string name="first" value="back"/>' in text
        assert '<float name="design_nm" value="10600"/>' in text
        mirror = SharedCoating("mirror", preset("protected_al"), ("L1_front",))
        assert '<boolean name="opaque" value="true"/>' in recoated(TRIPLET, [mirror], tmp_path)


INFRARED = {"spectrum": "blackbody:300", "band_nm": (8000.0, 12000.0)}


@pytest.mark.parametrize(
    ("light", "nm"),
    [({"wavelength_nm": (8000.0, 12000.0)}, 1e4), (INFRARED, 1e4), ({"spectrum": "F C"}, 550.0), ({}, 550.0)],
)
def test_waves_are_those_of_the_light(light: dict[str, object], nm: float, tmp_path: Path) -> None:
    system = replace(lens(), source=Source(radius=2.0, **light))
    system.to_xml(tmp_path / "plate.xml")
    rules = Rules(coatings={"B": "ZnS 0.25w"})
    for found in coated_prescription(system, rules)[1], write_coated(tmp_path / "plate.xml", tmp_path / "b.xml", rules):
        assert found.changes["B_rear"].coating.design_nm == pytest.approx(nm, rel=1e-3)


def test_files_that_are_refused(tmp_path: Path) -> None:
    interface = '<bsdf type="interface"/>'
    each_refused(
        ("<scene>\n</scen>", ("a",), "line 2: broken XML, mismatched tag"),
        (SCENE.replace("utf-8", "latin-1"), ("a",), "its encoding is latin-1"),
        (SCENE.replace(interface, '<bsdf type="diffuse"/>'), ("e",), "shape 'e': its BSDF is 'diffuse'"),
        (SCENE.replace(interface, ""), ("e",), "shape 'e': it has no BSDF"),
        (SCENE, ("glass",), "it has no shape 'glass'"),
        (SCENE, ("a", "a"), "shape 'a' gets two coatings"),
        by=lambda text, surfaces: recoated(write(tmp_path, text), [SharedCoating("AR", AR, surfaces)], tmp_path),
    )
    with refused(r"none\.xml': No such file"):
        recoated(tmp_path / "none.xml", [SharedCoating("AR", AR, ("a",))], tmp_path)

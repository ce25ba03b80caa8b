"""Coatings put on surfaces of a scene file: what changes, what stays, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from oracles.small_scenes import write
from scene.test_rewrite import changes

import mistray
from mistray.coatings import Layer, Stack, preset
from mistray.errors import MistrayError
from mistray.scene.load import find
from mistray.scene.recoat import SharedCoating, recoated, write_recoated

pytestmark = pytest.mark.quick

AR = Stack((Layer("1.38", 99.5), Layer("2.1", 131.25)), name="AR")
TRIPLET = find("cooke_triplet")
SCENE = """<?xml version="1.0" encoding="utf-8"?>
<!-- a > b, "quoted" -->
<scene version="3.0.0">
    <integrator type="straylight"/>
    <emitter type="collimated"><float name="radius" value="1"/></emitter>
    <bsdf type="interface" id="glass">
        <string name="back" value="1.5"/> <!-- crown -->
        <float name="R" value="0.1"/>
        <float name="T" value="0.9"/>
    </bsdf>
    <bsdf type="thinfilm" id="old">
        <string name="preset" value="v_coat"/>
    </bsdf>
    <!-- the lens -->
    <shape type="asphere" id="a">
        <float name="semi_diameter" value="5"/>
        <ref id="glass"/>
    </shape>
    <shape type="asphere" id="b">
        <float name="semi_diameter" value="5"/>
        <transform name="to_world"><translate z="2"/></transform>
        <bsdf type="interface">
            <string name="front" value="1.5"/>
            <ref id="old"/>
        </bsdf>
    </shape>
    <shape type="asphere" id="c"><float name="semi_diameter" value="5"/>
        <transform name="to_world"><translate z="4"/></transform>
        <bsdf type="interface"><string name="back" value="1.6"/><bsdf type="thinfilm"><string name="layers" value="1.4 100"/></bsdf></bsdf></shape>
    <shape type="asphere" id="d"><float name="semi_diameter" value="5"/>
        <transform name="to_world"><translate z="6"/></transform>
        <bsdf type='thinfilm' id="alone"><string name="front" value="1.6"/><string name="preset" value="bbar3"/><string name="back" value="air"/></bsdf></shape>
    <shape type="asphere" id="e"><float name="semi_diameter" value="5"/>
        <transform name="to_world"><translate z="8"/></transform><bsdf type="interface"/></shape>
    <shape type="asphere" id="detector">
        <float name="half_width" value="5"/><float name="half_height" value="5"/>
        <transform name="to_world"><translate z="9"/></transform>
        <bsdf type="interface"><float name="R" value="0"/></bsdf>
        <sensor type="irradiancemeter"><film type="hdrfilm"><rfilter type="box"/></film></sensor>
    </shape>
</scene>
"""  # noqa: E501


class TestWhatChanges:
    def test_only_the_new_lines(self, tmp_path: Path) -> None:
        before = TRIPLET.read_text(encoding="utf-8")
        after = recoated(TRIPLET, [SharedCoating("AR", AR, ("L1_front", "L3_rear"))], TRIPLET.parent, "for a test -- x")
        gone, new = changes(before, after)
        assert gone == []
        assert [line for line in new if line] == [
            "<!-- Coatings put on by mistray: for a test - - x -->",
            '<bsdf type="thinfilm" id="AR">',
            '<string name="layers" value="1.38 99.5, 2.1 131.25"/>',
            "</bsdf>",
            '<ref id="AR"/>',
            '<ref id="AR"/>',
        ]

    def test_every_way_to_have_a_coating(self, tmp_path: Path) -> None:
        """Shared interface, shared coating, nested coating, coating alone, nothing: all end with the new design."""
        source = write(tmp_path, SCENE)
        done = write_recoated(source, [SharedCoating("AR", AR, ("a", "b", "c", "d", "e"))], tmp_path / "new.xml")
        text = done.read_text(encoding="utf-8")
        scene = mistray.load(done)
        bsdfs = {shape.id(): shape.bsdf() for shape in scene.shapes()}
        films = {id(bsdfs[name].film) for name in "abcde"}
        assert len(films) == 1, "one design, one object"
        for name, sides in {"a": ("air", "1.5"), "b": ("1.5", "air"), "c": ("air", "1.6"), "d": ("1.6", "air")}.items():
            assert (bsdfs[name].front, bsdfs[name].back) == sides
            assert bsdfs[name].coating.layers == AR.layers
        assert bsdfs["detector"].opaque
        assert 'id="glass"' in text, "others may refer to the shared interface"
        assert 'id="old"' not in text, "nobody refers to the old coating any more"
        assert 'id="alone"' in text, "the surface keeps its name"
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

    def test_order_and_design_wavelength(self, tmp_path: Path) -> None:
        infrared = Stack((Layer("Ge", 300.0),), first="back")
        text = recoated(TRIPLET, [SharedCoating("IR", infrared, ("L1_front",), 10600.0)], tmp_path)
        assert '<string name="first" value="back"/>' in text
        assert '<float name="design_nm" value="10600"/>' in text


class TestRefusals:
    def test_files(self, tmp_path: Path) -> None:
        coating = [SharedCoating("AR", AR, ("a",))]
        with pytest.raises(MistrayError, match=r"none\.xml': No such file"):
            recoated(tmp_path / "none.xml", coating, tmp_path)
        with pytest.raises(MistrayError, match="line 2: broken XML, mismatched tag"):
            recoated(write(tmp_path, "<scene>\n</scen>"), coating, tmp_path)
        with pytest.raises(MistrayError, match="its encoding is latin-1"):
            recoated(write(tmp_path, SCENE.replace("utf-8", "latin-1")), coating, tmp_path)
        diffuse = SCENE.replace('<bsdf type="interface"/>', '<bsdf type="diffuse"/>')
        with pytest.raises(MistrayError, match="shape 'e': its BSDF is 'diffuse'"):
            recoated(write(tmp_path, diffuse), [SharedCoating("AR", AR, ("e",))], tmp_path)
        bare = SCENE.replace('<bsdf type="interface"/>', "")
        with pytest.raises(MistrayError, match="shape 'e': it has no BSDF"):
            recoated(write(tmp_path, bare), [SharedCoating("AR", AR, ("e",))], tmp_path)
        for surfaces, words in ((("glass",), "it has no shape 'glass'"), (("a", "a"), "shape 'a' gets two coatings")):
            with pytest.raises(MistrayError, match=words):
                recoated(write(tmp_path, SCENE), [SharedCoating("AR", AR, surfaces)], tmp_path)

"""Python hears what the shell hears, writes what the commands write, and takes one where several may be given."""

import copy
import json
import pickle
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import pytest
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray import materials, report
from mistray.messages import Message
from mistray.notes import Code, quiet

DOCS = Path(__file__).parents[1] / "docs" / "warnings.md"


def heard(call: Callable[[], Any]) -> tuple[Any, list[tuple[str, str]]]:
    """The result of a call, and the code and text of what it warns of."""
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always")
        result = call()
    assert all(one.category is mistray.MistrayWarning and one.filename == __file__ for one in raised)
    return result, [(one.message.code, str(one.message)) for one in raised]


@pytest.fixture(scope="module")
def scene() -> mi.Scene:
    return mistray.load("cooke_triplet")


def two_balls(near: str) -> str:
    """Two balls of glass before a detector; the normal of a sphere points outwards: it comes from the front, inside."""
    ball = '<shape type="sphere" id="{}"><float name="radius" value="{}"/>{}</shape>'
    far = ball.format("far", 9, '<point name="center" x="0" y="0" z="15"/>' + interface_xml("1.5", "air"))
    detector = shape_xml("asphere", "detector", 30.0, sensor=True, half_width=9.0, half_height=9.0)
    text = scene_text(ball.format("near", 5, near), far, detector, radius=3.0)
    return text.replace("</emitter>", '<transform name="to_world"><translate z="-20"/></transform></emitter>')


def test_medium_on_the_wrong_side(load_scene):
    """The far ball is met from glass that is not there: the light is lost, and `trace` says so."""
    t, found = heard(lambda: mistray.trace(load_scene(two_balls(interface_xml("air", "1.5"))), rays=500))
    assert [code for code, _ in found] == [note.code for note in t.notes if note.warns]
    lost = t.energy.cut["medium"] / t.energy.launched_W
    assert lost > 0.1
    (text,) = [text for code, text in found if code == "medium"]
    assert f"{lost:.1e}" in text
    right, _ = heard(lambda: mistray.trace(load_scene(two_balls(interface_xml("1.5", "air"))), rays=500))
    assert not [note for note in right.notes if note.code == "medium"]


def test_cuts_warnings_and_notes(scene):
    t, found = heard(lambda: mistray.trace(scene, rays=500))
    assert [(note.code, note.warns) for note in t.notes if note.code == "cut"] == [("cut", False)]
    assert "cut" not in [code for code, _ in found]
    for again in (copy.deepcopy(t.notes), pickle.loads(pickle.dumps(t.notes))):
        assert [(note, note.code, note.warns) for note in again] == [(note, note.code, note.warns) for note in t.notes]
    few, found = heard(lambda: mistray.trace(scene, rays=500, max_reflections=0))
    assert few.energy.cut["max_reflections"] > 0.01 * few.energy.launched_W
    assert "cut" in [code for code, _ in found]
    # Each line once, with its fields; the traces of the fields say nothing of their own
    report, found = heard(lambda: mistray.ghosts(scene, [0.0, 5.0], rays=500, max_reflections=0))
    assert found == [(note.code, f"{note} [{note.code}]") for note in report.notes if note.warns]
    cut = [text for code, text in found if code == "cut"]
    assert len(cut) == 1
    assert cut[0].startswith("field 0, 5 deg: ")
    pst, found = heard(lambda: mistray.pst(scene, [0.0, 70.0], rays=2000, next_order=False))
    assert found == [(note.code, f"{note} [{note.code}]") for note in pst.notes]
    assert {"no-light", "error"} & {code for code, _ in found}
    seen, found = heard(lambda: mistray.objects(scene, rays=500))
    assert found == [(note.code, f"{note} [{note.code}]") for note in seen.notes]


def test_filters_choose_by_code(scene):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", r".*\[cut\]$", mistray.MistrayWarning)
        with pytest.raises(mistray.MistrayWarning) as raised:
            mistray.trace(scene, rays=500, max_reflections=0)
    assert raised.value.code == "cut"


def test_a_gradient_is_quiet(scene):
    """What a search traces on its way is no result of the user's."""
    metric = mistray.optimize.transmission(scene, rays=500, max_reflections=0)
    assert heard(lambda: mistray.gradient(metric, mi.traverse(scene), ["L1_front.curvature"]))[1] == []


def test_suppressed_notes_are_kept_on_request(scene):
    """Once each, those of the function that was called and not of those that it calls; and none in a block within."""
    kept = []
    with quiet(kept):
        t = mistray.trace(scene, rays=500, max_reflections=0)
        pst = mistray.pst(scene, [0.0, 70.0], rays=2000, next_order=False)
        with quiet():
            mistray.trace(scene, rays=500, max_reflections=0)
    assert kept == [note for note in (*t.notes, *pst.notes) if note.warns]
    assert "cut" in {note.code for note in kept}


def test_every_code_is_documented():
    assert re.findall(r"^\| `([a-z-]+)` \|", DOCS.read_text(), re.MULTILINE) == list(Code)
    assert {message.value[0] for message in Message} == set(Code)


@pytest.mark.core
def test_image_quality(tmp_path: Path) -> None:
    found = mistray.image_quality(mistray.load("double_gauss"), field_deg=[0.0])
    assert re.search(r"\bfield\b", report.quality_text(found, [20.0]))
    files = report.write_quality(found, tmp_path / "out", frequencies=[20.0])
    assert {"report.html", "image_quality.json"} <= {path.name for path in files}
    assert all(path.stat().st_size for path in files)
    assert len(json.loads((tmp_path / "out/image_quality.json").read_text())["fields"]) == 1


@pytest.mark.core
def test_ghosts_and_study(tmp_path: Path) -> None:
    scene = mistray.load("plate_and_wall")
    files = report.write_png(mistray.ghosts(scene, field_deg=[0.0], rays=500), tmp_path)
    assert files
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in files)
    text = report.study_text(mistray.study(scene, field_deg=[0.0], rays=200))
    assert text.count("\n") > 3
    assert "plate" in text


@pytest.mark.core
def test_first_level() -> None:
    limits = {"ghosts off": {"max_reflections": 0}, "all": {"max_reflections": 2}}
    found = mistray.first_level(mistray.load("lens_and_window"), [0.0], limits=limits, rays=1000)
    ghosts = {name: curve.curve("ghost")[0].sum() for name, curve in found.curves.items()}
    assert ghosts["ghosts off"] == 0 < ghosts["all"]


def test_tables_of_materials() -> None:
    assert materials.table_nodes_nm("nd=1.5 Vd=60") == ()
    nodes = materials.table_nodes_nm("Ag")
    assert nodes == tuple(sorted(nodes))
    assert len(nodes) > 10

"""Sweeps and the cache: what is found again, what is not, and what happens when the disk does not play along."""

import hashlib
import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from oracles.small_scenes import interface_xml, scene_text, shape_xml, write
from refusals import refused

import mistray
from mistray.analyses.sweep import run as sweeping
from mistray.analyses.sweep.cells import Cell, KeptRows, SceneContents, foreign_plugins, traced_facts
from mistray.analyses.sweep.configurations import Resolved
from mistray.analyses.sweep.numbers import COLUMNS, FIRST_LIGHT, TEXTS
from mistray.cache import Cache
from mistray.trace import Settings

pytestmark = pytest.mark.quick
TABLE = "wavelength_nm,n\n400,1.53\n700,1.51\n"
LENS = scene_text(
    shape_xml("asphere", "front", 0.0, interface_xml("air", "glass.csv k=0"), radius=20.0, semi_diameter=4.0),
    shape_xml("asphere", "rear", 3.0, interface_xml("glass.csv k=0", "air"), radius=-30.0, semi_diameter=4.0),
    shape_xml("asphere", "detector", 24.0, sensor=True, half_width=8.0, half_height=8.0),
)
LIGHT = ("power", "variance", "direct", "strongest")
STATES = {"a": {}, "b": {"detector.z": 0.5}}
ASKED: dict[str, Any] = {"field_deg": [0, 5], "wavelength_nm": [500], "configurations": STATES, "rays": 64}
Row = tuple[dict[str, Any], bool]


def made_up(number: int, **numbers: Any) -> dict[str, Any]:
    """A row with a number of its own."""
    row = {**dict.fromkeys(COLUMNS, 0.0), **dict.fromkeys(TEXTS), FIRST_LIGHT: {key: {} for key in LIGHT}}
    return row | {"number": number} | numbers


@pytest.fixture
def lens(tmp_path: Path) -> Path:
    folder = tmp_path / "lens"
    folder.mkdir()
    (folder / "glass.csv").write_text(TABLE)
    return write(folder, LENS)


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    return tmp_path / "kept"


@pytest.fixture
def traces(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Notes every trace and makes up its numbers: what is found in the cache has nothing to do with them."""
    done: list[str] = []

    def note(scene: Any, cell: Any, *_: Any) -> Row:
        done.append(str(cell))
        return made_up(len(done), stray_W=0.1 + len(done), stray_se_W=float("nan"), worst_path=None), True

    monkeypatch.setattr(sweeping, "_traced", note)
    return done


class TestReuse:
    def test_numbers_come_back_to_the_last_digit(self, lens: Path, kept: Path) -> None:
        first = mistray.sweep(lens, cache=kept, **ASKED)
        again = mistray.sweep(lens, cache=kept, **ASKED)
        assert (first.reused, again.reused) == (0, 4)
        assert again.cache_folder == kept
        assert again.to_pandas().equals(first.to_pandas())
        assert list(again.to_pandas().dtypes) == list(first.to_pandas().dtypes)
        assert first.warnings == again.warnings == ()
        without = mistray.sweep(lens, cache=False, **ASKED)
        assert (without.reused, without.cache_folder) == (0, None)
        assert list(without.to_pandas().stray_W) == pytest.approx(list(first.to_pandas().stray_W), rel=1e-9)
        assert again.trace("b", 5).paths[0].power_W == pytest.approx(again.estimate("direct_W", "b", 5).value, rel=1e-9)

    def test_what_is_new_is_traced(self, lens: Path, kept: Path, tmp_path: Path, traces: list[str]) -> None:
        """Names, places and order do not count."""
        mistray.sweep(lens, cache=kept, **ASKED)
        assert len(traces) == 4
        more = {**ASKED, "field_deg": [5, 7, 0], "configurations": {**STATES, "c": {"detector.z": 1.0}}}
        found = mistray.sweep(lens, cache=kept, **more)
        assert found.reused == 4
        new = ("a", 7), ("b", 7), ("c", 5), ("c", 7), ("c", 0)
        assert traces[4:] == [f"configuration '{name}', field {field} deg, 500 nm" for name, field in new]
        assert [row["field_deg"] for row in found.rows] == [5, 7, 0] * 3
        other = shutil.copytree(lens.parent, tmp_path / "elsewhere") / "scene.xml"
        states = {"z": {"detect*.z": [0.5]}, "y": {}}
        found = mistray.sweep(other, cache=kept, **{**ASKED, "field_deg": [5, 0], "configurations": states})
        assert found.reused == 4
        assert [row["configuration"] for row in found.rows] == ["z", "z", "y", "y"]
        assert [row["number"] for row in found.rows] == [4, 3, 2, 1]

    def test_an_interrupted_sweep_goes_on(self, lens: Path, kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        done = []

        def fail(scene: Any, cell: Any, *_: Any) -> Row:
            if len(done) == 3:
                raise KeyboardInterrupt
            done.append(cell)
            return made_up(len(done)), True

        monkeypatch.setattr(sweeping, "_traced", fail)
        with pytest.raises(KeyboardInterrupt):
            mistray.sweep(lens, cache=kept, **ASKED)
        monkeypatch.setattr(sweeping, "_traced", lambda *_: (made_up(0), True))
        assert [row["number"] for row in mistray.sweep(lens, cache=kept, **ASKED).rows] == [1, 2, 3, 0]

    def test_rows_before_an_error_are_kept(self, lens: Path, kept: Path) -> None:
        """A wavelength at which the glass is not known."""
        with refused(r"configuration 'a', field 0 deg, 900 nm: .*glass\.csv"):
            mistray.sweep(lens, [0], [500, 900], rays=64, configurations={"a": {}}, cache=kept)
        assert mistray.sweep(lens, [0], [500], rays=64, cache=kept).reused == 1

    def test_files_that_change_meanwhile(self, lens: Path, kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """A glass table is read when a wavelength needs it: what follows a change is not kept under the old content."""
        done: list[str] = []

        def change(scene: Any, cell: Any, *_: Any) -> Row:
            done.append(str(cell))
            if len(done) == 3:
                (lens.parent / "glass.csv").write_text(TABLE.replace("1.53", "1.6"))
            return made_up(len(done)), True

        monkeypatch.setattr(sweeping, "_traced", change)
        found = mistray.sweep(lens, cache=kept, **ASKED)
        assert [row["number"] for row in found.rows] == [1, 2, 3, 4]
        told = "sweep: files of the scene were changed while it was traced; the rows since then are not kept"
        assert found.warnings == (told,)
        assert mistray.sweep(lens, cache=kept, **ASKED).reused == 0
        (lens.parent / "glass.csv").write_text(TABLE)
        assert mistray.sweep(lens, cache=kept, **ASKED).reused == 2


def test_whatever_a_number_depends_on_makes_another_key(lens: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def key(place: tuple[str, float] | None = None, field_deg: float = 0.0, nm: float = 500.0,
            azimuth_deg: float | None = None, **settings: Any) -> str:  # fmt: skip
        contents = SceneContents(lens)
        facts = traced_facts(contents, Settings.of(mistray.load(lens), **settings), azimuth_deg)
        configuration = Resolved("name", {} if place is None else {place[0]: np.array([place[1]])}, {})
        return KeptRows(Cache(Path(), 1), contents, facts).key(Cell(configuration, nm, field_deg))

    first, glass = key(), lens.parent / "glass.csv"
    assert key(seed=0) == first  # the default
    seen = [first, key(seed=1), key(rays=2000), key(max_reflections=3), key(flux_threshold=1e-9),
            key(polarization="stokes"), key(field_deg=1e-12), key(nm=500.0 + 1e-9), key(azimuth_deg=10.0),
            key(("front.z", 1.0)), key(("rear.z", 1.0)), key(("front.z", 1.0 + 1e-7))]  # fmt: skip
    for text in (TABLE.replace("1.53", "1.54"), TABLE + "\n"):
        glass.write_text(text)
        seen.append(key())
    glass.write_text(TABLE)
    assert key() == first
    seeded = 'type="straylight"><integer name="seed" value="7"/></integrator>'
    bent = LENS.replace('"20.0"', '"20.000001"')
    for text in (f"{LENS}<!-- a remark -->", LENS.replace('type="straylight"/>', seeded), bent):
        lens.write_text(text)
        seen.append(key())
    lens.write_text(LENS)
    monkeypatch.setattr("mistray.analyses.sweep.cells.code_fingerprint", lambda: "other code")
    seen.append(key())
    monkeypatch.undo()
    monkeypatch.setattr("mistray.analyses.sweep.cells.mi", SimpleNamespace(variant=lambda: "cuda_ad_rgb"))
    seen.append(key())
    assert len(set(seen)) == len(seen)


class TestWhatIsNotCached:
    def test_loaded_scenes_and_dicts(self, lens: Path, kept: Path, traces: list[str]) -> None:
        scene = mistray.load(lens)
        assert mistray.sweep(scene, **ASKED).cache_folder is None
        assert mistray.sweep(scene, **ASKED).reused == 0
        for wanted in (True, kept):
            with refused(r"only results of scene files are cached.*or leave out the cache"):
                mistray.sweep(scene, cache=wanted, **ASKED)
        assert not kept.exists()

    def test_plugins_from_elsewhere(self, lens: Path, kept: Path, traces: list[str], monkeypatch: Any) -> None:
        scene = mistray.load(lens)
        assert foreign_plugins(scene) == foreign_plugins(mistray.load("phone_camera_scatter")) == []
        monkeypatch.setattr(type(scene.shapes()[0].bsdf()), "__module__", "notebook")
        assert foreign_plugins(scene) == ["Interface"]
        found = mistray.sweep(lens, **ASKED)
        told = "sweep: the code of plugins from elsewhere (Interface) may change, so that nothing is cached"
        assert (found.cache_folder, found.warnings) == (None, (told,))
        with refused("plugins from elsewhere"):
            mistray.sweep(lens, cache=kept, **ASKED)


@pytest.mark.parametrize(
    "content",
    [b"", b"null", b"[]", b"{}", b"7", b"NaN", b"1e999", b'"row"', b"\xff\xfe", b"[" * 100_000, b"{" + b'"a":' * 9,
     b"STRAY:1e999", b'STRAY:"1"', b"STRAY:true", b"STRAY:null", b"STRAY:[]", b"STRAY:" + b"9" * 5000, b"-STRAY",
     b"-first_light", b"first_light:3", b'first_light:{"power":{}}', b"worst_path:3"],
)  # fmt: skip
def test_an_entry_of_another_form(lens: Path, kept: Path, traces: list[str], content: bytes) -> None:
    """Its sum agrees; it is named once, removed and made again."""
    mistray.sweep(lens, cache=kept, **ASKED)
    path = sorted(kept.iterdir())[1]
    magic, key, _, old = path.read_bytes().split(b"\n", 3)
    content = content.replace(b"STRAY", b"stray_W")
    if content.startswith(b"-"):
        content = json.dumps({k: v for k, v in json.loads(old).items() if k != content[1:].decode()}).encode()
    elif b":" in content and not content.startswith(b"{"):
        name, _, value = content.partition(b":")
        row = json.dumps({**json.loads(old), name.decode(): "HERE"})
        content = row.encode().replace(b'"HERE"', value)
    path.write_bytes(b"\n".join((magic, key, hashlib.sha256(content).hexdigest().encode(), content)))
    found = mistray.sweep(lens, cache=kept, **ASKED)
    assert found.reused == 3
    assert [f"'{path}' is damaged" in line for line in found.warnings] == [True]
    again = mistray.sweep(lens, cache=kept, **ASKED)
    assert (again.reused, again.warnings) == (4, ())

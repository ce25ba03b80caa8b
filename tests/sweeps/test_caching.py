"""Sweeps and the cache: what is found again, what is not, and what happens when the disk does not play along."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from oracles.small_scenes import interface_xml, scene_text, shape_xml, write

import mistray
from mistray.cache import Cache, store
from mistray.errors import MistrayError
from mistray.sweeps import trace_rows as sweeping
from mistray.sweeps.cells import Cell, KeptRows, SceneContents, foreign_plugins, traced_facts
from mistray.sweeps.configurations import Resolved
from mistray.sweeps.numbers import COLUMNS, FIRST_LIGHT, TEXTS
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

    def note(scene: Any, cell: Any, *_: Any) -> dict[str, Any]:
        done.append(str(cell))
        return made_up(len(done), stray_W=0.1 + len(done), stray_se_W=float("nan"), worst_path=None)

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

    def test_what_is_new_is_traced(self, lens: Path, kept: Path, traces: list[str]) -> None:
        mistray.sweep(lens, cache=kept, **ASKED)
        assert len(traces) == 4
        more = {**ASKED, "field_deg": [5, 7, 0], "configurations": {**STATES, "c": {"detector.z": 1.0}}}
        found = mistray.sweep(lens, cache=kept, **more)
        assert found.reused == 4
        assert traces[4:] == [
            "configuration 'a', field 7 deg, 500 nm",
            "configuration 'b', field 7 deg, 500 nm",
            *[f"configuration 'c', field {field} deg, 500 nm" for field in (5, 7, 0)],
        ]
        assert [row["field_deg"] for row in found.rows] == [5, 7, 0] * 3

    def test_an_interrupted_sweep_goes_on(self, lens: Path, kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        done = []

        def fail(scene: Any, cell: Any, *_: Any) -> dict[str, Any]:
            if len(done) == 3:
                raise KeyboardInterrupt
            done.append(cell)
            return made_up(len(done))

        monkeypatch.setattr(sweeping, "_traced", fail)
        with pytest.raises(KeyboardInterrupt):
            mistray.sweep(lens, cache=kept, **ASKED)
        monkeypatch.setattr(sweeping, "_traced", lambda *_: made_up(0))
        found = mistray.sweep(lens, cache=kept, **ASKED)
        assert [row["number"] for row in found.rows] == [1, 2, 3, 0]

    def test_rows_before_an_error_are_kept(self, lens: Path, kept: Path) -> None:
        """A wavelength at which the glass is not known."""
        with pytest.raises(MistrayError, match=r"configuration 'a', field 0 deg, 900 nm: .*glass\.csv"):
            mistray.sweep(lens, [0], [500, 900], rays=64, configurations={"a": {}}, cache=kept)
        assert mistray.sweep(lens, [0], [500], rays=64, cache=kept).reused == 1

    def test_files_that_change_meanwhile(self, lens: Path, kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """A glass table is read when a wavelength needs it: what follows a change is not kept under the old content."""
        done: list[str] = []

        def change(scene: Any, cell: Any, *_: Any) -> dict[str, Any]:
            done.append(str(cell))
            if len(done) == 3:
                (lens.parent / "glass.csv").write_text(TABLE.replace("1.53", "1.6"))
            return made_up(len(done))

        monkeypatch.setattr(sweeping, "_traced", change)
        found = mistray.sweep(lens, cache=kept, **ASKED)
        assert [row["number"] for row in found.rows] == [1, 2, 3, 4]
        assert found.warnings == (
            "sweep: files of the scene were changed while it was traced; the rows since then are not kept",
        )
        assert mistray.sweep(lens, cache=kept, **ASKED).reused == 0
        (lens.parent / "glass.csv").write_text(TABLE)
        assert mistray.sweep(lens, cache=kept, **ASKED).reused == 2

    def test_names_places_and_order_do_not_count(
        self, lens: Path, kept: Path, tmp_path: Path, traces: list[str]
    ) -> None:
        mistray.sweep(lens, cache=kept, **ASKED)
        other = shutil.copytree(lens.parent, tmp_path / "elsewhere") / "scene.xml"
        states = {"z": {"detect*.z": [0.5]}, "y": {}}
        found = mistray.sweep(other, cache=kept, **{**ASKED, "field_deg": [5, 0], "configurations": states})
        assert found.reused == 4
        assert [row["configuration"] for row in found.rows] == ["z", "z", "y", "y"]
        assert [row["number"] for row in found.rows] == [4, 3, 2, 1]

    def test_the_environment_switches_it_off(
        self, lens: Path, traces: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setenv("MISTRAY_CACHE", str(tmp_path / "of the user"))
        assert mistray.sweep(lens, **ASKED).cache_folder == tmp_path / "of the user"
        assert mistray.sweep(lens, **ASKED).reused == 4
        monkeypatch.setenv("MISTRAY_CACHE", "off")
        found = mistray.sweep(lens, **ASKED)
        assert (found.reused, found.cache_folder) == (0, None)


class TestKeys:
    """A change of anything that a number depends on makes another key."""

    def key(
        self,
        lens: Path,
        values: dict[str, list[float]] | None = None,
        field_deg: float = 0.0,
        wavelength_nm: float = 500.0,
        azimuth_deg: float | None = None,
        **settings: Any,
    ) -> str:
        contents = SceneContents(lens)
        facts = traced_facts(contents, Settings.of(mistray.load(lens), **settings), azimuth_deg)
        configuration = Resolved("name", {key: np.array(numbers) for key, numbers in (values or {}).items()}, {})
        return KeptRows(Cache(Path(), 1), contents, facts).key(Cell(configuration, wavelength_nm, field_deg))

    @pytest.mark.parametrize(
        "settings",
        [{"seed": 1}, {"rays": 2000}, {"max_reflections": 3}, {"flux_threshold": 1e-9}, {"polarization": "stokes"}],
    )
    def test_settings(self, lens: Path, settings: dict[str, Any]) -> None:
        assert self.key(lens, **settings) != self.key(lens)
        assert self.key(lens, seed=0) == self.key(lens)  # the default

    def test_files(self, lens: Path) -> None:
        seen = {self.key(lens)}
        glass = lens.parent / "glass.csv"
        for text in (TABLE.replace("1.53", "1.54"), TABLE + "\n"):
            glass.write_text(text)
            seen.add(self.key(lens))
        glass.write_text(TABLE)
        assert self.key(lens) in seen
        lens.write_text(LENS.replace("radius", "radius", 1) + "<!-- a remark -->")
        seen.add(self.key(lens))
        lens.write_text(
            LENS.replace('type="straylight"/>', 'type="straylight"><integer name="seed" value="7"/></integrator>')
        )
        seen.add(self.key(lens))
        lens.write_text(LENS.replace('"20.0"', '"20.000001"'))
        seen.add(self.key(lens))
        assert len(seen) == 6

    def test_the_rest(self, lens: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        keys = [
            self.key(lens),
            self.key(lens, field_deg=1e-12),
            self.key(lens, wavelength_nm=500.0 + 1e-9),
            self.key(lens, {"front.z": [1.0]}),
            self.key(lens, {"rear.z": [1.0]}),
            self.key(lens, {"front.z": [1.0 + 1e-7]}),
            self.key(lens, azimuth_deg=10.0),
        ]
        monkeypatch.setattr("mistray.sweeps.cells.code_fingerprint", lambda: "other code")
        keys.append(self.key(lens))
        monkeypatch.undo()
        monkeypatch.setattr("mistray.sweeps.cells.mi", SimpleNamespace(variant=lambda: "cuda_ad_rgb"))
        keys.append(self.key(lens))
        assert len(set(keys)) == len(keys)


def test_files_are_watched(lens: Path) -> None:
    contents = SceneContents(lens)
    assert contents.unchanged()
    glass = lens.parent / "glass.csv"
    os.utime(glass, (1, 1))
    assert contents.unchanged()  # the time alone does not matter
    glass.write_text(TABLE.replace("1.53", "1.54"))
    assert not contents.unchanged()
    glass.write_text(TABLE)
    assert contents.unchanged()
    glass.unlink()
    assert not contents.unchanged()


class TestWhatIsNotCached:
    def test_loaded_scenes_and_dicts(self, lens: Path, kept: Path, traces: list[str]) -> None:
        scene = mistray.load(lens)
        assert mistray.sweep(scene, **ASKED).cache_folder is None
        assert mistray.sweep(scene, **ASKED).reused == 0
        for wanted in (True, kept):
            with pytest.raises(MistrayError, match=r"only results of scene files are cached.*or leave out the cache"):
                mistray.sweep(scene, cache=wanted, **ASKED)
        assert not kept.exists()

    def test_plugins_from_elsewhere(self, lens: Path, kept: Path, traces: list[str], monkeypatch: Any) -> None:
        assert foreign_plugins(mistray.load(lens)) == []
        assert foreign_plugins(mistray.load("phone_camera_scatter")) == []
        scene = mistray.load(lens)
        monkeypatch.setattr(type(scene.shapes()[0].bsdf()), "__module__", "notebook")
        assert foreign_plugins(scene) == ["Interface"]
        found = mistray.sweep(lens, **ASKED)
        assert found.cache_folder is None
        assert found.warnings == (
            "sweep: the code of plugins from elsewhere (Interface) may change, so that nothing is cached",
        )
        with pytest.raises(MistrayError, match="plugins from elsewhere"):
            mistray.sweep(lens, cache=kept, **ASKED)


class TestTrouble:
    def test_a_damaged_entry(self, lens: Path, kept: Path, traces: list[str]) -> None:
        first = mistray.sweep(lens, cache=kept, **ASKED)
        paths = sorted(kept.iterdir())
        data = bytearray(paths[1].read_bytes())
        data[-2] ^= 4
        paths[1].write_bytes(bytes(data))
        paths[2].write_bytes(paths[2].read_bytes()[:-9])
        found = mistray.sweep(lens, cache=kept, **ASKED)
        assert found.reused == 2
        assert len(found.warnings) == 2
        assert all("is damaged; its result is computed again" in line for line in found.warnings)
        assert len(traces) == 6
        assert sum(row["number"] > 4 for row in found.rows) == 2  # made again, not guessed
        again = mistray.sweep(lens, cache=kept, **ASKED)
        assert (again.reused, again.warnings) == (4, ())
        assert len(first.rows) == 4

    @pytest.mark.parametrize(
        "content",
        [b"", b"null", b"[]", b"{}", b"7", b"NaN", b"1e999", b'"row"', b"\xff\xfe", b"[" * 100_000, b"{" + b'"a":' * 9,
         b"STRAY:1e999", b'STRAY:"1"', b"STRAY:true", b"STRAY:null", b"STRAY:[]", b"STRAY:" + b"9" * 5000, b"-STRAY",
         b"-first_light", b"first_light:3", b'first_light:{"power":{}}', b"worst_path:3"],
    )  # fmt: skip
    def test_an_entry_of_another_form(self, lens: Path, kept: Path, traces: list[str], content: bytes) -> None:
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

    @pytest.mark.parametrize("place", ["file/cache", "file"])
    def test_a_folder_that_cannot_be(self, lens: Path, tmp_path: Path, traces: list[str], place: str) -> None:
        (tmp_path / "file").write_text("")
        found = mistray.sweep(lens, cache=tmp_path / place, **ASKED)
        assert [row["number"] for row in found.rows] == [1, 2, 3, 4]
        assert len(found.warnings) == 1
        assert "results are not kept, make room or name another folder" in found.warnings[0]

    def test_the_disk_is_full(self, lens: Path, kept: Path, traces: list[str], monkeypatch: Any) -> None:
        monkeypatch.setattr(store.os, "replace", _no_room)
        found = mistray.sweep(lens, cache=kept, **ASKED)
        assert [row["number"] for row in found.rows] == [1, 2, 3, 4]
        assert found.warnings == (
            f"cache '{kept}': No space left on device; results are not kept, make room or name another folder in "
            "MISTRAY_CACHE, or switch the cache off",
        )
        assert list(kept.iterdir()) == []


def _no_room(*_: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


ROWS = """
import json, sys, mistray
found = mistray.sweep(sys.argv[1], [0, 3, 5, 7], [450, 500, 550], {"a": {}, "b": {"detector.z": 0.5}}, rays=2000)
print(json.dumps([found.reused, found.warnings, [row["stray_W"] for row in found.rows]]))
"""


def start(lens: Path, cache: Path, *before: str) -> subprocess.Popen[str]:
    command = [*before, sys.executable, "-c", ROWS, str(lens)]
    environment = {**os.environ, "MISTRAY_CACHE": str(cache)}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def answer(process: subprocess.Popen[str]) -> tuple[int, list[str], list[float]]:
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    reused, warnings, values = json.loads(out.splitlines()[-1])
    return reused, warnings, values


@pytest.mark.slow
def test_two_processes(lens: Path, kept: Path) -> None:
    """At once they give the same numbers and leave whole entries; a third finds them all."""
    both = [answer(process) for process in [start(lens, kept), start(lens, kept)]]
    third = answer(start(lens, kept))
    assert third[0] == len(third[2]) == 24
    for reused, warnings, values in both:
        assert reused <= 24
        assert warnings == []
        assert values == pytest.approx(third[2], rel=1e-9)
    assert Cache(kept, 10**9).contents().entries == 24


def may_mount() -> bool:
    command = ["unshare", "-m", "mount", "-t", "tmpfs", "tmpfs", "/mnt"]
    try:
        return subprocess.run(command, capture_output=True).returncode == 0
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "reason"), [("size=16k", "No space left on device"), ("ro", "Read-only file system")]
)
def test_a_small_disk(lens: Path, kept: Path, options: str, reason: str) -> None:
    """A real disk that is full after some entries, or read-only."""
    if not may_mount():
        pytest.skip("this user may not mount a small disk")
    kept.mkdir()
    script = 'mount -t tmpfs -o "$1" tmpfs "$2" && shift 2 && exec "$@"'
    reused, warnings, values = answer(start(lens, kept, "unshare", "-m", "sh", "-c", script, "sh", options, str(kept)))
    assert reused == 0
    assert len(values) == 24
    assert len(warnings) == 1
    assert f"{reason}; results are not kept" in warnings[0]

"""`mistray sweep` and `mistray cache`: table, files, JSON, bad input."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import json_units
import pandas as pd
import pytest
from oracles.small_scenes import plates_text, write

from mistray import cli
from mistray.errors import UnfinishedError

STATES = """
[[configuration]]
name = "weak"

[[configuration]]
name = "strong"
values = { "p0_*.bsdf.R" = 0.3, "p0_*.bsdf.T" = 0.6 }
"""
ASKED = ("--field-deg", "0", "10", "--wavelength-nm", "500", "600", "--rays", "64")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MISTRAY_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def plate(tmp_path: Path) -> str:
    return str(write(tmp_path, plates_text(1, R=0.1, T=0.8)))


@pytest.fixture
def states(tmp_path: Path) -> str:
    path = tmp_path / "states.toml"
    path.write_text(STATES)
    return str(path)


def run(capsys: Any, *arguments: str) -> tuple[int, str, str]:
    code = cli.main(list(arguments))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


class TestSweep:
    def test_table_and_files(self, capsys: Any, plate: str, states: str, tmp_path: Path) -> None:
        out = tmp_path / "new" / "out"
        code, printed, errors = run(capsys, "sweep", plate, states, *ASKED, "--out", str(out))
        assert (code, errors) == (0, "")
        lines = [line.split() for line in printed.splitlines()]
        assert sum(line[:1] == ["weak"] for line in lines) == sum(line[:1] == ["strong"] for line in lines) == 4
        assert "p0_rear → p0_front" in printed
        assert "8 rows, 0 of them from the cache in" in printed
        names = {path.name for path in out.iterdir()}
        assert names == {"sweep.csv", "configurations.csv", "sweep.json", "sweep.png", "report.html"}
        table = pd.read_csv(out / "sweep.csv")
        assert list(table.columns[:3]) == ["configuration", "field_deg", "wavelength_nm"]
        assert list(table.ghost_to_signal.round(6)) == [0.01] * 4 + [0.09] * 4
        values = pd.read_csv(out / "configurations.csv")
        assert list(values[values.key == "p0_rear.bsdf.R"].value.round(6)) == [0.3]
        html = (out / "report.html").read_text(encoding="utf-8")
        assert html.count("data:image/png") == 1
        assert "p0_rear.bsdf.T = 0.6" in html
        assert "mistray sweep" in html

    def test_json(self, capsys: Any, plate: str, states: str, cache: Path) -> None:
        records = []
        for _ in range(2):
            code, printed, errors = run(capsys, "sweep", plate, states, *ASKED, "--json")
            assert (code, errors) == (0, "")
            records.append(json_units.read(printed))
        assert records[0]["rows"] == records[1]["rows"]
        assert [record["rows_from_cache"] for record in records] == [0, 8]
        assert records[1]["cache"] == str(cache)
        row = records[0]["rows"][7]
        assert (row["configuration"], row["field_deg"], row["wavelength_nm"]) == ("strong", 10, 600)
        assert row["ghost_to_signal"] == pytest.approx(0.09, rel=1e-5)
        assert row["ghost_to_signal_se"] < 1e-6  # all rays carry the same
        strong = records[0]["configurations"][1]
        assert {(item["key"], item["unit"]) for item in strong["values"]} == {
            (f"p0_{face}.bsdf.{share}", "1") for face in ("front", "rear") for share in "RT"
        }
        assert records[0]["settings"]["rays"] == 64

    def test_the_scene_as_it_is(self, capsys: Any, plate: str, cache: Path) -> None:
        code, printed, errors = run(capsys, "sweep", plate, "--rays", "64", "--no-cache")
        assert (code, errors) == (0, "")
        assert "1 rows, all traced" in printed
        assert "as it is" in printed
        assert not cache.exists()

    def test_a_configuration_on_the_command_line(self, capsys: Any, plate: str, states: str) -> None:
        """It stands beside the scene as it is, or behind the configurations of the file."""
        values = ("--set", "p0_*.bsdf.R=0.3", "--set", "p0_*.bsdf.T=0.6")
        code, printed, errors = run(capsys, "sweep", plate, *values, *ASKED, "--json")
        assert (code, errors) == (0, "")
        rows = json_units.read(printed)["rows"]
        name = "p0_*.bsdf.R = 0.3, p0_*.bsdf.T = 0.6"
        assert [row["configuration"] for row in rows] == ["as it is"] * 4 + [name] * 4
        assert [row["ghost_to_signal"] for row in rows] == pytest.approx([0.01] * 4 + [0.09] * 4)
        code, printed, errors = run(capsys, "sweep", plate, states, *values, *ASKED, "--json")
        assert [row["configuration"] for row in json_units.read(printed)["rows"][::4]] == ["weak", "strong", name]

    def test_its_pst(self, capsys: Any, plate: str) -> None:
        """
        Half the reflectance of a face halves the ghost, a PST of 0.005, and a black face takes it.

        What goes past the plate is a straight shot before and after.
        """
        asked = ("--pst-field-deg", "0", "--rays", "2000", "--json")
        for change, lost in ((("--set", "p0_front.bsdf.R=0.05"), 0.0025), (("--paint", "p0_front=black"), 0.005)):
            code, printed, errors = run(capsys, "sweep", plate, *change, *asked)
            assert (code, errors) == (0, "")
            (row,) = json_units.read(printed)["rows"]
            assert row["configuration"] == change[1].replace("=", " = ")
            assert row["before"] - row["after"] == pytest.approx(lost, rel=0.15)

    def test_a_dark_field_is_drawn(self, capsys: Any, plate: str, tmp_path: Path) -> None:
        """Light that misses the detector: no direct image, no stray light, nothing to divide by."""
        out = tmp_path / "out"
        code, _, errors = run(capsys, "sweep", plate, "--field-deg", "0", "88.8", "--rays", "64", "--out", str(out))
        assert (code, errors) == (0, "")
        dark = json.loads((out / "sweep.json").read_text())["rows"][1]
        assert (dark["direct_W"], dark["ghost_to_signal"], dark["worst_path"]) == (0.0, None, None)

    def test_a_cache_that_cannot_be_written_is_one_line(
        self, capsys: Any, plate: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (tmp_path / "file").write_text("")
        monkeypatch.setenv("MISTRAY_CACHE", str(tmp_path / "file" / "below"))
        code, printed, errors = run(capsys, "sweep", plate, *ASKED, "--json")
        assert code == 0
        assert len(json_units.read(printed)["rows"]) == 4
        assert errors.count("\n") == 1
        assert errors.startswith("mistray: warning: cache '")
        assert "Not a directory; results are not kept" in errors

    def test_workers_that_are_gone(
        self, capsys: Any, plate: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """The rows that are finished are written, and are in the cache."""
        running, out = sys.modules["mistray.sweeps.trace_rows"], tmp_path / "out"
        real, calls = running.trace, []

        def gone(*arguments: Any, **more: Any) -> Any:
            calls.append(more)
            if len(calls) > 2:
                raise UnfinishedError("scheduler tcp://host:1 is gone; start it again")
            return real(*arguments, **more)

        monkeypatch.setattr(running, "trace", gone)
        code, printed, errors = run(capsys, "sweep", plate, *ASKED, "--out", str(out))
        assert (code, printed, errors.count("\n")) == (2, "", 1)
        assert "configuration 'as it is', field 0 deg, 600 nm: scheduler tcp://host:1 is gone; start it again" in errors
        assert f"the rows that are finished are in {out}" in errors
        assert list(pd.read_csv(out / "sweep.csv").field_deg) == [0, 10]
        monkeypatch.undo()
        monkeypatch.setenv("MISTRAY_CACHE", str(tmp_path / "cache"))
        assert "4 rows, 2 of them from the cache" in run(capsys, "sweep", plate, *ASKED)[1]

    @pytest.mark.parametrize("finished", [0, 2])
    def test_interrupted(self, capsys: Any, plate: str, monkeypatch: pytest.MonkeyPatch, finished: int) -> None:
        running, done = sys.modules["mistray.sweeps.trace_rows"], []

        def interrupted(*_: Any) -> dict[str, Any]:
            if len(done) == finished:
                raise KeyboardInterrupt
            done.append(None)
            return {"number": 1}

        monkeypatch.setattr(running, "_traced", interrupted)
        code, printed, errors = run(capsys, "sweep", plate, *ASKED)
        assert (code, printed, errors.count("\n")) == (130, "", 1)
        assert ("finished rows are in the cache, the same command goes on" in errors) == (finished > 0)

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (("no.toml",), "configurations 'no.toml': No such file or directory; check the path"),
            (("--field-deg", "95"), "95 must lie between -90 and 90"),
            (("--wavelength-nm", "500", "500"), "give every wavelength once"),
            (("--rays", "0"), "--rays: 0 must"),
            (("--formats", "parquet"), "--formats writes files; say with --out"),
            (("--set", "p0_rear.bsdf.R"), "'p0_rear.bsdf.R' is no value; write KEY=VALUE"),
            (("--set", "p0_rear.bsdf.R=nan"), "'nan' is not a number"),
            (("--set", "p0_rear.bsdf.Q=1"), "the scene has no parameter 'p0_rear.bsdf.Q'; did you mean"),
            (
                ("--set", "p0_rear.bsdf.R=0.1", "p0_rear.bsdf.R=0.2"),
                "--set: p0_rear.bsdf.R is 0.1 and 0.2; give one value",
            ),
            (
                ("--set", "a b=1", "--pst-field-deg", "20"),
                "error: configuration 'a b = 1': the scene has no parameter 'a b'",
            ),
            (("--coating", "p0_*=bare"), "--coating is compared by its PST; give --pst-field-deg as well"),
            (("--paint", "p0_*=black"), "--paint is compared by its PST; give --pst-field-deg as well"),
            (("--pst-field-deg", "20"), "give --set, --coating, --paint, a TOML file with them, or --rank"),
        ],
    )
    def test_bad_input_is_one_line(self, capsys: Any, plate: str, arguments: tuple[str, ...], words: str) -> None:
        code, printed, errors = run(capsys, "sweep", plate, *arguments)
        assert (code, printed, errors.count("\n")) == (2, "", 1)
        assert errors.startswith("mistray: error: ")
        assert words in errors

    def test_nothing_is_traced_when_the_output_cannot_be_written(
        self, capsys: Any, plate: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(sys.modules["mistray.sweeps.trace_rows"], "trace", None)
        code, _, errors = run(capsys, "sweep", plate, "--out", plate)
        assert code == 2
        assert "is a file; name a directory" in errors


class TestCache:
    def test_info_and_clear(self, capsys: Any, plate: str, cache: Path) -> None:
        def ask(action: str) -> dict[str, Any]:
            code, printed, errors = run(capsys, "cache", action, "--json")
            assert (code, errors) == (0, "")
            return json_units.read(printed)

        assert ask("info")["entries"] == 0
        assert not cache.exists()
        run(capsys, "sweep", plate, *ASKED)
        (cache / "notes.txt").write_text("mine")
        held = ask("info")
        assert (held["folder"], held["entries"], held["limit_bytes"]) == (str(cache), 4, 1_000_000_000)
        assert 4_000 < held["size_bytes"] < 20_000
        assert run(capsys, "cache", "info")[1].startswith(f"{cache}: holds 4 results, 0.0")
        cleared = ask("clear")
        assert (cleared["action"], cleared["entries"], cleared["size_bytes"]) == ("clear", 4, held["size_bytes"])
        assert ask("info")["entries"] == 0
        assert [path.name for path in cache.iterdir()] == ["notes.txt"]

    def test_off(self, capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("MISTRAY_CACHE", "off")
        assert run(capsys, "cache", "info") == (0, "the cache is switched off by MISTRAY_CACHE\n", "")
        assert json_units.read(run(capsys, "cache", "clear", "--json")[1])["folder"] is None

    def test_wrong(self, capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("MISTRAY_CACHE_MB", "much")
        code, _, errors = run(capsys, "cache", "info")
        assert code == 2
        assert (
            errors == "mistray: error: MISTRAY_CACHE_MB is 'much'; give the size of the cache in MB, greater than 0\n"
        )

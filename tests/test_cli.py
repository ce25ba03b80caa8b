"""The command line: arguments, one-line errors, exit codes; progress on a terminal after a second."""

import argparse
import ast
import importlib
import io
import math
import re
import subprocess
import sys
import time
from dataclasses import fields
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import json_units
import numpy as np
import pandas as pd
import pytest
import vectors
from analyses.fake_pst import fake_pst
from analyses.fake_scene import lens_scene
from analyses.fake_trace import EXTENT, trace_at
from command_line import Captured, Patch, fails, on_a_terminal, run, succeeds

import mistray.scene
from mistray import MistrayError, cli
from mistray.analyses.pst.progress import PstProgress
from mistray.analyses.pst.request import PstRequest
from mistray.cli import program
from mistray.cli.parsed_options import Options
from mistray.cli.progress import progress_bar, working
from mistray.report import read_irradiance
from mistray.toolkit.pages.model import Report
from mistray.trace import Settings

Calls = list[dict[str, Any]]


@pytest.fixture
def fake(monkeypatch: Patch) -> Calls:
    """Replaces scene, tracer and PST; notes the arguments of every call."""
    calls: Calls = []

    def trace(scene: Any, field_deg: float | None = None, progress: Any = None, **settings: Any) -> Any:
        calls.append({"field_deg": field_deg, **settings})
        return trace_at(field_deg or 0.0)

    def pst(scene: Any, request: PstRequest, *, progress: Any, **given: Any) -> Any:
        light = {name: list(value) for name, value in request.light.items()}
        calls.append(vars(request) | light | dict(request.settings) | given)
        return fake_pst(request.field_deg, request.azimuths_deg, map_pixels=request.map_pixels)

    importlib.import_module("mistray.analyses.study.run")  # or it would keep the ones below for other tests
    monkeypatch.setattr(importlib.import_module("mistray.analyses.ghosts.field_traces"), "trace", trace)
    monkeypatch.setattr(importlib.import_module("mistray.analyses.pst.run"), "run", pst)
    monkeypatch.setattr(mistray.scene, "load", lambda *given: lens_scene())
    return calls


OF_PARSERS = ("arguments", "command", "drawings.ray_choice", "field_options", "fields", "installed", "shared_options")
PACKAGE = Path(cli.__file__).parents[1]
# Of toolkit and analyses, what the parser of a command is made of
DECLARED = [(PACKAGE / "toolkit").joinpath(*name.split(".")).with_suffix(".py") for name in OF_PARSERS]
DECLARED += [file for name in ("command", "request") for file in PACKAGE.glob(f"analyses/*/{name}.py")]


@pytest.mark.parametrize(
    "file", [*sorted(PACKAGE.glob("cli/**/*.py")), *DECLARED], ids=lambda file: f"{file.parent.name}/{file.stem}"
)
def test_the_command_line_itself_imports_nothing_heavy(file: Path) -> None:
    """Analysis and Mitsuba are imported by the command that needs them, after libLLVM is settled."""
    names: set[str] = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            whole = re.fullmatch(r"mistray\.analyses\.\w+", node.module)  # of an analysis only modules
            names |= {f"{node.module}.{alias.name}" for alias in node.names} if whole else {node.module}
    heavy = {name for name in names if name.partition(".")[0] not in sys.stdlib_module_names}
    light = (
        "_libatomic _llvm _mitsuba_compat _variant entry_points errors interrupts known_arguments light named_values "
        "notes param percent ranges read_file replace_file settings supervisor time_budget"
    )
    allowed = {f"mistray.{name}" for name in light.split()} | {f"mistray.toolkit.{name}" for name in OF_PARSERS}
    declared = re.compile(r"mistray\.(cli\b.*|analyses\.\w+\.(command|request))")
    assert not {name for name in heavy if name not in allowed and not declared.fullmatch(name)}


def test_every_command_is_in_the_list_and_those_with_tables_have_formats() -> None:
    names = {
        file.parent.name if file.stem == "command" else file.stem
        for file in [*PACKAGE.glob("cli/commands/*.py"), *PACKAGE.glob("analyses/*/command.py")]
        if re.search(r"^COMMAND = ", file.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert {module.__name__.removesuffix(".command").rpartition(".")[2] for module in program.COMMANDS} == names
    for command in (module.COMMAND for module in program.COMMANDS):
        known = {option.dest for option in command.options}
        assert not known & set(dir(Options)), command.name  # no option hides what all commands do
        written = [pattern for option in command.options for pattern in option.writes or ()]
        assert any(pattern.endswith((".csv", ".*")) for pattern in written) == ("formats" in known), command.name


def test_version_and_module(capsys: Captured) -> None:
    done = subprocess.run([sys.executable, "-m", "mistray", "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, succeeds(capsys, "--version"))
    assert done.stdout.startswith("mistray ")


TREE = vectors.toml("settings.toml")


@pytest.mark.parametrize("command", ["ghosts", "pst"])
def test_every_setting_reaches_the_trace(capsys: Captured, fake: Calls, command: str) -> None:
    assert {setting.name for setting in fields(Settings)} == set(TREE)
    arguments = [text for key, value in TREE.items() for text in ("--" + key.replace("_", "-"), str(value))]
    several = ["--wavelength-nm", "450", "550", "650", "--weights", "1", "2", "1"]
    succeeds(capsys, command, "lens.xml", *arguments, *several, "--quiet")
    assert Settings(**{name: fake[0][name] for name in TREE}) == Settings(**TREE)
    assert (list(fake[0]["wavelength_nm"]), list(fake[0]["weights"])) == ([450.0, 550.0, 650.0], [1.0, 2.0, 1.0])


def test_formats_hold_what_was_traced(capsys: Captured, fake: Calls, tmp_path: Path, monkeypatch: Patch) -> None:
    """Maps to the last bit, but for the single precision of EXR; tables as those of CSV. The last line names a page."""
    ghosts_output = importlib.import_module("mistray.analyses.ghosts.page.output")
    monkeypatch.setattr(ghosts_output, "ghosts_report", lambda *_: Report("", "", []))
    monkeypatch.setattr(ghosts_output, "draw", lambda report, _: ({}, report))
    monkeypatch.setattr(importlib.import_module("mistray.analyses.pst.page"), "draw", lambda *_: {})
    out, wanted = tmp_path / "out", trace_at(0.0).irradiance
    command = ("ghosts", "lens.xml", "--field-deg", "0", "--out", out, "--formats", "parquet", "exr", "fits", "npy")
    assert succeeds(capsys, *command).splitlines()[-1].endswith(f"open {out / 'report.html'}")
    for ending in ("exr", "fits", "npy"):
        back = read_irradiance(out / f"irradiance_0deg.{ending}")
        assert np.array_equal(back.irradiance, wanted.astype(np.float32) if ending == "exr" else wanted)
        assert back.extent == EXTENT
        assert back.facts["field_deg"] == 0
    for name in ("paths", "energy", "surfaces", "summary"):
        table = pd.read_csv(out / f"{name}.csv", dtype={"path_ids": str})
        pd.testing.assert_frame_equal(pd.read_parquet(out / f"{name}.parquet"), table, check_dtype=False, rtol=1e-12)
    command = ("pst", "lens.xml", "--field-deg", "0:40:20", "--map-field-deg", "20", "--out", tmp_path / "pst")
    assert succeeds(capsys, *command, "--formats", "parquet", "fits", "--quiet") == ""
    assert fake[-1]["state"] == tmp_path / "pst" / "pst_state.npz"
    back = read_irradiance(tmp_path / "pst" / "irradiance_20deg.fits")
    value, se = fake_pst([0.0, 20.0, 40.0], map_pixels=64).irradiance(20.0)
    assert np.array_equal([back.irradiance, back.irradiance_se], [value, se], equal_nan=True)
    assert back.facts["source_W_mm2"] == 1.0
    assert len(pd.read_parquet(tmp_path / "pst" / "pst.parquet")) == 3
    assert (tmp_path / "pst" / "pst_paths.parquet").is_file()
    succeeds(capsys, "pst", "lens.xml", "--method", "forward", "--out", tmp_path / "forward", "--quiet")
    assert (fake[-1]["method"], fake[-1]["state"]) == ("forward", None)  # which saves nothing to go on from


DENIED = PermissionError(13, "Permission denied", "x.xml")


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (MistrayError("shape 'L1': no material;\n  add one"), "shape 'L1': no material; add one"),
        (RuntimeError("LLVM backend\nis not available"), "LLVM backend is not available"),
        (DENIED, "'x.xml': Permission denied; check the place, its permissions and its free space"),
        (MemoryError(), "out of memory; use fewer rays, fields or pixels"),
    ],
)
def test_errors_are_one_line(capsys: Captured, monkeypatch: Patch, error: BaseException, line: str) -> None:
    monkeypatch.setattr(mistray.scene, "load", Mock(side_effect=error))
    assert fails(capsys, "ghosts", "lens.xml") == line


def test_a_trace_that_fails_writes_nothing(capsys: Captured, fake: Calls, monkeypatch: Patch, tmp_path: Path) -> None:
    traces = importlib.import_module("mistray.analyses.ghosts.field_traces")
    monkeypatch.setattr(traces, "trace", Mock(side_effect=MistrayError("field 80 deg: no ray meets the lens")))
    fails(capsys, "ghosts", "lens.xml", "--out", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("within", [False, True])
def test_an_interrupt_before_all_is_saved(capsys: Captured, monkeypatch: Patch, tmp_path: Path, within: bool) -> None:
    """Also as Dr.Jit has it, as a RuntimeError; what another run has saved is none that --force goes on from."""
    error = RuntimeError("while_loop(): encountered an exception") if within else KeyboardInterrupt()
    error.__cause__ = KeyboardInterrupt() if within else None
    monkeypatch.setattr(mistray.scene, "load", Mock(side_effect=error))
    (tmp_path / "pst_state.npz").write_bytes(b"of another run")
    for command in (("ghosts", "lens.xml"), ("pst", "plate", "--out", tmp_path, "--force")):
        assert run(capsys, *command) == (130, "", "mistray: interrupted, nothing was written\n")


def test_a_real_scene_in_colour(capfd: Captured, tmp_path: Path) -> None:
    """The plate does not disperse: each line holds its share of every number."""
    out = tmp_path / "out"
    lines = ("--wavelength-nm", "450", "550", "650", "--weights", "1", "2", "1")
    options = ("--rays", "4000", "--out", out, "--json", "--per-wavelength", "--colour", "--stops", "1.5")
    (field,) = json_units.read(succeeds(capfd, "ghosts", "plate", *lines, *options))["fields"]
    parts = field["per_wavelength"]
    assert [part["wavelength_nm"] for part in parts] == [450.0, 550.0, 650.0]
    assert [part["share_of_flux"] for part in parts] == pytest.approx([0.25, 0.5, 0.25])
    assert [part["stray_W"] / field["stray_W"] for part in parts] == pytest.approx([0.25, 0.5, 0.25], rel=1e-4)
    assert all(abs(part["energy"]["closure"]) < 1e-5 for part in parts)
    assert field["paths_ghost"] == parts[0]["paths_ghost"]
    assert len(parts[1]["worst_paths"]) == len(field["worst_paths"])
    assert (out / "colour_0deg.png").is_file()


def test_what_takes_long_says_so_and_leaves_nothing_behind(monkeypatch: Patch) -> None:
    for stream, quiet in ((on_a_terminal(monkeypatch), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, "stderr", stream)
        with working("loading plate", quiet=quiet):
            time.sleep(0.2)
        with progress_bar(argparse.Namespace(quiet=quiet)) as progress:
            assert progress is None
        assert stream.getvalue() == ""
    terminal = on_a_terminal(monkeypatch)

    def fails() -> None:
        with working("loading phone_camera"):
            time.sleep(0.3)
            raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        fails()
    written = terminal.getvalue()
    assert "loading phone_camera … 00:00" in written
    assert written.rstrip(" ").endswith("\r")
    time.sleep(0.2)
    assert terminal.getvalue() == written


def test_the_bar_counts(monkeypatch: Patch) -> None:
    terminal = on_a_terminal(monkeypatch)
    with progress_bar(argparse.Namespace(quiet=False)) as progress:
        assert progress is not None
        progress(0.5, 2.0)
        progress(0.1, 2.0)  # a bar does not go back
        progress(0.6, 2.0)
        progress(2.0, 2.0)
    assert re.findall(r"(\d+)%", terminal.getvalue()) == ["0", "25", "25", "30", "100"]


def test_bars_say_at_once_what_is_done(monkeypatch: Patch) -> None:
    """Right after the start and after each other: the next step may take hours."""
    from mistray.analyses.pst import command as pst
    from mistray.analyses.study import command as study

    terminal, options = on_a_terminal(monkeypatch), Options(quiet=False)
    with study.bar(options) as progress:
        assert progress is not None
        progress(1, "checking", 0.0)
        progress(2, "finding objects", 0.1)
    assert "step 1 of 8, checking:   0%" in terminal.getvalue()
    assert "step 2 of 8, finding objects:  10%" in terminal.getvalue()
    for state, text in (
        (PstProgress(0, 4000, math.inf, 0.02, 60.0, math.nan), "the pilot is done"),
        (PstProgress(1000, 4000, math.inf, None, 60.0, 7265.0), "no light yet at some angles, 2:01:05 left"),
        (PstProgress(1000, 4000, 0.031, 0.02, 60.0, 83.0), "error 3.1 % of 2 %, 01:23 left"),
        (PstProgress(1000, 4000, math.nan, None, 60.0, 9.0), "| 00:00, 00:09 left"),  # no error is known
    ):
        with pst._progress(options, []) as draw:
            draw(state)
        assert text in terminal.getvalue()
    assert "tracing:  25%" in terminal.getvalue()
    # What an interrupt of the measurement with one more event leaves is the first one
    first, more = (PstProgress(rays, rays, 0.03, None, 60.0, 0.0) for rays in (4000, 500))
    assert pst._so_far([first, more]) == "4e+03 start rays, worst error 3 %, are"

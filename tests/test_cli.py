"""The command line: arguments, one-line errors, exit codes, files."""

import ast
import importlib
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import json_units
import pytest
from report.fake_scene import lens_scene
from report.fake_trace import trace_at

import mistray.scene
import mistray.scenes
from mistray import cli
from mistray.cli import program
from mistray.cli.options import Options
from mistray.errors import MistrayError
from mistray.trace import Settings


def run(capsys, *arguments):
    """Exit code, stdout and stderr of one command in this process."""
    code = cli.main(arguments)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def fails(capsys, *arguments):
    """The one line that a command with bad input prints."""
    code, out, err = run(capsys, *arguments)
    assert code == 2
    assert out == ""
    assert err.startswith("mistray: error: ")
    assert err.count("\n") == 1
    return err.strip().removeprefix("mistray: error: ")


@pytest.fixture
def fake(monkeypatch):
    """Replaces scene and tracer; notes the arguments of every trace."""
    calls = []

    def trace(scene, field_deg=None, progress=None, **settings):
        calls.append({"field_deg": field_deg, **settings})
        return trace_at(field_deg or 0.0)

    monkeypatch.setattr(importlib.import_module("mistray.analysis.field_traces"), "trace", trace)
    monkeypatch.setattr(mistray.scene, "load", lambda *given: lens_scene())
    return calls


def test_help_of_every_command_has_an_example(capsys):
    commands = program._parser()._subparsers._group_actions[0].choices
    assert len(commands) == len(program.COMMANDS)
    for arguments in ((), *((name,) for name in commands)):
        code, out, err = run(capsys, *arguments, "--help")
        assert code == 0
        assert "example" in out
        assert err == ""


@pytest.mark.parametrize("file", sorted(Path(cli.__file__).parent.rglob("*.py")), ids=lambda file: file.stem)
def test_the_command_line_itself_imports_nothing_heavy(file):
    """Analysis and Mitsuba are imported by the command that needs them, after libLLVM is settled."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    names = set()
    for node in tree.body:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module)
    heavy = {name for name in names if name.partition(".")[0] not in sys.stdlib_module_names}
    names_of = (
        "errors",
        "interrupts",
        "notes",
        "param",
        "percent",
        "ranges",
        "read_file",
        "renamed",
        "replace_file",
        "settings",
        "supervisor",
        "time_budget",
    )
    light = tuple(f"mistray.{name}" for name in names_of)
    assert not {name for name in heavy if name not in light and not name.startswith("mistray.cli")}


def test_every_command_is_in_the_list():
    files = Path(cli.__file__).parent.rglob("*.py")
    commands = {file.stem for file in files if "\nCOMMAND = Command(" in file.read_text(encoding="utf-8")}
    assert {module.__name__.rpartition(".")[2] for module in program.COMMANDS} == commands


def test_no_option_hides_what_all_commands_do():
    for module in program.COMMANDS:
        assert not {option.dest for option in module.COMMAND.options} & set(dir(Options)), module.COMMAND.name


def test_version(capsys):
    code, out, _ = run(capsys, "--version")
    assert code == 0
    assert out.startswith("mistray ")


def test_module_is_the_command():
    done = subprocess.run([sys.executable, "-m", "mistray", "--version"], capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stdout.startswith("mistray ")


def test_ghosts_prints_the_main_table(capsys, fake):
    code, out, err = run(capsys, "ghosts", "lens.xml", "--field-deg", "0", "10", "--rays", "2e3")
    assert code == 0
    assert err == ""
    assert "detector → L1_rear" in out
    assert [call["field_deg"] for call in fake] == [0.0, 10.0]
    assert fake[0]["rays"] == 2000


def test_ghosts_passes_every_option_on(capsys, fake):
    options = {
        "azimuth_deg": 30.0,
        "rays": 1000,
        "max_reflections": 4,
        "max_scatters": 3,
        "max_optical_scatters": 2,
        "max_random_scatters": 1,
        "max_generations": 5,
        "max_events": 20,
        "max_consecutive": 9,
        "max_segments": 5000,
        "scatter_rays": 2,
        "aimed_rays": 7,
        "aim": "targets",
        "flux_threshold": 1e-6,
        "cut_below": "R=1e-6, t=1e-9, A=1e-12",
        "cut_below_W": "T=1e-3",
        "scatter_threshold": 1e-3,
        "splitting": "one",
        "below_threshold": "roulette",
        "seed": 5,
        "ray_control": "reflect_specular",
        "polarization": "stokes",
    }
    assert {setting.name for setting in fields(Settings)} == set(options) - {"azimuth_deg"}
    arguments = [text for key, value in options.items() for text in ("--" + key.replace("_", "-"), str(value))]
    several = ("--wavelength-nm", "450", "550", "650", "--weights", "1", "2", "1")
    code, _, _ = run(capsys, "ghosts", "lens.xml", *arguments, *several)
    assert code == 0
    spectrum = {"wavelength_nm": [450.0, 550.0, 650.0], "weights": [1.0, 2.0, 1.0]}
    assert fake[0] == {"field_deg": None, **options, **spectrum}


def test_ghosts_writes_its_files(capsys, fake, tmp_path):
    out = tmp_path / "out"
    code, text, _ = run(capsys, "ghosts", "lens.xml", "--out", str(out))
    assert code == 0
    assert (out / "report.html").is_file()
    assert f"mistray ghosts lens.xml --out {out}" in (out / "report.html").read_text()
    assert str(out / "report.html") in text


def test_json_is_json(capsys, fake):
    code, out, _ = run(capsys, "ghosts", "lens.xml", "--field-deg", "0", "20", "--json")
    answer = json_units.read(out)
    assert code == 0
    assert [field["field_deg"] for field in answer["fields"]] == [0.0, 20.0]
    assert answer["fields"][1]["ghost_to_signal"] is None
    worst = answer["fields"][0]["worst_paths"][0]
    assert worst["label"] == "detector → L1_rear"
    assert worst["power_se_W"] > 0
    verdict = answer["verdict"]
    assert verdict["remedy"]["percent_of_stray"] <= 100
    assert any(verdict["remedy"]["surface"] in text for text in verdict["sentences"])
    assert [left["field_deg"] for left in verdict["remedy"]["left"]] == [0.0, 20.0]


def test_quiet_is_quiet(capsys, fake):
    assert run(capsys, "ghosts", "lens.xml", "--quiet") == (0, "", "")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "the following arguments are required: COMMAND; see 'mistray --help'"),
        (("goats", "x"), "invalid choice: 'goats'"),
        (("ghosts",), "the following arguments are required: SCENE; see 'mistray ghosts --help'"),
        (("ghosts", "x", "--rays", "many"), "argument --rays: 'many' is not a number"),
        (
            ("ghosts", "x", "--rays", "1.5"),
            "argument --rays: 1.5 must be a whole number between 1 and 4294967295",
        ),
        (("ghosts", "x", "--field-deg", "95"), "argument --field-deg: 95 must lie between -90 and 90 degrees"),
        (("ghosts", "x", "--wavelength-nm", "0"), "argument --wavelength-nm: 0 must lie between 10 and 1e7 nm"),
        (("ghosts", "x", "--flux-threshold", "nan"), "argument --flux-threshold: 'nan' is not a number"),
        (("ghosts", "x", "--splitting", "some"), "argument --splitting: invalid choice: 'some'"),
        (
            ("ghosts", "x", "--wavelength-nm", "450", "550", "--weights", "1"),
            "--weights has 1 values for 2 of --wavelength-nm; give one weight for each wavelength",
        ),
        (("ghosts", "x", "--weights", "1"), "--weights without --wavelength-nm; give one wavelength for each weight"),
        (("ghosts", "x", "--stops", "2"), "--stops is about colour pictures; add --colour, or leave it out"),
        (("ghosts", "x", "--colour"), "--colour draws pictures; say with --out where they shall go"),
        (("ghosts", "x", "--polarization", "linear"), "argument --polarization: invalid choice: 'linear'"),
        (("ghosts", "x", "--depth", "2"), "unrecognized arguments: --depth 2"),
        (("import", "no_such_lens.json"), "lens 'no_such_lens.json': No such file or directory; check the path"),
    ],
)
def test_wrong_arguments(capsys, arguments, message):
    assert message in fails(capsys, *arguments)


def test_wrong_output_directory_is_found_before_the_trace(capsys, fake, tmp_path):
    (tmp_path / "out").write_text("")
    assert "is a file; name a directory" in fails(capsys, "ghosts", "lens.xml", "--out", str(tmp_path / "out"))
    assert fake == []


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (MistrayError("shape 'L1': no material;\n  add one"), "shape 'L1': no material; add one"),
        (RuntimeError("LLVM backend\nis not available"), "LLVM backend is not available"),
        (
            PermissionError(13, "Permission denied", "x.xml"),
            "'x.xml': Permission denied; check the place, its permissions and its free space",
        ),
        (MemoryError(), "out of memory; use fewer rays, fields or pixels"),
    ],
)
def test_errors_are_one_line(capsys, fake, monkeypatch, error, line):
    def load(source, *others):
        raise error

    monkeypatch.setattr(mistray.scene, "load", load)
    assert fails(capsys, "ghosts", "lens.xml") == line


def test_nothing_is_written_when_the_trace_fails(capsys, fake, monkeypatch, tmp_path):
    def trace(*_, **__):
        raise MistrayError("field 80 deg: no ray meets the lens; choose a smaller field")

    monkeypatch.setattr(importlib.import_module("mistray.analysis.field_traces"), "trace", trace)
    fails(capsys, "ghosts", "lens.xml", "--out", str(tmp_path / "out"))
    assert list(tmp_path.iterdir()) == []


def test_interrupt(capsys, fake, monkeypatch):
    def load(source, *others):
        raise KeyboardInterrupt

    monkeypatch.setattr(mistray.scene, "load", load)
    code, out, err = run(capsys, "ghosts", "lens.xml")
    assert (code, out, err) == (130, "", "mistray: interrupted, nothing was written\n")


def test_doctor_answers_in_json(capsys, monkeypatch):
    from mistray import doctor

    monkeypatch.setattr(doctor, "report", lambda: [doctor.Check("mitsuba", "ok", "3.9.1")])
    code, out, _ = run(capsys, "doctor", "--json")
    assert code == 0
    assert json_units.read(out)["checks"][0]["name"] == "mitsuba"


@pytest.fixture
def lens(tmp_path):
    path = tmp_path / "lens.json"
    path.write_text("{}")
    return path


def test_import_writes_a_scene_that_loads(capsys, tmp_path):
    lens = Path(mistray.scenes.__file__).parent / "phone_camera" / "prescription.json"
    output = tmp_path / "a.xml"
    code, out, _ = run(capsys, "import", str(lens), "-o", str(output), "--wavelength-nm", "600")
    scene = mistray.scene.load(output)
    assert code == 0
    assert f"{output}: {len(scene.shapes())} surfaces; next: mistray ghosts {output}" in out
    assert list(scene.emitters()[0].wavelengths_nm) == [600.0]


def test_import_knows_the_variants_of_the_file(capsys, tmp_path):
    lens = Path(mistray.scenes.__file__).parent / "phone_camera" / "prescription.json"
    line = fails(capsys, "import", str(lens), "-o", str(tmp_path / "a.xml"), "--variant", "nope")
    assert "variant 'nope' is unknown; it has R13=5.272" in line


def test_import_of_batoid(capsys, tmp_path):
    batoid = pytest.importorskip("batoid")
    lens = Path(batoid.datadir) / "LSST" / "LSST_r.yaml"
    code, _, _ = run(capsys, "import", str(lens), "-o", str(tmp_path / "a.xml"), "--wavelength-nm", "620")
    assert code == 0
    assert (tmp_path / "a.xml").is_file()


def test_import_that_fails_leaves_nothing(capsys, monkeypatch, lens, tmp_path):
    def broken(prescription):
        raise MistrayError("surface 'L1': no material; give one")

    monkeypatch.setattr("mistray.prescription.scene_file.xml_text", broken)
    fails(capsys, "import", str(lens), "-o", str(tmp_path / "a.xml"))
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["lens.json"]


def test_import_names_the_types_it_reads(capsys, tmp_path):
    path = tmp_path / "lens.osl"
    path.write_text("")
    assert "files of type '.osl' cannot be read; give one of .json, .yaml" in fails(capsys, "import", str(path))


def test_import_of_batoid_needs_a_wavelength_and_no_variant(capsys, tmp_path):
    path = tmp_path / "lens.yaml"
    path.write_text("")
    assert "give --wavelength-nm" in fails(capsys, "import", str(path))
    message = fails(capsys, "import", str(path), "--wavelength-nm", "620", "--variant", "b")
    assert "batoid files hold no variants; leave it out" in message


@pytest.fixture(scope="module")
def plate():
    return (Path(mistray.scenes.__file__).parent / "plate" / "scene.xml").read_text(encoding="utf-8")


def without(text, tag):
    return re.sub(rf"<{tag}\b.*?</{tag}>", "", text, flags=re.DOTALL)


@pytest.mark.parametrize(
    ("damage", "parts"),
    [
        (lambda text: text[: len(text) // 2], ["scene.xml', line ", "broken XML"]),
        (lambda text: text.replace('type="asphere"', 'type="aspherical"', 1), ["there is no plugin 'aspherical'"]),
        (lambda text: text.replace('name="semi_diameter"', 'name="half_diameter"', 1), ["shape 'plate_front'"]),
        (
            lambda text: re.sub(r'(name="semi_diameter" value=")', r"\1-", text, count=1),
            ["shape 'plate_front': semi_diameter is -", "must lie between"],
        ),
        (lambda text: without(text, "sensor"), ["no detector"]),
        (lambda text: without(text, "emitter"), ["no source"]),
    ],
    ids=["broken XML", "unknown plugin", "unknown parameter", "negative size", "no detector", "no source"],
)
def test_bad_scenes_are_one_line(capfd, tmp_path, plate, damage, parts):
    """`capfd` sees what Mitsuba itself writes, too."""
    path = tmp_path / "scene.xml"
    path.write_text(damage(plate))
    line = fails(capfd, "ghosts", str(path), "--rays", "100", "--out", str(tmp_path / "out"))
    assert all(part in line for part in parts)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("platte",), ["scene 'platte': no such file", "such as plate"]),
        (("plate", "--rays", "0"), ["--rays: 0 must"]),
        (("plate", "--flux-threshold", "2"), ["--flux-threshold: 2 must"]),
        (("plate", "--wavelength-nm", "550", "550"), ["give every wavelength once"]),
        (("plate", "--wavelength-nm", "450", "550", "--weights", "0", "0"), ["weights are", "give one above 0"]),
        (("plate", "--colour", "--out", "no_such_folder"), ["1 wavelength (550 nm)", "needs at least 3"]),
        (
            ("plate", "--colour", "--out", "no_such_folder", "--wavelength-nm", "450", "550", "900"),
            ["900 nm is not visible"],
        ),
        (("plate", "--variant", "scalar_rgb"), ["variant 'scalar_rgb' cannot run the ray tree"]),
        (("plate", "--threads", "0"), ["--threads: 0 must be a whole number"]),
        (("plate", "--variant", "cuda_ad_spectral_mono"), ["variant 'cuda_ad_spectral_mono'"]),
    ],
)
def test_bad_settings_are_one_line(capfd, arguments, parts):
    line = fails(capfd, "ghosts", *arguments)
    assert all(part in line for part in parts)


def test_a_real_scene(capfd, tmp_path):
    """The plate between air: R² ghost of 2 rays of light, and a report."""
    out = tmp_path / "out"
    code, text, err = run(capfd, "ghosts", "plate", "--rays", "2000", "--out", str(out), "--json")
    answer = json_units.read(text)
    assert (code, err) == (0, "")
    assert abs(answer["fields"][0]["energy"]["closure"]) < 1e-5
    assert answer["fields"][0]["paths_direct"] == 1
    assert answer["fields"][0]["paths_ghost"] > 0
    assert {Path(file).name for file in answer["files"]} == {file.name for file in out.iterdir()}
    assert "<title>Ghost analysis: plate</title>" in (out / "report.html").read_text(encoding="utf-8")


def test_a_real_scene_in_colour(capfd, tmp_path):
    """The plate does not disperse: each line holds its share of every number."""
    out = tmp_path / "out"
    lines = ("--wavelength-nm", "450", "550", "650", "--weights", "1", "2", "1")
    options = ("--rays", "4000", "--out", str(out), "--json", "--per-wavelength", "--colour", "--stops", "1.5")
    code, text, err = run(capfd, "ghosts", "plate", *lines, *options)
    answer = json_units.read(text)
    (field,) = answer["fields"]
    parts = field["per_wavelength"]
    assert (code, err) == (0, "")
    assert [part["wavelength_nm"] for part in parts] == [450.0, 550.0, 650.0]
    assert [part["share_of_flux"] for part in parts] == pytest.approx([0.25, 0.5, 0.25])
    assert [part["stray_W"] / field["stray_W"] for part in parts] == pytest.approx([0.25, 0.5, 0.25], rel=1e-4)
    assert all(abs(part["energy"]["closure"]) < 1e-5 for part in parts)
    assert field["paths_ghost"] == parts[0]["paths_ghost"]
    assert len(parts[1]["worst_paths"]) == len(field["worst_paths"])
    assert (out / "colour_0deg.png").is_file()


def test_a_reader_that_stops_reading_is_no_error():
    command = f"{sys.executable} -m mistray ghosts plate --rays 1000 --json | true"
    done = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert done.stderr == ""

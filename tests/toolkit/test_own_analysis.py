"""An analysis of another distribution, as docs/extending.md has it: function, command, files, completion."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import mitsuba as mi
import pytest
from refusals import refused

from mistray._variant import ensure_variant, plugins_of_others, use_plugins
from mistray.scatter import kinds

ROOT = Path(__file__).parents[2]
MOST_LINES = 120
ENGINE = ("kernel", "recorders", "sampling", "execute", "trace", "surfaces", "gradients")
# Without the finder of an editable install, which looks into the checkout
ALONE = "import sys; sys.meta_path[:] = [f for f in sys.meta_path if 'editable' not in str(f).lower()]; "


def folder_of_the_page(place: Path) -> Path:
    """The folder `losses` below a place, with the entry point of a distribution beside it."""
    page = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    files = dict(re.findall(r'^```python title="losses/(.+?)"\n(.*?)^```', page, re.MULTILINE | re.DOTALL))
    folder = place / "losses"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text('"""Light that surfaces absorb."""\n', encoding="utf-8")
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    entry(place, "losses")
    return folder


def entry(place: Path, package: str, group: str = "mistray.analyses", module: str = "") -> None:
    """An entry point that names a package, or a module of it, as an installed distribution has it."""
    info = place / f"{package}-1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(f"[{group}]\n{package} = {module or package}\n", encoding="utf-8")


def mistray(place: Path, *words: str, code: int = 0) -> str:
    path = os.pathsep.join([str(place), str(ROOT)])
    run = [sys.executable, "-m", "mistray", *words]
    done = subprocess.run(run, cwd=place, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    return done.stderr if code else done.stdout


def test_a_folder_of_another_distribution(tmp_path: Path) -> None:
    folder = folder_of_the_page(tmp_path)
    assert sum(len(file.read_text().splitlines()) for file in folder.glob("*.py")) <= MOST_LINES
    assert "losses" in mistray(tmp_path, "--help")
    assert "--least" in mistray(tmp_path, "losses", "--help")
    assert "--least" in mistray(tmp_path, "completion", "bash")
    words = ("losses", "double_gauss", "--rays", "1000")
    found = json.loads(mistray(tmp_path, *words, "--json"))
    assert {row["surface"] for row in found["losses"]} >= {"barrel_face", "stop_front"}
    assert all(row["power_W_se"] >= 0 for row in found["losses"])
    out = tmp_path / "out"
    mistray(tmp_path, *words, "--out", str(out), "--formats", "parquet")
    names = {file.name for file in out.iterdir()}
    assert names >= {"report.html", "losses.csv", "losses.json", "losses.parquet", "absorbed.png"}
    assert (out / "losses.csv").read_text().splitlines()[0] == "surface,power_W,power_W_se"
    assert "argument --least: 2 must" in mistray(tmp_path, *words, "--least", "2", code=2)


def test_its_result_in_a_session(tmp_path: Path) -> None:
    folder_of_the_page(tmp_path)
    code = "import mistray; from losses.run import losses; r = losses(mistray.load('double_gauss'), rays=1000)\n"
    code += "print(repr(r)); print(r._repr_html_()); print(type(r.plot()).__name__)"
    path = os.pathsep.join([str(tmp_path), str(ROOT)])
    env = {**os.environ, "PYTHONPATH": path, "MPLBACKEND": "agg"}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    line, *html, axes = done.stdout.splitlines()
    assert re.fullmatch(r"Losses\(double_gauss, \d+ surfaces, .* W\)", line)
    assert "absorbed power [W]" in "".join(html)
    assert axes == "Axes"


@pytest.mark.quick
def test_a_package_that_cannot_be_imported_is_named_and_left_out(tmp_path: Path) -> None:
    entry(tmp_path, "no_such_package")
    assert "ghosts" in mistray(tmp_path, "--help")
    told = mistray(tmp_path, "ghosts", "no_such_scene", code=2)
    assert "analysis 'no_such_package' is left out" in told
    assert "Traceback" not in told


@pytest.mark.parametrize("gone", ["thermal", ""])
def test_a_command_goes_with_its_folder(tmp_path: Path, gone: str) -> None:
    """Without one analysis, and without any, the rest is there; a name that has gone is one line."""
    shutil.copytree(ROOT / "mistray", tmp_path / "mistray", ignore=shutil.ignore_patterns("__pycache__"))
    for package in ("plugins", "scenes"):
        (tmp_path / "mistray" / package).symlink_to(ROOT / package)
    shutil.rmtree(tmp_path / "mistray" / "analyses" / gone)

    def run(code: str) -> tuple[str, str]:
        command = [sys.executable, "-c", ALONE + code]
        env = {**os.environ, "PYTHONPATH": str(tmp_path)}
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)
        return done.stdout, done.stderr

    told, _ = run("from mistray.cli import main; main(['--help'])")
    assert "thermal" not in told
    assert ("\n    ghosts " in told) == bool(gone)
    assert "doctor" in told
    code = "import mistray; print(mistray.trace(mistray.load('plate'), rays=100).energy.launched_W); mistray.thermal"
    launched, error = run(code)
    assert float(launched) > 0
    assert error.splitlines()[-1].startswith("AttributeError: mistray.thermal: mistray.analyses")


@pytest.mark.long
def test_the_engine_does_not_need_analyses(tmp_path: Path) -> None:
    """Its quick tests in a checkout without any analysis: only those fail that call an analysis themselves."""
    ignored = shutil.ignore_patterns("__pycache__", "analyses", "plugins", "scenes")
    shutil.copytree(ROOT / "mistray", tmp_path / "mistray", ignore=ignored)
    shutil.copytree(ROOT / "tests", tmp_path / "tests", ignore=shutil.ignore_patterns("__pycache__", "analyses"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    for package in ("plugins", "scenes"):
        (tmp_path / package).symlink_to(ROOT / package)
        (tmp_path / "mistray" / package).symlink_to(ROOT / package)
    command = [sys.executable, "-c", f"{ALONE}import pytest; sys.exit(pytest.main())", "-q", "-p", "no:cacheprovider"]
    command += ["--continue-on-collection-errors", "--junitxml=found.xml", "-m", "not (gpu or slow or long)"]
    command += [f"tests/{name}" for name in ENGINE]
    env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, check=False)
    cases = list(ElementTree.parse(tmp_path / "found.xml").getroot().iter("testcase"))
    wrong = {case.get("name"): one.text or "" for case in cases for one in case if one.tag in ("failure", "error")}
    calls = re.compile(r"mistray\.analyses|cannot import name 'pst' from 'mistray'|invalid choice: 'ghosts'")
    assert [name for name, text in wrong.items() if not calls.search(text)] == []
    assert len(wrong) < 0.06 * len(cases)


TEMPLATE = ROOT / "examples" / "scatter_package"
PLUGINS = "cosine_power.plugins"


@pytest.mark.long
def test_plugins_of_another_distribution(tmp_path: Path) -> None:
    """The template's entry point makes its scatter model one of the command line, with its parameters as options."""
    point = '[project.entry-points."mistray.plugins"]\ncosine_power = "cosine_power.plugins"'
    assert point in (TEMPLATE / "pyproject.toml").read_text(encoding="utf-8")
    shutil.copytree(TEMPLATE / "cosine_power", tmp_path / "cosine_power")
    entry(tmp_path, "cosine_power", "mistray.plugins", PLUGINS)
    assert "--power" in mistray(tmp_path, "bsdf", "--help")
    found = json.loads(mistray(tmp_path, "bsdf", "cosine_power", "--total", "0.3", "--json"))
    assert found["totals"][0]["incidence_deg"] == 0
    assert found["totals"][0]["scattered"] == pytest.approx(0.3, rel=1e-3)
    scatter = "barrel*=cosine_power total=0.3"
    traced = ("ghosts", "cooke_triplet", "--rays", "1000", "--max-scatters", "1", "--json")
    assert "barrel_face" in mistray(tmp_path, *traced, "--scatter", scatter)
    # A package that is broken takes nothing else down
    (tmp_path / "cosine_power" / "plugins.py").write_text("import no_such_module\n", encoding="utf-8")
    assert json.loads(mistray(tmp_path, *traced))
    told = mistray(tmp_path, *traced, "--scatter", scatter, code=2)
    assert f"plugins '{PLUGINS}' cannot be imported" in told
    assert "Traceback" not in told


def test_named_modules_of_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(TEMPLATE))
    monkeypatch.setenv("MISTRAY_PLUGINS", "")
    monkeypatch.setattr(kinds, "_known", dict(kinds._known))
    ensure_variant()
    use_plugins([PLUGINS])
    surface = mi.load_dict({"type": "interface", "R": 0.9, "haze": {"type": "cosine_power", "total": 0.3}})
    assert "cosine_power.total" in mi.traverse(surface)
    assert plugins_of_others() == {PLUGINS: True}
    with refused("plugins 'no.such' cannot be imported", "PYTHONPATH"):
        use_plugins(["no.such"])


def test_a_model_needs_a_name_of_its_own() -> None:
    kinds.add_kind("abg", kinds.KINDS["abg"])
    with refused("scatter model 'abg'", "rename it"):
        kinds.add_kind("abg", kinds.KINDS["paint"])

"""The variant is one that can trace, and every plugin follows it."""

import os
import re
import subprocess
import sys
from pathlib import Path
from textwrap import dedent
from types import SimpleNamespace

import pytest
from refusals import refused

from mistray import _llvm, _mitsuba_compat, _variant

ROOT = Path(__file__).parents[1]


def run_python(code: str, *arguments: str, **environment: str | None) -> subprocess.CompletedProcess[str]:
    variables = {**os.environ, "MISTRAY_VARIANT": None, "DRJIT_LIBLLVM_PATH": None, **environment}
    return subprocess.run(
        [sys.executable, "-c", dedent(code), *arguments],
        env={key: value for key, value in variables.items() if value is not None},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.parametrize(
    ("before", "environment", "argument", "expected"),
    [
        ("", {"MISTRAY_VARIANT": "llvm_ad_spectral"}, "", "llvm_ad_spectral"),
        ("", {"MISTRAY_VARIANT": "llvm_ad_spectral"}, "'llvm_ad_mono'", "llvm_ad_mono"),
        ("mi.set_variant('llvm_ad_mono')", {"MISTRAY_VARIANT": "llvm_ad_spectral"}, "", "llvm_ad_mono"),
        ("mi.set_variant('scalar_rgb')", {}, "", "variant 'scalar_rgb' cannot run the ray tree"),
        ("", {"MISTRAY_VARIANT": "scalar_rgb"}, "", "variant 'scalar_rgb' cannot run the ray tree"),
        ("", {}, "'llvm_rgb'", "variant 'llvm_rgb' is not part of Mitsuba"),
    ],
)
def test_choice_of_the_variant(before, environment, argument, expected):
    run = run_python(
        f"""
        if {before!r}:
            import os
            os.environ["DRJIT_LIBLLVM_PATH"] = {_llvm.find_llvm().path!r}
            import mitsuba as mi
            {before or "pass"}
        try:
            from mistray._variant import ensure_variant
            print(ensure_variant({argument}))
        except ValueError as error:
            print(error)
        """,
        **environment,
    )
    assert run.stdout.startswith(expected), run.stdout + run.stderr


@pytest.mark.parametrize(
    ("variant", "held", "message"),
    [
        ("llvm_ad_rgb", (15, 0, 6), r"imported with LLVM 15\.0\.6 and needs version 17 or newer"),
        ("llvm_ad_rgb", (), "imported with no LLVM"),
        ("cuda_ad_rgb", (), "no NVIDIA GPU"),
    ],
)
def test_backends_and_releases_that_cannot_run(monkeypatch, variant, held, message):
    import drjit as dr

    monkeypatch.setattr(dr, "has_backend", lambda backend: bool(held))
    monkeypatch.setattr(dr, "detail", SimpleNamespace(llvm_version=lambda: held))
    with refused(message):
        _variant._require_backend(variant)
    _mitsuba_compat.check_release("3.9.1")
    for version in ("3.8.0", "3.10.0", "3.90.1", "4.0.0"):
        with refused(rf"mitsuba {version} is installed .* pip install"):
            _mitsuba_compat.check_release(version)


MISSING = "try:\n    raise ImportError('libatomic.so.1: no such file')\nexcept ImportError:\n    _drjit_ext"
IMPORT = """
    try:
        from mistray._mitsuba_compat import import_mitsuba
        import_mitsuba()
    except ValueError as error:
        print(error)
"""


@pytest.mark.parametrize(
    ("module", "remedy"),
    [
        (MISSING, "libatomic1"),
        ("raise ImportError('drjit is of another version')", "pip install --force-reinstall 'mitsuba=="),
    ],
)
def test_mitsuba_that_cannot_be_imported(tmp_path, module, remedy):
    (tmp_path / "mitsuba.py").write_text(module)
    run = run_python(IMPORT, PYTHONPATH=str(tmp_path))
    assert run.stdout.startswith("mitsuba cannot be imported ("), run.stderr
    assert remedy in run.stdout


def test_every_plugin_file_is_found_and_named_after_its_plugin():
    files = [file for file in ROOT.glob("plugins/*/*.py") if file.stem != "__init__"]
    assert set(_variant.plugin_modules()) == {f"mistray.plugins.{file.parent.name}.{file.stem}" for file in files}
    for file in files:
        names = re.findall(r'^ *mi\.register_\w+\(\s*"(\w+)"', file.read_text(), re.MULTILINE)
        assert file.stem.startswith("_") or names in ([], [file.stem])


def test_other_variants_have_no_plugins():
    """LLVM is chosen before Mitsuba is imported, in a variant that can trace; then another one is."""
    run = run_python(
        """
        import warnings
        from mistray._variant import ensure_variant
        ensure_variant()
        import drjit as dr, mitsuba as mi
        x = dr.arange(mi.Float, 8)
        print(mi.variant(), dr.detail.llvm_version()[0] >= 17, dr.sum(dr.maximum(dr.minimum(x, 4), 2))[0])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            mi.set_variant("scalar_rgb")
        print(caught[0].message)
        """
    )
    message = (
        "mistray: no plugins in variant 'scalar_rgb', the ray tree needs a JIT variant; "
        "call mi.set_variant('llvm_ad_rgb')"
    )
    assert run.stdout == f"llvm_ad_rgb True 25.0\n{message}\n", run.stderr


@pytest.mark.long
@pytest.mark.parametrize(
    ("steps", "told"),
    [
        ("mi.set_variant('llvm_ad_rgb'); import mistray.plugins", 0),
        ("import mistray.plugins", 0),
        ("import mistray.plugins; mi.set_variant('llvm_ad_mono')", 0),
        ("mi.set_variant('llvm_ad_spectral_polarized'); from mistray import plugins", 0),
        ("mi.set_variant('scalar_rgb'); import mistray.plugins; mi.set_variant('llvm_ad_rgb')", 1),
        ("mi.set_variant('scalar_rgb'); import mistray; mi.set_variant('llvm_ad_rgb')", 0),
    ],
)
def test_an_import_registers_in_any_order(steps: str, told: int) -> None:
    lens = {"type": "asphere", "semi_diameter": 1.0, "bsdf": {"type": "interface"}}
    run = run_python(
        f"import mitsuba as mi\n{steps}\nprint(mi.load_dict({{'type': 'scene', 'lens': {lens}}}).shapes()[0].bsdf())",
        DRJIT_LIBLLVM_PATH=_llvm.find_llvm().path,
    )
    assert run.stdout == "Interface[air | air, Fresnel]\n", run.stderr
    assert run.stderr.count("no plugins in variant 'scalar_rgb'") == told


def test_threads() -> None:
    """The number that Dr.Jit uses; with one all work is the calling thread's, and results stay what they are."""
    code = """
        import os
        import drjit as dr
        import mistray
        scene = mistray.load("plate")
        for count in (os.cpu_count(), 1):
            mistray.set_threads(count)
            print(dr.thread_count(), float(mistray.trace(scene, rays=300_000).energy.detected_W))
    """
    words = run_python(code).stdout.split()
    assert words[::2] == [str(os.cpu_count()), "1"]
    assert float(words[1]) == pytest.approx(float(words[3]), rel=1e-12)
    for count in (0, -1, 1.5, True, 1025):
        with refused(f"threads is {count}; it must be a whole number between"):
            _variant.set_threads(count)

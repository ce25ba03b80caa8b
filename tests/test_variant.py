"""libLLVM is settled before Mitsuba is imported, the variant is one that can trace, and every plugin follows it."""

from __future__ import annotations

import ast
import glob
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from types import SimpleNamespace

import pytest

from mistray import _mitsuba_compat, _variant
from mistray.errors import MistrayError

ROOT = Path(__file__).parents[1]


def run_python(code: str, *arguments: str, **environment: str | None) -> subprocess.CompletedProcess[str]:
    """Run code in a fresh interpreter; None removes a variable from its environment."""
    variables = {**os.environ, "MISTRAY_VARIANT": None, "DRJIT_LIBLLVM_PATH": None, **environment}
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *arguments],
        env={key: value for key, value in variables.items() if value is not None},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.parametrize(
    ("path", "version"),
    [
        ("/opt/elsewhere/libLLVM-15.so.1", (15,)),
        ("/opt/elsewhere/libLLVM-14.0.6.so.1", (14, 0, 6)),
        ("/opt/elsewhere/libLLVM.so.19.1", (19, 1)),
        ("/opt/conda/lib/libLLVM.19.1.dylib", (19, 1)),
        ("/opt/homebrew/Cellar/llvm/21.1.2/lib/libLLVM.dylib", (21, 1, 2)),
        ("/opt/homebrew/Cellar/llvm@18/18.1.8/lib/libLLVM.dylib", (18,)),
        ("/usr/lib64/llvm17/lib64/libLLVM.so", (17,)),
        ("/opt/elsewhere/libLLVM.so", None),
    ],
)
def test_version_from_the_name(path, version):
    assert _variant._named_version(path) == version


def test_search_takes_the_newest_that_loads(monkeypatch):
    versions = {
        "/a/libLLVM-15.so.1": None,
        "/b/libLLVM-17.so.1": (17, 0, 6),
        "/c/libLLVM.so.19.1": (19, 1, 7),
        "/d/libLLVM.so.21.1": OSError("wrong ELF class"),
        "/e/libLLVM.so.99.1": (99, 1, 0),
        "/f/libLLVM.so": None,
    }

    def loaded(path):
        if isinstance(versions[path], OSError):
            raise versions[path]
        return versions[path]

    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(_variant, "_loaded_version", loaded)
    monkeypatch.setattr(_variant, "_libraries", lambda: list(versions))
    assert _variant.find_llvm() == _variant.Llvm("/c/libLLVM.so.19.1", (19, 1, 7))
    monkeypatch.setattr(_variant, "_libraries", lambda: ["/e/libLLVM.so.99.1", "/a/libLLVM-15.so.1"])
    assert _variant.find_llvm().version == (99, 1, 0)


def test_no_llvm_says_what_to_install(monkeypatch):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(_variant, "_libraries", lambda: ["/a/libLLVM-15.so.1"])
    with pytest.raises(MistrayError) as caught:
        _variant.find_llvm()
    message = str(caught.value)
    assert "\n" not in message
    for word in ("17 or newer", "/a/libLLVM-15.so.1 (LLVM 15)", "apt-get", "dnf", "conda", "brew"):
        assert word in message


@pytest.mark.parametrize(("loaded", "shown"), [(None, "LLVM 15"), ((16, 0, 6), "LLVM 16.0.6")])
def test_given_library_too_old(monkeypatch, loaded, shown):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/a/libLLVM-15.so.1")
    monkeypatch.setattr(_variant, "_loaded_version", lambda path: loaded)
    monkeypatch.setattr(_variant, "_libraries", list)
    with pytest.raises(MistrayError, match=rf"^DRJIT_LIBLLVM_PATH=/a/libLLVM-15.so.1 is {shown}, .* aborts .* install"):
        _variant.find_llvm()


def test_given_file_is_no_library(monkeypatch, tmp_path):
    file = tmp_path / "libLLVM.so"
    file.write_text("not a library")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(file))
    with pytest.raises(MistrayError, match=r"libLLVM.so cannot be loaded"):
        _variant.find_llvm()


def test_llvm_is_chosen_before_mitsuba_is_imported():
    run = run_python(
        """
        from mistray._variant import ensure_variant
        ensure_variant()
        import drjit as dr, mitsuba as mi
        x = dr.arange(mi.Float, 8)
        print(mi.variant(), dr.detail.llvm_version()[0] >= 17, dr.sum(dr.maximum(dr.minimum(x, 4), 2))[0])
        """
    )
    assert run.stdout.split() == ["llvm_ad_rgb", "True", "25.0"], run.stderr


OLD_LLVM = sorted(glob.glob("/usr/lib/*/libLLVM-1[456].so*"))


@pytest.mark.skipif(not OLD_LLVM, reason="no LLVM 14 to 16 on this machine")
@pytest.mark.parametrize("path", OLD_LLVM[-1:])
def test_old_llvm_is_refused_without_an_abort(path):
    code = """
        import sys
        if sys.argv[1:]:
            import drjit
        try:
            from mistray._variant import ensure_variant
            ensure_variant()
        except ValueError as error:
            print(error)
        """
    early = run_python(code, DRJIT_LIBLLVM_PATH=path)
    assert early.stdout.startswith(f"DRJIT_LIBLLVM_PATH={path} is LLVM 1"), early.stderr
    late = run_python(code, "drjit first", DRJIT_LIBLLVM_PATH=path)
    assert late.stdout.startswith("variant 'llvm_ad_rgb': Dr.Jit has been imported with LLVM 1"), late.stderr


@pytest.mark.long
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
            os.environ["DRJIT_LIBLLVM_PATH"] = {_variant.find_llvm().path!r}
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
def test_backend_that_cannot_run(monkeypatch, variant, held, message):
    import drjit as dr

    monkeypatch.setattr(dr, "has_backend", lambda backend: bool(held))
    monkeypatch.setattr(dr, "detail", SimpleNamespace(llvm_version=lambda: held))
    with pytest.raises(MistrayError, match=message):
        _variant._require_backend(variant)


def test_other_mitsuba_releases_are_refused():
    _mitsuba_compat.check_release("3.9.1")
    for version in ("3.8.0", "3.10.0", "3.90.1", "4.0.0"):
        with pytest.raises(MistrayError, match=rf"mitsuba {version} is installed .* pip install"):
            _mitsuba_compat.check_release(version)


@pytest.mark.parametrize(
    ("module", "remedy"),
    [
        (
            "try:\n    raise ImportError('libatomic.so.1: no such file')\nexcept ImportError:\n    _drjit_ext",
            "libatomic1",
        ),
        ("raise ImportError('drjit is of another version')", "pip install --force-reinstall 'mitsuba=="),
    ],
)
def test_mitsuba_that_cannot_be_imported(tmp_path, module, remedy):
    (tmp_path / "mitsuba.py").write_text(module)
    run = run_python(
        """
        try:
            from mistray._mitsuba_compat import import_mitsuba
            import_mitsuba()
        except ValueError as error:
            print(error)
        """,
        PYTHONPATH=str(tmp_path),
    )
    assert run.stdout.startswith("mitsuba cannot be imported ("), run.stderr
    assert remedy in run.stdout


def test_every_plugin_file_is_found():
    on_disk = {f"mistray.plugins.{file.parent.name}.{file.stem}" for file in ROOT.glob("plugins/*/*.py")}
    assert set(_variant.plugin_modules()) == {name for name in on_disk if not name.endswith(".__init__")}


@pytest.mark.parametrize("file", sorted(ROOT.glob("plugins/*/[!_]*.py")), ids=lambda file: file.stem)
def test_a_plugin_is_named_after_its_file(file):
    calls = [node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.Call)]
    names = [call.args[0].value for call in calls if ast.unparse(call.func).startswith("mi.register_")]
    assert names in ([], [file.stem])


def test_plugins_follow_every_switch_of_variant(tmp_path):
    """A plugin whose base class is in a module that comes later in the walk must not keep the old variant's base."""
    files = {
        "toy/__init__.py": "",
        "toy/shapes/__init__.py": "",
        "toy/shapes/first.py": """
            import mitsuba as mi
            from toy.shapes.second import Base

            class First(Base):
                pass

            mi.register_bsdf("toy", lambda props: First(props))
            """,
        "toy/shapes/second.py": """
            import mitsuba as mi

            class Base(mi.BSDF):
                def __init__(self, props):
                    super().__init__(props)
                    self.variant = mi.variant()

                def to_string(self):
                    return f"Toy[{self.variant}]"
            """,
    }
    for name, text in files.items():
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(textwrap.dedent(text))
    run = run_python(
        """
        import warnings
        from mistray import _variant
        _variant.PLUGIN_ROOT = "toy"
        _variant.ensure_variant("llvm_ad_mono")
        import mitsuba as mi
        for variant in ("llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_rgb"):
            mi.set_variant(variant)
            print(mi.load_dict({"type": "toy"}))
        assert _variant.ensure_variant() == "llvm_ad_rgb"
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            mi.set_variant("scalar_rgb")
        print(caught[0].message)
        """,
        PYTHONPATH=str(tmp_path),
    )
    assert run.stdout.splitlines() == [
        "Toy[llvm_ad_rgb]",
        "Toy[llvm_ad_spectral]",
        "Toy[llvm_ad_rgb]",
        "mistray: no plugins in variant 'scalar_rgb', the ray tree needs a JIT variant",
    ], run.stderr


def test_mesh_buffers_round_trip():
    import numpy as np

    _variant.ensure_variant()
    import mitsuba as mi

    vertices = np.array([[0, 0, 1], [2, 0, 1], [0, 3, 1], [2, 3, 1]], dtype=np.float32)
    faces = np.array([[0, 1, 2], [1, 3, 2]], dtype=np.uint32)
    mesh = mi.Mesh("m", len(vertices), len(faces))
    _mitsuba_compat.write_mesh(mesh, vertices, faces)
    read = _mitsuba_compat.mesh_arrays(mesh)
    assert np.array_equal(read[0], vertices)
    assert np.array_equal(read[1], faces)
    assert mesh.surface_area()[0] == pytest.approx(6.0)


def test_threads() -> None:
    """The number that Dr.Jit uses; with one all work is the calling thread's, and results stay what they are."""
    code = """
        import drjit as dr
        import mistray
        scene = mistray.load("plate")
        import os
        for count in (os.cpu_count(), 1):
            mistray.set_threads(count)
            t = mistray.trace(scene, rays=300_000)
            print(dr.thread_count(), float(t.energy.detected_W))
    """
    words = run_python(code).stdout.split()
    assert words[::2] == [str(os.cpu_count()), "1"]
    assert float(words[1]) == pytest.approx(float(words[3]), rel=1e-12)


@pytest.mark.parametrize("count", [0, -1, 1.5, True, 1025])
def test_threads_out_of_range(count: object) -> None:
    with pytest.raises(MistrayError, match=f"threads is {count}; it must be a whole number between"):
        _variant.set_threads(count)

"""libLLVM is settled before Mitsuba is imported; the variant is one that can trace, and every plugin follows it."""

import ctypes
import os
import re
import subprocess
import sys
from pathlib import Path
from textwrap import dedent
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
import vectors
from refusals import refused

from mistray import _libatomic, _llvm, _mitsuba_compat, _variant


def run_python(code: str, *arguments: str, **environment: str | None) -> subprocess.CompletedProcess[str]:
    variables = {**os.environ, "MISTRAY_VARIANT": None, "DRJIT_LIBLLVM_PATH": None, **environment}
    known = {key: value for key, value in variables.items() if value is not None}
    command = [sys.executable, "-c", dedent(code), *arguments]
    return subprocess.run(command, env=known, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize(
    ("before", "environment", "argument", "expected"), vectors.toml("tables.toml")["choice of the variant"]
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
    files = [file for file in Path(__file__).parents[1].glob("plugins/*/*.py") if file.stem != "__init__"]
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
    message = "mistray: no plugins in variant 'scalar_rgb', the ray tree needs a JIT variant; call mi.set_variant"
    assert run.stdout == f"llvm_ad_rgb True 25.0\n{message}('llvm_ad_rgb')\n", run.stderr


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


OF_WHEEL = ("x86_64-unknown-linux-gnu/libunwind.so.1.0", "x86_64-unknown-linux-gnu/libc++abi.so.1.0",
            "x86_64-unknown-linux-gnu/libc++.so.1.0", "libLLVM.so.23.1")  # fmt: skip
ON_LINUX = pytest.mark.skipif(not _libatomic.on_linux_x86_64(), reason="the wheel is for Linux on x86-64")


@pytest.fixture
def no_wheel(monkeypatch):
    monkeypatch.setattr(_llvm, "_wheel", lambda: None)


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The wheel as pip lays it out in a virtual environment, with files that are no libraries; its folder lib."""
    site = tmp_path / "lib" / "python3" / "site-packages"
    info = site / "karellen_llvm_core-23.1.4.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: karellen-llvm-core\nVersion: 23.1.4\n")
    linker_script = "x86_64-unknown-linux-gnu/libc++.so"
    (info / "RECORD").write_text("".join(f"../../{name},,\n" for name in (*reversed(OF_WHEEL), linker_script)))
    for name in (*OF_WHEEL, linker_script):
        file = tmp_path / "lib" / name
        file.parent.mkdir(exist_ok=True)
        file.write_text("no library")
    monkeypatch.setattr(sys, "path", [str(site), *sys.path])
    monkeypatch.setattr(_llvm, "_wheel", _llvm._wheel.__wrapped__)
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    return tmp_path / "lib"


@pytest.mark.usefixtures("no_wheel")
def test_search_takes_the_newest_that_loads(monkeypatch):
    """By the version that it tells; what is too old by its name or folder, or does not load, is left out."""
    versions = {
        "/a/libLLVM-15.so.1": None, "/b/libLLVM-17.so.1": (17, 0, 6), "/c/libLLVM.so.19.1": (19, 1, 7),
        "/d/libLLVM.so.21.1": OSError("wrong ELF class"), "/e/libLLVM.so.99.1": (99, 1, 0), "/f/libLLVM.so": None,
    }  # fmt: skip

    def loaded(path):
        if isinstance(versions.get(path), OSError):
            raise versions[path]
        return versions.get(path)

    def found(*paths):
        monkeypatch.setattr(_llvm, "_libraries", lambda: list(paths))
        return _llvm.find_llvm()

    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(_llvm, "_loaded_version", loaded)
    assert found(*versions) == _llvm.Llvm("/c/libLLVM.so.19.1", (19, 1, 7))
    assert found("/e/libLLVM.so.99.1", "/a/libLLVM-15.so.1").version == (99, 1, 0)
    for path, version in (
        ("/x/libLLVM.19.1.dylib", (19, 1)), ("/usr/llvm17/lib64/libLLVM.so", (17,)),
        ("/x/llvm/21.1.2/lib/libLLVM.dylib", (21, 1, 2)), ("/x/llvm@18/18.1.8/lib/libLLVM.dylib", (18,)),
    ):  # fmt: skip
        assert _llvm._named_version(path) == version
    with refused() as caught:
        found("/a/libLLVM-15.so.1")
    for word in ("/a/libLLVM-15.so.1", "17 or newer", "apt-get", "dnf", "conda", "brew"):
        assert word in str(caught.value)


@pytest.mark.usefixtures("no_wheel")
def test_a_given_library_that_is_no_good(monkeypatch, tmp_path):
    monkeypatch.setattr(_llvm, "_libraries", list)
    (tmp_path / "libLLVM.so").write_text("not a library")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM.so"))
    with refused(r"libLLVM.so cannot be loaded"):
        _llvm.find_llvm()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/a/libLLVM-15.so.1")
    for loaded, shown in ((None, "LLVM 15"), ((16, 0, 6), "LLVM 16.0.6")):
        monkeypatch.setattr(_llvm, "_loaded_version", lambda path, loaded=loaded: loaded)
        with refused(rf"^DRJIT_LIBLLVM_PATH=.* is {shown}, .* aborts .* install"):
            _llvm.find_llvm()


def test_the_wheel_comes_before_the_system(installed, monkeypatch):
    """Unless it is newer than what was tried; the variable comes before both."""
    wheel, system = str(installed / "libLLVM.so.23.1"), "/c/libLLVM.so.22.1"
    monkeypatch.setattr(_llvm, "_libraries", lambda: [system])
    monkeypatch.setattr(_llvm, "_loaded_version", {wheel: (23, 1, 4), system: (22, 1, 0)}.get)
    needed = tuple(str(installed / name) for name in OF_WHEEL[:-1])
    assert _llvm.find_llvm() == _llvm.Llvm(wheel, (23, 1, 4), needed)
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", system)
    assert _llvm.find_llvm() == _llvm.Llvm(system, (22, 1, 0))
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", wheel)  # as children inherit it
    assert _llvm.find_llvm().needs == needed
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH")
    monkeypatch.setattr(_llvm, "NEWEST_TRIED_LLVM", 22)
    assert _llvm.find_llvm().path == system


@ON_LINUX
def test_what_the_wheel_needs_is_loaded_before_it(installed, monkeypatch):
    opened = []

    def load(path):
        opened.append(path)
        return object()  # a library that cannot tell its version

    monkeypatch.setattr(_libatomic, "provide_libatomic", lambda: None)
    monkeypatch.setattr(_llvm, "provide_libatomic", lambda: opened.append("libatomic"))
    monkeypatch.setattr(ctypes, "CDLL", load)
    assert _llvm._loaded_version(str(installed / "libLLVM.so.23.1")) is None
    assert opened == ["libatomic", *(str(installed / name) for name in OF_WHEEL)]
    assert "pip install 'mistray[llvm]'" in _llvm.LLVM_REMEDY  # the remedy without root


def test_a_wheel_without_its_libraries(installed, monkeypatch):
    """`pip install --target` leaves them out."""
    (installed / "libLLVM.so.23.1").unlink()
    monkeypatch.setattr(_llvm, "_libraries", list)
    with refused("found only karellen-llvm-core without its libraries.*--target"):
        _llvm.find_llvm()


@pytest.mark.parametrize("needs", [(), ("/a/libc++.so.1",)])
def test_drjit_that_was_imported_first(monkeypatch, needs):
    """The variable is no remedy where the library needs others before it."""
    import drjit as dr

    monkeypatch.setattr(dr, "has_backend", lambda backend: False)
    monkeypatch.setattr(_variant, "search_llvm", lambda: (_llvm.Llvm("/a/libLLVM.so.23.1", (23, 1, 4), needs), []))
    with refused("import mistray before mitsuba and drjit") as caught:
        _variant._require_backend("llvm_ad_rgb")
    assert ("DRJIT_LIBLLVM_PATH=/a/libLLVM.so.23.1" in str(caught.value)) == (not needs)


class TestLibatomic:
    """What stands in for libatomic does what that does, and Dr.Jit takes it."""

    pytestmark = ON_LINUX

    @pytest.mark.parametrize("named", [True, False])
    def test_compare_and_exchange(self, monkeypatch, tmp_path, named):
        """Of libatomic where there is one, and of the stand-in under another name."""
        if named:
            library = ctypes.CDLL(_libatomic.NAME)
        else:
            monkeypatch.setattr(_libatomic, "NAME", "libatomic-of-a-test.so.1")
            path = _libatomic.provide_libatomic.__wrapped__()
            assert re.fullmatch(rf"/proc/{os.getpid()}/fd/\d+", path)
            library = ctypes.CDLL(path)
            os.close(int(Path(path).name))
        exchange = getattr(library, _libatomic.FUNCTION)
        exchange.restype = ctypes.c_bool
        exchange.argtypes = [ctypes.c_void_p] * 2 + [ctypes.c_uint64] * 2 + [ctypes.c_int] * 2
        pair = ctypes.c_uint64 * 2
        room = (ctypes.c_uint64 * 4)()
        memory = pair.from_address(-(-ctypes.addressof(room) // 16) * 16)
        memory[:] = first = [1 << 63, 3]
        second, expected = [5, (1 << 64) - 1], pair(*first)
        assert exchange(ctypes.addressof(memory), expected, *second, 5, 5)
        assert (list(memory), list(expected)) == (second, first)
        assert not exchange(ctypes.addressof(memory), expected, 7, 8, 5, 5)
        assert (list(memory), list(expected)) == (second, second)

    def test_a_machine_that_has_libatomic_keeps_it_and_one_that_runs_no_code_from_memory(self, monkeypatch):
        opened = []
        monkeypatch.setattr(ctypes, "CDLL", opened.append)
        assert _libatomic.provide_libatomic.__wrapped__() is None
        assert opened == [_libatomic.NAME]
        monkeypatch.setattr(ctypes, "CDLL", Mock(side_effect=OSError))
        assert _libatomic.provide_libatomic.__wrapped__() is None

    @pytest.mark.long
    def test_drjit_runs_with_it(self, tmp_path):
        """The loader takes the library that is loaded under the name, and not the file of the system."""
        (tmp_path / "stand-in.so").write_bytes(_libatomic.library())
        code = f"""
import ctypes
ctypes.CDLL({str(tmp_path / "stand-in.so")!r})
import mistray
print(mistray.trace(mistray.load("plate"), rays=100_000).energy.detected_W > 0)
print("stand-in.so" in (maps := open("/proc/self/maps").read()), "/libatomic" in maps)
"""
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
        assert done.stdout.split() == ["True", "True", "False"], done.stderr

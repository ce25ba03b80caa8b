"""libLLVM is settled before Mitsuba is imported: which is taken, what is loaded before it, what is said of the rest."""

import ctypes
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from refusals import refused

from mistray import _libatomic, _llvm, _variant

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
    versions = {wheel: (23, 1, 4), system: (22, 1, 0)}
    monkeypatch.setattr(_llvm, "_libraries", lambda: [system])
    monkeypatch.setattr(_llvm, "_loaded_version", versions.get)
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


def test_a_wheel_without_its_libraries(installed, monkeypatch):
    """`pip install --target` leaves them out."""
    (installed / "libLLVM.so.23.1").unlink()
    monkeypatch.setattr(_llvm, "_libraries", list)
    with refused("found only karellen-llvm-core without its libraries.*--target"):
        _llvm.find_llvm()


@ON_LINUX
def test_the_remedy_without_root():
    assert "pip install 'mistray[llvm]'" in _llvm.LLVM_REMEDY


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

    def test_a_machine_that_has_libatomic_keeps_it(self, monkeypatch):
        opened = []
        monkeypatch.setattr(ctypes, "CDLL", opened.append)
        assert _libatomic.provide_libatomic.__wrapped__() is None
        assert opened == [_libatomic.NAME]

    def test_a_kernel_that_runs_no_code_from_memory(self, monkeypatch):
        def refuse(path):
            raise OSError(path)

        monkeypatch.setattr(ctypes, "CDLL", refuse)
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

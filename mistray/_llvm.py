"""Selection of libLLVM, which Dr.Jit opens on import: the one that is named, that of the extra, or the machine's.

With LLVM 15 and 16 on x86, Dr.Jit starts but aborts the process without a traceback ("Cannot select: fmaximum") on the
first kernel that takes a minimum or a maximum.
"""

from __future__ import annotations

import ctypes
import functools
import glob
import os
import re
import sys
from dataclasses import dataclass

from mistray._libatomic import on_linux_x86_64, provide_libatomic
from mistray.errors import MistrayError

OLDEST_LLVM = 17
NEWEST_TRIED_LLVM = 23  # a newer one is taken only where there is nothing else
WHEEL = "karellen-llvm-core"  # which the extra "llvm" of pyproject.toml installs
LLVM_REMEDY = (
    "install one: "
    + ("pip install 'mistray[llvm]', " if on_linux_x86_64() else "")
    + "apt-get install libllvm19 (Debian, Ubuntu), dnf install llvm-libs (Fedora), "
    "conda install -c conda-forge libllvm19 (conda), brew install llvm (macOS); "
    "or set DRJIT_LIBLLVM_PATH to the library's file"
)

_LIBRARY_NAME = re.compile(r"libLLVM[-.\d]*\.(so|dylib)[.\d]*")
_VERSION_IN_NAME = re.compile(r"libLLVM(?:-|\.so\.|\.)(\d+(?:\.\d+)*)")
_VERSION_IN_FOLDER = re.compile(r"llvm[-@/]?(\d+(?:\.\d+)*)(?=/)")
_IN_WHEEL = re.compile(r"(libunwind|libc\+\+abi|libc\+\+|libLLVM)\.so\.\d.*")


@dataclass(frozen=True)
class Llvm:
    """libLLVM that Dr.Jit can use: its `path`, `version` (major, minor, patch), and libraries to load before it."""

    path: str
    version: tuple[int, ...]
    needs: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"LLVM {version_text(self.version)} ({self.path})"


def version_text(version: tuple[int, ...]) -> str:
    """Return a version in its usual notation: (19, 1, 7) becomes "19.1.7"."""
    return ".".join(str(number) for number in version)


def find_llvm() -> Llvm:
    """
    Return the libLLVM for Dr.Jit.

    ``DRJIT_LIBLLVM_PATH`` takes precedence if it is set, then the wheel of the extra ``llvm`` if it is installed.
    Otherwise the search covers the linker's cache, the distribution's folders, the conda environment and Homebrew. The
    newest library that loads is taken, from `OLDEST_LLVM` to `NEWEST_TRIED_LLVM`; a newer one only if there is no
    other. What the library of the wheel needs is loaded, too.

    Raises
    ------
    MistrayError
        If the library that ``DRJIT_LIBLLVM_PATH`` names cannot be loaded or is too old, or if no library is found.
    """
    given = os.environ.get("DRJIT_LIBLLVM_PATH")
    if not given:
        found, rejected = search_llvm()
        if found:
            return found
        seen = f" (found only {', '.join(rejected)})" if rejected else ""
        raise MistrayError(f"no libLLVM of version {OLDEST_LLVM} or newer{seen}; {LLVM_REMEDY}")
    try:
        version = _loaded_version(given)
    except OSError as error:
        raise MistrayError(f"DRJIT_LIBLLVM_PATH={given} cannot be loaded ({error}); {_remedy_for_given()}") from None
    if version is None or version[0] < OLDEST_LLVM:
        told = version or _named_version(given)
        text = version_text(told) if told else "15 or older"
        raise MistrayError(
            f"DRJIT_LIBLLVM_PATH={given} is LLVM {text}, with which Dr.Jit aborts the process; "
            f"version {OLDEST_LLVM} or newer is needed: {_remedy_for_given()}"
        )
    return Llvm(given, version, _needs(given))


def _remedy_for_given() -> str:
    found, _ = search_llvm()
    return f"unset DRJIT_LIBLLVM_PATH to use {found}" if found else LLVM_REMEDY


def search_llvm() -> tuple[Llvm | None, list[str]]:
    """Return the best usable libLLVM of this machine, None if there is none, and a line on each rejected one."""
    candidates = []
    rejected = []
    wheel = _wheel()
    if wheel == ():
        rejected.append(f"{WHEEL} without its libraries, which pip leaves out with --target")
    for path in sorted({*_libraries(), *(wheel or ())[-1:]}):
        try:
            version = _named_version(path) or _loaded_version(path)
        except OSError:
            version = None
        if version is None or version[0] < OLDEST_LLVM:
            rejected.append(f"{path} (LLVM {version_text(version)})" if version else path)
        else:
            candidates.append((version[0] <= NEWEST_TRIED_LLVM, bool(_needs(path)), version, path))
    for *_, path in sorted(candidates, reverse=True):
        try:
            version = _loaded_version(path)
        except OSError as error:
            rejected.append(f"{path} ({error})")
            continue
        if version and version[0] >= OLDEST_LLVM:
            return Llvm(path, version, _needs(path)), rejected
        rejected.append(path)
    return None, rejected


@functools.cache
def _wheel() -> tuple[str, ...] | None:
    """
    Return the libraries of the LLVM wheel in order of loading, libLLVM last.

    The result is None if the wheel is not installed, and () if one of them is missing.

    They are looked up in the files that pip recorded, because their folder differs among kinds of install.
    """
    listed = f"{WHEEL.replace('-', '_')}-*.dist-info"
    if not any(glob.glob(listed, root_dir=folder) for folder in sys.path):
        return None
    from importlib import metadata  # which takes longer to import than all else here

    try:
        files = metadata.distribution(WHEEL).files or []
    except metadata.PackageNotFoundError:
        return None
    found = {}
    for file in files:
        named = _IN_WHEEL.fullmatch(file.name)
        path = os.path.realpath(str(file.locate()))
        if named and os.path.isfile(path):
            found[named[1]] = path
    order = ("libunwind", "libc++abi", "libc++", "libLLVM")
    return tuple(found[name] for name in order) if len(found) == len(order) else ()


def _needs(path: str) -> tuple[str, ...]:
    """
    Return the paths of the libraries to load before a libLLVM; () unless it is that of the pip wheel.

    By itself the wheel's libLLVM finds them only once Python has started again after pip.
    """
    wheel = _wheel()
    return wheel[:-1] if wheel and os.path.realpath(path) == wheel[-1] else ()


def _libraries() -> list[str]:
    """Return the paths of libLLVM files in the linker's cache and the usual folders, links resolved, each once."""
    listed = []
    if sys.platform.startswith("linux"):
        listed = re.findall(r"=> (.*libLLVM.*)", _linker_cache())
    folders = [
        "/usr/lib/llvm-*/lib",
        "/usr/lib/*-linux-gnu",
        "/usr/lib64",
        "/usr/lib64/llvm*/lib*",
        "/usr/lib",
        f"{sys.prefix}/lib",
        f"{os.environ.get('CONDA_PREFIX', sys.prefix)}/lib",
        "/opt/homebrew/opt/llvm*/lib",
        "/usr/local/opt/llvm*/lib",
    ]
    for folder in folders:
        listed += glob.glob(f"{folder}/libLLVM*")
    files = {os.path.realpath(path) for path in listed if _LIBRARY_NAME.fullmatch(os.path.basename(path))}
    return sorted(path for path in files if os.path.isfile(path))


def _linker_cache() -> str:
    import subprocess

    for program in ("/sbin/ldconfig", "ldconfig"):
        try:
            return subprocess.run([program, "-p"], capture_output=True, text=True, check=True).stdout
        except (OSError, subprocess.CalledProcessError):
            continue
    return ""


def _named_version(path: str) -> tuple[int, ...] | None:
    """Return the LLVM version in the name of a file or its folder, as a tuple; None if there is none."""
    folder, name = os.path.split(os.path.realpath(path))
    found = _VERSION_IN_NAME.match(name) or _VERSION_IN_FOLDER.search(folder + "/")
    return tuple(int(number) for number in found[1].split(".")) if found else None


def _loaded_version(path: str) -> tuple[int, int, int] | None:
    """
    Load a libLLVM, and what it needs, and return the version that it reports; None below LLVM 16, which reports none.

    Raise OSError if it does not load.
    """
    needs = _needs(path)
    if needs:
        provide_libatomic()
    for needed in needs:
        ctypes.CDLL(needed)
    library = ctypes.CDLL(path)  # RTLD_LOCAL: Dr.Jit does not see it unless it is the one it is told to open
    if not hasattr(library, "LLVMGetVersion"):
        return None
    major, minor, patch = ctypes.c_uint(), ctypes.c_uint(), ctypes.c_uint()
    library.LLVMGetVersion(ctypes.byref(major), ctypes.byref(minor), ctypes.byref(patch))
    return major.value, minor.value, patch.value

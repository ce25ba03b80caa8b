"""Selection of libLLVM and of the Mitsuba variant, and registration of the plugins.

Dr.Jit opens libLLVM only once, on import. So the library is selected here before that, with only the standard library.
With LLVM 15 and 16 on x86, Dr.Jit starts but aborts the process without a traceback ("Cannot select: fmaximum") on the
first kernel that takes a minimum or a maximum.
"""

from __future__ import annotations

import contextlib
import ctypes
import glob
import importlib
import os
import pkgutil
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType

from mistray._mitsuba_compat import import_mitsuba, own_folder_first
from mistray.entry_points import points_of
from mistray.errors import MistrayError, MistrayWarning
from mistray.ranges import THREADS

DEFAULT_VARIANT = "llvm_ad_rgb"
OLDEST_LLVM = 17
NEWEST_TRIED_LLVM = 22  # a newer one is taken only where there is nothing else
LLVM_REMEDY = (
    "install one: apt-get install libllvm19 (Debian, Ubuntu), dnf install llvm-libs (Fedora), "
    "conda install -c conda-forge libllvm19 (conda), brew install llvm (macOS); "
    "or set DRJIT_LIBLLVM_PATH to the library's file"
)
PLUGIN_ROOT = "mistray.plugins"  # also the group of entry points that name modules of plugins
PLUGIN_MODULES = "MISTRAY_PLUGINS"  # environment variable: more such modules, separated by commas
LANES_OF_THREAD = 1 << 14  # which Dr.Jit gives to a thread at once

_LIBRARY_NAME = re.compile(r"libLLVM[-.\d]*\.(so|dylib)[.\d]*")
_VERSION_IN_NAME = re.compile(r"libLLVM(?:-|\.so\.|\.)(\d+(?:\.\d+)*)")
_VERSION_IN_FOLDER = re.compile(r"llvm[-@/]?(\d+(?:\.\d+)*)(?=/)")

_registered_variant: str | None = None


@dataclass(frozen=True)
class Llvm:
    """A libLLVM that Dr.Jit can use: `path` of the file and `version` (major, minor, patch)."""

    path: str
    version: tuple[int, ...]

    def __str__(self) -> str:
        return f"LLVM {version_text(self.version)} ({self.path})"


def version_text(version: tuple[int, ...]) -> str:
    """Format a version as text: (19, 1, 7) becomes "19.1.7"."""
    return ".".join(str(number) for number in version)


def find_llvm() -> Llvm:
    """
    Find the libLLVM for Dr.Jit.

    ``DRJIT_LIBLLVM_PATH`` takes precedence if it is set. Otherwise the search covers the linker's cache, the
    distribution's folders, the conda environment and Homebrew. The newest library that loads is taken, from
    `OLDEST_LLVM` to `NEWEST_TRIED_LLVM`; a newer one only if there is no other.

    Raises
    ------
    MistrayError
        If the library that ``DRJIT_LIBLLVM_PATH`` names cannot be loaded or is too old, or if no library is found.
    """
    given = os.environ.get("DRJIT_LIBLLVM_PATH")
    if not given:
        found, rejected = _search()
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
    return Llvm(given, version)


def ensure_variant(name: str | None = None) -> str:
    """
    Activate a JIT variant of Mitsuba and register the plugins for it; repeated calls are harmless.

    Parameters
    ----------
    name : str, optional
        Variant such as ``"llvm_ad_rgb"`` or ``"cuda_ad_rgb"``. Default: the variant that is active already, else
        ``$MISTRAY_VARIANT``, else `DEFAULT_VARIANT`.

    Returns
    -------
    str
        Name of the active variant.

    Raises
    ------
    MistrayError
        If the variant does not exist, is not a JIT variant or cannot run here, or if Mitsuba or libLLVM is missing or
        unsupported.
    """
    wanted = name or active_variant() or os.environ.get("MISTRAY_VARIANT") or DEFAULT_VARIANT
    _require_jit(wanted)
    if "drjit" not in sys.modules:
        try:
            os.environ["DRJIT_LIBLLVM_PATH"] = find_llvm().path
        except MistrayError:
            if wanted.startswith("llvm_"):
                raise
    mi = import_mitsuba()
    if wanted not in mi.variants():
        usable = ", ".join(variant for variant in mi.variants() if not variant.startswith("scalar_"))
        raise MistrayError(f"variant '{wanted}' is not part of Mitsuba {mi.__version__}; choose one of {usable}")
    _require_backend(wanted)
    if mi.variant() != wanted:
        mi.set_variant(wanted)
    register_plugins()
    return wanted


def set_threads(count: int) -> None:
    """
    Set the number of CPU threads that trace; by default all of them do.

    Results differ only by the rounding of float64 sums. The ``cuda`` variants trace on the GPU, whatever the number.

    Parameters
    ----------
    count : int
        Number of threads, including the calling one, from 1 to the number of processors of the machine.

    Raises
    ------
    MistrayError
        If the number is out of range, or no variant can be activated.
    """
    count = THREADS.check("threads", count)
    ensure_variant()
    import drjit as dr

    dr.set_thread_count(count)


@contextlib.contextmanager
def reading_threads() -> Iterator[None]:
    """Use at least two threads within a block: with one, Mitsuba hangs when it reads an EXR file."""
    import drjit as dr

    before = dr.thread_count()
    dr.set_thread_count(max(before, 2))
    try:
        yield
    finally:
        dr.set_thread_count(before)


def on_gpu() -> bool:
    """Whether the active variant traces on a GPU."""
    import drjit as dr
    import mitsuba as mi

    return bool(dr.backend_v(mi.Float) != dr.JitBackend.LLVM)


def lanes_of_threads() -> int:
    """Number of lanes of a launch that Dr.Jit spreads over all CPU threads."""
    import drjit as dr

    return dr.thread_count() * LANES_OF_THREAD


def active_variant() -> str | None:
    """Name of the active Mitsuba variant; None if there is none. Does not import Mitsuba."""
    mitsuba = sys.modules.get("mitsuba")
    return mitsuba.variant() if mitsuba else None


def plugin_modules() -> list[str]:
    """Full names of the modules that hold plugins: all files in the folders of `mistray.plugins`."""
    try:
        root = importlib.import_module(PLUGIN_ROOT)
    except ModuleNotFoundError:
        raise MistrayError(
            f"package '{PLUGIN_ROOT}' is not installed; run 'pip install -e .' in the repository"
        ) from None
    return [module.name for kind in _walk(root) for module in _walk(importlib.import_module(kind.name))]


def plugins_of_others() -> dict[str, bool]:
    """Full names of the modules of plugins that other packages have, and whether the user named them."""
    given = [name.strip() for name in os.environ.get(PLUGIN_MODULES, "").split(",") if name.strip()]
    return {value: value in given for value in (*(value for _, value in points_of(PLUGIN_ROOT)), *given)}


def use_plugins(modules: Sequence[str]) -> None:
    """
    Register the plugins of modules, now or with the variant, and after each later switch of variant.

    Parameters
    ----------
    modules : sequence of str
        Full names of modules on the import path, such as "my_package.plugins".

    Raises
    ------
    MistrayError
        If a variant is active and a module cannot be imported.
    """
    given = [name for name, is_given in plugins_of_others().items() if is_given]
    os.environ[PLUGIN_MODULES] = ",".join(dict.fromkeys([*given, *modules]))
    if _registered_variant is not None:
        _import_of_others()


def register_plugins() -> None:
    """Register every plugin with the active variant, now and after each later switch of variant."""
    mi = import_mitsuba()
    mi.detail.remove_variant_callback(_on_variant_change)
    mi.detail.add_variant_callback(_on_variant_change)
    if _registered_variant is None:
        own_folder_first(mi.file_resolver())
    if mi.variant() != _registered_variant:
        _register_for(mi.variant())


def _on_variant_change(old: str | None, new: str) -> None:
    """Register the plugins for a new variant; Mitsuba calls this after each switch."""
    if new.startswith("scalar_"):
        warnings.warn(f"mistray: no plugins in variant '{new}', the ray tree needs a JIT variant", stacklevel=2)
        return
    _require_backend(new)
    if new != _registered_variant:
        _register_for(new)


def _register_for(variant: str) -> None:
    # Plugin classes derive from classes of one variant. All modules are dropped before the first is imported again:
    # reloading them one by one would leave a class derived from another plugin's base on the base of the old variant.
    global _registered_variant
    names, others = plugin_modules(), tuple(plugins_of_others())
    for name in [
        name for name in sys.modules if name in names or f"{name}.".startswith(tuple(f"{n}." for n in others))
    ]:
        del sys.modules[name]
    for name in names:
        importlib.import_module(name)
    _import_of_others()
    _registered_variant = variant


def _import_of_others() -> None:
    """Import the plugins of other packages; leave out an installed one that cannot be, and raise for a named one."""
    for name, is_given in plugins_of_others().items():
        try:
            importlib.import_module(name)
        except Exception as error:  # code of others
            told = f"plugins '{name}' cannot be imported ({type(error).__name__}: {error})"
            if is_given:
                raise MistrayError(f"{told}; install their package, or set PYTHONPATH to their folder") from None
            warnings.warn(MistrayWarning(f"{told}; they are left out: repair or remove their package"), stacklevel=2)


def _walk(package: ModuleType) -> Iterator[pkgutil.ModuleInfo]:
    return pkgutil.iter_modules(package.__path__, package.__name__ + ".")


def _require_jit(variant: str) -> None:
    if variant.startswith("scalar_"):
        raise MistrayError(
            f"variant '{variant}' cannot run the ray tree, which needs a JIT variant; "
            f"call mi.set_variant('{DEFAULT_VARIANT}') first, or set MISTRAY_VARIANT={DEFAULT_VARIANT}"
        )


def _require_backend(variant: str) -> None:
    """Raise `MistrayError` if the backend of a variant is missing, or if its LLVM would abort the process."""
    import drjit as dr

    if variant.startswith("llvm_"):
        version = dr.detail.llvm_version() if dr.has_backend(dr.JitBackend.LLVM) else ()
        if not version or version[0] < OLDEST_LLVM:
            held = f"LLVM {version_text(version)}" if version else "no LLVM"
            found, _ = _search()
            remedy = f"set DRJIT_LIBLLVM_PATH={found.path} before Python starts" if found else LLVM_REMEDY
            raise MistrayError(
                f"variant '{variant}': Dr.Jit has been imported with {held} and needs version {OLDEST_LLVM} or newer; "
                f"import mistray before mitsuba and drjit, or {remedy}"
            )
    elif variant.startswith("cuda_") and not dr.has_backend(dr.JitBackend.CUDA):
        raise MistrayError(
            f"variant '{variant}': Dr.Jit finds no NVIDIA GPU with a recent driver; "
            f"'mistray doctor' says what it needs; or use {DEFAULT_VARIANT}"
        )


def _remedy_for_given() -> str:
    found, _ = _search()
    return f"unset DRJIT_LIBLLVM_PATH to use {found}" if found else LLVM_REMEDY


def _search() -> tuple[Llvm | None, list[str]]:
    """Return the best libLLVM of this machine, None if there is none, and a line of text on each rejected one."""
    candidates = []
    rejected = []
    for path in _libraries():
        try:
            version = _named_version(path) or _loaded_version(path)
        except OSError:
            version = None
        if version is None or version[0] < OLDEST_LLVM:
            rejected.append(f"{path} (LLVM {version_text(version)})" if version else path)
        else:
            candidates.append((version[0] <= NEWEST_TRIED_LLVM, version, path))
    for _, _, path in sorted(candidates, reverse=True):
        try:
            version = _loaded_version(path)
        except OSError as error:
            rejected.append(f"{path} ({error})")
            continue
        if version and version[0] >= OLDEST_LLVM:
            return Llvm(path, version), rejected
        rejected.append(path)
    return None, rejected


def _libraries() -> list[str]:
    """Paths of all libLLVM files on this machine, with links resolved, each once."""
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
    """Version in the name of a file or of its folder; None if there is none."""
    folder, name = os.path.split(os.path.realpath(path))
    found = _VERSION_IN_NAME.match(name) or _VERSION_IN_FOLDER.search(folder + "/")
    return tuple(int(number) for number in found[1].split(".")) if found else None


def _loaded_version(path: str) -> tuple[int, int, int] | None:
    """Version reported by a library itself; None below LLVM 16, which cannot report it. Raises OSError."""
    library = ctypes.CDLL(path)  # RTLD_LOCAL: Dr.Jit does not see it unless it is the one it is told to open
    if not hasattr(library, "LLVMGetVersion"):
        return None
    major, minor, patch = ctypes.c_uint(), ctypes.c_uint(), ctypes.c_uint()
    library.LLVMGetVersion(ctypes.byref(major), ctypes.byref(minor), ctypes.byref(patch))
    return major.value, minor.value, patch.value

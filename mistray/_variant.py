"""Selection of the Mitsuba variant, which computes on the CPU or the GPU, and registration of the plugins.

Dr.Jit opens libLLVM only once, on import. So the library is selected before that, with only the standard library.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pkgutil
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from types import ModuleType

from mistray._llvm import LLVM_REMEDY, OLDEST_LLVM, find_llvm, search_llvm, version_text
from mistray._mitsuba_compat import import_mitsuba, own_folder_first
from mistray.entry_points import points_of
from mistray.errors import MistrayError, MistrayWarning
from mistray.ranges import THREADS

DEFAULT_VARIANT = "llvm_ad_rgb"
PLUGIN_ROOT = "mistray.plugins"  # also the group of entry points that name modules of plugins
PLUGIN_MODULES = "MISTRAY_PLUGINS"  # environment variable: more such modules, separated by commas
LANES_OF_THREAD = 1 << 14  # which Dr.Jit gives to a thread at once

_registered_variant: str | None = None


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

    Examples
    --------
    >>> mistray.ensure_variant()
    '..._ad_rgb'
    """
    wanted = name or active_variant() or os.environ.get("MISTRAY_VARIANT") or DEFAULT_VARIANT
    if wanted == active_variant():
        _follow_variants(import_mitsuba())  # also if this one will not do: the next may
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

    Examples
    --------
    >>> import os
    >>> mistray.set_threads(max(1, os.cpu_count() - 1))  # one processor stays free
    >>> mistray.set_threads(os.cpu_count())
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
    """True if the active Mitsuba variant traces on a GPU (CUDA)."""
    import drjit as dr
    import mitsuba as mi

    return bool(dr.backend_v(mi.Float) != dr.JitBackend.LLVM)


def lanes_of_threads() -> int:
    """Return the smallest number of rays in a kernel launch that gives work to all CPU threads."""
    import drjit as dr

    return dr.thread_count() * LANES_OF_THREAD


def active_variant() -> str | None:
    """Return the name of the active Mitsuba variant, without importing Mitsuba; None if there is none."""
    mitsuba = sys.modules.get("mitsuba")
    return mitsuba.variant() if mitsuba else None


def plugin_modules() -> list[str]:
    """
    Return the full names of the modules that hold plugins: all files in the folders of `mistray.plugins`.

    Raise `MistrayError` if that package is not installed.
    """
    try:
        root = importlib.import_module(PLUGIN_ROOT)
    except ModuleNotFoundError:
        raise MistrayError(
            f"package '{PLUGIN_ROOT}' is not installed; run 'pip install -e .' in the repository"
        ) from None
    return [module.name for kind in _walk(root) for module in _walk(importlib.import_module(kind.name))]


def plugins_of_others() -> dict[str, bool]:
    """Return module names of plugins of other packages: True if the user named the module, False if its package did."""
    given = _given_plugins()
    return {value: value in given for value in (*(value for _, value in points_of(PLUGIN_ROOT)), *given)}


def _given_plugins() -> list[str]:
    return [name.strip() for name in os.environ.get(PLUGIN_MODULES, "").split(",") if name.strip()]


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
    os.environ[PLUGIN_MODULES] = ",".join(dict.fromkeys([*_given_plugins(), *modules]))
    if _registered_variant is not None:
        _import_of_others(plugins_of_others())


def register_plugins() -> None:
    """Register every plugin with the active variant, now and after each later switch of variant."""
    mi = import_mitsuba()
    _follow_variants(mi)
    if mi.variant() != _registered_variant:
        _register_for(mi.variant())


def warn_without_plugins() -> None:
    """Warn if the active variant is a scalar one, which can have no plugins; the next variant gets its own."""
    variant = active_variant() or ""
    if variant.startswith("scalar_"):
        text = f"mistray: no plugins in variant '{variant}', the ray tree needs a JIT variant"
        warnings.warn(f"{text}; call mi.set_variant('{DEFAULT_VARIANT}')", stacklevel=3)


def _follow_variants(mi: ModuleType) -> None:
    """Have the plugins registered after each switch of variant."""
    mi.detail.remove_variant_callback(_on_variant_change)
    mi.detail.add_variant_callback(_on_variant_change)


def _on_variant_change(old: str | None, new: str) -> None:
    """
    Register the plugins for a new variant; Mitsuba calls this after each switch.

    A scalar variant gets a warning instead. A variant without its backend raises `MistrayError`.
    """
    if new.startswith("scalar_"):
        warn_without_plugins()
        return
    _require_backend(new)
    if new != _registered_variant:
        _register_for(new)


def _register_for(variant: str) -> None:
    # Plugin classes derive from classes of one variant. All modules are dropped before the first is imported again:
    # reloading them one by one would leave a class derived from another plugin's base on the base of the old variant.
    global _registered_variant
    if _registered_variant is None:
        own_folder_first(import_mitsuba().file_resolver())
    names, others = plugin_modules(), plugins_of_others()
    inside = tuple(f"{name}." for name in others)
    for name in [name for name in sys.modules if name in names or f"{name}.".startswith(inside)]:
        del sys.modules[name]
    for name in names:
        importlib.import_module(name)
    _import_of_others(others)
    _registered_variant = variant


def _import_of_others(others: Mapping[str, bool]) -> None:
    """
    Import the modules of `plugins_of_others`.

    Warn if an installed one fails; raise if one that the user named fails.
    """
    for name, is_given in others.items():
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
    """Raise `MistrayError` if the backend of a variant is missing, or if its LLVM version would abort the process."""
    import drjit as dr

    if variant.startswith("llvm_"):
        version = dr.detail.llvm_version() if dr.has_backend(dr.JitBackend.LLVM) else ()
        if not version or version[0] < OLDEST_LLVM:
            held = f"LLVM {version_text(version)}" if version else "no LLVM"
            found, _ = search_llvm()
            remedy = (
                f", or set DRJIT_LIBLLVM_PATH={found.path} before Python starts" if found else f", or {LLVM_REMEDY}"
            )
            raise MistrayError(
                f"variant '{variant}': Dr.Jit has been imported with {held} and needs version {OLDEST_LLVM} or newer; "
                f"import mistray before mitsuba and drjit{'' if found and found.needs else remedy}"
            )
    elif variant.startswith("cuda_") and not dr.has_backend(dr.JitBackend.CUDA):
        raise MistrayError(
            f"variant '{variant}': Dr.Jit finds no NVIDIA GPU with a recent driver; "
            f"'mistray doctor' says what it needs; or use {DEFAULT_VARIANT}"
        )

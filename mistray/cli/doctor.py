"""Report on which requirements of mistray this machine meets, which are missing, and how to get them.

It works even if packages are missing or broken: Mitsuba and Dr.Jit are loaded in subprocesses only, where an abort does
no harm.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib.metadata
import json
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from mistray._libatomic import NAME as LIBATOMIC
from mistray._libatomic import provide_libatomic
from mistray._llvm import find_llvm
from mistray._mitsuba_compat import import_remedy
from mistray._variant import DEFAULT_VARIANT
from mistray.errors import MistrayError

DISTRIBUTION = "mistray"
PROBE_TIMEOUT_S = 120.0
# What Dr.Jit 1.5 and Mitsuba 3.9 ask for; with the drivers of CUDA 12.7 Dr.Jit refuses OptiX
OLDEST_CUDA, REFUSED_CUDA = (12, 2), (12, 7)
OLDEST_CAPABILITY = (7, 5)
GPU_NEEDS = (
    "for the cuda variants only: an NVIDIA GPU of compute capability 7.5 or newer (GeForce RTX 20, T4 and later) with "
    "its driver, 535 or newer, and OptiX"
)

# What each extra of pyproject.toml adds for a user; the others are for developers
EXTRAS = {
    "batoid": "lens files of batoid, and its telescopes",
    "cad": "mechanical parts from STEP, STL, OBJ, PLY and glTF files",
    "distributed": "traces by the workers of a dask cluster",
    "images": "irradiance as EXR and FITS files",
    "llvm": "libLLVM without root, for Linux on x86-64",
    "nlopt": "further methods of mistray optimize",
    "pdf": "reports as PDF",
    "tables": "tables as Parquet files",
    "validate": "the programs that mistray validate asks",
    "view": "scenes, rays and paths in 3-D, by mistray view",
    "widget": "the live explorer in Jupyter",
    "xarray": "traces and PSTs as xarray data sets, for NetCDF and Zarr",
}
# What `mistray` loads before Dr.Jit, as a process without it must do
_PRELOAD = "import ctypes, sys\nfor path in sys.argv[2:]: ctypes.CDLL(path)\n"
# Minimum and maximum abort LLVM 15 and 16; Float64 sums and a ray against a mesh are what every trace uses.
_PROBE = """
import mitsuba as mi
for variant in sys.argv[1].split(","):
    try:
        mi.set_variant(variant)
        import drjit as dr
        x = dr.linspace(mi.Float, 0, 1, 16)
        y = mi.Float64(dr.maximum(dr.minimum(x, 0.75), 0.25))
        scene = mi.load_dict({"type": "scene", "plane": {"type": "rectangle"}})
        hit = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(x * 0.5, 0, 1), mi.Vector3f(0, 0, -1)))
        right = abs(dr.sum(y)[0] - 8) < 1e-5 and dr.all(hit.is_valid())
        print(variant, "ok" if right else "gives wrong numbers", flush=True)
    except Exception as error:
        print(variant, " ".join(str(error).split()), flush=True)
"""


@dataclass(frozen=True)
class Check:
    """
    One line of the report: a requirement of mistray and its state on this machine.

    Attributes
    ----------
    name : str
        Name of the requirement.
    status : {"ok", "missing", "optional"}
        Result of the check. "missing": required, but absent, broken or of the wrong version. "optional": absent, but
        mistray works without it.
    found : str
        Description of what was found.
    remedy : str
        Advice on how to get what is missing; empty if nothing is.
    """

    name: str
    status: Literal["ok", "missing", "optional"]
    found: str
    remedy: str = ""


def report() -> list[Check]:
    """
    Check the requirements of mistray on this machine.

    Returns
    -------
    list of Check
        Checks of Python, required packages, libLLVM, the GPU, the Mitsuba variants and the optional extras. This takes
        a few seconds, because each variant runs a small kernel.
    """
    checks = [*_packages(), _llvm(), *_libatomic()]
    mitsuba = next((check for check in checks if check.name == "mitsuba"), None)
    cuda = _cuda()
    checks.append(cuda)
    if mitsuba is None or mitsuba.status == "ok":
        checks += _variants(cuda.status == "ok")
    return [*checks, *_extras()]


def show(checks: list[Check], as_json: bool = False, request: Mapping[str, Any] | None = None) -> int:
    """
    Print a report, as a table or as JSON.

    Parameters
    ----------
    checks : list of Check
        Checks from `report`.
    as_json : bool
        Whether to print JSON instead of a table.
    request : mapping, optional
        Request of the command, which the JSON repeats.

    Returns
    -------
    int
        Exit code: 0, or 1 if something required is missing.
    """
    missing = [check.name for check in checks if check.status == "missing"]
    if as_json:
        found = {"checks": [asdict(check) for check in checks], "missing": missing}
        print(json.dumps(found | {"request": dict(request or {}), "files": []}, indent=2))
    else:
        width = max(len(check.name) for check in checks)
        for check in checks:
            remedy = f"\n{'':{width + 12}}→ {check.remedy}" if check.remedy else ""
            print(f"{check.status:9} {check.name:{width}}  {check.found}{remedy}")
        print(f"\nmissing: {', '.join(missing)}" if missing else "\nmistray can run on this machine.")
    return 1 if missing else 0


def _packages() -> Iterator[Check]:
    try:
        metadata = importlib.metadata.metadata(DISTRIBUTION)
        from packaging.requirements import Requirement
        from packaging.specifiers import SpecifierSet
    except importlib.metadata.PackageNotFoundError:
        yield Check(DISTRIBUTION, "missing", "not installed", "pip install -e . in the repository")
        return
    except ImportError:
        yield Check("packaging", "missing", "not installed", "pip install packaging")
        return
    python = platform.python_version()
    wanted = SpecifierSet(metadata["Requires-Python"])
    if wanted.contains(python):
        yield Check("python", "ok", f"{python} ({sys.executable})")
    else:
        yield Check("python", "missing", f"{python}, needs {wanted}", f"install a Python {wanted}")
    yield Check(DISTRIBUTION, "ok", metadata["Version"])
    for text in metadata.get_all("Requires-Dist") or []:
        requirement = Requirement(text)
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            found = _installed_version(requirement.name)
            if found is None or not requirement.specifier.contains(found, prereleases=True):
                needs = f", needs {requirement.specifier}" if found else ""
                yield Check(requirement.name, "missing", f"{found or 'not installed'}{needs}", f"pip install '{text}'")
            else:
                yield Check(requirement.name, "ok", found)


def _extras() -> Iterator[Check]:
    try:
        metadata = importlib.metadata.metadata(DISTRIBUTION)
        from packaging.requirements import Requirement
    except ImportError:  # PackageNotFoundError is one; `_packages` has reported it
        return
    requirements = [Requirement(text) for text in metadata.get_all("Requires-Dist") or []]
    for extra, adds in EXTRAS.items():
        absent = []
        present = []
        for requirement in requirements:
            marker = requirement.marker
            if marker is None or marker.evaluate({"extra": ""}) or not marker.evaluate({"extra": extra}):
                continue
            found = _installed_version(requirement.name)
            if found is not None and requirement.specifier.contains(found, prereleases=True):
                present.append(f"{requirement.name} {found}")
            else:
                absent.append(f"{requirement.name}{requirement.specifier}")
        if absent:
            remedy = f"pip install '{DISTRIBUTION}[{extra}]', which brings {', '.join(absent)}"
            yield Check(f"extra: {extra}", "optional", f"not installed, would add {adds}", remedy)
        elif present:  # neither for an extra that is for other systems
            yield Check(f"extra: {extra}", "ok", f"{adds} ({', '.join(present)})")


def _installed_version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _llvm() -> Check:
    try:
        llvm = find_llvm()
    except MistrayError as error:
        problem, _, remedy = str(error).partition("; ")
        return Check("libLLVM", "missing", problem, remedy)
    if os.environ.get("DRJIT_LIBLLVM_PATH"):
        return Check("libLLVM", "ok", f"{llvm}, named by DRJIT_LIBLLVM_PATH")
    return Check("libLLVM", "ok", f"{llvm}, of the {'extra llvm' if llvm.needs else 'system'}")


def _libatomic() -> Iterator[Check]:
    """Yield a check that libatomic is missing but replaced, if mistray provides a substitute on this machine."""
    if provide_libatomic():
        yield Check("libatomic", "ok", f"no {LIBATOMIC}; mistray brings the one function of it that Dr.Jit calls")


def _cuda() -> Check:
    """Return the check of the GPU: whether its NVIDIA driver offers the CUDA and OptiX versions that Dr.Jit needs."""
    try:
        driver = _library("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1", "DRJIT_LIBCUDA_PATH")
    except OSError:
        return Check("NVIDIA GPU", "optional", "no driver", GPU_NEEDS)
    cuda, count = ctypes.c_int(0), ctypes.c_int(0)
    if driver.cuInit(0) or driver.cuDeviceGetCount(ctypes.byref(count)) or count.value == 0:
        return Check("NVIDIA GPU", "optional", "a driver, but no GPU", GPU_NEEDS)
    driver.cuDriverGetVersion(ctypes.byref(cuda))
    version = divmod(cuda.value // 10, 100)  # 12040 is 12.4
    gpus = [_gpu(driver, number) for number in range(count.value)]
    found = f"{', '.join(map(str, gpus))}; driver for CUDA {version[0]}.{version[1]}"
    if max(gpu.capability for gpu in gpus) < OLDEST_CAPABILITY:
        return Check("NVIDIA GPU", "optional", f"{found}: too old a GPU", GPU_NEEDS)
    if version < OLDEST_CUDA or version == REFUSED_CUDA:
        which = "which miscompiles" if version == REFUSED_CUDA else "too old"
        return Check("NVIDIA GPU", "optional", f"{found}, {which}", "update the driver to version 570 or newer")
    try:
        if sys.platform != "win32":  # there it lies in a folder of the driver that only Dr.Jit looks for
            _library("libnvoptix.so.1", "DRJIT_LIBOPTIX_PATH")
    except OSError:
        remedy = (
            "install the whole driver, which brings libnvoptix.so.1 (Debian, Ubuntu: libnvidia-gl-VERSION); "
            "start a container with NVIDIA_DRIVER_CAPABILITIES=all"
        )
        return Check("NVIDIA GPU", "optional", f"{found}, without OptiX", remedy)
    return Check("NVIDIA GPU", "ok", found)


@dataclass(frozen=True)
class _Gpu:
    """Properties of a GPU: its name, compute capability (major, minor) and memory, bytes."""

    name: str
    capability: tuple[int, int]
    memory: int

    def __str__(self) -> str:
        major, minor = self.capability
        return f"{self.name} (compute capability {major}.{minor}, {self.memory / 2**30:.0f} GiB)"


def _gpu(driver: ctypes.CDLL, number: int) -> _Gpu:
    """Return name, compute capability and memory of the GPU of index `number`, as its driver states them."""
    device, name, memory = ctypes.c_int(0), ctypes.create_string_buffer(100), ctypes.c_size_t(0)
    driver.cuDeviceGet(ctypes.byref(device), number)
    driver.cuDeviceGetName(name, len(name), device)
    driver.cuDeviceTotalMem_v2(ctypes.byref(memory), device)
    major, minor = ctypes.c_int(0), ctypes.c_int(0)
    for value, attribute in ((major, 75), (minor, 76)):  # CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR, _MINOR
        driver.cuDeviceGetAttribute(ctypes.byref(value), attribute, device)
    return _Gpu(name.value.decode(), (major.value, minor.value), memory.value)


def _library(name: str, variable: str) -> ctypes.CDLL:
    """
    Load and return a library of the GPU driver, found as Dr.Jit does: by an environment variable, else its name.

    Raises
    ------
    OSError
        If the library cannot be loaded.
    """
    return ctypes.CDLL(os.environ.get(variable) or name)


def _variants(with_cuda: bool) -> list[Check]:
    """
    Run a small kernel in each JIT variant of Mitsuba, each backend in its own process; return the checks.

    Variants for CUDA are run only if `with_cuda`. If Mitsuba cannot be imported, there is one check that says so.
    """
    environment = dict(os.environ)
    before = [path for path in (provide_libatomic(),) if path]
    with contextlib.suppress(MistrayError):  # reported by _llvm; the kernels show what Dr.Jit makes of it
        llvm = find_llvm()
        environment["DRJIT_LIBLLVM_PATH"] = llvm.path
        before += llvm.needs
    listing = _run_python("import mitsuba as mi; print(','.join(mi.variants()))", "", before, environment)
    if listing.returncode:
        reason = _reason(listing)
        return [Check("variants", "missing", f"mitsuba cannot be imported: {reason}", import_remedy(reason))]
    backends: dict[str, list[str]] = {}
    for variant in listing.stdout.split()[-1].split(","):
        backends.setdefault(variant.partition("_")[0], []).append(variant)
    checks = []
    for backend, variants in backends.items():
        if backend == "scalar" or (backend == "cuda" and not with_cuda):
            continue
        run = _run_python(_PROBE, ",".join(variants), before, environment)
        results = dict(line.split(" ", 1) for line in run.stdout.splitlines() if line.partition(" ")[0] in variants)
        for variant in variants:
            result = results.get(variant)
            if result == "ok":
                checks.append(Check(variant, "ok", "runs"))
                continue
            status: Literal["missing", "optional"] = "missing" if variant == DEFAULT_VARIANT else "optional"
            remedy = "see libLLVM" if backend == "llvm" else "update the driver of the GPU"
            checks.append(Check(variant, status, result or f"died: {_reason(run)}", remedy))
    return checks


def _run_python(
    code: str, argument: str, before: list[str], environment: dict[str, str]
) -> subprocess.CompletedProcess[str]:
    """
    Run Python code in its own process, which first loads the libraries at paths `before`; return its outcome.

    The code finds `argument` in ``sys.argv[1]``. A process that gives no answer within `PROBE_TIMEOUT_S` is ended, and
    counts as ended by SIGTERM.
    """
    command = [sys.executable, "-c", _PRELOAD + code, argument, *before]
    try:
        return subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=PROBE_TIMEOUT_S, errors="replace"
        )
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, -signal.SIGTERM, "", f"no answer in {PROBE_TIMEOUT_S:g} s")


def _reason(run: subprocess.CompletedProcess[str]) -> str:
    """Return a line that says why a process failed: the signal or exit code, and its first error message."""
    lines = [line.strip() for line in run.stderr.splitlines() if line.strip()]
    telling = [line for line in lines if "rror" in line or "LLVM" in line] or lines[-1:]
    ended = signal.Signals(-run.returncode).name if run.returncode < 0 else f"exit code {run.returncode}"
    return ": ".join([ended, *(line[:200] for line in telling[:1])])

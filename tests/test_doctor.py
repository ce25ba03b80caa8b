"""`mistray doctor` reports what is there, survives what is broken and says how to get what is missing."""

import ctypes
import importlib.metadata
import json
import re
import sys
import tomllib
from pathlib import Path
from unittest.mock import Mock

import pytest
from packaging.requirements import Requirement

from mistray._llvm import Llvm
from mistray.cli import doctor
from mistray.errors import MistrayError

ROOT = Path(__file__).parents[1]


def by_name(checks):
    return {check.name: check for check in checks}


def test_this_machine_is_complete(capsys):
    assert doctor.show(doctor.report(), as_json=True) == 0
    checks = {check["name"]: check for check in json.loads(capsys.readouterr().out)["checks"]}
    for line in [line for line in importlib.metadata.requires("mistray") if "extra ==" not in line]:
        assert checks[Requirement(line).name]["status"] == "ok"
    assert checks["llvm_ad_rgb"] == {"name": "llvm_ad_rgb", "status": "ok", "found": "runs", "remedy": ""}
    assert checks["libLLVM"]["found"].startswith("LLVM ")
    assert {"python", "NVIDIA GPU", "extra: batoid"} <= set(checks)


def test_missing_and_wrong_packages(monkeypatch):
    true_version = importlib.metadata.version

    def version(name):
        if name in ("tqdm", "batoid"):
            raise importlib.metadata.PackageNotFoundError(name)
        return "3.10.0" if name == "mitsuba" else true_version(name)

    monkeypatch.setattr(importlib.metadata, "version", version)
    checks = by_name([*doctor._packages(), *doctor._extras()])
    assert (checks["tqdm"].status, checks["tqdm"].remedy[:17]) == ("missing", "pip install 'tqdm")
    assert (checks["mitsuba"].status, checks["mitsuba"].found) == ("missing", "3.10.0, needs <3.10,>=3.9.1")
    extra = checks["extra: batoid"]
    assert (extra.status, extra.remedy.partition(",")[0]) == ("optional", "pip install 'mistray[batoid]'")
    assert "would add lens files of batoid" in extra.found


def test_extras_are_those_of_users():
    """Every extra is a developers' or says what it adds; the page about installing has the same sentences."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    developers = {"notebooks", "scatmech"}
    assert set(project["optional-dependencies"]) == developers | doctor.EXTRAS.keys()
    assert not developers & doctor.EXTRAS.keys()
    page = (ROOT / "docs" / "install.md").read_text(encoding="utf-8").partition("## Extras")[2]
    rows = re.findall(r"^\| `(\w+)` \| (.*) \|$", page, re.MULTILINE)
    assert {name: adds.replace("`", "") for name, adds in rows} == doctor.EXTRAS


@pytest.mark.parametrize(
    ("needs", "variable", "origin"),
    [((), "", "of the system"), (("a",), "", "of the extra llvm"), (("a",), "/b", "named by DRJIT_LIBLLVM_PATH")],
)
def test_whose_llvm_is_used(monkeypatch, needs, variable, origin):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", variable)
    monkeypatch.setattr(doctor, "find_llvm", lambda: Llvm("/b", (23, 1, 4), needs))
    assert doctor._llvm().found == f"LLVM 23.1.4 (/b), {origin}"


def test_libatomic_is_named_where_it_is_missing(monkeypatch):
    assert list(doctor._libatomic()) == []
    monkeypatch.setattr(doctor, "provide_libatomic", lambda: "/proc/1/fd/3")
    (check,) = doctor._libatomic()
    assert (check.name, check.status) == ("libatomic", "ok")


def test_no_llvm(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "_variants", lambda with_cuda: [])
    monkeypatch.setattr(doctor, "find_llvm", Mock(side_effect=MistrayError("no libLLVM; install one")))
    assert doctor.show(doctor.report()) == 1
    printed = capsys.readouterr().out
    assert all(part in printed for part in ("missing   libLLVM", "→ install one"))
    assert printed.rstrip().endswith("missing: libLLVM")


def test_a_variant_that_does_not_run(monkeypatch):
    for code, found in (
        ("import os; os.abort()", "died: SIGABRT"),
        ("raise SystemExit('LLVM is odd')", "died: exit code 1: LLVM is odd"),
        ("print('llvm_ad_rgb gives wrong numbers')", "gives wrong numbers"),
    ):
        monkeypatch.setattr(doctor, "_PROBE", code)
        check = by_name(doctor._variants(with_cuda=False))["llvm_ad_rgb"]
        assert (check.status, check.found) == ("missing", found)


class Driver:
    """Answers like the NVIDIA driver's library: CUDA version × 1000, and (name, capability, bytes) of each GPU."""

    def __init__(self, cuda: int, *gpus: tuple[str, tuple[int, int], int]) -> None:
        self.gpus = gpus
        self.cuInit = lambda flags: 0
        self.cuDeviceGetCount = lambda count: self.put(count, len(gpus))
        self.cuDriverGetVersion = lambda version: self.put(version, cuda)
        self.cuDeviceGet = self.put
        self.cuDeviceTotalMem_v2 = lambda memory, device: self.put(memory, gpus[device.value][2])

    def put(self, place, value):
        place._obj.value = value
        return 0

    def cuDeviceGetName(self, name, size, device):
        name.value = self.gpus[device.value][0].encode()
        return 0

    def cuDeviceGetAttribute(self, value, attribute, device):
        return self.put(value, self.gpus[device.value][1][{75: 0, 76: 1}[attribute]])


H100, K80 = ("NVIDIA H100", (9, 0), 80 << 30), ("Tesla K80", (3, 7), 12 << 30)


@pytest.mark.skipif(sys.platform == "win32", reason="OptiX is looked for elsewhere there")
@pytest.mark.parametrize(
    ("driver", "optix", "status", "words"),
    [
        (None, True, "optional", ("no driver", "compute capability 7.5", "535 or newer")),
        (Driver(12040), True, "optional", ("a driver, but no GPU", "compute capability 7.5")),
        (Driver(12040, K80, H100), True, "ok", ("Tesla K80 (compute capability 3.7, 12 GiB), NVIDIA H100",)),
        (Driver(12040, K80), True, "optional", ("too old a GPU", "compute capability 7.5")),
        (Driver(12010, H100), True, "optional", ("CUDA 12.1, too old", "update the driver to version 570")),
        (Driver(12070, H100), True, "optional", ("CUDA 12.7, which miscompiles", "version 570")),
        (Driver(12040, H100), False, "optional", ("without OptiX", "NVIDIA_DRIVER_CAPABILITIES=all")),
    ],
)
def test_what_a_gpu_needs(monkeypatch, driver, optix, status, words):
    """The driver of a machine without one is faked; what the true one answers is in the tests that need a GPU."""

    def library(name):
        found = {"libcuda.so.1": driver, "libnvoptix.so.1": optix}[name]
        if not found:
            raise OSError(f"{name}: cannot open shared object file")
        return found

    monkeypatch.setenv("DRJIT_LIBCUDA_PATH", "/nowhere/libcuda.so")
    assert doctor._cuda().found == "no driver"
    monkeypatch.delenv("DRJIT_LIBCUDA_PATH")
    monkeypatch.delenv("DRJIT_LIBOPTIX_PATH", raising=False)
    monkeypatch.setattr(ctypes, "CDLL", library)
    check = doctor._cuda()
    assert check.status == status
    assert bool(check.remedy) == (status != "ok")
    for word in words:
        assert word in f"{check.found}; {check.remedy}"


@pytest.mark.gpu
def test_the_gpu_runs_every_variant():
    checks = by_name(doctor.report())
    assert {check.status for name, check in checks.items() if name.startswith(("cuda_", "NVIDIA"))} == {"ok"}

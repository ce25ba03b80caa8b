"""`mistray doctor` reports what is there, survives what is broken and says how to get what is missing."""

from __future__ import annotations

import importlib.metadata
import json

import pytest

from mistray import doctor
from mistray.errors import MistrayError


def by_name(checks):
    return {check.name: check for check in checks}


def test_this_machine_is_complete(capsys):
    assert doctor.show(doctor.report(), as_json=True) == 0
    checks = {check["name"]: check for check in json.loads(capsys.readouterr().out)["checks"]}
    required = [line for line in importlib.metadata.requires("mistray") if "extra ==" not in line]
    for line in required:
        name = line.split("=")[0].rstrip("<>!~ ")
        assert checks[name]["status"] == "ok"
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
    assert checks["tqdm"].status == "missing"
    assert checks["tqdm"].remedy.startswith("pip install 'tqdm")
    assert checks["mitsuba"].status == "missing"
    assert checks["mitsuba"].found == "3.10.0, needs ==3.9.*"
    assert checks["extra: batoid"].status == "optional"
    assert checks["extra: batoid"].remedy == "pip install 'mistray[batoid]'"


def test_no_llvm(monkeypatch, capsys):
    def find_llvm():
        raise MistrayError("no libLLVM of version 17 or newer; install one")

    monkeypatch.setattr(doctor, "find_llvm", find_llvm)
    monkeypatch.setattr(doctor, "_variants", lambda with_cuda: [])
    assert doctor.show(doctor.report()) == 1
    printed = capsys.readouterr().out
    assert "missing   libLLVM" in printed
    assert "→ install one" in printed
    assert printed.rstrip().endswith("missing: libLLVM")


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("import os; os.abort()", "died: SIGABRT"),
        ("raise SystemExit('LLVM is odd')", "died: exit code 1: LLVM is odd"),
        ("print('llvm_ad_rgb gives wrong numbers')", "gives wrong numbers"),
    ],
)
def test_a_variant_that_does_not_run(monkeypatch, code, found):
    monkeypatch.setattr(doctor, "_PROBE", code)
    check = by_name(doctor._variants(with_cuda=False))["llvm_ad_rgb"]
    assert (check.status, check.found) == ("missing", found)


def test_broken_mitsuba(monkeypatch, tmp_path):
    (tmp_path / "mitsuba.py").write_text("raise ImportError('drjit is of another version')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (check,) = doctor._variants(with_cuda=False)
    assert check.status == "missing"
    assert "drjit is of another version" in check.found

"""The machine and the versions that a row was measured with."""

from __future__ import annotations

import platform
from functools import cache
from pathlib import Path

import drjit as dr
import mitsuba as mi

import mistray


def _cpu_information() -> list[str]:
    file = Path("/proc/cpuinfo")
    return file.read_text().splitlines() if file.exists() else []


@cache
def machine() -> str:
    """The processor, the number of its threads that Dr.Jit uses, and the versions."""
    mistray.ensure_variant()
    model = next(
        (line.split(":", 1)[1].strip() for line in _cpu_information() if "model name" in line),
        platform.processor(),
    )
    llvm = ".".join(str(part) for part in dr.detail.llvm_version())
    versions = f"Mitsuba {mi.__version__}, Dr.Jit {dr.__version__}, LLVM {llvm}, Python {platform.python_version()}"
    return f"{model}, {dr.thread_count()} threads, {mi.variant()}, {versions}"

"""Every JIT variant of Mitsuba registers the plugins and traces the same paths, alone and after a switch."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

CODE = """
import mistray, mitsuba as mi
for variant in {variants!r}:
    mi.set_variant(variant)
    t = mistray.trace(mistray.load("plate"), rays=1000)
    print(mi.variant(), len(t.paths), round(t.energy.detected_W / t.energy.launched_W, 6))
"""


def run(*variants: str) -> list[str]:
    done = subprocess.run([sys.executable, "-c", CODE.format(variants=variants)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return re.findall(r"(?:llvm|cuda)_ad_\w+ \d+ [\d.]+", done.stdout)  # Mitsuba's own messages lie between


@pytest.mark.long
@pytest.mark.parametrize(
    "variant",
    ["llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_mono_polarized", "llvm_ad_spectral", "llvm_ad_spectral_polarized"],
)
def test_variant(variant):
    assert run(variant) == [f"{variant} 2 0.923075"]


def test_switches_in_one_process():
    order = ("llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_mono", "llvm_ad_rgb")
    assert run(*order) == [f"{variant} 2 0.923075" for variant in order]


@pytest.mark.gpu
def test_cuda():
    assert run("cuda_ad_rgb") == ["cuda_ad_rgb 2 0.923075"]


@pytest.mark.long
def test_the_kernel_is_made_for_no_backend() -> None:
    """The same source runs by LLVM and on a GPU; only `_variant` settles and asks for a backend."""
    root = Path(__file__).parents[2]
    marks = (r"\b(?:dr|mi)\.(?:llvm|cuda|thread_count)\b", "llvm_version|reorder_threads", r"\.Expand\b")
    own = re.compile("|".join((*marks, r"(?:from|import) (?:drjit|mitsuba)\.")))
    files = [file for folder in ("mistray", "plugins") for file in (root / folder).rglob("*.py")]
    assert {str(file.relative_to(root)) for file in files if own.search(file.read_text())} <= {"mistray/_variant.py"}

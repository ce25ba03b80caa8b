"""Every JIT variant of Mitsuba registers the plugins and traces the same paths, alone and after a switch."""

from __future__ import annotations

import re
import subprocess
import sys

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

"""Every JIT variant of Mitsuba registers the plugins and traces the same paths, alone and after a switch."""

from __future__ import annotations

import ast
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


def backend_names(code: str) -> set[str]:
    """Names of Dr.Jit and Mitsuba that exist for one backend only, or mean something for one only."""
    own = {"llvm", "cuda", "thread_count", "llvm_version", "Expand", "reorder_threads"}
    found = set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Attribute):
            found |= {node.attr} & own
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names] + [getattr(node, "module", None) or ""]
            found |= {name for name in names if name.startswith(("drjit.", "mitsuba."))}
    return found


@pytest.mark.long
def test_the_kernel_is_made_for_no_backend() -> None:
    """The same source runs by LLVM and on a GPU; only `_variant` settles and asks for a backend."""
    root = Path(__file__).parents[2]
    files = [file for folder in ("mistray", "plugins") for file in (root / folder).rglob("*.py")]
    found = {str(file.relative_to(root)): names for file in files if (names := backend_names(file.read_text()))}
    assert set(found) <= {"mistray/_variant.py"}, found
    assert backend_names("x = dr.llvm.ad.Float(0)") == {"llvm"}
    assert backend_names("from drjit.cuda import Float") == {"drjit.cuda"}
    assert backend_names("dr.scatter_reduce(op, x, y, i, mode=dr.ReduceMode.Expand)") == {"Expand"}

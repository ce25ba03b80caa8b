"""Converter from STEP to GLB, as a separate program so that a damaged file can neither crash nor block the caller.

python step_process.py STEP GLB TOLERANCE_MM ANGLE_RAD SECONDS
"""

from __future__ import annotations

import contextlib
import math
import sys

MEMORY_BYTES = 8 << 30


def main(source: str, target: str, tolerance_mm: str, angle_rad: str, seconds: str) -> int:
    """
    Convert a STEP file to glTF within `seconds` of processor time; return the exit status.

    It is 0 on success, 3 if cascadio is missing, and 4 if cascadio cannot read the file.
    """
    with contextlib.suppress(ImportError, ValueError, OSError):  # not on every system
        import resource

        limit = math.ceil(float(seconds))
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    sys.modules["trimesh"] = None  # type: ignore[assignment]  # cascadio does without it, and starts three times as fast
    try:
        import cascadio
    except ImportError:
        return 3
    failed = cascadio.step_to_glb(
        source,
        target,
        tol_linear=float(tolerance_mm),
        tol_angular=float(angle_rad),
        tol_relative=False,
        merge_primitives=True,
        use_parallel=False,
        include_brep=True,
    )
    return 4 if failed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

"""
Faults that are put into a copy of the program, one at a time: `python tests/mutations.py [NAME ...]`.

A fault is caught if a test fails that `make test` runs, in the files named beside it. The run says which, and ends with
exit code 1 if a fault is not caught.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]


class Fault(NamedTuple):
    """One line of the program, and what it becomes."""

    file: str
    right: str
    wrong: str
    tests: str  # files or folders where it should show, below tests


FAULTS = {
    "fresnel s and p": Fault(
        "mistray/physics/fresnel.py", "return r_s, r_p", "return r_p, r_s", "physics trace kernel"
    ),
    "phase of a thin film": Fault(
        "mistray/physics/thinfilm.py",
        "sin, cos = ops.sincos(phase)",
        "sin, cos = ops.sincos(-phase)",
        "physics coatings",
    ),
    "snell's ratio": Fault(
        "mistray/kernel/interaction.py", "eta, opaque = n_i / n_t,", "eta, opaque = n_t / n_i,", "kernel trace"
    ),
    "solid angle of the PST": Fault(
        "mistray/execute/backward.py",
        "np.pi / self.grid.solid_angle[:, None]",
        "2 / self.grid.solid_angle[:, None]",
        "execute validation analysis",
    ),
    "cosine of the PST": Fault(
        "mistray/analysis/pst/result.py",
        "cosine = np.maximum(self.grid.mean_cosine, np.finfo(float).tiny)",
        "cosine = np.ones(len(self.grid.mean_cosine))",
        "analysis validation",
    ),
    "pdf ratio of a connection": Fault(
        "mistray/kernel/pdf_ratios.py",
        "begun = n2 * it.cos_i / (cos_out * pdf_rev * state",
        "begun = n2 * it.cos_i * pdf_rev / (cos_out * state",
        "kernel execute sampling analysis validation",
    ),
    "weight of roulette": Fault(
        "mistray/kernel/branching.py",
        "dr.select(u * limit < v, limit, 0)",
        "dr.select(u * limit < v, v, 0)",
        "kernel trace sampling",
    ),
    "normalisation of a lobe": Fault(
        "mistray/physics/abg.py",
        "return float(math.pi * a / b * hyp2f1(",
        "return float(2 * math.pi * a / b * hyp2f1(",
        "physics scatter",
    ),
    "beer-lambert": Fault(
        "mistray/surfaces/optics.py",
        "left = flux * dr.exp(-coefficient",
        "left = flux * dr.exp(-2 * coefficient",
        "trace kernel surfaces",
    ),
    "boundary kernel": Fault(
        "mistray/gradients/edges.py",
        "(4 - 6 * delta / width) / width",
        "0.75 * (4 - 6 * delta / width) / width",
        "gradients",
    ),
    "sign of the replay": Fault(
        "mistray/gradients/path_replay.py",
        "return value - dr.detach(value)",
        "return dr.detach(value) - value",
        "test_every_derivative.py gradients",
    ),
    "area of the pupil over that of the detector": Fault(
        "mistray/analyses/study/analysis.py",
        "transmittance * first.pupil_area_mm2 / area",
        "transmittance * area / first.pupil_area_mm2",
        "analysis test_every_command.py",
    ),
    "emissivity": Fault(
        "mistray/sampling/warm/emissivity.py",
        "else 1 - it.R - it.T",
        "else 1 - it.R",
        "sampling analysis test_every_command.py",
    ),
    "emissivity of a scattering surface": Fault(
        "mistray/kernel/scatter_shares.py",
        "absorbed = 1 - it.R * back.kept - it.T * along.kept - back.scattered - along.scattered",
        "absorbed = 1 - it.R * back.kept - it.T * along.kept",
        "analysis/test_thermal.py",
    ),
    # Chosen by a reader who had not seen the tests
    "weights of wavelengths in an image": Fault(
        "mistray/analyses/image/result.py",
        "flux = np.array([line.weight * line.pupil.total for line in self.lines])",
        "flux = np.array([line.weight for line in self.lines])",
        "analysis",
    ),
    "unit of an anamorphic asphere": Fault(
        "mistray/io/codev/sags.py", "unit ** (1 - 2 * n)", "unit ** (1 - n)", "prescription test_cli_import.py"
    ),
    "error of a NETD": Fault(
        "mistray/analyses/thermal/netd.py", "a / (2 * flux) - b / rise.value", "a / flux - b / rise.value", "analysis"
    ),
}


def caught(fault: Fault) -> str:
    """The test that fails, or nothing."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "mistray"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", ".venv*", "out", "__pycache__", ".*_cache"))
        for package in ("plugins", "scenes"):  # installed from beside the package; those of the copy count
            (copy / "mistray" / package).symlink_to(copy / package)
        path = copy / fault.file
        text = path.read_text(encoding="utf-8")
        if text.count(fault.right) != 1:
            raise SystemExit(
                f"'{fault.right}' is {text.count(fault.right)} times in {fault.file}; mend tests/mutations.py"
            )
        path.write_text(text.replace(fault.right, fault.wrong), encoding="utf-8")
        options = ["-x", "-q", "--no-header", "-p", "no:cacheprovider", "-n", "2", "--dist", "loadfile"]
        tests = [f"tests/{name}" for name in fault.tests.split()]
        command = [sys.executable, "-m", "pytest", *options, "-m", "not (gpu or slow or long)", *tests]
        done = subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1, 2):
        raise SystemExit(done.stdout + done.stderr)
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    return found[1] if found else ""


def main(names: list[str]) -> int:
    survived = 0
    for name in names or FAULTS:
        by = caught(FAULTS[name])
        survived += not by
        print(f"{name}: {'caught by ' + by if by else 'NOT CAUGHT'}", flush=True)
    return min(survived, 1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

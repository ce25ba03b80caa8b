"""What the walls of the phone camera's barrel are worth: the gradient of the light that they scatter, and a search.

The light comes from 60° to 80° and is scattered once. First the derivatives by the radii of the barrel's cones and by
the wall of the stop, and what a report on that camera advises (a cylinder instead of the cone behind the stop, a thin
stop) would change if they held so far; then the study phone_barrel.toml, whose search knows nothing of that advice. Run
from anywhere; it takes a quarter of an hour or more:
python examples/phone_barrel.py [folder for the results]
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import mitsuba as mi
import numpy as np

import mistray
from mistray.analyses.optimize.page import write_optimization
from mistray.analyses.optimize.tables import report_text
from mistray.optimize import Gradient, optimize, pst_band

SCENE = "phone_camera_scatter"
STUDY = Path(__file__).with_name("phone_barrel.toml")
RAYS = 30_000
CONES = [f"barrel_{number}_cone.{end}" for number in (1, 2, 3, 4) for end in ("r0", "r1")]
# What the report advises, as changes in mm
ADVICE = {
    "cylinder behind the stop, as wide as the rear end of the cone": {"barrel_1_cone.r0": 0.189, "stop_rear.r1": 0.189},
    "cylinder behind the stop, as wide as the front end of the cone": {"barrel_1_cone.r1": -0.189},
    "wall of the stop of 0.01 mm instead of 0.075 mm": {"stop_wall.z0": 0.065},
}


def walls(rays: int = RAYS) -> Gradient:
    """Light from 60° to 80° that is scattered once and nowhere reflected, differentiated by the walls."""
    scene = mistray.load(SCENE)
    dark = pst_band(scene, 60, 80, "single_scatter", quantity="integral", rays=rays, max_scatters=1, max_reflections=0)
    return mistray.gradient(dark, mi.traverse(scene), keys=[*CONES, "stop_rear.r1", "stop_wall.z0"])


def predicted(found: Gradient, changes: Mapping[str, float]) -> tuple[float, float]:
    """What changes of parameters (key → mm) do to ln(metric) if its derivatives hold so far, with standard error."""
    keys = list(changes)
    step = np.array([changes[key] for key in keys])
    slope = np.array([found.gradient[key][0] for key in keys])
    return float(step @ slope / found.value), float(np.sqrt(step @ found.covariance(keys) @ step) / found.value)


def main(folder: Path) -> None:
    """Differentiate, search and write the results."""
    found = walls()
    print("d ln(metric) / d parameter, 1/mm")
    for key in found.gradient:
        slope, error = predicted(found, {key: 1.0})
        print(f"{key:18s} {slope:+8.2f} ± {error:.2f}")
    for name, changes in ADVICE.items():
        change, error = predicted(found, changes)
        print(f"{name}: {100 * change:+.0f} ± {100 * error:.0f} %")
    result = optimize(SCENE, STUDY, checkpoint=folder / "checkpoint.json")
    write_optimization(result, folder)
    print(report_text(result))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/phone_barrel"))

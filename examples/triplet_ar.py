"""Antireflection coatings of the Cooke triplet, made for its ghosts, against a quarter wave of MgF2 and a preset.

The study is triplet_ar.toml; it starts from the three-layer preset. Run from anywhere; on two cores it takes minutes:
python examples/triplet_ar.py [folder for the results]
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import mistray
from mistray.analyses.optimize.page import write_optimization
from mistray.analyses.optimize.tables import comparison_table, report_text
from mistray.coatings import preset
from mistray.optimize import Comparison, compare, measure, optimize, read_study
from mistray.scene.load import find
from mistray.scene.recoat import SharedCoating, write_recoated

SCENE = "cooke_triplet"
STUDY = Path(__file__).with_name("triplet_ar.toml")


def against_quarter_wave(scene_file: Path) -> Comparison:
    """Ghosts with a quarter wave of MgF2 on every surface, before, and with the coatings of a scene, after."""
    study = read_study(STUDY)
    surfaces = tuple(name for group in study.coatings for name in group.surfaces or ())
    with tempfile.TemporaryDirectory() as folder:
        coating = SharedCoating("mgf2", preset("mgf2_quarter_wave"), surfaces)
        before = mistray.load(write_recoated(find(SCENE), [coating], Path(folder) / "scene.xml"))
    return compare(measure(before, study), measure(mistray.load(scene_file), study))


def main(folder: Path) -> None:
    """Optimise, write the results and print both comparisons."""
    started = time.perf_counter()
    result = optimize(SCENE, STUDY, checkpoint=folder / "checkpoint.json")
    write_optimization(result, folder)
    print(f"before: three-layer preset on every surface\n{report_text(result)}\n")
    comparison = against_quarter_wave(folder / "scene.xml")
    print(f"before: quarter wave of MgF2 on every surface\n{comparison_table(comparison)}")
    for name, rows in (("preset", result.comparison.rows), ("MgF2", comparison.rows)):
        least = min(rows, key=lambda row: row.ratio)
        where = f"{least.field_deg:g}° and {least.wavelength_nm:g} nm"
        print(f"least ratio to {name}: {least.ratio:.2f} ± {least.ratio_se:.2f} at {where}")
    print(f"{time.perf_counter() - started:.0f} s in all; results in {folder}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/triplet_ar"))

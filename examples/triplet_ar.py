"""Antireflection coatings of the Cooke triplet, made for its ghosts: examples/triplet_ar.toml, with textbook coatings beside it.

Run from anywhere: python examples/triplet_ar.py [folder for the results]. Takes one to two minutes on two cores.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import mistray
from mistray.coatings import preset
from mistray.optimize import Comparison, compare, measure, optimize_coatings, read_study
from mistray.report.optimization import comparison_table, report_text, write_optimization
from mistray.scene.load import find
from mistray.scene.recoat import SharedCoating, write_recoated

SCENE = "cooke_triplet"
STUDY = Path(__file__).with_name("triplet_ar.toml")
TEXTBOOK = {"quarter wave of MgF2": "mgf2_quarter_wave", "three-layer preset": "bbar3"}


def against_textbook(scene: Path, study_file: Path, optimized: Path) -> dict[str, Comparison]:
    """Ghosts with each textbook coating on every surface, before, and with the optimised ones, after."""
    study = read_study(study_file)
    surfaces = tuple(name for group in study.coatings for name in group.surfaces or ())
    after = measure(mistray.load(optimized), study.metric)
    result = {}
    for title, name in TEXTBOOK.items():
        with tempfile.TemporaryDirectory() as folder:
            coating = SharedCoating(name, preset(name), surfaces)
            coated = mistray.load(write_recoated(scene, [coating], Path(folder) / "scene.xml"))
        result[title] = compare(measure(coated, study.metric), after)
    return result


def main(folder: Path) -> None:
    """Optimise, write the results and print both comparisons."""
    started = time.perf_counter()
    result = optimize_coatings(SCENE, STUDY, checkpoint=folder / "checkpoint.json")
    write_optimization(result, folder)
    print(report_text(result))
    print(f"\n{time.perf_counter() - started:.0f} s in all; results in {folder}")
    for title, comparison in against_textbook(find(SCENE), STUDY, folder / "scene.xml").items():
        least = min(comparison.rows, key=lambda row: row.ratio)
        print(f"\nbefore: {title} on every surface\n{comparison_table(comparison, 'W/W')}")
        print(f"least ratio: {least.ratio:.2f} ± {least.ratio_se:.2f} at {least.field_deg}°, {least.wavelength_nm} nm")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/triplet_ar"))

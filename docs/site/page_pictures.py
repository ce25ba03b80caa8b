"""Draws the pictures of the pages of docs/ that no command and no example draws.

    python docs/site/page_pictures.py [NAME ...]

Without names it draws all. Each is a PNG file of few colours in docs/images.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from pathlib import Path

from make_pictures import save_small
from matplotlib.figure import Figure

from mistray.toolkit.figures.palette import BLACK, BLUE, GREEN, ORANGE, PURPLE, VERMILION

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
WIDTH = 1100  # pixels, for the width of a page
sys.path.insert(0, str(ROOT / "tests"))


def phone_camera_mitigation() -> Figure:
    """Stray light after five changes of the phone camera over that before, from the table of its page."""
    from validation.tables import read, value

    shown = {
        "lenses R 2 to 0.25 %": (VERMILION, "o"),
        "detector R 20 to 5 %": (ORANGE, "s"),
        "all cones to cylinders": (BLUE, "^"),
        "black bevels": (GREEN, "D"),
        "matt walls of 1 %": (PURPLE, "v"),
        "bevels, walls, cylinders, CL 200": (BLACK, "o"),
    }
    rows = {row["change"]: row for row in read("phone_camera_mitigation.md", "changes")}
    angles = [column.rstrip("°") for column in next(iter(rows.values())) if column.endswith("°")]
    figure = Figure(figsize=(9, 4.6), layout="constrained")
    axes = figure.subplots()
    for name, (colour, marker) in shown.items():
        found = [value(rows[name][f"{angle}°"]) for angle in angles]
        x, y = [float(angle) for angle in angles], [ratio for ratio, _ in found]
        axes.errorbar(x, y, [se for _, se in found], color=colour, marker=marker, ms=5, lw=1.3, capsize=2, label=name)
    axes.axhline(1, color="0.5", lw=0.8)
    axes.set(yscale="log", ylim=(0.018, 2), xlabel="field angle [deg]", ylabel="stray PST, after over before")
    axes.set_yticks([0.02, 0.05, 0.1, 0.2, 0.5, 1, 2], ["0.02", "0.05", "0.1", "0.2", "0.5", "1", "2"])
    axes.grid(axis="y", color="0.9")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure


PICTURES: dict[str, Callable[[], Figure]] = {"phone_camera_mitigation": phone_camera_mitigation}


def png_of(figure: Figure) -> bytes:
    """A figure as PNG, as fine as a page shows it."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=150)
    return content.getvalue()


def main() -> int:
    """Draw what is named, or all."""
    names = sys.argv[1:] or list(PICTURES)
    if unknown := set(names) - set(PICTURES):
        raise SystemExit(f"{', '.join(sorted(unknown))}: choose from {', '.join(PICTURES)}")
    for name in names:
        save_small(IMAGES / f"{name}.png", png_of(PICTURES[name]()), WIDTH)
    return 0


if __name__ == "__main__":
    sys.exit(main())

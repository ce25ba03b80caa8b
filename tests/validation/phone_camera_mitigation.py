"""Changes against the stray light of the phone camera: PST after over before, and the paths as the scene is."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

from mistray.sweeps import PstSweep, read_configurations, sweep_pst

STUDY = Path(__file__).parents[2] / "examples" / "phone_mitigation.toml"
ANGLES_DEG = (4, 10, 20, 30, 45, 60, 75)
IMAGE_DEG = 4  # where the image is looked at
FACES = 10  # of the five lenses
ALL_FACES = (0.9975 / 0.98) ** FACES  # light that passes all of them, with R of 0.25 % over that with 2 %


def swept(rays: float, names: Collection[str] = ()) -> PstSweep:
    """The PST as the scene is and with the changes of these names, all without any."""
    given = read_configurations(STUDY)
    assert set(names) <= {one.name for one in given}
    chosen = [one for one in given if not names or one.name in names]
    return sweep_pst("phone_camera_scatter", chosen, ANGLES_DEG, rays=rays)


def ratios(found: PstSweep) -> list[dict[str, Any]]:
    """After over before by change: of the image, and of the stray light at each angle, with standard errors."""
    rows = []
    for name in found.configurations[1:]:
        image = found.changed(name, IMAGE_DEG, "direct")
        row = {"change": name, "image": image.ratio, "image_se": image.ratio_se}
        for angle in ANGLES_DEG:
            stray = found.changed(name, angle)
            row |= {f"at{angle}": stray.ratio, f"at{angle}_se": stray.ratio_se}
            row[f"text{angle}"] = _text(stray.ratio, stray.ratio_se)
        rows.append(row)
    return rows


def start(found: PstSweep) -> list[dict[str, Any]]:
    """The stray light of the scene as it is, with its strongest path, by angle."""
    pst = found.pst[found.configurations[0]]
    value, se = pst.curve("stray")
    rows = []
    for k, angle in enumerate(ANGLES_DEG):
        paths = pst.paths(angle, n=3)
        first = paths[paths.kind != "direct"].iloc[0]
        row = {"angle": angle, "pst": value[k], "pst_se": se[k]}
        rows.append(row | {"path": _short(first), "share": first.percent_of_stray})
    return rows


def _text(value: float, se: float) -> str:
    """A number with one digit of its standard error, or two if the first is 1: so that many fit in a line."""
    digits = f"{se:.1e}"
    decimals = -int(digits.partition("e")[2]) + (digits[0] == "1")
    return f"{value:.{decimals}f} ± {se:.{decimals}f}"


def _short(path: Any) -> str:
    """A path by the surfaces where it leaves the way of the image."""
    named = [event.rpartition(":") for event in path.events.split()]
    turns = {"R": "reflected by", "r": "scattered by", "I": "totally reflected by"}
    words = [f"{turns[what]} {name}" for name, _, what in named if what in turns]
    return ", ".join(words) or "through " + ", ".join(name for name, _, _ in named if "bevel" in name)

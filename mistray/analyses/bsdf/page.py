"""Output of an evaluated scatter model: text, JSON values, picture and files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mistray.analyses.bsdf.figures import bsdf_figure
from mistray.analyses.bsdf.run import BsdfResult
from mistray.files.json_values import plain
from mistray.replace_file import replace_file
from mistray.scatter.abg import ABg
from mistray.scatter.harvey_shack import HarveyShack
from mistray.scatter.measured.bsdf_csv import write_bsdf_csv
from mistray.scatter.measured.zemax_bsdf import write_zemax_bsdf
from mistray.scatter.scan import table
from mistray.toolkit.figures.figure import Figure
from mistray.toolkit.pages.model import Table, columns
from mistray.toolkit.tables.text import ABSENT, table_text

# The way from a roughness to A, B and g: text, attribute, unit of the text, name in JSON
SHEET = (
    ("As", "psd_amplitude_um4", "µm⁴", "psd_amplitude_um4"),
    ("Bs", "psd_length_um", "µm", "psd_length_um"),
    ("C", "psd_slope", "", "psd_slope"),
    ("D", "bsdf_per_psd", "µm⁻⁴", "bsdf_per_psd_per_um4"),
    ("BSDF(0)", "bsdf_0", "1/sr", "bsdf_0_1_sr"),
    ("Bennett and Porteus TIS", "tis", "", "tis"),
    ("correction", "correction", "", "correction"),
    ("shortest wavelength", "shortest_wavelength_um", "nm", "shortest_wavelength_um"),
    ("A", "a", "1/sr", "A_1_sr"),
    ("B", "b", "", "B"),
    ("g", "g", "", "g"),
)


def text(found: BsdfResult) -> str:
    """Return the result of `mistray bsdf` as text: A, B and g from a roughness, total scatter in percent, and notes."""
    parts = notes(found)
    if found.sheet is not None:
        values = {text: (getattr(found.sheet, name), unit) for text, name, unit, _ in SHEET}
        scales = {text: 1e3 if unit == "nm" else 1 for text, (_, unit) in values.items()}
        lines = (f"{text:<24} {scales[text] * value:.9g} {unit}".rstrip() for text, (value, unit) in values.items())
        parts.append("\n".join(lines))
    parts.append(_totals(found.totals))
    if found.unaimed is not None:
        lines = (f"{text:<31} {value:.5g}" for text, value in _hits(found).values())
        parts.append("\n".join(["without importance sampling", *lines]))
    asked = found.request
    title = f"{found.title}: {asked.front} | {asked.back}, {asked.wavelength_nm:g} nm"
    return f"{title}\n" + "\n\n".join(parts)


def record(found: BsdfResult) -> dict[str, Any]:
    """Return a result as JSON-serialisable values: A, B and g from a roughness, TIS of each event, and BSDF curves."""
    asked, sheet = found.request, found.sheet
    answer = {
        "model": found.title,
        "front": asked.front,
        "back": asked.back,
        "from_front": not asked.from_back,
        "wavelength_nm": asked.wavelength_nm,
        "notes": notes(found),
        "from_roughness": sheet and {name: getattr(sheet, attribute) for _, attribute, _, name in SHEET},
        "without_importance_sampling": found.unaimed and {name: value for name, (_, value) in _hits(found).items()},
        "totals": found.totals,
        "event": found.curves[0].event,
        "curves": [
            ({"rotation_deg": one.rotation_deg} if found.turned else {})
            | {name: getattr(one, name) for name in ("incidence_deg", "theta_s_deg", "distance")}
            | {"bsdf_1_sr": one.values}
            for one in found.curves
        ],
    }
    return dict(plain(answer))


def figure(found: BsdfResult) -> Figure:
    """
    Return the picture of the BSDF.

    For `harvey_shack`, and for `abg` with g > 0 and no reference wavelength, it marks the |β - β0| at which the BSDF
    bends.
    """
    model, light, knee = found.model, found.light, None
    if isinstance(model, ABg) and model.g > 0 and model.reference_nm is None:
        knee = float(model.B ** (1 / model.g))
    if isinstance(model, HarveyShack):
        knee = model.parameters(light.wavelength_nm, found.curves[0].event, light.n_in, light.n_out)[1]
    return bsdf_figure(found.curves, found.title, knee)


def write_curves(found: BsdfResult, path: Path, command: str) -> None:
    """Write the BSDF in the plane of incidence, 1/sr, as CSV with angles in degrees; `command` is its first line."""
    heads = ["rotation_deg"] * found.turned + ["theta_i_deg", "theta_s_deg", "distance", "bsdf"]
    lines = [f"# {command}", ",".join(heads)]
    for one in found.curves:
        fixed = [one.rotation_deg] * found.turned + [one.incidence_deg]
        for values in zip(one.theta_s_deg, one.distance, one.values, strict=True):
            lines.append(",".join(f"{value:.9g}" for value in (*fixed, *values)))
    replace_file(path, "\n".join(lines) + "\n", "curves")


def write_table(found: BsdfResult, path: Path, command: str) -> None:
    """Write the BSDF over the hemisphere as a table that scenes can read: Zemax .bsdf or .csv, by the suffix."""
    frame, write = ("specular", write_zemax_bsdf) if path.suffix.lower() == ".bsdf" else ("normal", write_bsdf_csv)
    write(table(found.model, found.request.angles_deg, frame, found.curves[0].event, found.light), path, command)


def notes(found: BsdfResult) -> list[str]:
    """Return the model's advice on unusual parameters as lines of text; empty if there is none."""
    advice = getattr(found.model, "advice", lambda: None)()
    return [f"note: {advice}"] if advice else []


def _hits(found: BsdfResult) -> dict[str, tuple[str, float]]:
    """
    Return probabilities, 0 … 1, of hitting a small detector, and rays needed: label and number by JSON name.

    It is empty without such a detector.
    """
    unaimed = found.unaimed
    if unaimed is None:
        return {}
    return {
        "of_scatter": ("chance of this scatter", unaimed.of_scatter),
        "total": ("and of getting there", unaimed.total),
        "rays_for_one_hit": ("rays for one hit in the mean", unaimed.rays_for_one_hit),
        "rays_for_50_percent": ("rays for a hit in 50 % of runs", unaimed.rays_for(0.5)),
    }


def _totals(found: list[dict[str, Any]]) -> str:
    """Return, as text, a table of TIS (% of the incident light), loss (% of the specular beam) and peak BSDF (1/sr)."""
    places = dict.fromkeys((row.get("rotation_deg"), row["incidence_deg"]) for row in found)
    heads, cells = ["incidence [deg]"], [[f"{angle:g}" for _, angle in places]]
    if "rotation_deg" in found[0]:
        heads, cells = ["rotation [deg]", *heads], [[f"{rotation:g}" for rotation, _ in places], *cells]
    for event in dict.fromkeys(row["event"] for row in found):
        rows = [row for row in found if row["event"] == event]
        heads += [f"{event} [TIS %]", "[loss %]", "[peak 1/sr]"]
        for key, scale in (("scattered", 100), ("loss", 100), ("peak_1_sr", 1)):
            cells.append([ABSENT if row[key] is None else f"{scale * row[key]:.4g}" for row in rows])
    shown = table_text(Table(columns(*heads), list(zip(*cells, strict=True))))
    return f"{shown}\nTIS: share of the incident light; loss: share of the specular beam that it loses"

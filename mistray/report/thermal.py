"""Thermal self-emission as text, CSV, JSON, a picture and one self-contained report.html."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.ticker import LogLocator

from mistray.analysis.estimate import Estimate
from mistray.analysis.thermal.emission import Emitter, ThermalReport
from mistray.files.json_values import plain
from mistray.report.figures.figure import Figure
from mistray.report.figures.plots import BLUE, GREEN, ORANGE, VERMILION, as_png, as_svg
from mistray.report.html.markup import cell, data_table, figure, number_cell, section, setting_text, thousands
from mistray.report.html.page import page
from mistray.report.output import csv_text, write_files
from mistray.report.tables.text import ABSENT, number, text_table, with_error

SHOWN, RETURNS_SHOWN = 12, 6  # rows of the printed tables, and bars of the picture
KIND_COLOURS = {"surface": BLUE, "medium": GREEN}
COLD_COLOUR = ORANGE
MEANINGS = (
    ("irradiance", "W/mm² in the band, that meets the detector; 1 W/mm² = 10⁶ W/m²"),
    ("share", "n² times the share of the detector's view, of Lambertian rays, that meets a surface"),
    ("emission", "n² times the share that it absorbs, 1 - R - T - scatter at each angle: by Kirchhoff's law what it "
     "emits; times π and the radiance of a blackbody of its temperature it is the irradiance. All emissions, what "
     "leaves the system and what is not followed add up to n², n the index before the detector"),
    ("image of the scene", "of a blackbody around the system, by light without scatter and without any reflection but "
     "those of mirrors"),
    ("NITD", "narcissus: change of the scene's temperature that would take as much light away as the detector's view "
     "of all that is colder than the housing, by way of ghosts and scatter; what is seen is its change over the field"),
    ("± ", "one standard error, from the spread of independent batches of rays"),
)  # fmt: skip


def summary_rows(report: ThermalReport) -> list[tuple[str, str, Estimate]]:
    """What is known of the whole: text, unit and number."""
    return [
        ("self-emission", "W/mm²", report.total_W_mm2),
        (f"image of a blackbody scene at {report.scene_K:g} K", "W/mm²", report.image_W_mm2),
        ("scene by all paths", "W/mm²", report.scene_W_mm2),
        ("self-emission / image", "1", report.to_image),
        ("detector in its own view (emission)", "1", report.self_view),
        ("NITD", "K", report.nitd_K),
        ("not followed to its source", "W/mm²", Estimate(report.lost_W_mm2, math.nan)),
    ]


def heading(report: ThermalReport) -> str:
    """What was computed, in one line."""
    waves = ", ".join(f"{wave:g}" for wave in report.wavelengths_um)
    return (
        f"thermal emission on '{report.detector}', {report.band_um[0]:g} to {report.band_um[1]:g} µm, "
        f"{report.temperature_K:g} K where no other is given, detector at {report.detector_K:g} K; "
        f"{thousands(report.facts['rays'])} rays, traced at {waves} µm"
    )


def thermal_text(report: ThermalReport, shown: int = SHOWN) -> str:
    """What `mistray thermal` prints: the strongest emitters, the sums, and what to mind."""
    columns = [("emitter", ""), ("part", ""), ("T", "K"), ("emission", "1"), ("irradiance", "W/mm²"), ("of total", "%")]
    total = report.total_W_mm2.value
    rows = [
        [
            e.name,
            e.part or "(medium)",
            f"{e.temperature_K:g}",
            with_error(e.emission),
            with_error(e.irradiance_W_mm2),
            _percent(e, total),
        ]
        for e in report.emitters[:shown]
    ]
    rest = report.emitters[shown:]
    if rest:
        power = sum(e.irradiance_W_mm2.value for e in rest)
        share = f"{100 * power / total:.3g}" if total > 0 else ABSENT
        rows.append([f"… and {len(rest)} more", "", "", "", number(power, 4), share])
    sums = [[text, unit, _shown(value)] for text, unit, value in summary_rows(report)]
    parts = [heading(report), text_table(columns, rows, left=(0, 1)) if rows else "nothing emits", ""]
    parts.append(text_table([("", ""), ("unit", ""), ("value", "")], sums, left=(0, 1)))
    if report.returned:
        columns = [("the detector sees itself by", ""), ("part", ""), ("emission", "1"), ("NITD", "K")]
        rows = [
            [r.surface, r.part, with_error(r.emission), with_error(r.nitd_K)] for r in report.returned[:RETURNS_SHOWN]
        ]
        parts += ["", text_table(columns, rows, left=(0, 1))]
    parts += [f"warning: {note}" for note in report.notes]
    return "\n".join(parts)


def _shown(value: Estimate) -> str:
    """A number, with its error if that is known."""
    return with_error(value) if math.isfinite(value.se) else number(value.value, 3)


def _percent(emitter: Emitter, total: float) -> str:
    return f"{100 * emitter.irradiance_W_mm2.value / total:.3g}" if total > 0 else ABSENT


def return_frame(report: ThermalReport) -> pd.DataFrame:
    """Surfaces by which the detector sees itself: surface, part, emission and NITD with their errors."""
    rows = [(r.surface, r.part, *r.emission, *r.nitd_K) for r in report.returned]
    return pd.DataFrame(rows, columns=["surface", "part", "emission", "emission_se", "nitd_K", "nitd_K_se"])


def thermal_record(report: ThermalReport) -> dict[str, Any]:
    """Everything as plain values for JSON."""
    names = ("total_W_mm2", "scene_W_mm2", "image_W_mm2", "to_image", "self_view", "nitd_K")
    record = {name: getattr(report, name).value for name in names}
    record |= {f"{name}_se": getattr(report, name).se for name in names}
    keys = ("lost_W_mm2", "temperature_K", "detector_K", "scene_K", "band_um", "wavelengths_um", "detector", "notes")
    record |= {key: getattr(report, key) for key in keys}
    record |= {"facts": report.facts, "emitters": report.to_pandas().to_dict("records")}
    record |= {"returned": return_frame(report).to_dict("records")}
    found = plain(record)
    assert isinstance(found, dict)
    return found


def thermal_figure(report: ThermalReport, title: str = "") -> Figure:
    """Irradiance by surface and medium as bars, the strongest first, and lines for all of it and for the scene."""
    lit = [e for e in report.emitters if e.irradiance_W_mm2.value > 0][:SHOWN]
    made = Figure(figsize=(8.6, 1.4 + 0.32 * max(len(lit), 3)), dpi=120, layout="constrained")
    axes = made.subplots()
    values = np.array([e.irradiance_W_mm2.value for e in lit])
    colours = [COLD_COLOUR if e.temperature_K < report.temperature_K else KIND_COLOURS[e.kind] for e in lit]
    axes.barh(range(len(lit)), values, color=colours, height=0.7)
    errors = np.array([e.irradiance_W_mm2.se for e in lit])
    axes.errorbar(values, range(len(lit)), xerr=np.minimum(errors, 0.9 * values), fmt="none", ecolor="#333333", lw=0.9)
    axes.set_yticks(range(len(lit)), [e.name for e in lit], fontsize=8)
    axes.invert_yaxis()
    for value, colour, text in (
        (report.total_W_mm2.value, VERMILION, "all self-emission"),
        (report.image_W_mm2.value, "#555555", f"image of a blackbody at {report.scene_K:g} K"),
    ):
        if value > 0:
            axes.axvline(value, color=colour, lw=1.2, ls="--", label=f"{text}: {value:.3g} W/mm²")
    if len(lit):
        axes.set_xscale("log")
        axes.set_xlim(max(values.min() / 3, values.max() * 1e-8))
        axes.xaxis.set_major_locator(LogLocator(10, numticks=12))
    axes.set_xlabel(f"irradiance on the detector, {report.band_um[0]:g} to {report.band_um[1]:g} µm [W/mm²]")
    axes.grid(True, axis="x", color="#dddddd", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    if axes.get_legend_handles_labels()[0]:
        made.legend(loc="outside upper right", fontsize=8, frameon=False, ncols=2)
    made.suptitle(title, fontsize=10, x=0.01, ha="left")
    note = "bars of one standard error; blue: surfaces, green: media, orange: what is colder than the rest"
    made.supxlabel(note, fontsize=7.5, color="#555555")
    return made


def html_text(report: ThermalReport, title: str = "scene", command: str = "") -> str:
    """The report as HTML text; `title` is the name of the system, `command` the command line that made it."""
    parts = [
        ("picture", "Emitters", figure(as_svg(thermal_figure(report)), "Irradiance by surface and medium.")),
        ("sums", "Sums", _sums(report)),
        ("parts", "By part", _parts(report)),
        ("surfaces", "By surface", _surfaces(report.emitters, report.total_W_mm2.value)),
        *([("narcissus", "Narcissus", _returns(report))] if report.returned else []),
        ("settings", "Definitions and settings", _settings(report, command)),
    ]
    links = "".join(f'<a href="#{anchor}">{text}</a>' for anchor, text, _ in parts)
    box = ""
    if report.notes:
        items = "".join(f"<li>{escape(note)}</li>" for note in report.notes)
        box = f'<div class="warnings"><b>Mind</b><ul>{items}</ul></div>'
    finding = f"Self-emission on the detector: <b>{with_error(report.total_W_mm2)} W/mm²</b>"
    if math.isfinite(report.to_image.value):
        finding += f", {with_error(report.to_image)} of the image of a blackbody scene at {report.scene_K:g} K"
    head = (
        f'<header><h1>Thermal self-emission: {escape(title)}</h1><p class="sub">{escape(heading(report))}.</p>'
        f"<p>{finding}.</p>{box}<nav>{links}</nav></header>"
    )
    return page(f"Thermal self-emission: {title}", [head, *(section(*part) for part in parts)])


def _sums(report: ThermalReport) -> str:
    rows = [[cell(text, "t"), cell(unit), _number(value)] for text, unit, value in summary_rows(report)]
    return data_table("t-sums", [("", "", "t"), ("unit", ""), ("value", "")], rows, sortable=False)


def _number(value: Estimate) -> str:
    return number_cell(value) if math.isfinite(value.se) else cell(number(value.value, 4))


def _parts(report: ThermalReport) -> str:
    total = report.total_W_mm2.value
    rows = [
        [cell(part, "t"), number_cell(value), cell(f"{100 * value.value / total:.3g}" if total > 0 else ABSENT)]
        for part, value in report.by_part().items()
    ]
    return data_table("t-parts", [("part", "", "t"), ("irradiance", "W/mm²"), ("of total", "%")], rows)


def _surfaces(emitters: Sequence[Emitter], total: float) -> str:
    header = [
        ("emitter", "", "t"), ("part", "", "t"), ("kind", "", "t"), ("temperature", "K"), ("rays", ""), ("share", "n²"),
        ("emission", "n²"), ("irradiance", "W/mm²"), ("of total", "%"),
    ]  # fmt: skip
    rows = [
        [
            *(cell(text, "t") for text in (e.name, e.part, e.kind)),
            cell(f"{e.temperature_K:g}"),
            cell(str(e.hits)),
            *(number_cell(value) for value in (e.share, e.emission, e.irradiance_W_mm2)),
            cell(_percent(e, total)),
        ]
        for e in emitters
    ]
    return data_table("t-surfaces", header, rows)


def _returns(report: ThermalReport) -> str:
    text = "Where light of the detector turns back to it: one reflection, transmitted everywhere else."
    header = [("surface", "", "t"), ("part", "", "t"), ("emission", "n²"), ("NITD", "K")]
    rows = [
        [cell(r.surface, "t"), cell(r.part, "t"), number_cell(r.emission), number_cell(r.nitd_K)]
        for r in report.returned
    ]
    return f"<p>{text}</p>" + data_table("t-returns", header, rows)


def _settings(report: ThermalReport, command: str) -> str:
    definitions = "".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in MEANINGS)
    shown: dict[str, Any] = {"band_um": report.band_um, "wavelengths_um": report.wavelengths_um}
    for key, value in report.facts.items():
        shown |= value if isinstance(value, dict) else {key: thousands(value) if key == "rays" else value}
    items = "".join(
        f"<dt>{escape(str(key))}</dt><dd>{escape(setting_text(value))}</dd>" for key, value in shown.items()
    )
    ran = f"<h3>Command</h3><pre>{escape(command)}</pre>" if command else ""
    return (
        f'<h3>Definitions</h3><dl class="settings">{definitions}</dl>'
        f'<h3>Settings</h3><dl class="settings">{items}</dl>{ran}'
    )


def csv_tables(report: ThermalReport) -> dict[str, pd.DataFrame]:
    """The tables by file name: thermal.csv, and narcissus.csv where a cold detector sees itself."""
    return {"thermal.csv": report.to_pandas()} | ({"narcissus.csv": return_frame(report)} if report.returned else {})


def write_thermal(report: ThermalReport, directory: str | Path, title: str = "scene", command: str = "") -> list[Path]:
    """
    Write the tables of `csv_tables`, thermal.json, thermal.png and report.html.

    Parameters
    ----------
    report : ThermalReport
    directory : str or Path
        Made if it is missing, with the directories above it; other files in it are left alone.
    title : str
        Name of the optical system.
    command : str
        Command line, quoted in the report.

    Returns
    -------
    list of Path
        The files written.
    """
    record = {"title": title, "command": command} | thermal_record(report)
    files: dict[str, str | bytes] = {
        **{name: csv_text(table) for name, table in csv_tables(report).items()},
        "thermal.json": json.dumps(record, indent=1, allow_nan=False),
        "thermal.png": as_png(thermal_figure(report, title)),
        "report.html": html_text(report, title, command),
    }
    return write_files(files, directory)

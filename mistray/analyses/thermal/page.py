"""Output of thermal self-emission: text, JSON values, tables, a picture and a report."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from mistray.analyses.thermal.narcissus import NarcissusReturn, ZoneReturn
from mistray.analyses.thermal.netd import NoiseSource
from mistray.analyses.thermal.result import Emitter, ThermalReport
from mistray.estimate import Estimate
from mistray.files.json_values import plain
from mistray.toolkit.pages.model import FigurePart, NotePart, Report, Section, Table, Value, columns
from mistray.toolkit.pages.output import write_report
from mistray.toolkit.pages.parts import settings_section, terms, thousands
from mistray.toolkit.rows import frame, records, table
from mistray.toolkit.tables.frames import row_of
from mistray.toolkit.tables.text import ABSENT, number, table_text, with_error

if TYPE_CHECKING:
    import pandas as pd

SHOWN, RETURNS_SHOWN, NOISE_SHOWN = 12, 6, 6  # rows of the printed tables
WAVELENGTHS_SHOWN = 6  # in a line


def heading(report: ThermalReport) -> str:
    """Return a line that names detector, band (µm), temperatures (K), number of rays and traced wavelengths (µm)."""
    waves = ", ".join(f"{wave:.4g}" for wave in report.wavelengths_um)
    if len(report.wavelengths_um) > WAVELENGTHS_SHOWN:
        low, high = report.wavelengths_um[0], report.wavelengths_um[-1]
        waves = f"{len(report.wavelengths_um)} wavelengths from {low:.4g} to {high:.4g}"
    within = f", integrals over the band to {100 * report.band_error:.2g} %" if report.band_error > 0 else ""
    return (
        f"thermal emission on '{report.detector}', {report.band_um[0]:g} to {report.band_um[1]:g} µm, "
        f"{report.temperature_K:g} K where no other is given, detector at {report.detector_K:g} K; "
        f"{thousands(report.facts['rays'])} rays, traced at {waves} µm{within}"
    )


def part_table(report: ThermalReport) -> Table:
    """Return the table of irradiance on the detector by part or medium: W/mm², and percent of all self-emission."""
    rows: list[list[Value]] = [[part, value, _percent(report, value.value)] for part, value in report.by_part().items()]
    heads = table(Emitter, (), only=("irradiance_W_mm2", "percent")).columns
    return Table([*columns("<part"), *heads], rows, "t-parts")


def thermal_text(report: ThermalReport, shown: int = SHOWN) -> str:
    """
    Return the text that `mistray thermal` prints: the `shown` strongest emitters, tables of sums, and warnings.

    Examples
    --------
    >>> found = mistray.thermal(mistray.load("cassegrain"), 293, (8, 12), wavelengths_um=10, rays=5000)
    >>> text = mistray.report.thermal_text(found, shown=2)
    >>> text.splitlines()[0].partition(",")[0]
    "thermal emission on 'detector'"
    """
    left = report.emitters[shown:]
    power = sum(e.irradiance_W_mm2.value for e in left)
    rest = [f"… and {len(left)} more", "", "", "", number(power, 4), _percent(report, power)]
    only = ("name", "part", "temperature_K", "emission", "irradiance_W_mm2", "percent")
    emitters = table(Emitter, report.emitters, only=only, most=shown, rest=rest, empty="nothing emits")
    sums = Table(columns("<", "<unit", "value"), _sums(report, 3))
    parts = [heading(report), table_text(emitters), "", table_text(sums)]
    if report.returned:
        parts += ["", table_text(table(NarcissusReturn, report.returned), RETURNS_SHOWN)]
    if report.noise_sources:
        parts += ["", table_text(table(NoiseSource, report.noise_sources), NOISE_SHOWN)]
    return "\n".join([*parts, *(f"warning: {note}" for note in report.notes)])


def _sums(report: ThermalReport, digits: int) -> list[list[Value]]:
    """Return table rows of sums over the system: text, unit, and value with its error, else to `digits` digits."""
    rows = [
        ("self-emission", "W/mm²", report.total_W_mm2),
        (f"image of a blackbody scene at {report.scene_K:g} K", "W/mm²", report.image_W_mm2),
        ("scene by all paths", "W/mm²", report.scene_W_mm2),
        ("self-emission / image", "1", report.to_image),
        ("detector in its own view (emission)", "1", report.self_view),
        ("NITD", "K", report.nitd_K),
        ("not followed to its source", "W/mm²", Estimate(report.lost_W_mm2, math.nan)),
    ]
    if report.netd is not None:
        rows.append(("image of the scene by its temperature", "W/(mm² K)", report.netd.per_kelvin_W_mm2))
        if report.netd.noise.detectivity is not None:
            rows.append(("NETD by D*", "K", report.netd.by_detectivity_K))
        if report.netd.noise.quantum_efficiency is not None:
            rows.append(("NETD by the noise of photons", "K", report.netd.by_photons_K))
    return [[text, unit, v if math.isfinite(v.se) else number(v.value, digits)] for text, unit, v in rows]


def _percent(report: ThermalReport, power: float) -> str:
    total = report.total_W_mm2.value
    return f"{100 * power / total:.3g}" if total > 0 else ABSENT


def record(report: ThermalReport) -> dict[str, Any]:
    """Return a thermal report as JSON-serialisable values."""
    values = row_of(
        report, "total_W_mm2", "scene_W_mm2", "image_W_mm2", "to_image", "self_view", "nitd_K", "lost_W_mm2",
        "temperature_K", "detector_K", "scene_K", "band_um", "wavelengths_um", "band_error", "detector",
        "notes", "facts",
    )  # fmt: skip
    if report.netd is not None:
        known = row_of(report.netd, "per_kelvin_W_mm2", "by_detectivity_K", "by_photons_K")
        sources = records(NoiseSource, report.noise_sources)
        values["netd"] = asdict(report.netd.noise) | known | {"sources": sources}
    values["emitters"] = records(Emitter, report.emitters)
    values["returned"] = records(NarcissusReturn, report.returned)
    values["narcissus_field"] = records(ZoneReturn, report.by_zone)
    return dict(plain(values))


def page(report: ThermalReport, title: str = "scene", command: str = "") -> Report:
    """Return the report page; `title` is the system's name, `command` the command line that made it."""
    from mistray.analyses.thermal.figures import narcissus_figure, thermal_figure
    from mistray.toolkit.figures.plots import as_png

    finding = Markup("Self-emission on the detector: <b>{} W/mm²</b>").format(with_error(report.total_W_mm2))
    if math.isfinite(report.to_image.value):
        finding += f", {with_error(report.to_image)} of the image of a blackbody scene at {report.scene_K:g} K"
    drawn = FigurePart(functools.partial(thermal_figure, report), "Irradiance by surface and medium.")
    sums = Table(columns("<", "unit", "value"), _sums(report, 4), "t-sums", sortable=False)
    returns = (
        "Where light of the detector turns back to it: one reflection, transmitted everywhere else. With the shield: "
        "also to all else that is cold. Middle - edge: how much that changes over the detector."
    )
    facts: dict[str, Any] = {"band_um": report.band_um, "wavelengths_um": report.wavelengths_um}
    for key, value in report.facts.items():
        facts |= value if isinstance(value, dict) else {key: thousands(value) if key == "rays" else value}
    sections = [
        Section("picture", "Emitters", [drawn], "Emitters"),
        Section("sums", "Sums", [sums], "Sums"),
        Section("parts", "By part", [part_table(report)], "By part"),
        Section("surfaces", "By surface", [table(Emitter, report.emitters, "t-surfaces")], "By surface"),
    ]
    if report.returned:
        over = FigurePart(functools.partial(narcissus_figure, report), "NITD by surface over the detector.")
        shown = [
            NotePart(returns),
            table(NarcissusReturn, report.returned, "t-returns"),
            *([over] if report.zones_mm else []),
        ]
        sections.append(Section("narcissus", "Narcissus", shown, "Narcissus"))
    if report.netd is not None:
        pixel = report.netd.noise
        given = f"A pixel of {pixel.pixel_um:g} µm, {pixel.bandwidth_hz:g} Hz"
        given += f", D* = {pixel.detectivity:g} cm √Hz/W" if pixel.detectivity is not None else ""
        given += f", quantum efficiency {pixel.quantum_efficiency:g}" if pixel.quantum_efficiency is not None else ""
        tables = [table(NoiseSource, report.noise_sources, "t-netd")] if report.noise_sources else []
        sections.append(Section("netd", "NETD", [NotePart(f"{given}. The sums are above."), *tables], "NETD"))
    return Report(
        "Thermal self-emission",
        title,
        [*sections, settings_section(facts, command, terms("thermal"), link="Definitions and settings")],
        lead=[NotePart(f"{heading(report)}.", "sub"), NotePart(finding + ".")],
        warnings=report.notes,
        csv=csv_tables(report),
        json={"thermal.json": {"title": title, "command": command} | record(report)},
        result=report,
        files={"thermal.png": as_png(thermal_figure(report, title))},
    )


def csv_tables(report: ThermalReport) -> dict[str, pd.DataFrame]:
    """Return DataFrames by file name: thermal.csv, and narcissus and NETD tables if they have rows."""
    further: dict[str, tuple[type, Sequence[Any]]] = {
        "narcissus.csv": (NarcissusReturn, report.returned),
        "narcissus_field.csv": (ZoneReturn, report.by_zone),
        "netd.csv": (NoiseSource, report.noise_sources),
    }
    return {"thermal.csv": report.to_pandas()} | {name: frame(*rows) for name, rows in further.items() if rows[1]}


def write_thermal(report: ThermalReport, directory: str | Path, title: str = "scene", command: str = "") -> list[Path]:
    """
    Write the tables of `csv_tables`, thermal.json, thermal.png and report.html into a directory, see `write_report`.

    `title`, the name of the optical system, and `command`, the command line, appear in the report. Returns the files
    written; the page is the last.

    Examples
    --------
    >>> found = mistray.thermal(mistray.load("cassegrain"), 293, (8, 12), wavelengths_um=10, rays=5000)
    >>> [file.name for file in mistray.report.write_thermal(found, "thermal")]
    ['thermal.csv', 'thermal.json', 'thermal.png', 'report.html']
    """
    return write_report(page(report, title, command), directory)


text = thermal_text  # names in a `page`
write = write_thermal

"""Numbers as text, and the tables of a ghost analysis: printed ones and CSV files."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from mistray.analysis.estimate import Estimate
from mistray.analysis.ghosts import FieldSummary, GhostReport
from mistray.analysis.ranking import DIRECT, FEWEST_RAYS, KINDS
from mistray.trace import Trace

LIMIT_WARNING = 1e-6  # of the launched flux
COATING_WARNING = 1e-4  # of R and T, by interpolation over the angle
CLOSURE_WARNING = 1e-5
MOST_DECIMALS = 6
CUT_TEXTS = {
    "flux_threshold": "cut by flux_threshold = {flux_threshold:g}; lower it, or use below_threshold = roulette",
    "max_reflections": "not followed beyond max_reflections = {max_reflections}; raise it to see where that goes",
    "max_events": "cut by max_events = {max_events}; raise it",
    "medium": "lost where a ray met a surface from the wrong material; the geometry has a gap or an overlap",
}
ABSENT = "–"
ALL = "all"


def with_error(number: Estimate, digits: int = 2) -> str:
    """
    A number and its standard error as text, "9.3548e-05 ± 1.2e-08".

    The error has ``digits`` digits and the value ends at the same place. A number that is not finite is "–", an error
    that is not known shows as "± ?".
    """
    value, se = number
    if not math.isfinite(value):
        return ABSENT
    if not math.isfinite(se):
        return f"{value:.4g} ± ?"
    if se <= 0:
        return f"{value:.6g} ± 0"
    if value == 0:
        return f"0 ± {se:.{digits - 1}e}"
    places = _exponent(value) - _exponent(se) + digits - 1
    decimals = min(max(places, 0), 9)
    fixed = max(digits - 1 - _exponent(se), 0)
    if -4 < _exponent(value) < 5 and se < abs(value) and fixed <= MOST_DECIMALS:
        return f"{value:.{fixed}f} ± {se:.{fixed}f}"
    return f"{value:.{decimals}e} ± {se:.{digits - 1}e}"


def number(value: float, digits: int = 5) -> str:
    """A number without error as text; "–" if it is not finite."""
    return f"{value:.{digits}g}" if math.isfinite(value) else ABSENT


def text_table(columns: Sequence[tuple[str, str]], rows: Sequence[Sequence[str]], left: Sequence[int] = ()) -> str:
    """
    Fixed-width table with a line of units below the header.

    Parameters
    ----------
    columns : sequence of (str, str)
        Header and unit of each column.
    rows : sequence of sequence of str
        Cells.
    left : sequence of int
        Numbers of the columns that are flush left; all others are flush right.
    """
    header = [text for text, _ in columns]
    lines = [header, [f"[{unit}]" if unit else "" for _, unit in columns], *[list(row) for row in rows]]
    widths = [max(len(line[k]) for line in lines) for k in range(len(columns))]

    def join(line: Sequence[str]) -> str:
        cells = [
            cell.ljust(w) if k in left else cell.rjust(w) for k, (cell, w) in enumerate(zip(line, widths, strict=True))
        ]
        return "  ".join(cells).rstrip()

    rule = "  ".join("-" * w for w in widths)
    return "\n".join([join(lines[0]), join(lines[1]), rule, *[join(line) for line in lines[2:]]])


def summary_table(summaries: Sequence[FieldSummary]) -> str:
    """Main table: one row for each field, and for each wavelength where there are summaries of one."""
    waves = any(s.wavelength_nm is not None for s in summaries)
    columns = [
        ("field", "deg"),
        *([("λ", "nm")] if waves else []),
        ("paths", ""),
        ("direct image", "W"),
        ("stray light", "W"),
        ("stray/direct", ""),
        ("stray/nominal", ""),
        ("worst ghost", "norm. RMS irradiance"),
    ]
    rows = [
        [
            f"{s.field_deg:g}",
            *([ALL if s.wavelength_nm is None else f"{s.wavelength_nm:g}"] if waves else []),
            str(s.paths),
            with_error(s.direct.power_W) if s.direct.power_W.value > 0 else ABSENT,
            with_error(s.stray_W),
            with_error(s.ghost_to_signal),
            with_error(s.stray_to_nominal),
            with_error(s.brightest_normalised),
        ]
        for s in summaries
    ]
    return text_table(columns, rows)


def ghost_table(report: GhostReport, count: int = 4, per_wavelength: bool = False) -> str:
    """The worst stray paths of every field by RMS irradiance; per wavelength, each with its spectrum below it."""
    columns = [
        ("field", "deg"),
        ("path", ""),
        ("ghost surfaces", "1st → 2nd"),
        ("kind", ""),
        *([("λ", "nm")] if per_wavelength else []),
        ("power", "W"),
        ("RMS radius", "mm"),
        ("RMS irradiance", "W/mm²"),
        ("normalised", "to on-axis image"),
    ]
    rows = []
    for field in report:
        for row in report.top(field, count).itertuples(index=False):
            name = [f"{field:g}", f"{row.path_id}{' ' if row.well_sampled else '*'}", str(row.label), str(row.kind)]
            rows.append([*name, *([ALL] if per_wavelength else []), *_path_numbers(row)])
            if per_wavelength:
                for line in report.spectrum(field, row.path_id).itertuples(index=False):
                    mark = "" if line.well_sampled else "* "
                    rows.append(["", mark, "", "", f"{line.wavelength_nm:g}", *_path_numbers(line)])
    return text_table(columns, rows, left=(2, 3)) if rows else "no stray path reaches the detector"


def _path_numbers(row: Any) -> list[str]:
    columns = ("power{}_W", "rms_radius{}_mm", "rms_irradiance{}_W_mm2", "normalised_rms_irradiance{}")
    return [with_error(Estimate(*(getattr(row, name.format(kind)) for kind in ("", "_se")))) for name in columns]


def ledger_table(report: GhostReport) -> str:
    """Energy ledger of every field at every wavelength, and of all light."""
    columns = [("field", "deg"), ("λ", "nm"), ("launched", "W"), ("detected", "W"), ("absorbed by surfaces", "W"),
               ("absorbed in media", "W"), ("escaped", "W"), ("cut", "W"), ("closure", "relative")]  # fmt: skip
    rows = []
    for field, t in report.items():
        ledgers = {ALL: t.energy} | {f"{line:g}": t.energy_at(line) for line in report.wavelengths_nm}
        for name, energy in ledgers.items():
            absorbed = [sum(power for power, _ in part.values()) for part in (energy.absorbed, energy.absorbed_in)]
            rows.append(
                [
                    f"{field:g}",
                    name,
                    number(energy.launched_W, 6),
                    with_error(Estimate(energy.detected_W, energy.detected_se_W)),
                    *(number(power, 6) for power in absorbed),
                    with_error(Estimate(energy.escaped_W, energy.escaped_se_W)),
                    number(sum(energy.cut.values()), 3),
                    f"{energy.closure:.1e}",
                ]
            )
    return text_table(columns, rows)


def main_table(report: GhostReport, count: int = 4, per_wavelength: bool = False) -> str:
    """
    What `mistray ghosts` prints: the main table, the worst ghosts of each field and the energy closure.

    Parameters
    ----------
    report : GhostReport
    count : int
        Worst paths of each field.
    per_wavelength : bool
        Add rows for each wavelength, and the energy ledger at each of them.
    """
    nominal = report.nominal.rms_irradiance_W_mm2
    closure = max((report[field].energy.closure for field in report), key=abs)
    lines: list[float | None] = [None, *(report.wavelengths_nm if per_wavelength else [])]
    parts = [
        summary_table([report.summary(field, wavelength) for field in report for wavelength in lines]),
        "",
        f"Worst {count} stray paths of each field by RMS irradiance P/(π r_rms²)",
        ghost_table(report, count, per_wavelength),
        "",
    ]
    if per_wavelength:
        parts += ["Energy ledger", ledger_table(report), ""]
    parts += [
        f"normalised: over the RMS irradiance of the direct image on axis, {with_error(nominal)} W/mm²",
        "stray/nominal: over the power of the direct image on axis.  ±: one standard error; of sums an upper bound",
    ]
    if per_wavelength:
        parts.append("rows of one wavelength: normalised to the direct image on axis at that wavelength")
    if any(not report.top(field, count).well_sampled.all() for field in report):
        parts.append(f"*: fewer than {FEWEST_RAYS} rays, RMS radius and irradiance are unreliable")
    parts.append(f"energy closure, worst field: {closure:.1e} of the launched flux")
    parts += [f"warning: {text}" for text in warnings(report)]
    return "\n".join(parts)


def warnings(report: GhostReport) -> list[str]:
    """What a reader must know before trusting the numbers; empty if all is well."""
    found = []
    if report.nominal.power_W.value == 0:
        found.append("no direct light reaches the detector on axis: nothing can be normalised to it")
    settings = next(iter(report.values())).settings
    for reason in dict.fromkeys(reason for t in report.values() for reason in t.energy.cut if reason != "roulette"):
        shares = {field: abs(t.energy.cut.get(reason, 0.0)) / t.energy.launched_W for field, t in report.items()}
        large = [field for field, share in shares.items() if share > LIMIT_WARNING]
        if large:
            share = max(shares.values())
            found.append(f"{_fields(large)}: up to {share:.1e} of the launched flux was {_cut_text(reason, settings)}")
    open_ends = [field for field, t in report.items() if abs(t.energy.closure) > CLOSURE_WARNING]
    if open_ends:
        worst = max(abs(report[field].energy.closure) for field in open_ends)
        found.append(f"{_fields(open_ends)}: the energy closes to {worst:.1e} only, not to {CLOSURE_WARNING:g}")
    coarse = [field for field, t in report.items() if t.coating_error > COATING_WARNING]
    if coarse:
        worst = max(report[field].coating_error for field in coarse)
        found.append(
            f"{_fields(coarse)}: R of a coating in total reflection varies too fast with the angle for its table; the "
            f"error is up to {worst:.1e}"
        )
    few = [field for field in report if not report.top(field, 4).well_sampled.all()]
    if few:
        found.append(f"{_fields(few)}: some of the worst four paths hold fewer than {FEWEST_RAYS} rays; raise rays")
    return found


def path_table(report: GhostReport, per_wavelength: bool = False) -> pd.DataFrame:
    """All paths of all fields after ``field_deg``; columns as in `GhostReport.table`, ``path_ids`` as text."""
    tables = [report.table(field, per_wavelength).assign(field_deg=field) for field in report]
    table = _first(pd.concat(tables, ignore_index=True), "field_deg")
    return table.assign(path_ids=[" ".join(map(str, path_ids)) for path_ids in table.path_ids])


def energy_table(report: GhostReport, per_wavelength: bool = False) -> pd.DataFrame:
    """Energy ledger of all fields: field_deg, entry, name, power_W, power_se_W (NaN: exact or not estimated), share."""
    ledgers = _by_wavelength(report, per_wavelength, lambda t: t.energy, lambda t, line: t.energy_at(line))
    rows = []
    for where, energy in ledgers:
        entries = [
            ("launched", "source", energy.launched_W, 0.0),
            ("detected", "detector", energy.detected_W, energy.detected_se_W),
        ]
        entries += [("absorbed", name, power, se) for name, (power, se) in energy.absorbed.items()]
        entries += [("absorbed in", name, power, se) for name, (power, se) in energy.absorbed_in.items()]
        entries += [("escaped", "scene", energy.escaped_W, energy.escaped_se_W)]
        entries += [("cut", reason, power, math.nan) for reason, power in energy.cut.items()]
        entries += [("unaccounted", "closure", energy.closure * energy.launched_W, math.nan)]
        rows += [
            where
            | {"entry": entry, "name": name, "power_W": power, "power_se_W": se, "share": power / energy.launched_W}
            for entry, name, power, se in entries
        ]
    return pd.DataFrame(rows)


def surface_table(report: GhostReport, per_wavelength: bool = False) -> pd.DataFrame:
    """Flux report of all fields: the columns of ``Trace.surfaces`` after ``field_deg`` (and ``wavelength_nm``)."""
    parts = _by_wavelength(report, per_wavelength, lambda t: t.surfaces, lambda t, line: t.surfaces_at(line))
    tables = [surfaces.to_pandas().assign(**where) for where, surfaces in parts]
    return _first(pd.concat(tables, ignore_index=True), *parts[0][0])


def summary_frame(report: GhostReport, per_wavelength: bool = False) -> pd.DataFrame:
    """Main table with full precision, one row for each field (and wavelength)."""
    lines = report.wavelengths_nm if per_wavelength else [None]
    return pd.DataFrame([_summary_row(report.summary(field, wavelength)) for field in report for wavelength in lines])


def csv_tables(report: GhostReport, per_wavelength: bool = False) -> dict[str, pd.DataFrame]:
    """The tables that `write_csv` writes, by file name."""
    makers = {"summary": summary_frame, "paths": path_table, "energy": energy_table, "surfaces": surface_table}
    tables = {f"{name}.csv": make(report) for name, make in makers.items()}
    if per_wavelength:
        tables |= {f"{name}_per_wavelength.csv": make(report, True) for name, make in makers.items()}
    return tables


def write_csv(report: GhostReport, directory: str | Path, per_wavelength: bool = False) -> list[Path]:
    """
    Write summary.csv, paths.csv, energy.csv and surfaces.csv, each over all fields with full precision.

    Parameters
    ----------
    report : GhostReport
    directory : str or Path
        Must exist.
    per_wavelength : bool
        Write the same tables at each wavelength too, as summary_per_wavelength.csv and so on.

    Returns
    -------
    list of Path
        The files written.
    """
    files = []
    for name, table in csv_tables(report, per_wavelength).items():
        path = Path(directory) / name
        table.to_csv(path, index=False, lineterminator="\n")
        files.append(path)
    return files


def _by_wavelength(
    report: GhostReport, per_wavelength: bool, of_all: Callable[[Trace], Any], of_one: Callable[[Trace, float], Any]
) -> list[tuple[dict[str, float], Any]]:
    """Something of every field, or of every field and wavelength, each with the columns that say of which."""
    if not per_wavelength:
        return [({"field_deg": field}, of_all(t)) for field, t in report.items()]
    return [
        ({"field_deg": field, "wavelength_nm": wavelength}, of_one(t, wavelength))
        for field, t in report.items()
        for wavelength in report.wavelengths_nm
    ]


def _summary_row(s: FieldSummary) -> dict[str, Any]:
    row: dict[str, Any] = {"field_deg": s.field_deg}
    if s.wavelength_nm is not None:
        row["wavelength_nm"] = s.wavelength_nm
    row["paths"] = s.paths
    row |= {f"paths_{_snake(kind)}": s.paths_of_kind[kind] for kind in (DIRECT, *KINDS)}
    estimates = {
        "direct_power_W": s.direct.power_W,
        "direct_rms_radius_mm": s.direct.rms_radius_mm,
        "direct_rms_irradiance_W_mm2": s.direct.rms_irradiance_W_mm2,
        "stray_W": s.stray_W,
        **{f"{_snake(kind)}_W": s.stray_of_kind_W[kind] for kind in KINDS},
        "ghost_to_signal": s.ghost_to_signal,
        "stray_to_nominal": s.stray_to_nominal,
        "worst_normalised_rms_irradiance": s.brightest_normalised,
    }
    for name, estimate in estimates.items():
        row |= {name: estimate.value, f"{name}_se": estimate.se}
    row["worst_path_id"] = s.brightest
    row |= {
        f"map_{name}": getattr(s.map, name) for name in ("minimum", "maximum", "mean", "rms", "flux_W", "incident_rays")
    }
    return row | {"asymmetry": s.asymmetry, "asymmetry_expected": s.asymmetry_expected}


def _first(table: pd.DataFrame, *names: str) -> pd.DataFrame:
    return table[[*names, *[name for name in table.columns if name not in names]]]


def _snake(kind: str) -> str:
    return kind.replace("+", "_").replace(" ", "_")


def _fields(fields_deg: Sequence[float]) -> str:
    return f"field {', '.join(f'{field:g}' for field in fields_deg)} deg"


def _cut_text(reason: str, settings: dict[str, Any]) -> str:
    """How a reason of the energy ledger reads in a warning."""
    return CUT_TEXTS.get(reason, f"lost to '{reason}'").format(**settings)


def _exponent(value: float) -> int:
    return math.floor(math.log10(abs(value)))

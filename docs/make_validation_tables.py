"""Writes the tables of docs/validation, of all its pages or of some.

    PYTHONPATH=tests python docs/make_validation_tables.py [phone_camera] [phone_camera_objects] [lsst] …

Tables stand between comments with their names. Tests in `tests/validation` compare them with smaller runs.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from validation import phone_camera
from validation.tables import DOCS

import mistray

if TYPE_CHECKING:
    import pandas as pd
    from validation.beside_batoid import Comparison, Names, Sums
    from validation.phone_camera_objects import Row as StudyRow

    from mistray.analyses.objects.result import Objects

IMAGE_RAYS = 40_000
ON_AXIS_RAYS = 4_000_000
GHOST_RAYS = {0.0: 400_000, 5.0: 400_000, 10.0: 400_000}
FAR_GHOST_RAYS = 2_000_000
THREE_REFLECTION_RAYS = 1_000_000
BEAM_RAYS = 100_000
TOP = 4
PST_RAYS, PST_BEAM_RAYS = 1_000_000, 50_000
PST_BEAM_FIELDS_DEG = [10, 20, 30, 40]
MITIGATION_RAYS = 20_000
PST_STRAY = ("straight_shot", "ghost", "single_scatter")
LSST_RAYS = 100_000
LSST_FIELDS_DEG = (0.0, 1.0, 1.4, 1.6, 1.75)
PRODUCT_ANGLES, PRODUCTS_SHOWN = (4.0, 30.0), 12
Row = dict[str, Any]


def number(value: float, se: float | None = None, digits: int = 4) -> str:
    """A number with four digits; with a standard error, two digits of that and as many decimals of the value."""
    if not math.isfinite(value):
        return "–"
    if se is None:
        text = f"{value:.{digits}g}"
        return f"{value:,.0f}" if "e+" in text else text
    if se == 0 or not math.isfinite(se):
        return number(value)
    decimals = 1 - int(f"{se:.1e}".partition("e")[2])
    if abs(value) < 1e-3 or abs(value) >= 1e6:
        exponent = math.floor(math.log10(abs(value)))
        scale, places = 10.0**exponent, max(decimals + exponent, 0)
        return f"({value / scale:.{places}f} ± {se / scale:.{places}f})e{exponent}"
    decimals = max(decimals, 0)
    return f"{value:.{decimals}f} ± {se:.{decimals}f}"


def _markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    cells = [list(header), *[list(row) for row in rows]]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]

    def line(row: Sequence[str]) -> str:
        return "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |"

    return "\n".join([line(cells[0]), "|" + "|".join("-" * (w + 2) for w in widths) + "|", *map(line, cells[1:])])


class _Cells(dict[str, Any]):
    """Values of a row; "a±b" is the number a with the standard error b."""

    def __missing__(self, key: str) -> str:
        value, se = key.split("±")
        return number(self[value], self[se])


def table(header: str, cells: str, rows: Iterable[Mapping[str, Any]]) -> str:
    """A Markdown table of headings and formats of a row's values, parted by " | "; {a±b} is a number with its error."""
    return _markdown(header.split(" | "), [cells.format_map(_Cells(row)).split(" | ") for row in rows])


def write(file: str, tables: dict[str, str]) -> None:
    """Put each table between its markers ``<!-- name -->`` and ``<!-- end -->``; every marker must have its table."""
    path = DOCS / file
    text = path.read_text(encoding="utf-8")
    names = re.findall(r"<!-- (\w+) -->\n", text)
    if set(names) - {"end"} != set(tables):
        raise ValueError(f"{path}: it has places for {sorted(set(names) - {'end'})}, not for {sorted(tables)}")
    for name, table in tables.items():
        text = re.sub(rf"(<!-- {name} -->\n).*?(<!-- end -->)", rf"\g<1>\n{table}\n\n\g<2>", text, flags=re.DOTALL)
    path.write_text(text, encoding="utf-8")


def _in_kilowatts(rows: list[dict[Any, Any]]) -> list[dict[Any, Any]]:
    others = ("limit", "reading", "radius_mm", "wavelength_nm", "rms_um")
    return [{key: value if key in others else value / 1e3 for key, value in row.items()} for row in rows]


def _readings_table(rows: list[dict[Any, Any]]) -> str:
    columns = [key for key in rows[0] if key != "reading"]
    header = " | ".join(["reading of the study", *(f"{radius:.5f} mm, {nm:.2f} nm" for radius, nm in columns)])
    named = [{"reading": row["reading"]} | {f"c{k}": row[key] for k, key in enumerate(columns)} for row in rows]
    return table(header, " | ".join(["{reading}", *(f"{{c{k}:.2f}}" for k in range(len(columns)))]), named)


def _ghost_rows(tables: dict[float, pd.DataFrame], three: dict[float, pd.DataFrame]) -> str:
    def own(row: Any) -> str:
        return number(row.rms_irradiance_W_mm2, row.rms_irradiance_se_W_mm2)

    rows: list[Row] = []
    for field, found in tables.items():
        study = [ghost for ghost in phone_camera.REPORT if ghost.field_deg == field]
        for rank, ghost in enumerate(study[:TOP]):
            source = three.get(field) if len(ghost.surfaces) == 3 else found
            same = phone_camera.strongest(source, ghost.surfaces) if source is not None and ghost.surfaces else None
            ours = found.iloc[rank]
            rows.append(
                asdict(ghost)
                | {"rank": rank + 1, "names": ours.surfaces, "watt": own(ours), "norm": ours.normalised_rms_irradiance}
                | {"theirs": " → ".join(ghost.surfaces) or "not named", "same": own(same) if same is not None else "–"}
            )
    return table(
        "field ° | rank | mistray: reflecting surfaces | W/mm² | normalised | study: path | its surfaces | "
        "study W/mm² | study norm. | mistray on its surfaces",
        "{field_deg:g} | {rank} | {names} | {watt} | {norm:.3g} | {path} | {theirs} | {irradiance:.4g} | "
        "{normalised:.3g} | {same}",
        rows,
    )


def _write_phone_camera() -> None:
    scene = phone_camera.shipped().to_scene()
    tables = {
        field: phone_camera.ghost_table(scene, field, GHOST_RAYS.get(field, FAR_GHOST_RAYS))
        for field in phone_camera.FIELDS_DEG
    }
    three = {
        field: phone_camera.ghost_table(scene, field, THREE_REFLECTION_RAYS, max_reflections=3)
        for field in phone_camera.THREE_REFLECTIONS
    }
    limits = {"stop": "stop", "beam": "source, no stop"}
    on_axis = [row | {"limit": limits[row["limit"]]} for row in _in_kilowatts(phone_camera.on_axis(ON_AXIS_RAYS))]
    image = table(
        "field ° | RMS spot µm | same rays, float64 | evenly sampled | figure | chief ray mm | figure mm | passed | "
        "figure passed | illumination | figure rel. | with barrel | figure barrel",
        "{field_deg:g} | {rms_um:.4f} | {rms_replayed_um:.4f} | {rms_even_um:.3f} | {rms_figure_um:.3f} | "
        "{chief_mm:.5f} | {chief_figure_mm:.5f} | {passed:.4f} | {passed_figure:.4f} | {illumination:.4f} | "
        "{illumination_figure:.4f} | {barrel±barrel_se} | {barrel_figure:.4f}",
        phone_camera.image(IMAGE_RAYS),
    )
    write(
        "phone_camera.md",
        {
            "image": image,
            "on_axis": table(
                "beam ends at | radius mm | λ nm | RMS spot µm | quadrature | ray tree | ± of 10⁴ rays | ± of 10⁶ rays",
                "{limit} | {radius_mm:.5f} | {wavelength_nm:.2f} | {rms_um:.4f} | {quadrature:.2f} | "
                "{traced±traced_se} | {study_se:.1f} | {million_se:.2f}",
                on_axis,
            ),
            "readings": _readings_table(_in_kilowatts(phone_camera.readings())),
            "pairs": table(
                "ghost | RMS radius µm | ray tree | quadrature | quadrature, no stop | ± of 10⁴ rays | study",
                "{surfaces} | {rms_um:.2f} | {traced±traced_se} | {quadrature:.4f} | {unclipped:.4f} | {study_se:.2g} "
                "| {study:.4f}",
                phone_camera.ghost_pairs(tables[0]),
            ),
            "ghosts": _ghost_rows(tables, three),
            "turned": table(
                "number | study W/mm² | its beam and stop | beam about the stop | stop of 1.2517 mm",
                "{name} | {study±study_se} | {studied±studied_se} | {about_stop±about_stop_se} | "
                "{own_stop±own_stop_se}",
                phone_camera.beams_and_stops(BEAM_RAYS),
            ),
        },
    )


def _list_table(rows: Sequence[StudyRow], which: str, found: Objects, other: Objects | None = None) -> str:
    from validation import phone_camera_objects as camera

    def cells(row: StudyRow) -> list[str]:
        rays, *watt = camera.sums(found, which, row)
        watts = [watt, *([camera.sums(other, which, row)[1:]] if other else [])]
        own = (number(power, se) if power else "0" for power, se in watts)
        return [row.label, f"{row.rays}", f"{row.power:.6f}", camera.names(row), f"{rays:.0f}", *own]

    header = ["study", "study rays", "study W", "here", "rays", "W", *(["W with total reflection"] if other else [])]
    return _markdown(header, [cells(row) for row in rows])


def _beyond_table(rows: Sequence[StudyRow], which: str, found: Objects, least: float = 1e-4) -> str:
    from validation import phone_camera_objects as camera

    known = {place for row in rows for place in row.here}
    scale = camera.STUDY_RAYS / found.facts["rays"]
    left = [entry for entry in getattr(found, which) if (entry.id, entry.side) not in known and entry.power > least]
    return _markdown(
        ("object", "side", "rays", "W"),
        [(e.id, e.side, f"{scale * e.rays:.0f}", number(e.power, e.power_se)) for e in left],
    )


def _common_table(found: Objects) -> str:
    from validation import phone_camera_objects as camera

    lines = [(label, here, "yes" if study else "–", "yes" if own else "–")
             for label, here, study, own in camera.common_rows(found)]  # fmt: skip
    known = {place for row in (*camera.CRITICAL, *camera.ILLUMINATED) for place in row.here}
    lines += [("–", f"{e.id}", "–", "yes") for e in found.common if (e.id, e.side) not in known]
    return _markdown(("study", "here", "common in the study", "common here"), lines)


def _product_table(results: dict[float, list[dict[str, Any]]]) -> str:
    def with_ratio(angle: float, row: dict[str, Any]) -> dict[str, Any]:
        ratio = row["product"] / row["traced"]
        error = ratio * np.hypot(row["product_se"] / row["product"], row["traced_se"] / row["traced"])
        return row | {"angle": angle, "ratio": ratio, "ratio_se": error}

    return table(
        "angle ° | object | Φ W | BSDF 1/sr | GCF | product W | traced W | product / traced",
        "{angle:g} | {id} | {flux:.4g} | {bsdf:.3g} | {gcf:.3g} | {product±product_se} | {traced±traced_se} | "
        "{ratio±ratio_se}",
        [with_ratio(angle, row) for angle, rows in results.items() for row in rows[:PRODUCTS_SHOWN]],
    )


def _write_phone_camera_objects() -> None:
    from validation import phone_camera_objects as camera

    found, reflected = camera.search(), camera.search(total_reflection=True)
    write(
        camera.FILE,
        {
            "critical": _list_table(camera.CRITICAL, "critical", found, reflected),
            "critical_only_here": _beyond_table(camera.CRITICAL, "critical", found),
            "illuminated": _list_table(camera.ILLUMINATED, "illuminated", found),
            "illuminated_only_here": _beyond_table(camera.ILLUMINATED, "illuminated", found),
            "common": _common_table(found),
            "products": _product_table({angle: camera.products(angle, 1_000_000, 400_000) for angle in PRODUCT_ANGLES}),
        },
    )


def _beam_psts(loaded: Any, angles: list[int], rays: int) -> dict[int, float]:
    from validation.phone_camera_pst import ABSORBED, SIDE

    beam = mistray.ghosts(loaded, field_deg=angles, rays=rays)
    area = SIDE**2
    sums = {angle: beam.summary(float(angle)) for angle in angles}
    return {angle: (s.direct.power_W.value + s.stray_W.value) / ABSORBED / area for angle, s in sums.items()}


def _write_phone_camera_pst() -> None:
    from validation import phone_camera_pst as camera

    scene = camera.scene()
    curve = camera.curve(scene, PST_RAYS)
    groups = {group: curve.curve(group) for group in ("total", "direct", *PST_STRAY)}
    implied = camera.implied().PST

    def light(group: str, i: int) -> str:
        value, se = (column[i] for column in groups[group])
        return number(value, se) if value > 0 or group == "total" else "–"

    rows: list[Row] = [
        {"angle": angle, "projected": number(projected, se), "implied": "–"}
        | {group: light(group, i) for group in groups}
        | ({"implied": f"{implied[angle]:.3g}"} if angle in implied.index else {})
        for i, (angle, projected, se) in enumerate(zip(curve.field_deg, *curve.to("projected").curve(), strict=True))
        if angle % 4 == 0 or angle in implied.index
    ]
    watts = camera.watts(scene, PST_BEAM_RAYS).to_dict("records")
    beam = _beam_psts(scene, PST_BEAM_FIELDS_DEG, PST_BEAM_RAYS)
    write(
        "phone_camera_pst.md",
        {
            "pst": table(
                "angle ° | all light | projected | image | straight shots | ghosts | single scatter | Table 27",
                "{angle:g} | {total} | {projected} | {direct} | {straight_shot} | {ghost} | {single_scatter} | "
                "{implied}",
                rows,
            ),
            "breaks": table(
                "angle ° | slope before, decades/° | after | ± of the change | causes before | causes after",
                "{angle:g} | {before:+.3f} | {after:+.3f} | {se:.3f} | {causes_before} | {causes_after}",
                camera.bends(curve).to_dict("records"),
            ),
            "causes": table(
                "angle ° | study | % | first-level scatter here | % | all stray light here | %",
                "{angle:g} | {name} | {percent:.3g} | {surface} | {surface_percent:.0f} | {cause} | "
                "{cause_percent:.0f}",
                camera.main_causes(curve).to_dict("records"),
            ),
            "watts": table(
                "angle ° | study: 1st scatter | study W | same surface here | our strongest | its W",
                "{angle:g} | {name} | {study:.2g} | {found} | {surface} | {power±power_se}",
                [row | {"found": number(row["same"], row["same_se"]) if row["same"] > 0 else "0"} for row in watts],
            ),
            "beam": table(
                "angle ° | beam of 1.252 mm in the y-z plane | light everywhere, all azimuths",
                "{angle:g} | {beam:.3g} | {all}",
                [{"angle": angle, "beam": e, "all": light("total", angle // 2)} for angle, e in beam.items()],
            ),
        },
    )


def _differences(pairs: dict[Names, tuple[Sums, Sums]]) -> dict[str, float]:
    both = list(pairs.values())
    return {
        "rays": max(abs(a.rays - b.rays) for a, b in both),
        "flux": max(abs(a.flux / b.flux - 1) for a, b in both),
        "centroid_mm": max(float(np.hypot(a.x_mm - b.x_mm, a.y_mm - b.y_mm)) for a, b in both),
        "rms": max(abs(a.rms_mm / b.rms_mm - 1) for a, b in both),
    }


def _write_phone_camera_mitigation() -> None:
    from validation import phone_camera_mitigation as changed

    found = changed.swept(MITIGATION_RAYS)
    angles = changed.ANGLES_DEG
    write(
        "phone_camera_mitigation.md",
        {
            "start": table(
                "angle ° | stray PST | strongest path | % of the stray light",
                "{angle:g} | {pst±pst_se} | {path} | {share:.0f}",
                changed.start(found),
            ),
            "changes": table(
                " | ".join(["change", "image", *(f"{angle}°" for angle in angles)]),
                " | ".join(["{change}", "{image:.3f}", *(f"{{text{angle}}}" for angle in angles)]),
                changed.ratios(found),
            ),
        },
    )


def _write_lsst() -> None:
    from validation.beside_batoid import LSST

    results = {field: LSST.compare(field, LSST_RAYS) for field in LSST_FIELDS_DEG}
    fields: list[Row] = []
    for field, result in results.items():
        most = max(ours.rays for ours, _ in result.paths.values())
        again = {names: pair for names, pair in result.more.items() if names.count("M3") > 1}
        for kind, pairs in (("neighbours", result.ghosts()), ("by M3 again", again)):
            if pairs:
                fields.append(
                    {"field": field, "kind": kind, "found": len(pairs), "missing": len(result.missing)}
                    | {"vignetted": sum(a.rays < 0.95 * most for a, _ in pairs.values())}
                    | {"permille": sum(1e3 * a.flux for a, _ in pairs.values())}
                    | _differences(pairs)
                )

    def turns(pairs: list[tuple[Names, tuple[Sums, Sums]]]) -> str:
        return table(
            "turns at | rays | flux ‰ | batoid ‰ | y mm | batoid y mm | RMS radius mm | batoid RMS mm",
            "{name} | {a.rays} | {a_flux:.6f} | {b_flux:.6f} | {a.y_mm:.4f} | {b.y_mm:.4f} | {a.rms_mm:.5f} | "
            "{b.rms_mm:.5f}",
            [
                {"name": LSST.label(names), "a": a, "b": b, "a_flux": 1e3 * a.flux, "b_flux": 1e3 * b.flux}
                for names, (a, b) in pairs
            ],
        )

    ghosts = sorted(results[1.0].ghosts().items(), key=lambda item: -item[1][0].flux / item[1][0].rms_mm ** 2)
    write(
        "lsst.md",
        {
            "fields": table(
                "field ° | paths | found | vignetted | only batoid's | flux ‰ | Δ rays | Δ flux / flux | "
                "Δ centroid mm | Δ RMS radius / RMS radius",
                "{field:g} | {kind} | {found} | {vignetted} | {missing} | {permille:.4f} | {rays} | {flux:.1e} | "
                "{centroid_mm:.1e} | {rms:.1e}",
                fields,
            ),
            "ghosts": turns(ghosts[:10]),
            "more": turns(list(results[1.6].more.items())[:5]),
            "image": table(
                "field ° | RMS spot µm | batoid µm | added in quadrature µm",
                "{field:g} | {ours:.3f} | {theirs:.3f} | {added:.2f}",
                [{"field": field, **_spots(result)} for field, result in results.items()],
            ),
        },
    )


def _write_telescopes() -> None:
    from validation.test_telescopes import FAINT, RAYS, TELESCOPES

    rows: list[Row] = []
    for telescope, fields in TELESCOPES.values():
        for field in fields:
            result = telescope.compare(field, RAYS)
            star = result.image[1]
            ghosts = {names: pair for names, pair in result.ghosts().items() if pair[1].flux > FAINT * star.flux}
            more = {names: pair for names, pair in ghosts.items() if pair[0].rays > pair[1].rays}
            given_up = {names: telescope.unconverged(names, result) for names in more}
            whole = {names: pair for names, pair in ghosts.items() if not given_up.get(names)}
            rows.append(
                {"file": telescope.file, "field": field, "ghosts": len(ghosts), **_spots(result)}
                | {"flux": _differences(whole)["flux"], "left": len(ghosts) - len(whole)}
                | {"more": sum(a.rays - b.rays for a, b in more.values()), "given_up": sum(given_up.values())}
            )
    found = table(
        "telescope | field ° | RMS spot µm | batoid µm | ghosts | Δ flux / flux | with rays given up | more rays | "
        "given up",
        "{file} | {field:g} | {ours:.3f} | {theirs:.3f} | {ghosts} | {flux:.1e} | {left} | {more} | {given_up}",
        rows,
    )
    write("telescopes.md", {"telescopes": found})


def _spots(result: Comparison) -> dict[str, float]:
    ours, theirs = (1e3 * image.rms_mm for image in result.image)
    return {"ours": ours, "theirs": theirs, "added": math.sqrt(max(ours**2 - theirs**2, 0.0))}


REPORTS: dict[str, Callable[[], None]] = {
    "phone_camera": _write_phone_camera,
    "phone_camera_objects": _write_phone_camera_objects,
    "phone_camera_pst": _write_phone_camera_pst,
    "phone_camera_mitigation": _write_phone_camera_mitigation,
    "lsst": _write_lsst,
    "telescopes": _write_telescopes,
}

if __name__ == "__main__":
    for report in sys.argv[1:] or REPORTS:
        REPORTS[report]()

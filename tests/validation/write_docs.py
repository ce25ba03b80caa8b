"""Writes the tables of docs/validation: ``python tests/validation/write_docs.py [phone_camera] [lsst] …``."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from validation import phone_camera
from validation.tables import number, table, write

if TYPE_CHECKING:
    import pandas as pd
    from validation.beside_batoid import Comparison, Names, Sums

IMAGE_RAYS = 40_000
ON_AXIS_RAYS = 4_000_000
GHOST_RAYS = {0.0: 400_000, 5.0: 400_000, 10.0: 400_000}
FAR_GHOST_RAYS = 2_000_000
THREE_REFLECTION_RAYS = 1_000_000
TOP = 4
PST_RAYS, PST_BEAM_RAYS = 1_000_000, 50_000
PST_BEAM_FIELDS_DEG = [10, 20, 30, 40]
MITIGATION_RAYS = 20_000
PST_STRAY = ("straight_shot", "ghost", "single_scatter")
LSST_RAYS = 100_000
LSST_FIELDS_DEG = (0.0, 1.0, 1.4, 1.6, 1.75)
Row = dict[str, Any]


def in_kilowatts(rows: list[dict[Any, Any]]) -> list[dict[Any, Any]]:
    others = ("limit", "reading", "radius_mm", "wavelength_nm", "rms_um")
    return [{key: value if key in others else value / 1e3 for key, value in row.items()} for row in rows]


def readings_table(rows: list[dict[Any, Any]]) -> str:
    columns = [key for key in rows[0] if key != "reading"]
    header = " | ".join(["reading of the study", *(f"{radius:.5f} mm, {nm:.2f} nm" for radius, nm in columns)])
    named = [{"reading": row["reading"]} | {f"c{k}": row[key] for k, key in enumerate(columns)} for row in rows]
    return table(header, " | ".join(["{reading}", *(f"{{c{k}:.2f}}" for k in range(len(columns)))]), named)


def ghost_rows(tables: dict[float, pd.DataFrame], three: dict[float, pd.DataFrame]) -> str:
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


def write_phone_camera() -> None:
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
    on_axis = [row | {"limit": limits[row["limit"]]} for row in in_kilowatts(phone_camera.on_axis(ON_AXIS_RAYS))]
    radii = phone_camera.implied_radii(tables)
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
            "readings": readings_table(in_kilowatts(phone_camera.readings())),
            "pairs": table(
                "ghost | RMS radius µm | ray tree | quadrature | quadrature, no stop | ± of 10⁴ rays | study",
                "{surfaces} | {rms_um:.2f} | {traced±traced_se} | {quadrature:.4f} | {unclipped:.4f} | {study_se:.2g} "
                "| {study:.4f}",
                phone_camera.ghost_pairs(tables[0]),
            ),
            "ghosts": ghost_rows(tables, three),
            "radii": table(
                "field ° | ghost | power mW | RMS radius µm | study implies µm | difference in quadrature µm",
                "{field_deg:g} | {surfaces} | {power_mW:.3f} | {rms_um:.1f} | {study_rms_um:.1f} | {blur}",
                [row | {"blur": f"{row['blur_um']:.0f}" if math.isfinite(row["blur_um"]) else "–"} for row in radii],
            ),
        },
    )


def write_phone_camera_pst() -> None:
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
    beam = camera.beam_psts(scene, PST_BEAM_FIELDS_DEG, PST_BEAM_RAYS)
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


def write_phone_camera_mitigation() -> None:
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


def write_lsst() -> None:
    from validation.beside_batoid import LSST, differences

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
                    | differences(pairs)
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


def write_telescopes() -> None:
    from validation.beside_batoid import differences
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
                | {"flux": differences(whole)["flux"], "left": len(ghosts) - len(whole)}
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
    "phone_camera": write_phone_camera,
    "phone_camera_pst": write_phone_camera_pst,
    "phone_camera_mitigation": write_phone_camera_mitigation,
    "lsst": write_lsst,
    "telescopes": write_telescopes,
}

if __name__ == "__main__":
    for report in sys.argv[1:] or REPORTS:
        REPORTS[report]()

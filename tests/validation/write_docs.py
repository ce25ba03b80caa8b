"""Writes the tables of docs/validation: ``python tests/validation/write_docs.py [phone_camera] [lsst] …``."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from validation import phone_camera
from validation.tables import markdown, number, write

if TYPE_CHECKING:
    import pandas as pd
    from validation.beside_batoid import Comparison, Sums

IMAGE_RAYS = 40_000
ON_AXIS_RAYS = 4_000_000
GHOST_RAYS = {0.0: 400_000, 5.0: 400_000, 10.0: 400_000}
FAR_GHOST_RAYS = 2_000_000
THREE_REFLECTION_RAYS = 1_000_000
TOP = 4
PST_RAYS, PST_BEAM_RAYS = 1_000_000, 50_000
PST_BEAM_FIELDS_DEG = [10, 20, 30, 40]
PST_STRAY = ("straight_shot", "ghost", "single_scatter")
LSST_RAYS = 100_000
LSST_FIELDS_DEG = (0.0, 1.0, 1.4, 1.6, 1.75)


def image_table(rows: list[dict[str, float]]) -> str:
    """Spot, chief ray and illumination, each with its reference figure."""
    header = ("field °", "RMS spot µm", "same rays, float64", "evenly sampled", "figure", "chief ray mm", "figure mm",
              "passed", "figure passed", "illumination", "figure rel.", "with barrel", "figure barrel")  # fmt: skip
    return markdown(
        header,
        [
            (
                f"{row['field_deg']:g}",
                f"{row['rms_um']:.4f}",
                f"{row['rms_replayed_um']:.4f}",
                f"{row['rms_even_um']:.3f}",
                f"{row['rms_figure_um']:.3f}",
                f"{row['chief_mm']:.5f}",
                f"{row['chief_figure_mm']:.5f}",
                f"{row['passed']:.4f}",
                f"{row['passed_figure']:.4f}",
                f"{row['illumination']:.4f}",
                f"{row['illumination_figure']:.4f}",
                number(row["barrel"], row["barrel_se"]),
                f"{row['barrel_figure']:.4f}",
            )
            for row in rows
        ],
    )


def on_axis_table(rows: list[dict[str, float]]) -> str:
    """RMS irradiance of the image on axis in kW/mm²."""
    limits = {"stop": "stop", "beam": "source, no stop"}
    return markdown(
        (
            "beam ends at",
            "radius mm",
            "λ nm",
            "RMS spot µm",
            "quadrature",
            "ray tree",
            "± of 10⁴ rays",
            "± of 10⁶ rays",
        ),
        [
            (
                limits[row["limit"]],
                f"{row['radius_mm']:.5f}",
                f"{row['wavelength_nm']:.2f}",
                f"{row['rms_um']:.4f}",
                f"{row['quadrature'] / 1e3:.2f}",
                number(row["traced"] / 1e3, row["traced_se"] / 1e3),
                f"{row['study_se'] / 1e3:.1f}",
                f"{row['million_se'] / 1e3:.2f}",
            )
            for row in rows
        ],
    )


def readings_table(rows: list[dict[Any, Any]]) -> str:
    """RMS irradiance of the image on axis for other readings of the data, kW/mm²."""
    columns = [key for key in rows[0] if key != "reading"]
    header = ["reading of the study", *(f"{radius:.5f} mm, {nm:.2f} nm" for radius, nm in columns)]
    return markdown(header, [[row["reading"], *(f"{row[key] / 1e3:.2f}" for key in columns)] for row in rows])


def pairs_table(rows: list[dict[str, float]]) -> str:
    """The four ghosts of Table 22."""
    return markdown(
        ("ghost", "RMS radius µm", "ray tree", "quadrature", "quadrature, no stop", "± of 10⁴ rays", "study"),
        [
            (
                str(row["surfaces"]),
                f"{row['rms_um']:.2f}",
                number(row["traced"], row["traced_se"]),
                f"{row['quadrature']:.4f}",
                f"{row['unclipped']:.4f}",
                f"{row['study_se']:.2g}",
                f"{row['study']:.4f}",
            )
            for row in rows
        ],
    )


def ghost_rows(tables: dict[float, pd.DataFrame], three: dict[float, pd.DataFrame]) -> str:
    """The four worst paths of each field beside those of the study."""
    rows = []
    for field, table in tables.items():
        study = [ghost for ghost in phone_camera.REPORT if ghost.field_deg == field]
        for rank, ghost in enumerate(study[:TOP]):
            own = table.iloc[rank]
            source = three.get(field) if len(ghost.surfaces) == 3 else table
            same = phone_camera.strongest(source, ghost.surfaces) if source is not None and ghost.surfaces else None
            rows.append(
                (
                    f"{field:g}",
                    str(rank + 1),
                    str(own.surfaces),
                    number(own.rms_irradiance_W_mm2, own.rms_irradiance_se_W_mm2),
                    f"{own.normalised_rms_irradiance:.3g}",
                    str(ghost.path),
                    " → ".join(ghost.surfaces) or "not named",
                    f"{ghost.irradiance:.4g}",
                    f"{ghost.normalised:.3g}",
                    number(same.rms_irradiance_W_mm2, same.rms_irradiance_se_W_mm2) if same is not None else "–",
                )
            )
    header = ("field °", "rank", "mistray: reflecting surfaces", "W/mm²", "normalised", "study: path", "its surfaces",
              "study W/mm²", "study norm.", "mistray on its surfaces")  # fmt: skip
    return markdown(header, rows)


def radii_table(rows: list[dict[str, float]]) -> str:
    """RMS radii of the detector's ghosts, and those that the study implies."""
    return markdown(
        ("field °", "ghost", "power mW", "RMS radius µm", "study implies µm", "difference in quadrature µm"),
        [
            (
                f"{row['field_deg']:g}",
                str(row["surfaces"]),
                f"{row['power_mW']:.3f}",
                f"{row['rms_um']:.1f}",
                f"{row['study_rms_um']:.1f}",
                f"{row['blur_um']:.0f}" if math.isfinite(row["blur_um"]) else "–",
            )
            for row in rows
        ],
    )


def write_phone_camera() -> None:
    """docs/validation/phone_camera.md."""
    scene = phone_camera.shipped().to_scene()
    tables = {
        field: phone_camera.ghost_table(scene, field, GHOST_RAYS.get(field, FAR_GHOST_RAYS))
        for field in phone_camera.FIELDS_DEG
    }
    three = {
        field: phone_camera.ghost_table(scene, field, THREE_REFLECTION_RAYS, max_reflections=3)
        for field in phone_camera.THREE_REFLECTIONS
    }
    write(
        "phone_camera.md",
        {
            "image": image_table(phone_camera.image(IMAGE_RAYS)),
            "on_axis": on_axis_table(phone_camera.on_axis(ON_AXIS_RAYS)),
            "readings": readings_table(phone_camera.readings()),
            "pairs": pairs_table(phone_camera.ghost_pairs(tables[0])),
            "ghosts": ghost_rows(tables, three),
            "radii": radii_table(phone_camera.implied_radii(tables)),
        },
    )


def write_phone_camera_pst() -> None:
    """docs/validation/phone_camera_pst.md."""
    from validation import phone_camera_pst as camera

    scene = camera.scene()
    curve = camera.curve(scene, PST_RAYS)
    groups = {group: curve.curve(group) for group in ("total", "direct", *PST_STRAY)}
    projected = curve.to("projected").curve()
    implied = camera.implied().PST
    beam = camera.beam_psts(scene, PST_BEAM_FIELDS_DEG, PST_BEAM_RAYS)
    write(
        "phone_camera_pst.md",
        {
            "pst": markdown(
                (
                    "angle °",
                    "all light",
                    "projected",
                    "image",
                    "straight shots",
                    "ghosts",
                    "single scatter",
                    "Table 27",
                ),
                [
                    (
                        f"{angle:g}",
                        number(groups["total"][0][i], groups["total"][1][i]),
                        number(projected[0][i], projected[1][i]),
                        *(
                            number(groups[group][0][i], groups[group][1][i]) if groups[group][0][i] > 0 else "–"
                            for group in ("direct", *PST_STRAY)
                        ),
                        f"{implied[angle]:.3g}" if angle in implied.index else "–",
                    )
                    for i, angle in enumerate(curve.field_deg)
                    if angle % 4 == 0 or angle in implied.index
                ],
            ),
            "breaks": markdown(
                ("angle °", "slope before, decades/°", "after", "± of the change", "causes before", "causes after"),
                [
                    (
                        f"{b.angle:g}",
                        f"{b.before:+.3f}",
                        f"{b.after:+.3f}",
                        f"{b.se:.3f}",
                        b.causes_before,
                        b.causes_after,
                    )
                    for b in camera.bends(curve).itertuples()
                ],
            ),
            "causes": markdown(
                ("angle °", "study", "%", "first-level scatter here", "%", "all stray light here", "%"),
                [
                    (
                        f"{row.angle:g}",
                        row.name_,
                        f"{row.percent:.3g}",
                        row.surface,
                        f"{row.surface_percent:.0f}",
                        row.cause,
                        f"{row.cause_percent:.0f}",
                    )
                    for row in camera.main_causes(curve).rename(columns={"name": "name_"}).itertuples()
                ],
            ),
            "watts": markdown(
                ("angle °", "study: 1st scatter", "study W", "same surface here", "our strongest", "its W"),
                [
                    (
                        f"{row.angle:g}",
                        row.name_,
                        f"{row.study:.2g}",
                        number(row.same, row.same_se) if row.same > 0 else "0",
                        row.surface,
                        number(row.power, row.power_se),
                    )
                    for row in camera.watts(scene, PST_BEAM_RAYS).rename(columns={"name": "name_"}).itertuples()
                ],
            ),
            "beam": markdown(
                ("angle °", "beam of 1.252 mm in the y-z plane", "light everywhere, all azimuths"),
                [
                    (
                        f"{angle:g}",
                        f"{irradiance:.3g}",
                        number(groups["total"][0][angle // 2], groups["total"][1][angle // 2]),
                    )
                    for angle, irradiance in beam.items()
                ],
            ),
        },
    )


def write_lsst() -> None:
    """docs/validation/lsst.md."""
    from validation import lsst

    results = {field: lsst.compare(field, LSST_RAYS) for field in LSST_FIELDS_DEG}
    fields = []
    for field, result in results.items():
        again = {names: pair for names, pair in result.more.items() if names.count("M3") > 1}
        for kind, pairs in (("neighbours", result.ghosts()), ("by M3 again", again)):
            if pairs:
                worst = lsst.differences(pairs)
                fields.append(
                    (
                        f"{field:g}",
                        kind,
                        str(len(pairs)),
                        str(sum(a.rays < 0.95 * _most_rays(result) for a, _ in pairs.values())),
                        str(len(result.missing)),
                        f"{1e3 * sum(a.flux for a, _ in pairs.values()):.4f}",
                        str(worst["rays"]),
                        f"{worst['flux']:.1e}",
                        f"{worst['centroid_mm']:.1e}",
                        f"{worst['rms']:.1e}",
                    )
                )
    header = ("field °", "paths", "found", "vignetted", "only batoid's", "flux ‰", "Δ rays", "Δ flux / flux",
              "Δ centroid mm", "Δ RMS radius / RMS radius")  # fmt: skip
    ghosts = sorted(results[1.0].ghosts().items(), key=lambda item: -item[1][0].flux / item[1][0].rms_mm ** 2)
    write(
        "lsst.md",
        {
            "fields": markdown(header, fields),
            "ghosts": markdown(
                ("turns at", "rays", "flux ‰", "batoid ‰", "y mm", "batoid y mm", "RMS radius mm", "batoid RMS mm"),
                [_lsst_row(lsst.label(names), *pair) for names, pair in ghosts[:10]],
            ),
            "more": markdown(
                ("turns at", "rays", "flux ‰", "batoid ‰", "y mm", "batoid y mm", "RMS radius mm", "batoid RMS mm"),
                [_lsst_row(lsst.label(names), *pair) for names, pair in list(results[1.6].more.items())[:5]],
            ),
            "image": markdown(
                ("field °", "RMS spot µm", "batoid µm", "added in quadrature µm"),
                [_image_row(field, result) for field, result in results.items()],
            ),
        },
    )


def write_telescopes() -> None:
    """docs/validation/telescopes.md."""
    from validation.beside_batoid import differences
    from validation.test_telescopes import FAINT, RAYS, TELESCOPES

    rows = []
    for telescope, fields in TELESCOPES.values():
        for field in fields:
            result = telescope.compare(field, RAYS)
            ours, star = result.image
            ghosts = {names: pair for names, pair in result.ghosts().items() if pair[1].flux > FAINT * star.flux}
            more = {names: pair for names, pair in ghosts.items() if pair[0].rays > pair[1].rays}
            given_up = {names: telescope.unconverged(names, result) for names in more}
            whole = {names: pair for names, pair in ghosts.items() if not given_up.get(names)}
            rows.append(
                (
                    telescope.file,
                    f"{field:g}",
                    f"{1e3 * ours.rms_mm:.3f}",
                    f"{1e3 * star.rms_mm:.3f}",
                    str(len(ghosts)),
                    f"{differences(whole)['flux']:.1e}",
                    str(len(ghosts) - len(whole)),
                    str(sum(pair[0].rays - pair[1].rays for pair in more.values())),
                    str(sum(given_up.values())),
                )
            )
    header = ("telescope", "field °", "RMS spot µm", "batoid µm", "ghosts", "Δ flux / flux", "with rays given up",
              "more rays", "given up")  # fmt: skip
    write("telescopes.md", {"telescopes": markdown(header, rows)})


def _most_rays(result: Comparison) -> int:
    return max(ours.rays for ours, _ in result.paths.values())


def _lsst_row(name: str, ours: Sums, theirs: Sums) -> tuple[str, ...]:
    cells = [f"{1e3 * s.flux:.6f}" for s in (ours, theirs)] + [f"{s.y_mm:.4f}" for s in (ours, theirs)]
    return (name, str(ours.rays), *cells, *(f"{s.rms_mm:.5f}" for s in (ours, theirs)))


def _image_row(field: float, result: Comparison) -> tuple[str, ...]:
    ours, theirs = next(pair for names, pair in result.paths.items() if result.order[names] == 0)
    a, b = 1e3 * ours.rms_mm, 1e3 * theirs.rms_mm
    return f"{field:g}", f"{a:.3f}", f"{b:.3f}", f"{math.sqrt(max(a * a - b * b, 0.0)):.2f}"


REPORTS: dict[str, Callable[[], None]] = {
    "phone_camera": write_phone_camera,
    "phone_camera_pst": write_phone_camera_pst,
    "lsst": write_lsst,
    "telescopes": write_telescopes,
}

if __name__ == "__main__":
    for report in sys.argv[1:] or REPORTS:
        REPORTS[report]()

"""Image quality as printed text, JSON values, tables, pictures and a report page."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from mistray.analyses.image.request import ImageTables
from mistray.analyses.image.result import FieldImage, ImageQuality
from mistray.files.json_values import plain
from mistray.ranges import FREQUENCY_PER_MM
from mistray.toolkit.pages.model import FigurePart, NotePart, Report, Section, Table, Value, columns
from mistray.toolkit.pages.output import write_report
from mistray.toolkit.pages.parts import settings_section, terms
from mistray.toolkit.tables.text import ABSENT, table_text

ZERNIKES = 37
DEFAULT_TABLES = ImageTables()
CURVE_POINTS = 101


def heading(found: ImageQuality) -> str:
    """Return a line of text with wavelengths (nm), stop, and magnification or image scale (mm)."""
    waves = ", ".join(f"{wave:g}" for wave in found.wavelengths_nm)
    scale = (
        f"magnification {found.magnification:.5g}"
        if found.near
        else f"image scale {found.image_scale_mm:.6g} mm / tan θ"
    )
    return f"image quality of the direct light at {waves} nm; stop: {found.stop}; {scale}"


def frequencies_of(found: ImageQuality, shown: ImageTables) -> Sequence[float]:
    """Return the spatial frequencies for the tables, 1/mm: those requested, or three below the cut-off."""
    return found.default_frequencies() if shown.frequencies is None else shown.frequencies


def quality_table(found: ImageQuality, shown: ImageTables = DEFAULT_TABLES) -> Table:
    """
    Return the table of main results by field: spot, wavefront, Strehl ratio, MTF, illumination, distortion.

    The MTF is that at the frequencies of `shown`, 1/mm.
    """
    frequencies = frequencies_of(found, shown)
    heads = columns(
        "<field", "image x, y [mm]", "rms spot [µm]", "rms OPD [waves]", "Strehl",
        *(f"MTF T/S at {f:g} [1/mm]" for f in frequencies),
        "80 % within [µm]", "N T/S", "rel. illum. [%]", "distortion [%]",
    )  # fmt: skip
    rows: list[list[Value]] = []
    for image in found:
        both = zip(image.mtf(frequencies, "tangential"), image.mtf(frequencies, "sagittal"), strict=True)
        rows.append([
            image.name, ", ".join(f"{place + 0.0:.4f}" for place in image.image_mm),
            f"{1e3 * image.rms_spot_mm():.3g}", f"{image.rms_waves():.4f}", _number(image.strehl, "{:.4f}"),
            *(" / ".join(_number(value, "{:.3f}") for value in pair) for pair in both),
            _number(1e3 * image.encircled_radius_mm(), "{:.3g}"),
            f"{image.f_number('tangential'):.3f} / {image.f_number('sagittal'):.3f}",
            f"{100 * image.relative_illumination:.2f}", _number(image.distortion_percent, "{:+.4f}"),
        ])  # fmt: skip
    return Table(heads, rows, "image_quality")


def field_image_table(image: FieldImage) -> Table:
    """Return the table of one field, a row per wavelength (nm): weight, RMS and PV OPD (waves), and Strehl ratio."""
    rows: list[list[Value]] = [
        [f"{line.wavelength_nm:g}", f"{line.weight:.3g}", f"{line.rms_waves():.4f}", f"{line.pv_waves():.4f}",
         _number(line.strehl, "{:.4f}")]
        for line in image.lines
    ]  # fmt: skip
    return Table(columns("λ [nm]", "weight", "rms OPD [waves]", "PV OPD [waves]", "Strehl"), rows)


def _number(value: float, form: str) -> str:
    return form.format(value) if math.isfinite(value) else ABSENT


def zernike_frame(found: ImageQuality) -> pd.DataFrame:
    """Return a DataFrame of Noll's Zernike coefficients in waves, by field (degrees), wavelength (nm) and index."""
    rows = []
    for image in found:
        for line in image.lines:
            fit = line.zernikes("noll", ZERNIKES)
            rows += [
                {"field_deg": image.field_deg, "wavelength_nm": line.wavelength_nm, "noll": number, "name": name,
                 "coefficient_waves": float(value)}
                for number, (name, value) in enumerate(zip(fit.names, fit.coefficients, strict=True), start=1)
            ]  # fmt: skip
    return pd.DataFrame(rows)


def curve_frame(found: ImageQuality) -> pd.DataFrame:
    """Return a DataFrame of each field's MTF and its diffraction limit at 101 frequencies, 1/mm, to the cut-off."""
    parts = []
    for image in found:
        last = max(image.cut_off_per_mm("tangential"), image.cut_off_per_mm("sagittal"))
        f = [last * k / (CURVE_POINTS - 1) for k in range(CURVE_POINTS)]
        parts.append(pd.DataFrame({
            "field_deg": image.field_deg, "frequency_per_mm": f,
            "mtf_tangential": image.mtf(f, "tangential"), "mtf_sagittal": image.mtf(f, "sagittal"),
            "diffraction_limit_tangential": image.diffraction_limit(f, "tangential"),
            "diffraction_limit_sagittal": image.diffraction_limit(f, "sagittal"),
        }))  # fmt: skip
    return pd.concat(parts, ignore_index=True)


def text(found: ImageQuality, shown: ImageTables = DEFAULT_TABLES) -> str:
    """Return the text that `mistray image` prints, with the MTF at the frequencies of `shown`, 1/mm."""
    notes = [f"note: {note}" for note in found.notes]
    return "\n".join([heading(found), table_text(quality_table(found, shown)), *notes])


def record(found: ImageQuality, shown: ImageTables = DEFAULT_TABLES) -> dict[str, Any]:
    """Return the image quality as JSON-serialisable values, with the MTF at the frequencies of `shown`, 1/mm."""
    fields, frequencies = [], frequencies_of(found, shown)
    for image, row in zip(found, found.to_pandas([]).to_dict("records"), strict=True):
        fit = image.main.zernikes("noll", ZERNIKES)
        fields.append({
            **row,
            "mtf": [
                {"frequency_per_mm": f, "tangential": float(t), "sagittal": float(s)}
                for f, t, s in zip(
                    frequencies, image.mtf(frequencies, "tangential"), image.mtf(frequencies, "sagittal"), strict=True
                )
            ],
            "zernikes_noll_waves": fit.coefficients.tolist(),
        })  # fmt: skip
    scale = {"magnification": found.magnification} if found.near else {"image_scale_mm": found.image_scale_mm}
    return dict(
        plain({"stop": found.stop, **scale, "fields": fields, "notes": list(found.notes), "facts": found.facts})
    )


def page(found: ImageQuality, shown: ImageTables = DEFAULT_TABLES, title: str = "scene", command: str = "") -> Report:
    """
    Return the report page, with the MTF in its table at the frequencies of `shown`, 1/mm.

    `title` is the name of the optical system, `command` the command line that made it.
    """
    from mistray.analyses.image import figures as drawn
    from mistray.toolkit.figures.plots import as_png

    pictures = {
        "mtf": (drawn.mtf_figure, "Modulation transfer function."),
        "psf": (drawn.psf_figure, "Point spread functions."),
        "opd": (drawn.opd_figure, "Wavefronts."),
        "spots": (drawn.spot_figure, "Spot diagrams."),
        "energy": (drawn.energy_figure, "Encircled energy."),
    }
    if len(found) > 1:
        pictures["fields"] = (drawn.field_figure, "Relative illumination, distortion and foci over the field.")
    sections = [Section("quality", "Image quality", [quality_table(found, shown)], "Numbers")]
    for name, (figure, text) in pictures.items():
        sections.append(
            Section(name, text.rstrip("."), [FigurePart(functools.partial(figure, found), text)], name.upper())
        )
    return Report(
        "Image quality",
        title,
        [*sections, settings_section(found.facts, command, terms("image"), link="Definitions and settings")],
        lead=[NotePart(f"{heading(found)}.", "sub")],
        warnings=list(found.notes),
        csv={
            "image_quality.csv": found.to_pandas(frequencies_of(found, shown)),
            "mtf.csv": curve_frame(found),
            "zernikes.csv": zernike_frame(found),
        },
        json={"image_quality.json": {"title": title, "command": command} | record(found, shown)},
        result=found,
        files={f"{name}.png": as_png(figure(found, title)) for name, (figure, _) in pictures.items()},
    )


def write_quality(
    found: ImageQuality,
    directory: str | Path,
    frequencies: float | Sequence[float] | None = None,
    title: str = "scene",
    command: str = "",
) -> list[Path]:
    """
    Write tables, pictures, image_quality.json and report.html into a directory, see `write_report`.

    `frequencies`, 1/mm, are those of the MTF in the tables; by default three below the cut-off. `title`, the name of
    the optical system, and `command`, the command line, appear in the report. The files written are returned.

    Examples
    --------
    >>> found = mistray.image_quality(mistray.load("ritchey_chretien"), 0.1, grid=32)
    >>> files = mistray.report.write_quality(found, "quality", frequencies=50.0)
    >>> [file.name for file in files[:3]]
    ['image_quality.csv', 'mtf.csv', 'zernikes.csv']
    """
    return write_report(page(found, _tables(frequencies), title, command), directory)


def _tables(frequencies: float | Sequence[float] | None) -> ImageTables:
    return ImageTables(
        frequencies if frequencies is None else tuple(FREQUENCY_PER_MM.check_each("frequencies", frequencies))
    )


def quality_text(found: ImageQuality, frequencies: float | Sequence[float]) -> str:
    """
    Return the printed text with the MTF at the given spatial frequencies, 1/mm.

    Examples
    --------
    >>> found = mistray.image_quality(mistray.load("ritchey_chretien"), 0.1, grid=32)
    >>> print(mistray.report.quality_text(found, 20.0).splitlines()[0])
    image quality of the direct light at 550 nm; stop: primary; image scale 4928.57 mm / tan θ
    """
    return text(found, _tables(frequencies))


write = write_quality  # its name in a `page`

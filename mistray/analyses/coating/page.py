"""Output of evaluated coatings: text, JSON values and picture."""

from __future__ import annotations

from typing import Any

import numpy as np

from mistray.analyses.coating.figures import CoatedSurfaces, coating_figure, surfaces_figure
from mistray.analyses.coating.run import CoatingResult, SurfacesResult
from mistray.coatings import CoatingSpectrum, Stack
from mistray.files.json_values import plain
from mistray.toolkit.figures.figure import Figure
from mistray.toolkit.pages.model import Table, columns
from mistray.toolkit.tables.text import table_text

SHARES = ("R", "T", "A")
ROWS_SHOWN = 7
LAYER = {"material": "", "thickness_nm": ".3f", "n": ".4f", "k": ".3g", "waves": ".4f"}  # columns with their formats


def text(found: CoatingResult | SurfacesResult) -> str:
    """Return a result as tables of text: layers and R, T, A in percent, or mean reflectances of a scene's surfaces."""
    asked = found.request
    if isinstance(found, SurfacesResult):
        band = f"{asked.wavelength_nm[0]:g} to {asked.wavelength_nm[-1]:g} nm"
        title = f"mean reflectance from {band}, unpolarised light from the side of lower index"
        return f"{title}\n{table_text(_surfaces(found))}"
    tables = [*_layers(found), _over_band(found.values), _sample(found.values)]
    title = f"{_name(found)}: {asked.front} | {asked.back}, light from {asked.back if asked.from_back else asked.front}"
    return f"{title}\n" + "\n\n".join(map(table_text, tables))


def record(found: CoatingResult | SurfacesResult) -> dict[str, Any]:
    """Return a result as JSON-serialisable values; that of a single coating includes its whole spectrum."""
    asked = found.request
    if isinstance(found, SurfacesResult):
        surfaces = [
            {"names": list(surface.names)}
            | _facts(surface)
            | {"angles": [{"angle_deg": a, "R_mean": r} for a, r in zip(asked.angles_deg, row, strict=True)]}
            for surface, row in found.means
        ]
        lam = asked.wavelength_nm
        return {"wavelength_from_nm": lam[0], "wavelength_to_nm": lam[-1], "surfaces": surfaces}
    answer = {
        "coating": _name(found),
        "front": asked.front,
        "back": asked.back,
        "from_front": not asked.from_back,
        "design_nm": asked.design_nm,
        "layers": layer_rows(found),
        "band": band_rows(found.values),
        "spectrum": _spectrum(found.values),
    }
    return dict(plain(answer))


def figure(found: CoatingResult | SurfacesResult) -> Figure:
    """Draw the reflectance of a result over wavelength and angle: of one coating, or of each coating in a scene."""
    asked = found.request
    light = asked.wavelength_nm, asked.angles_deg
    if isinstance(found, SurfacesResult):
        return surfaces_figure([surface for surface, _ in found.means], *light)
    return coating_figure(found.coating, *light, asked.front, str(asked.back), not asked.from_back)


def layer_rows(found: CoatingResult) -> list[dict[str, Any]]:
    """
    Return rows for the layers of a stack: material, thickness (nm), n, k, and optical thickness (waves).

    Indices and waves are those at the design wavelength. There are no rows for other coatings.
    """
    if not isinstance(found.coating, Stack):
        return []
    design_nm, rows = found.request.design_nm, []
    for layer, n in zip(found.coating.layers, found.coating.indices(design_nm), strict=True):
        values = layer.material, layer.thickness_nm, n.real, n.imag, n.real * layer.thickness_nm / design_nm
        rows.append(dict(zip(LAYER, values, strict=True)))
    return rows


def band_rows(values: CoatingSpectrum) -> list[dict[str, Any]]:
    """
    Return rows by angle: unpolarised R, T and A, 0 … 1, averaged over the wavelengths, and the least and greatest R.

    Each extreme has its wavelength, nm.
    """
    rows = []
    for k, angle in enumerate(values.angle_deg):
        row = {"angle_deg": angle} | {f"{share}_mean": values.mean(share)[:, k].mean() for share in SHARES}
        r = values.mean()[:, k]
        for name, place in (("R_least", r.argmin()), ("R_greatest", r.argmax())):
            row |= {name: r[place], f"{name}_at_nm": values.wavelength_nm[place]}
        rows.append(row)
    return rows


def _spectrum(values: CoatingSpectrum) -> list[dict[str, Any]]:
    """
    Return a row for each angle (degrees) and wavelength (nm).

    It holds R, T and A, 0 … 1, for s and p, and the phases of reflection and transmission, rad.
    """
    return [
        {
            "angle_deg": angle,
            "wavelength_nm": wavelength,
            **{f"{share}_{pol}": getattr(values, share)[i, k, p] for share in SHARES for p, pol in enumerate("sp")},
            "phase_r_rad": values.phase_r[i, k],
            "phase_t_rad": values.phase_t[i, k],
        }
        for k, angle in enumerate(values.angle_deg)
        for i, wavelength in enumerate(values.wavelength_nm)
    ]


def _name(found: CoatingResult) -> str:
    return found.coating.name or found.request.coating


def _layers(found: CoatingResult) -> list[Table]:
    rows = [
        [f"{number}", *(format(row[name], digits) for name, digits in LAYER.items())]
        for number, row in enumerate(layer_rows(found), start=1)
    ]
    at = (f"{name} [at {found.request.design_nm:g} nm]" for name in ("n", "k", "waves"))
    first = getattr(found.coating, "first", "")
    return [Table(columns(f"layer [{first}]", "<material", "thickness [nm]", *at), rows)] if rows else []


def _over_band(values: CoatingSpectrum) -> Table:
    """Return the table of R, T and A in percent, mean over the wavelengths, with the least and greatest R, by angle."""
    rows = []
    for row in band_rows(values):
        # A rounding below zero is no absorption
        shares = [f"{100 * row[f'{share}_mean']:z.4f}" for share in SHARES]
        extremes = (f"{100 * row[name]:.4f} at {row[f'{name}_at_nm']:g}" for name in ("R_least", "R_greatest"))
        rows.append([f"{row['angle_deg']:g}", *shares, *extremes])
    band = f"% over {values.wavelength_nm[0]:g} … {values.wavelength_nm[-1]:g} nm"
    heads = columns("angle [deg]", f"R [{band}]", "T [%]", "A [%]", "least R [% at nm]", "greatest R [% at nm]")
    return Table(heads, rows)


def _sample(values: CoatingSpectrum) -> Table:
    """Return a table of reflectance R, percent, at up to 7 wavelengths: unpolarised, and s and p off the normal."""
    lam = values.wavelength_nm
    shown = np.unique(np.linspace(0, len(lam) - 1, min(ROWS_SHOWN, len(lam))).round().astype(int))
    heads, curves = ["wavelength [nm]"], list[np.ndarray]()
    for k, angle in enumerate(values.angle_deg):
        heads += [f"R {angle:g}° [%]"] + (["s [%]", "p [%]"] if angle > 0 else [])
        curves += [values.mean()[:, k]] + ([*values.R[:, k].T] if angle > 0 else [])
    rows = [[f"{lam[i]:g}", *(f"{100 * curve[i]:.4f}" for curve in curves)] for i in shown]
    return Table(columns(*heads), rows)


def _facts(surface: CoatedSurfaces) -> dict[str, str]:
    return {"coating": surface.coating.name or "ideal", "front": surface.front, "back": surface.back}


def _surfaces(found: SurfacesResult) -> Table:
    angles = (f"{angle:g}° [%]" for angle in found.request.angles_deg)
    rows = [
        [", ".join(surface.names), *_facts(surface).values(), *(f"{100 * mean:.4f}" for mean in row)]
        for surface, row in found.means
    ]
    return Table(columns("<surfaces", "<coating", "<front", "<back", *angles), rows)

"""`mistray coating`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from mistray.cli.coating_json import SHARES, as_json, band_rows, layer_rows
from mistray.cli.options import Options
from mistray.cli.progress import working
from mistray.errors import MistrayError
from mistray.ranges import POLAR_DEG, POSITIVE, WAVELENGTH_NM
from mistray.toolkit.command import Command, Option
from mistray.toolkit.shared_options import FORCE

if TYPE_CHECKING:
    import numpy as np

    from mistray.coatings import CoatingModel, CoatingSpectrum

DEFAULT_WAVELENGTHS = "400:700:5"
DEFAULT_ANGLES = (0.0, 15.0, 30.0, 45.0)
VISIBLE_TO_NM, POINTS = 780.0, 60
ROWS_SHOWN = 7
MOST_WAVELENGTHS = 20_000
LAYER = (("thickness_nm", ".3f"), ("n", ".4f"), ("k", ".3g"), ("waves", ".4f"))  # columns of numbers


# fmt: off
COMMAND = Command(
    "coating",
    "reflectance of a coating over wavelength and angle",
    "Evaluate a coating between two materials, or the coatings of a scene: R, T and A = 1 - R - T\n"
    "over wavelength and angle, for s and p. Pictures, and a CSV table that scenes can use.",
    (
        "mistray coating bbar3 --plot bbar3.png",
        "mistray coating protected_al --wavelength-nm 400:1000:10 --angles-deg 0 45",
        'mistray coating "MgF2 99.64, 2.1 0.5w, 1.63 0.25w" --back N-SF6 --csv ar.csv',
        "mistray coating COATING.DAT:AR --design-nm 587.6 --json",
        "mistray coating cooke_triplet --plot surfaces.png",
    ),
    (
        Option("coating", "preset, 'bare', table.csv, COATING.DAT:NAME, layers between commas (material and thickness "
               "in nm, or in waves with a w), or a scene", metavar="COATING"),
        Option("--front", "material in front (air)", metavar="MATERIAL"),
        Option("--back", "material behind (N-BK7; Ge for presets of the infrared)", metavar="MATERIAL"),
        Option("--from-back", "light comes from behind", bool),
        Option("--wavelength-nm", f"wavelengths, or first:last:step ({DEFAULT_WAVELENGTHS}; in the infrared the band "
               "of the preset, or that of the scene's light)", metavar="NM", nargs="+"),
        Option("--angles-deg", "angles of incidence (0 15 30 45)", POLAR_DEG, "DEG", "+", default=list(DEFAULT_ANGLES)),
        Option("--design-nm", "wavelength of thicknesses in waves and of presets (550, or the preset's own)",
               WAVELENGTH_NM, "NM", default=550.0),
        Option("--plot", "write a picture: .png, .svg or .pdf", Path, "FILE", writes=()),
        Option("--csv", "write R, T and phases; its angles are those in the material of lower index", Path, "FILE",
               writes=()),
        FORCE,
        Option("--json", "print JSON instead of the tables, with the whole spectrum", bool),
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    from mistray.coatings import PRESETS, coating_from_text, spectrum, write_table

    given = None if options.wavelength_nm is None else wavelengths(options.wavelength_nm)
    options.check_pictures("plot")
    files = options.claim()
    if _is_scene(options.coating):
        return _scene(options, given, files)
    coating = coating_from_text(options.coating, options.design_nm)
    design, design_nm, body, lam = PRESETS.get(options.coating), options.design_nm, "N-BK7", given or _visible()
    if design is not None and design.design_nm > VISIBLE_TO_NM:
        design_nm, body = design.centre_nm(design_nm), "Ge"
        lam = given or _band(*(end * design_nm for end in design.band))
    front, back, from_front = options.front or "air", options.back or body, not options.from_back
    values = spectrum(coating, lam, options.angles_deg, front, back, from_front)
    if options.plot is not None:
        from mistray.analyses.coating.figures import coating_figure
        from mistray.toolkit.figures.plots import write_figure

        write_figure(coating_figure(coating, lam, options.angles_deg, front, back, from_front), options.plot)
    if options.csv is not None:
        write_table(coating, options.csv, lam, options.angles_deg, front, back)
    name, side = coating.name or options.coating, front if from_front else back
    where = {"coating": name, "front": front, "back": back, "from_front": from_front}
    return options.tell(
        lambda: where | as_json(coating, values, design_nm),
        lambda: (
            f"{name}: {front} | {back}, light from {side}\n"
            + "\n\n".join([*_layers(coating, design_nm), _over_band(values), _sample(values)])
        ),
        files,
    )


def wavelengths(words: list[str]) -> list[float]:
    """Wavelengths from numbers and from ranges first:last:step."""
    import numpy as np

    found: list[float] = []
    for word in words:
        parts = word.split(":")
        try:
            numbers = [kind(part) for kind, part in zip((WAVELENGTH_NM, WAVELENGTH_NM, POSITIVE), parts, strict=False)]
        except argparse.ArgumentTypeError as error:
            raise MistrayError(f"--wavelength-nm {word}: {error}; give numbers, or first:last:step") from None
        if len(parts) == 1:
            found += numbers
            continue
        if len(parts) != 3 or numbers[1] < numbers[0]:
            raise MistrayError(f"--wavelength-nm {word}: give first:last:step with the last not below the first")
        steps = (numbers[1] - numbers[0]) / numbers[2]
        if steps >= MOST_WAVELENGTHS:
            raise MistrayError(f"--wavelength-nm {word}: {steps:g} wavelengths; take a larger step")
        count = int(steps + 1e-9) + 1
        found += (numbers[0] + numbers[2] * np.arange(count)).tolist()
    return sorted(set(found))


def _visible() -> list[float]:
    return wavelengths([DEFAULT_WAVELENGTHS])


def _band(low_nm: float, high_nm: float) -> list[float]:
    return wavelengths([f"{low_nm:.12g}:{high_nm:.12g}:{(high_nm - low_nm) / POINTS:.12g}"])


def _is_scene(text: str) -> bool:
    """Whether the argument is a scene: an XML file, a folder with one, or the name of a shipped one."""
    from mistray.coatings import PRESETS

    if text.lower().endswith(".xml"):
        return True
    if " " in text or text in PRESETS or text == "bare" or ".csv" in text.lower() or ".dat" in text.lower():
        return False
    from mistray._variant import ensure_variant

    ensure_variant()  # settles libLLVM before anything imports Mitsuba
    from mistray.scene.load import find

    try:
        find(text)
    except MistrayError:
        return False
    return True


def _scene(options: Options, given: list[float] | None, files: list[Path]) -> int:
    """Coatings of the surfaces of a scene."""
    from mistray._mitsuba_compat import silence_warnings
    from mistray._variant import ensure_variant

    own = " has no meaning for a scene, whose surfaces have their own materials; leave it out"
    options.refuse(("front", "back", "from_back", "csv"), own)
    ensure_variant()  # settles libLLVM before anything imports Mitsuba
    silence_warnings()
    from mistray.analyses.coating.figures import coated_surfaces, surfaces_figure
    from mistray.coatings import spectrum
    from mistray.coatings.stack import outside_first
    from mistray.materials import complex_index
    from mistray.scene import load
    from mistray.toolkit.figures.plots import write_figure
    from mistray.toolkit.pages.model import Table, columns
    from mistray.toolkit.tables.text import table_text

    with working(f"loading {options.coating}"):
        scene = load(options.coating)
        surfaces = coated_surfaces(scene)
    light = next((getattr(emitter, "wavelengths_nm", ()) for emitter in scene.emitters()), ())
    invisible = len(light) > 1 and min(light) > VISIBLE_TO_NM
    lam = given or (_band(min(light), max(light)) if invisible else _visible())
    if files:
        write_figure(surfaces_figure(surfaces, lam, options.angles_deg), options.plot)
    rows, records = [], []
    for surface in surfaces:
        sides = (complex_index(material, lam[0]) for material in (surface.front, surface.back))
        values = spectrum(
            surface.coating, lam, options.angles_deg, surface.front, surface.back, outside_first(*sides)
        ).mean()
        means = values.mean(axis=0)
        facts = {"coating": surface.coating.name or "ideal", "front": surface.front, "back": surface.back}
        rows.append([", ".join(surface.names), *facts.values(), *(f"{100 * value:.4f}" for value in means)])
        by_angle = zip(options.angles_deg, means.tolist(), strict=True)
        records.append(
            {"names": list(surface.names), **facts, "angles": [{"angle_deg": a, "R_mean": r} for a, r in by_angle]}
        )
    title = f"mean reflectance from {lam[0]:g} to {lam[-1]:g} nm, unpolarised light from the side of lower index"
    heads = columns("<surfaces", "<coating", "<front", "<back", *(f"{angle:g}° [%]" for angle in options.angles_deg))
    return options.tell(
        lambda: {"wavelength_from_nm": lam[0], "wavelength_to_nm": lam[-1], "surfaces": records},
        lambda: f"{title}\n{table_text(Table(heads, rows))}",
        files,
    )


def _layers(coating: CoatingModel, design_nm: float) -> list[str]:
    """Table of the layers of a stack; nothing for others."""
    from mistray.toolkit.pages.model import Table, columns
    from mistray.toolkit.tables.text import table_text

    rows = [
        [f"{number}", row["material"], *(f"{row[name]:{form}}" for name, form in LAYER)]
        for number, row in enumerate(layer_rows(coating, design_nm), start=1)
    ]
    if not rows:
        return []
    at = f"at {design_nm:g} nm"
    first = getattr(coating, "first", "")
    heads = columns(
        f"layer [{first}]", "<material", "thickness [nm]", *(f"{name} [{at}]" for name in ("n", "k", "waves"))
    )
    return [table_text(Table(heads, rows))]


def _over_band(values: CoatingSpectrum) -> str:
    """Table of the mean and the extremes of R over the wavelengths."""
    from mistray.toolkit.pages.model import Table, columns
    from mistray.toolkit.tables.text import table_text

    rows = []
    for row in band_rows(values):
        shares = [f"{100 * row[f'{share}_mean']:.4f}" for share in SHARES]
        # A rounding below zero is no absorption
        shares[2] = shares[2].removeprefix("-") if float(shares[2]) == 0 else shares[2]
        extremes = (f"{100 * row[name]:.4f} at {row[f'{name}_at_nm']:g}" for name in ("R_least", "R_greatest"))
        rows.append([f"{row['angle_deg']:g}", *shares, *extremes])
    band = f"% over {values.wavelength_nm[0]:g} … {values.wavelength_nm[-1]:g} nm"
    heads = columns("angle [deg]", f"R [{band}]", "T [%]", "A [%]", "least R [% at nm]", "greatest R [% at nm]")
    return table_text(Table(heads, rows))


def _sample(values: CoatingSpectrum) -> str:
    """Table of R at some of the wavelengths: unpolarised, and s and p off normal incidence."""
    import numpy as np

    from mistray.toolkit.pages.model import Table, columns
    from mistray.toolkit.tables.text import table_text

    lam = values.wavelength_nm
    shown = np.unique(np.linspace(0, len(lam) - 1, min(ROWS_SHOWN, len(lam))).round().astype(int))
    heads = columns("wavelength [nm]")
    curves: list[np.ndarray] = []
    for k, angle in enumerate(values.angle_deg):
        heads += columns(f"R {angle:g}° [%]")
        curves.append(values.mean()[:, k])
        if angle > 0:
            heads += columns("s [%]", "p [%]")
            curves += [values.R[:, k, 0], values.R[:, k, 1]]
    rows = [[f"{lam[i]:g}", *(f"{100 * curve[i]:.4f}" for curve in curves)] for i in shown]
    return table_text(Table(heads, rows))

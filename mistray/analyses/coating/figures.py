"""Pictures of coatings: reflectance over wavelength and over angle, of one coating and of the surfaces of a scene.

Solid lines are the mean of s and p, dashed ones s, dotted ones p. The figures are not registered with
pyplot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator

from mistray.coatings import Bare, CoatingModel, CoatingSpectrum, spectrum
from mistray.coatings.stack import outside_first
from mistray.errors import MistrayError
from mistray.materials import complex_index
from mistray.toolkit.figures.figure import Figure, plain_axes
from mistray.toolkit.figures.palette import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

LINE_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
GREY = "#999999"
ANGLES_DRAWN = np.linspace(0.0, 90.0, 361)
MIRROR = 0.5  # mean reflectance above which a coating is drawn as a mirror
LOWEST = 1e-5  # floor of the logarithmic axis
ANGLE_AXIS: dict[str, Any] = {"xlim": (0, 90), "xticks": range(0, 91, 15)}


@dataclass(frozen=True)
class CoatedSurfaces:
    """
    Surfaces of a scene that have the same coating between the same materials.

    Attributes
    ----------
    names : tuple of str
        Shape ids.
    coating : CoatingModel
        Coating of all these surfaces.
    front, back : str
        Materials in front and behind.
    """

    names: tuple[str, ...]
    coating: CoatingModel
    front: str
    back: str


def coated_surfaces(scene: Any) -> list[CoatedSurfaces]:
    """
    Return the transparent and mirror surfaces of a scene, grouped by coating and materials.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.

    Raises
    ------
    MistrayError
        If the scene has no such surface.
    """
    groups: dict[tuple[Any, str, str], list[str]] = {}
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        if hasattr(bsdf, "coating") and (not bsdf.opaque or bsdf.mirror):
            groups.setdefault((bsdf.coating, bsdf.front, bsdf.back), []).append(str(shape.id()))
    if not groups:
        raise MistrayError("the scene has no optical surface with an 'interface' or a 'thinfilm'")
    return [CoatedSurfaces(tuple(names), *key) for key, names in groups.items()]


def coating_figure(
    coating: CoatingModel,
    wavelengths_nm: Sequence[float],
    angles_deg: Sequence[float],
    front: str = "air",
    back: str = "N-BK7",
    from_front: bool = True,
) -> Figure:
    """
    Draw the reflectance of one coating, %: R(λ) at several angles on the left, R(θ) at three wavelengths on the right.

    Parameters
    ----------
    coating : CoatingModel
        Coating to draw.
    wavelengths_nm : sequence of float
        Two or more wavelengths, nm; the right side takes the first, the middle and the last.
    angles_deg : sequence of float
        Angles in the medium of incidence, degrees.
    front, back, from_front
        Arguments of `mistray.coatings.spectrum`.

    Raises
    ------
    MistrayError
        If there are fewer than two wavelengths.
    """
    lam = np.asarray(wavelengths_nm, dtype=np.float64)
    if len(lam) < 2:
        raise MistrayError(f"a plot over wavelength needs two or more wavelengths, there is {len(lam)}; give more")
    setting = (front, back, from_front)
    figure, (left, right) = Figure.of_panels(10.4, 4.6, 1, 2)
    over_wavelength = spectrum(coating, lam, angles_deg, *setting)
    mirror = float(over_wavelength.mean()[:, 0].mean()) > MIRROR
    for k, angle in enumerate(angles_deg):
        _lines(left, lam, over_wavelength, (slice(None), k), LINE_COLOURS[k % len(LINE_COLOURS)], f"{angle:g}°")
    shown = lam[sorted({0, len(lam) // 2, len(lam) - 1})]
    over_angle = spectrum(coating, shown, ANGLES_DRAWN, *setting)
    for k, wavelength in enumerate(shown):
        _lines(right, ANGLES_DRAWN, over_angle, (k, slice(None)), LINE_COLOURS[k], f"{wavelength:g} nm")
    if not isinstance(coating, Bare) and not mirror:
        bare = spectrum(Bare(), lam, angles_deg[:1], *setting).mean()[:, 0]
        left.plot(lam, 100 * bare, color=GREY, lw=1.0, label=f"bare, {angles_deg[0]:g}°")
        middle = spectrum(Bare(), shown[len(shown) // 2 :][:1], ANGLES_DRAWN, *setting).mean()[0]
        right.plot(ANGLES_DRAWN, 100 * middle, color=GREY, lw=1.0, label="bare")
    left.set(xlabel="wavelength [nm]", xlim=lam[[0, -1]])
    right.set(xlabel=f"angle of incidence in {front if from_front else back} [deg]", **ANGLE_AXIS)
    total = not mirror and float(over_wavelength.mean().max()) > MIRROR  # beside total reflection all else is small
    _reflectance_axis(left, mirror, logarithmic=total)
    _reflectance_axis(right, mirror, logarithmic=not mirror)
    for axes in (left, right):
        plain_axes(axes, legend=True, ylabel="reflectance [%]")
    styles = [Line2D([], [], color=BLACK, ls=ls, lw=1.2) for ls in ("-", "--", ":")]
    figure.legend(styles, ["mean of s and p", "s", "p"], loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    sides = f"{front} | {back}" if from_front else f"{back} | {front}"
    figure.suptitle(f"{_title(coating)}, {sides}, light from {front if from_front else back}", fontsize=11)
    return figure


def surfaces_figure(
    surfaces: Sequence[CoatedSurfaces], wavelengths_nm: Sequence[float], angles_deg: Sequence[float]
) -> Figure:
    """
    Draw the reflectance, %, of the surfaces of a scene, one row per group.

    R(λ) is on the left at several angles, R(θ) on the right at the middle wavelength.

    Parameters
    ----------
    surfaces : sequence of CoatedSurfaces
        Groups of surfaces made by `coated_surfaces`.
    wavelengths_nm : sequence of float
        Two or more wavelengths, nm.
    angles_deg : sequence of float
        Angles in the material of lower index, degrees; the light comes from that side.

    Raises
    ------
    MistrayError
        If there are fewer than two wavelengths.
    """
    lam = np.asarray(wavelengths_nm, dtype=np.float64)
    if len(lam) < 2:
        raise MistrayError(f"a plot over wavelength needs two or more wavelengths, there is {len(lam)}; give more")
    middle = float(lam[len(lam) // 2])
    figure, rows = Figure.of_panels(10.4, 0.7 + 2.5 * len(surfaces), len(surfaces), 2, dpi=110, squeeze=False)
    figure.set_layout_engine("constrained", h_pad=0.1)
    for surface, (left, right) in zip(surfaces, rows, strict=True):
        from_front = outside_first(complex_index(surface.front, middle), complex_index(surface.back, middle))
        setting = (surface.front, surface.back, from_front)
        over_wavelength = spectrum(surface.coating, lam, angles_deg, *setting)
        over_angle = spectrum(surface.coating, [middle], ANGLES_DRAWN, *setting)
        mirror = float(over_wavelength.mean()[:, 0].mean()) > MIRROR
        for k, angle in enumerate(angles_deg):
            colour = LINE_COLOURS[k % len(LINE_COLOURS)]
            left.plot(lam, 100 * over_wavelength.mean()[:, k], color=colour, lw=1.2, label=f"{angle:g}°")
        _lines(right, ANGLES_DRAWN, over_angle, (0, slice(None)), BLUE, f"{middle:g} nm")
        left.set(xlim=lam[[0, -1]], ylabel="reflectance [%]")
        right.set(**ANGLE_AXIS)
        _reflectance_axis(left, mirror, logarithmic=False)
        _reflectance_axis(right, mirror, logarithmic=not mirror)
        left.set_title(_names(surface.names), fontsize=9, loc="left")
        right.set_title(f"{_title(surface.coating)}, {surface.front} | {surface.back}", fontsize=9, loc="right")
    for axes, label in zip(rows[-1], ("wavelength [nm]", "angle of incidence [deg]"), strict=True):
        axes.set_xlabel(label)
        plain_axes(left, legend=surface is surfaces[0])
        plain_axes(right, legend=surface is surfaces[0])
    return figure.small_print(
        "left: mean of s and p; right: mean solid, s dashed, p dotted; light from the side of lower index"
    )


def _lines(axes: Axes, x: np.ndarray, values: CoatingSpectrum, part: Any, colour: str, label: str) -> None:
    """
    Draw R, percent, against `x`, wavelengths or angles: the mean of s and p, and each alone if they differ.

    `part` indexes the spectrum by wavelength and angle.
    """
    axes.plot(x, 100 * values.mean()[part], color=colour, lw=1.4, label=label)
    s, p = values.R[..., 0][part], values.R[..., 1][part]
    if np.max(np.abs(s - p)) > 1e-9:
        axes.plot(x, 100 * s, color=colour, lw=0.8, ls="--")
        axes.plot(x, 100 * p, color=colour, lw=0.8, ls=":")


def _reflectance_axis(axes: Axes, mirror: bool, logarithmic: bool) -> None:
    if logarithmic:
        axes.set_yscale("log")
        axes.set_ylim(max(100 * LOWEST, axes.get_ylim()[0]), 110)
        axes.yaxis.set_major_locator(LogLocator(10))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    elif mirror:
        axes.set_ylim(top=100.5)
    else:
        axes.set_ylim(bottom=0)


def _title(coating: CoatingModel) -> str:
    return coating.name if len(coating.name) <= 60 else coating.name[:57] + "…"


def _names(names: Sequence[str]) -> str:
    text = ", ".join(names)
    return text if len(text) <= 70 else f"{', '.join(names[:3])} and {len(names) - 3} more"

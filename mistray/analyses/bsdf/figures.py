"""Pictures of scatter models: BSDF against |β - β0| and against the angle, in the plane of incidence.

The public functions return Matplotlib figures that are not registered with pyplot.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from mistray.errors import MistrayError
from mistray.physics import contamination
from mistray.physics.contamination import CLEANED_SLOPE
from mistray.scatter.scan import Scan
from mistray.toolkit.figures.figure import Figure, plain_axes
from mistray.toolkit.figures.palette import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

LINE_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
SAME_CURVE = 0.02  # relative difference of curves that are drawn as one
LEAST_R, MOST_LEAST_R = 1e-6, 1e-3  # bounds of the left end of the axis of |β - β0|
FLAT = 0.9  # of the peak; the axis begins at a third or less of where the curve falls to it
MOST_DECADES = 12
LEVELS_DRAWN = (100.0, 200.0, 300.0, 400.0, 500.0, 1000.0)
VISIBLE_PERCENT = 0.1  # rule of thumb


def bsdf_figure(scans: Sequence[Scan], title: str, knee: float | None = None) -> Figure:
    """
    Draw the BSDF (1/sr) of one event on two scales.

    β and β0 are the direction cosines along the surface of scattered and specular light.

    The left panel has it against |β - β0|, both axes logarithmic; a model that depends on |β - β0| alone is one curve
    there. The right panel has it against the angle of scatter, degrees, on a logarithmic axis, and the TIS, percent.

    Parameters
    ----------
    scans : sequence of Scan
        Scans made by `mistray.scatter.scan.scan`.
    title : str
        Title of the figure, to which the event is added.
    knee : float, optional
        |β - β0|, dimensionless, at which the BSDF bends, marked on the left. Default: no mark.

    Raises
    ------
    MistrayError
        If there is no scan, or the BSDF is 0 everywhere.
    """
    if not scans:
        raise MistrayError("a plot of a BSDF needs one or more angles of incidence")
    figure, (left, right) = Figure.of_panels(10.4, 4.8, 1, 2)
    one, dashed = _is_one_curve(scans), False
    for number, scan in enumerate(scans):
        colour, label = LINE_COLOURS[number % len(LINE_COLOURS)], _label(scan, scans)
        if not one:
            dashed |= _against_distance(left, scan, colour, label)
        right.plot(
            scan.theta_s_deg, _positive(scan), color=colour, lw=1.3, label=f"{label}: TIS {100 * scan.scattered:.4g} %"
        )
    if one:
        _against_distance(left, max(scans, key=lambda scan: scan.incidence_deg), BLUE, "all angles of incidence")
    if knee is not None:
        left.axvline(knee, color="#999999", lw=0.9, ls=":")
        left.annotate(
            f"knee {knee:.3g}", (knee, 0.02), xycoords=("data", "axes fraction"), xytext=(4, 0),
            textcoords="offset points", fontsize=8, color="#555555",
        )  # fmt: skip
    bottom, top = _range(scans)
    for axes in (left, right):
        axes.set(yscale="log", ylim=(bottom, top), ylabel="BSDF [1/sr]")
        axes.yaxis.set_major_locator(LogLocator(10, numticks=14))
        plain_axes(axes, legend=True)
    away = "; dashed: away from the normal" if dashed else ""
    left.set(xscale="log", xlim=(_first_distance(scans), 2), xlabel=f"|β - β0|{away}")
    left.xaxis.set_major_locator(LogLocator(10, numticks=14))
    left.xaxis.set_minor_formatter(NullFormatter())
    right.set(xlim=(-90, 90), xticks=range(-90, 91, 30), xlabel="angle of scatter [deg]")
    figure.suptitle(f"{title}, {scans[0].event}", fontsize=11)
    return figure


def _label(scan: Scan, scans: Sequence[Scan]) -> str:
    """Return the label of a curve: angle of incidence, degrees, and the sample's azimuth if scans differ in it."""
    turned = any(other.rotation_deg != scan.rotation_deg for other in scans)
    return f"{scan.incidence_deg:g}°" + (f", sample {scan.rotation_deg:g}°" if turned else "")


def _against_distance(axes: Axes, scan: Scan, colour: str, label: str) -> bool:
    """
    Draw a BSDF against |β - β0|; return True if it needs two curves.

    Scatter at angles up to the specular one, also across the normal, is solid. Scatter beyond it is dashed. It is drawn
    only if it differs somewhere by more than 2 % from the solid curve.
    """
    inner = scan.theta_s_deg <= scan.specular_deg
    axes.plot(scan.distance[inner], _positive(scan)[inner], color=colour, lw=1.4, label=label)
    outer = ~inner
    if np.count_nonzero(outer) < 2:
        return False
    order = np.argsort(scan.distance[inner])
    expected = np.interp(scan.distance[outer], scan.distance[inner][order], scan.values[inner][order])
    if np.all(np.abs(scan.values[outer] - expected) <= SAME_CURVE * expected):
        return False
    axes.plot(scan.distance[outer], _positive(scan)[outer], color=colour, lw=0.9, ls="--")
    return True


def _positive(scan: Scan) -> np.ndarray:
    """Return the BSDF, 1/sr, with NaN in place of 0, so that a curve on a logarithmic axis ends there."""
    return np.where(scan.values > 0, scan.values, np.nan)


def _is_one_curve(scans: Sequence[Scan]) -> bool:
    """True if the BSDF of all scans depends on |β - β0| alone, to within 2 %."""
    widest = max(scans, key=lambda scan: scan.incidence_deg)
    order = np.argsort(widest.distance)
    r, f = widest.distance[order], widest.values[order]
    for scan in scans:
        expected = np.interp(scan.distance, r, f)
        if np.any(np.abs(scan.values - expected) > SAME_CURVE * expected):
            return False
    return True


def _first_distance(scans: Sequence[Scan]) -> float:
    """
    Return the left end of the axis of |β - β0|, a power of ten from `LEAST_R` to `MOST_LEAST_R`.

    Between these bounds it is a third or less of the place where a BSDF has first dropped by 10 %.
    """
    falls = [scan.distance[scan.values < FLAT * scan.values[np.argmin(scan.distance)]] for scan in scans]
    nearest = min((float(np.min(part[part > 0])) for part in falls if np.any(part > 0)), default=MOST_LEAST_R)
    return float(np.clip(10.0 ** np.floor(np.log10(nearest / 3)), LEAST_R, MOST_LEAST_R))


def _range(scans: Sequence[Scan]) -> tuple[float, float]:
    """
    Return the lower and upper end of the BSDF axis, 1/sr, at most 12 decades apart.

    Raises
    ------
    MistrayError
        If the BSDF is 0 everywhere.
    """
    values = np.concatenate([scan.values for scan in scans])
    values = values[values > 0]
    if not len(values):
        raise MistrayError("the BSDF is 0 everywhere; there is nothing to draw")
    top = 10.0 ** np.ceil(np.log10(values.max()) + 0.1)
    low, high = np.log10(values.min()) - 0.1, np.log10(top)
    return float(max(10.0 ** np.floor(low), 10.0 ** (high - MOST_DECADES))), float(top)


def particles_figure(level: float, slope: float = CLEANED_SLOPE) -> Figure:
    """
    Draw the particles of a cleanliness level: counts by diameter (µm), and the percentage of area that levels cover.

    Parameters
    ----------
    level : float
        Cleanliness level, drawn thick among the levels of `LEVELS_DRAWN`.
    slope : float
        Slope of the size distribution. The area is that of spheres of this distribution, which the scatter models use.
        At a slope of 0.926 that of the standard's formula, 7.6 % more, is drawn as well.
    """
    figure, (left, right) = Figure.of_panels(10.4, 4.4, 1, 2)
    levels = sorted({*LEVELS_DRAWN, float(level)})
    for number, one in enumerate(levels):
        diameter = np.geomspace(1, one, 200)
        own = one == level
        colour = BLACK if own else LINE_COLOURS[number % (len(LINE_COLOURS) - 1)]
        left.plot(
            diameter, contamination.count(diameter, one, slope), color=colour, lw=2.0 if own else 1.1,
            label=f"level {one:g}",
        )  # fmt: skip
    left.set(xlabel="particle diameter D [µm]", ylabel="particles larger than D on 0.1 m²")
    left.set(xlim=(1, levels[-1] * 1.1), ylim=(0.5, None))
    all_levels = np.geomspace(10, 1000, 100)
    spheres = [contamination.coverage_percent(one, slope) for one in all_levels]
    right.plot(all_levels, spheres, color=BLUE, lw=1.4, label="spheres of the distribution")
    if slope == CLEANED_SLOPE:
        standard = contamination.standard_coverage_percent(all_levels)
        right.plot(all_levels, standard, color=VERMILION, lw=1.1, ls="--", label="formula of the standard")
    covered = contamination.coverage_percent(level, slope)
    right.plot([level], [covered], "o", color=BLACK, label=f"level {level:.4g}: {covered:.4g} %")
    right.axhline(VISIBLE_PERCENT, color="#999999", lw=0.9, ls=":")
    right.annotate("seen by the naked eye", (10.5, 1.25 * VISIBLE_PERCENT), fontsize=8, color="#555555")
    right.set(xlabel="cleanliness level", ylabel="percent area coverage [%]", xlim=(10, 1000))
    for axes in (left, right):
        axes.set(xscale="log", yscale="log")
        axes.yaxis.set_major_locator(LogLocator(10, numticks=14))
        plain_axes(axes, legend=True)
    figure.suptitle(f"Particles of level {level:.4g}, slope {slope:g}", fontsize=11)
    return figure

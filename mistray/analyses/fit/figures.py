"""Picture of a fit: its residuals."""

from __future__ import annotations

import numpy as np

from mistray.analyses.fit.run import Fit
from mistray.toolkit.figures.figure import Figure, plain_axes
from mistray.toolkit.figures.palette import BLACK, BLUE


def residual_figure(found: Fit, title: str = "") -> Figure:
    """Draw the residuals (observed minus modelled) in standard errors, against the index of the datum, from 1."""
    made, axes = Figure.of_panels(8.6, 3.6)
    pulls = found.residual / np.sqrt(np.diag(found.noise))
    axes.axhspan(-1, 1, color="#eeeeee", zorder=0)
    axes.axhline(0, color=BLACK, lw=0.8)
    axes.plot(np.arange(1, len(pulls) + 1), pulls, ls="", marker="o", ms=4, color=BLUE)
    plain_axes(axes, below=True, xlabel="number of the datum", ylabel="residual / standard error")
    how = f"χ² = {found.chi_square:.4g} with {found.degrees} degrees of freedom; grey: ± one standard error"
    return made.headed(title, "observed less modelled", how)

"""Result of a sensitivity analysis: ranking, spread, proposed changes and perturbed systems."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from mistray.analyses.sensitivity.changes import ParameterChange
from mistray.analyses.sensitivity.draws import Draws
from mistray.analyses.sensitivity.propagation import MetricSpread
from mistray.analyses.sensitivity.rows import SensitivityRow
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.metrics.changes.first_surfaces import Entering, spoils
from mistray.metrics.changes.gaps import Gap
from mistray.result import KeyNumber, Result
from mistray.toolkit.rows import frame

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Together:
    """
    Combination of a few parameter changes, and its effect on the metric.

    Attributes
    ----------
    changes : tuple of (SensitivityRow, ParameterChange)
        Changes, the largest effect first; empty if no derivative is known well enough.
    factor : float
        Factor by which the metric is smaller, by the model, dimensionless.
    reached : bool
        Whether `factor` is the factor requested.
    traced : Estimate or None
        The factor from traces of the changed scene with other seeds; None if they were not requested, or there was no
        time for them.
    image : Estimate or None
        Power of the direct image over that before, dimensionless, at the sources' own field, from traces as well; None
        without a direct image or without traces.
    gaps : tuple of Gap
        Surfaces that meet before and are apart after, see `mistray.metrics.changes.gaps`.
    entering : mapping of str to tuple of Entering
        Surfaces that light newly meets first after the changes, by field angle in words.
    """

    changes: tuple[tuple[SensitivityRow, ParameterChange], ...]
    factor: float
    reached: bool
    traced: Estimate | None = None
    image: Estimate | None = None
    gaps: tuple[Gap, ...] = ()
    entering: Mapping[str, tuple[Entering, ...]] = field(default_factory=dict)

    @property
    def spoiled(self) -> bool:
        """True if so much light enters by new surfaces that a smaller metric is no improvement."""
        return any(spoils(entering) for entering in self.entering.values())


@dataclass(frozen=True, repr=False)
class Sensitivity(Result, table=".page:ranking_table", figure=".figures:ranking_figure"):
    """
    Result of `sensitivity`: ranked parameters, proposed changes, and spread of the metric.

    Attributes
    ----------
    name, unit : str
        Name and unit of the metric.
    value : Estimate
        Value of the metric, in its unit.
    rows : tuple of SensitivityRow
        Parameters, the largest change per tolerance first.
    spread : MetricSpread
        Linear propagation of all tolerances.
    factor : float
        Requested factor by which the changes shall lower the metric, dimensionless.
    together : Together
        The best combination of at most three changes.
    draws : Draws or None
        Monte Carlo of perturbed systems; None if not requested, or if there was no time for two.
    not_traced : tuple of str
        Requested parts for which there was no time, in words.
    left_out : tuple of str
        Effects that the derivatives do not contain.
    edge_width : float or None
        Width of the smoothing zones at rims, over their radii; None if no ray near a rim counts.
    without_derivative : tuple of str
        Keys of scene parameters that have no derivative.
    seconds : (float, float)
        Times of the primal and of the reverse run of the gradient, s.
    facts : dict
        Settings and facts of the computation, as plain values.

    Examples
    --------
    >>> ghosts = mistray.optimize.path_power(mistray.load("lens_and_window"), "ghost", rays=5000)
    >>> found = mistray.sensitivity(ghosts, keys=["detector.bsdf.R", "*.n_back_shift"], check=False)
    >>> row = found["detector.bsdf.R"]
    >>> print(f"d/dR = {row.derivative.value:.3f}; R = 0 lowers the ghosts by {row.to_factor:.1f}")
    d/dR = 0.031; R = 0 lowers the ghosts by 1.6
    >>> table = found.to_pandas()
    """

    name: str
    unit: str
    value: Estimate
    rows: tuple[SensitivityRow, ...]
    spread: MetricSpread
    factor: float
    together: Together
    draws: Draws | None = None
    not_traced: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    edge_width: float | None = None
    without_derivative: tuple[str, ...] = ()
    seconds: tuple[float, float] = (0.0, 0.0)
    facts: dict[str, Any] = field(default_factory=dict)

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the metric, the number of parameters, and the metric's spread by all tolerances in %, by label."""
        unit = f" [{self.unit}]" if self.unit else ""
        spread = self.spread.deviation.times(100)
        return {f"{self.name}{unit}": self.value, "parameters": len(self.rows), "spread [%]": spread}

    def __getitem__(self, label: str) -> SensitivityRow:
        """Return the row of the parameter with a given label; raise `MistrayError` if there is none."""
        for row in self.rows:
            if row.label == label:
                return row
        raise MistrayError(f"the table has no parameter '{label}'; see [row.label for row in result.rows]")

    def to_pandas(self) -> pd.DataFrame:
        """Return the rows as a frame, in the order of `rows`, with the columns of `SensitivityRow`."""
        return frame(SensitivityRow, self.rows)

    def __str__(self) -> str:
        return self.to_pandas().to_string(index=False)

"""First-level analysis: comparison of light scattered once, ghosts alone, and all light.

The scene is not changed; the limits of the trace are. Other programs call these limits the levels of scatter and of
specular ancestry that a ray may have.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from mistray.analyses.pst.request import FirstLevelRequest, PstRequest
from mistray.analyses.pst.result import Pst
from mistray.analyses.pst.run import run as pst
from mistray.result import KeyNumber, Result
from mistray.settings import Settings
from mistray.toolkit.analysis import analysis

if TYPE_CHECKING:
    import pandas as pd

LIMITS: dict[str, dict[str, int]] = {
    "scatter once": {"max_scatters": 1, "max_reflections": 0},
    "ghosts off": {"max_reflections": 0},
    "scatter off": {"max_scatters": 0},
    "all": {},
}
Progress = Callable[[str, Any], None]


@dataclass(frozen=True, eq=False, repr=False)
class FirstLevel(Result, table=".tables:level_table", figure=".figures:level_curves"):
    """
    Point source transmittances (PSTs) of one scene, one for each set of limits on its paths.

    Attributes
    ----------
    curves : dict of str to Pst
        Name of the set → its PST, dimensionless. Sets that result in the same limits share one.
    limits : dict of str to dict of str to int
        Name of the set → limits that it changes, numbers of events.

    Examples
    --------
    >>> limits = {"scatter off": {"max_scatters": 0}, "all": {}}
    >>> found = mistray.first_level(mistray.load("plate_and_wall"), [30], rays=10_000, limits=limits)
    >>> mistray.report.with_error(found.curves["all"].estimates("stray")[0])
    '2.904e-03 ± 5.8e-05'
    """

    curves: dict[str, Pst]
    limits: dict[str, dict[str, int]]

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the number of field angles, and the stray PST of each set of limits at the largest angle, by label."""
        angles = next(iter(self.curves.values())).field_deg
        last = {f"{name} at {angles[-1]:g}° [1]": one.estimates("stray")[-1] for name, one in self.curves.items()}
        return {"angles": len(angles), **last}

    def to_pandas(self, classes: str = "stray") -> pd.DataFrame:
        """
        Return the PSTs over field angle as a table: a row for each angle, columns for each set of limits.

        Parameters
        ----------
        classes : str
            "stray", "total" or a class of light, see `Pst.curve`.

        Returns
        -------
        DataFrame
            Columns angle_deg, and for each set its PST and standard error (``…_se``).
        """
        import pandas as pd

        first = next(iter(self.curves.values()))
        columns: dict[str, np.ndarray] = {"angle_deg": first.field_deg}
        for name, curve in self.curves.items():
            columns[name], columns[f"{name}_se"] = curve.curve(classes)
        return pd.DataFrame(columns)


def run(
    scene: mi.Scene, request: FirstLevelRequest, *, progress: Progress | None = None, seconds: float | None = None
) -> FirstLevel:
    """
    Compute the PST for sets of limits, by default: scatter once without ghosts, ghosts off, scatter off, all light.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    request : FirstLevelRequest
    progress : callable, optional
        Called with the name of a set and the progress that `mistray.pst` reports.
    seconds : float, optional
        Time limit of each PST, s, see `mistray.pst`.

    Raises
    ------
    MistrayError
        If the limits are empty or one is unknown, or `mistray.pst` raises it.

    Examples
    --------
    >>> found = mistray.first_level(mistray.load("plate_and_wall"), [30], rays=10_000)
    >>> for name, pst in found.curves.items():
    ...     print(f"{name}: {pst.curve('stray')[0][0]:.1e}")
    scatter once: 2.8e-03
    ghosts off: 2.8e-03
    scatter off: 0.0e+00
    all: 2.9e-03
    """
    shared = PstRequest(**{one.name: getattr(request, one.name) for one in fields(PstRequest)})
    chosen = {name: dict(change) for name, change in (request.limits or LIMITS).items()}
    done: dict[Settings, Pst] = {}
    curves = {}
    # One PST for all sets of equal settings
    for name, change in chosen.items():
        limits = {**shared.settings, **change}
        one = replace(shared, rays=limits.pop("rays", shared.rays), settings=limits)
        settings = one.settings_for(scene)
        if settings not in done:
            # The name is bound now: the loop variable changes
            report = (lambda state, name=name: progress(name, state)) if progress else None
            done[settings] = pst(scene, one, progress=report, seconds=seconds)
        curves[name] = done[settings]
    return FirstLevel(curves, chosen)


first_level = analysis("first_level", FirstLevelRequest, run)

"""First-level analysis: comparison of light scattered once, ghosts alone, and all light.

The scene is not changed; the limits of the trace are. Other programs call these limits the levels of scatter and of
specular ancestry that a ray may have.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from mistray.analyses.pst.result import Pst
from mistray.analyses.pst.run import pst
from mistray.errors import MistrayError
from mistray.notes import warns
from mistray.scene.check import require_scene
from mistray.settings import Settings

if TYPE_CHECKING:
    import pandas as pd

LIMITS: dict[str, dict[str, int]] = {
    "scatter once": {"max_scatters": 1, "max_reflections": 0},
    "ghosts off": {"max_reflections": 0},
    "scatter off": {"max_scatters": 0},
    "all": {},
}
Progress = Callable[[str, Any], None]


@dataclass(frozen=True, eq=False)
class FirstLevel:
    """
    Point source transmittances (PSTs) of one scene, one for each set of limits on its paths.

    Attributes
    ----------
    curves : dict
        Name of the set → Pst. Sets that result in the same limits share one.
    limits : dict
        Name of the set → limits that it changes.
    """

    curves: dict[str, Pst]
    limits: dict[str, dict[str, int]]

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


@warns
def first_level(
    scene: mi.Scene,
    field_deg: Any = range(0, 81, 2),
    *,
    limits: Mapping[str, Mapping[str, int]] | None = None,
    progress: Progress | None = None,
    **arguments: Any,
) -> FirstLevel:
    """
    Compute the PST for sets of limits, by default: scatter once without ghosts, ghosts off, scatter off, all light.

    Parameters
    ----------
    scene : mi.Scene
    field_deg : float or sequence of float
        Field angles, degrees.
    limits : mapping, optional
        Other sets: name → limits of `mistray.trace.Settings` that it changes. Default: `LIMITS`.
    progress : callable, optional
        Called with the name of a set and the progress that `mistray.pst` reports.
    **arguments
        Arguments of `mistray.pst`, the same for all sets; a limit given here holds where a set does not change it.

    Raises
    ------
    MistrayError
        If a limit is empty or unknown, or `mistray.pst` raises it.
    """
    require_scene(scene, "first_level")
    # Sets of limits
    chosen = {name: dict(change) for name, change in (LIMITS if limits is None else limits).items()}
    if not chosen:
        raise MistrayError("first_level: limits is empty; give at least one set of limits")
    # Limits among the arguments hold for every set
    known = set(Settings.__dataclass_fields__)
    own = {key: value for key, value in arguments.items() if key in known}
    done: dict[Settings, Pst] = {}
    curves = {}
    # One PST for all sets of equal settings
    for name, change in chosen.items():
        unknown = set(change) - known
        if unknown:
            raise MistrayError(
                f"first_level: '{name}' changes {', '.join(sorted(unknown))}, which is no limit of a trace"
            )
        settings = Settings.without_sources(scene, "a PST", **(own | change))
        if settings not in done:
            # The name is bound now: the loop variable changes
            report = (lambda state, name=name: progress(name, state)) if progress else None
            done[settings] = pst(scene, field_deg, progress=report, **(arguments | change))
        curves[name] = done[settings]
    return FirstLevel(curves, chosen)
